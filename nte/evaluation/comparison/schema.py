"""The schema of a comparison: what is trained, what is evaluated, and what is printed of it."""

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

from omegaconf import MISSING

from nte.config import to_yaml

RUN_OF = re.compile(r"\{(.*?)\}")  # stands for the run of a network


@dataclass
class Network:
    """A network that the comparison trains, once for each seed."""

    config: str = MISSING  # training configuration; relative to the comparison's file
    overrides: list[str] = field(default_factory=list)  # key=value, after those of the comparison
    seeds: list[int] | None = None  # None takes those of the comparison


@dataclass
class Situation:
    """What is evaluated together: clips and methods."""

    name: str = MISSING  # also the folder of its report
    clips: list[str] = field(default_factory=list)  # patterns below the folder of the data, such as test/fence_*
    light: str = "color"  # the component that it is about
    region: str = "all"  # the pixels that it is about
    methods: dict[str, str] = field(default_factory=dict)  # title → denoiser; {title} in it is the run of a network
    networks: list[str] = field(default_factory=list)  # titles of the comparison's networks
    first: int | None = None  # index of the first frame that is scored; None takes that of the comparison
    pictures: int = 8  # number of clips that the report has pictures of, spread evenly

    @property
    def titles(self) -> list[str]:
        """Titles of all methods, in order."""
        return [*self.methods, *self.networks]

    @property
    def runs(self) -> dict[str, str]:
        """Title of each method that uses the run of a network, such as composite:…,indirect=[{C}] → that network."""
        named = {title: RUN_OF.search(spec) for title, spec in self.methods.items()}
        return {title: found[1] for title, found in named.items() if found} | {title: title for title in self.networks}

    def with_run(self, title: str, run: str) -> str:
        """Return the denoiser of a method with the folder of a run in the place of its network."""
        return RUN_OF.sub(lambda _: run, self.methods[title]) if title in self.methods else run


@dataclass
class Columns:
    """A part of a table: metrics of some clips, in some pixels, of a light."""

    title: str = ""  # empty: light and region
    clips: list[str] = field(default_factory=list)  # patterns as in a situation; none: all of its clips
    light: str = ""  # empty: that of the situation
    region: str = "all"
    first: int | None = None  # index of the first frame that counts; None: the first that is scored
    metrics: list[str] = field(default_factory=lambda: ["psnr", "ssim", "l1", "mse", "flip", "temporal_l1"])
    margins: list[str] = field(default_factory=list)  # metrics whose difference from `against` gets an interval


@dataclass
class Table:
    """What is printed: a line for each method, and parts beside each other."""

    name: str = MISSING
    situation: str = MISSING  # whose clips and methods are shown
    caption: str = ""
    methods: list[str] = field(default_factory=list)  # titles; none: all of the situation
    against: str | None = None  # title of the method that others are compared with; None: that of the comparison
    columns: list[Columns] = field(default_factory=lambda: [Columns()])


@dataclass
class Plot:
    """Metrics of every frame of one clip, as a figure."""

    name: str = MISSING  # of the file, without .svg
    situation: str = MISSING
    clip: str = MISSING  # a pattern that one clip matches
    light: str = ""  # empty: that of the situation
    region: str = "all"
    first: int | None = None  # index of the first frame that is drawn
    metrics: list[str] = field(default_factory=lambda: ["ssim", "mse"])
    methods: list[str] = field(default_factory=list)  # titles; none: all of the situation


@dataclass
class Comparison:
    """A comparison on rendered clips, as read from YAML."""

    recipes: dict[str, str] = field(default_factory=dict)  # folder below the data's → recipe, relative to this file
    lists: dict[str, list[str]] = field(default_factory=dict)  # name → clips, or titles, that others use: ${lists.name}
    first: int = 1  # index of the first frame that is scored; before it, histories are still short
    against: str = ""  # title of the method that all others are compared with, clip by clip
    train: list[str] = field(
        default_factory=list
    )  # folders of training clips, below the data's; none: the configs' own
    seeds: list[int] = field(default_factory=list)  # of the networks
    overrides: list[str] = field(default_factory=list)  # key=value for every network
    networks: dict[str, Network] = field(default_factory=dict)  # title → network
    situations: list[Situation] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)  # none: one for each situation
    plots: list[Plot] = field(default_factory=list)

    def situation(self, name: str) -> Situation:
        """Return the situation with this name."""
        return next(situation for situation in self.situations if situation.name == name)

    def seeds_of(self, title: str) -> list[int]:
        """Return the seeds of a network."""
        own = self.networks[title].seeds
        return self.seeds if own is None else own

    def evaluated(self) -> str:
        """Return all that is evaluated as YAML text, without what is only printed and without folders."""
        networks = {title: replace(n, config=Path(n.config).name) for title, n in self.networks.items()}
        return to_yaml(replace(self, recipes={}, networks=networks, tables=[], plots=[], against=""))
