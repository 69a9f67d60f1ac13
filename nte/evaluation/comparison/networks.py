"""The networks of a comparison: a training for each network and seed, as a unit of work for `nte.jobs`."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from nte.cluster import on_cluster
from nte.config import to_yaml
from nte.errors import NteError, naming
from nte.evaluation.comparison.schema import Comparison
from nte.evaluation.units import share_threads
from nte.files import make_folder
from nte.jobs import Kind, in_processes
from nte.models.registry import make_network
from nte.training.checkpoint import PLAIN, module_state, write_checkpoint
from nte.training.clips import BrokenClipWarning
from nte.training.config import TrainConfig, load_train_config
from nte.training.initial import begin_with, read_weights
from nte.training.loop import train
from nte.training.material import needed_channels, open_material
from nte.training.run import DECODED
from nte.version import DENOISING, versions_of


@dataclass(frozen=True)
class Training:
    """One network with one seed. Its run folder is `config.runs`/`config.name`."""

    title: str
    seed: int
    config: TrainConfig
    device: str

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.config.name

    @property
    def folder(self) -> Path:
        """The run folder."""
        return Path(self.config.runs) / self.config.name


def trainings(comparison: Comparison, data: Path, runs: Path, device: str) -> list[Training]:
    """Make the trainings of all networks and seeds that a situation names; runs lie in the folder `runs`.

    Raises NteError for a configuration that does not load, for losses that the network cannot have, and for weights of
    `init_from` that do not fit.
    """
    wanted = dict.fromkeys(title for situation in comparison.situations for title in situation.runs.values())
    found = []
    for title in wanted:
        network = comparison.networks[title]
        for seed in comparison.seeds_of(title):
            with naming(f"networks.{title}"):
                config = load_train_config(Path(network.config), [*comparison.overrides, *network.overrides])
            config.seed, config.name, config.runs = seed, f"{title}_seed{seed}", str(runs)
            config.resume = True
            if comparison.train:
                config.data.clips = [str(data / folder) for folder in comparison.train]
            found.append(Training(title, seed, config, device))
    for unit in one_of_each(found):
        with naming(f"networks.{unit.title}"):
            _require_consistent(unit.config, runs)
    return found


def one_of_each(units: Iterable[Training]) -> list[Training]:
    """Return one training of each network: its seeds differ in nothing else."""
    found: dict[str, Training] = {}
    for unit in units:
        found.setdefault(unit.title, unit)
    return list(found.values())


def _require_consistent(config: TrainConfig, runs: Path) -> None:
    denoiser = make_network(config.network)
    needed_channels(denoiser, config)
    source = Path(config.init_from)
    if config.init_from and runs.resolve() not in source.resolve().parents:  # a run of this comparison may come first
        begin_with(denoiser, read_weights(source))


@contextmanager
def stand_ins(units: Iterable[Training]) -> Iterator[dict[str, str]]:
    """Make a run with new weights for each network, so that methods with it can be loaded before it is trained.

    Yields title → folder; the folders are removed after the block.
    """
    with TemporaryDirectory(prefix="nte_") as folder:
        found = {}
        for unit in one_of_each(units):
            run = Path(folder, unit.name)
            make_folder(run)
            (run / "config.yaml").write_text(to_yaml(replace(unit.config, resume=False)), encoding="utf-8")
            write_checkpoint(run, 0, module_state(PLAIN, make_network(unit.config.network)))
            found[unit.title] = str(run)
        yield found


def require_clips(units: Iterable[Training]) -> None:
    """Open the training clips of all networks, and warn once of each that is left out by all.

    Raises NteError if they do not fit a network, and if two networks with the same folders would learn from other
    clips, of which one cannot use some: then their comparison would not be about the networks.
    """
    told: dict[str, Warning] = {}
    seen: dict[str, tuple[str, list[Path], list[str]]] = {}
    for unit in one_of_each(units):
        with naming(f"networks.{unit.title}"), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            material = open_material(unit.config, make_network(unit.config.network), unit.folder / DECODED)
        clips, said = [clip.folder for clip in material.data.clips], [str(warning.message) for warning in caught]
        told |= {str(w.message): w.message for w in caught if isinstance(w.message, BrokenClipWarning)}
        other, theirs, said_there = seen.setdefault(repr(unit.config.data.clips), (unit.title, clips, said))
        if difference := {*clips} ^ {*theirs}:
            clip = min(difference)
            less, more, why = (unit.title, other, said) if clip in theirs else (other, unit.title, said_there)
            reason = next((text for text in why if str(clip) in text), str(clip))
            raise NteError(
                f"networks.{less} would learn from fewer clips than networks.{more}: {reason}: complete the clip, or "
                "take it away"
            )
    for warning in told.values():
        warnings.warn(warning, stacklevel=2)


def train_all(
    units: Mapping[str, Training], folder: Path, jobs: int, scheduler: str | None, done: Callable[[str, str], None]
) -> None:
    """Train what is not trained yet; call done(name, fault) for each, with "" or the reason why it failed.

    folder: where results go, which workers of a Dask scheduler must see, as well as the runs' folder. Weights depend in
    their last bits on the number of threads, which is the share of the cores that a process has.
    """
    if scheduler is not None:
        on_cluster(TRAINING, train_unit, units, folder, scheduler, done)
    elif jobs > 1:
        in_processes(TRAINING, train_unit, units, jobs, done)
    else:
        for name, unit in units.items():
            done(name, train_unit(unit))


def train_unit(unit: Training) -> str:
    """Train, or go on where an earlier training stopped; return "" or the reason why it failed, in one line.

    What the training says goes to the file `config.runs`/NAME.log. Raises KeyboardInterrupt if it was told to stop.
    """
    make_folder(unit.folder.parent)
    deterministic = torch.are_deterministic_algorithms_enabled()
    try:
        with (
            unit.folder.with_name(f"{unit.name}.log").open("a", encoding="utf-8") as log,
            redirect_stdout(log),
            redirect_stderr(log),
        ):
            train(unit.config, device=unit.device)
    except NteError as error:
        return str(error)
    except (RuntimeError, MemoryError) as error:  # such as too little memory on a device: others may still succeed
        return f"{type(error).__name__}: {(str(error).splitlines() or ['no reason given'])[0]}"
    finally:
        torch.use_deterministic_algorithms(deterministic)  # the evaluation that follows may be in this process
    return ""


def _versions() -> dict[str, str]:
    return versions_of(*DENOISING, "lightning-fabric")  # a network may learn on top of another denoiser


TRAINING = Kind("train", share_threads, _versions)
