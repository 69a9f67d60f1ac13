"""The schema of a comparison: what is trained, what is evaluated, and what is printed of it."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from omegaconf import MISSING

from nte.config import load_config, to_yaml
from nte.errors import NteError
from nte.evaluation.metric_table import METRICS
from nte.evaluation.metrics import REGIONS
from nte.files import is_folder_name
from nte.frames.channels import TARGETS

_NAMES = tuple(metric.name for metric in METRICS)
_RUN_OF = re.compile(r"\{(.*?)\}")  # stands for the run of a network


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
        named = {title: _RUN_OF.search(spec) for title, spec in self.methods.items()}
        return {title: found[1] for title, found in named.items() if found} | {title: title for title in self.networks}

    @property
    def untrained(self) -> list[str]:
        """Denoisers of all methods that use no network."""
        return [spec for title, spec in self.methods.items() if title not in self.runs]

    def with_run(self, title: str, run: str) -> str:
        """Return the denoiser of a method with the folder of a run in the place of its network."""
        return _RUN_OF.sub(lambda _: run, self.methods[title]) if title in self.methods else run


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


def read_comparison(path: Path) -> Comparison:
    """Read and check a comparison; recipes and training configurations become paths that can be opened.

    Paths of a `base` (nte.config) are relative to this file, too.

    Raises NteError, naming the file and the key, for a comparison that is not valid.
    """
    comparison = load_config(Comparison, path, check=_check)
    comparison.recipes = {folder: str(path.parent / recipe) for folder, recipe in comparison.recipes.items()}
    for network in comparison.networks.values():
        network.config = str(path.parent / network.config)
    if not comparison.tables:
        comparison.tables = [_whole(situation, comparison.against) for situation in comparison.situations]
    return comparison


def _whole(situation: Situation, against: str) -> Table:
    """The table of a situation: RMSE and SSIM of its light, also in its region, and of the composite."""
    parts = dict.fromkeys([(situation.light, "all"), (situation.light, situation.region), ("color", "all")])
    columns = [Columns(light=light, region=region, metrics=["rmse", "ssim"]) for light, region in parts]
    for part in columns:
        if against and (part.light, part.region) == (situation.light, situation.region):
            part.margins = ["rmse"]
    return Table(situation.name, situation.name, against=against, columns=columns)


def _check(comparison: Comparison) -> None:
    for folder in comparison.recipes:
        if Path(folder).is_absolute() or ".." in Path(folder).parts:
            raise NteError(f"recipes: '{folder}' leads out of the data's folder: expected a folder in it, or .")
    if not comparison.situations:
        raise NteError("'situations' is empty: expected at least one")
    for title in comparison.networks:
        _check_network(comparison, title)
    for number, situation in enumerate(comparison.situations):
        _check_situation(f"situations[{number}]", situation, comparison)
    _refuse_twice("two situations are called", [situation.name for situation in comparison.situations])
    for key, entries in (("tables", comparison.tables), ("plots", comparison.plots)):
        _refuse_twice(f"two {key} are called", [entry.name for entry in entries])
    for number, table in enumerate(comparison.tables):
        _check_table(f"tables[{number}]", table, comparison)
    for number, plot in enumerate(comparison.plots):
        where = f"plots[{number}]"
        if not is_folder_name(plot.name):
            raise NteError(f"{where}.name is {plot.name!r:.60}: expected the name of a file")
        _check_selection(where, plot.situation, plot.methods, plot.light, plot.region, comparison)
        _check_numbers(where, plot.metrics, plot.first, comparison.situation(plot.situation))


def _check_network(comparison: Comparison, title: str) -> None:
    seeds, where = comparison.seeds_of(title), f"networks.{title}"
    if not seeds:
        raise NteError(f"{where}: 'seeds' is empty: expected at least one, here or for all networks")
    if outside := [seed for seed in seeds if not 0 <= seed < 2**32]:
        raise NteError(f"{where}: the seed {outside[0]}: expected 0 to {2**32 - 1}")
    if twice := [seed for seed in seeds if seeds.count(seed) > 1]:
        raise NteError(f"{where}: the seed {twice[0]} is given twice: expected each once")
    if not is_folder_name(f"{title}_seed{max(seeds)}"):
        raise NteError(f"networks: the title {title!r:.60} cannot name a run's folder: expected one word or some")


def _check_situation(where: str, situation: Situation, comparison: Comparison) -> None:
    situation.first = comparison.first if situation.first is None else situation.first
    if situation.first < 0:
        raise NteError(f"{where}.first is {situation.first}: expected the index of a frame, 0 or more")
    if situation.pictures < 1:
        raise NteError(f"{where}.pictures is {situation.pictures}: expected a number of clips, 1 or more")
    _one_of(f"{where}.light", situation.light, TARGETS)
    _one_of(f"{where}.region", situation.region, REGIONS)
    if not is_folder_name(situation.name):
        raise NteError(f"{where}.name is {situation.name!r:.60}: expected the name of a folder")
    if not situation.clips:
        raise NteError(f"{where}.clips is empty: expected at least one")
    if not situation.titles:
        raise NteError(f"{where}.methods is empty: expected at least one, or networks")
    for title, network in situation.runs.items():
        place = "networks" if title in situation.networks else f"methods.{title}"
        _known(f"{where}.{place}", network, comparison.networks, "network")
    for title, spec in situation.methods.items():
        if len(networks := set(_RUN_OF.findall(spec))) > 1:
            raise NteError(f"{where}.methods.{title} uses {' and '.join(sorted(networks))}: expected one network")
    _refuse_twice(f"{where}: two methods are called", situation.titles)
    _refuse_twice(f"{where}: two methods are the denoiser", list(situation.methods.values()))
    if comparison.against and not comparison.tables and comparison.against not in situation.titles:
        known = ", ".join(situation.titles)
        raise NteError(f"{where}.methods lacks '{comparison.against}', named by 'against'; it has {known}")


def _check_table(where: str, table: Table, comparison: Comparison) -> None:
    if table.against is None:
        table.against = comparison.against
    if not table.columns:
        raise NteError(f"{where}.columns is empty: expected at least one part")
    for number, part in enumerate(table.columns):
        here = f"{where}.columns[{number}]"
        _check_selection(where, table.situation, table.methods, part.light, part.region, comparison, here)
        situation = comparison.situation(table.situation)
        _check_numbers(here, [*part.metrics, *part.margins], part.first, situation)
        if part.margins and not table.against:
            raise NteError(f"{here}.margins: no method to compare with: set 'against'")
    if table.against:
        _known(f"{where}.against", table.against, situation.titles, "method")


def _check_selection(
    where: str, name: str, methods: list[str], light: str, region: str, comparison: Comparison, part: str = ""
) -> None:
    """Raise NteError for a situation, a method, a light or a region that is not there."""
    _known(f"{where}.situation", name, [situation.name for situation in comparison.situations], "situation")
    for title in methods:
        _known(f"{where}.methods", title, comparison.situation(name).titles, "method")
    _one_of(f"{part or where}.light", light or "color", TARGETS)
    _one_of(f"{part or where}.region", region, REGIONS)


def _check_numbers(where: str, metrics: list[str], first: int | None, situation: Situation) -> None:
    if not metrics:
        raise NteError(f"{where}.metrics is empty: expected some of {', '.join(_NAMES)}")
    for name in metrics:
        _one_of(f"{where}: a metric", name, _NAMES)
    assert situation.first is not None
    if first is not None and first < situation.first:
        raise NteError(
            f"{where}.first is {first}, but situation '{situation.name}' is scored from frame {situation.first} on"
        )


def _one_of(what: str, value: str, allowed: Iterable[str]) -> None:
    if value not in allowed:
        raise NteError(f"{what} is '{value}': expected one of {', '.join(allowed)}")


def _known(where: str, name: str, known: Iterable[str], kind: str) -> None:
    if name not in known:
        raise NteError(f"{where}: there is no {kind} '{name}': expected one of {', '.join(known) or 'none'}")


def _refuse_twice(what: str, names: list[str]) -> None:
    if twice := [name for name in names if names.count(name) > 1]:
        raise NteError(f"{what} '{twice[0]}': expected a name of its own for each")
