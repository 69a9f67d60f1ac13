"""The networks of a comparison: a training for each network and seed, as a unit of work for `nte.jobs`."""

from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import torch

from nte.errors import NteError
from nte.evaluation.comparison.schema import Comparison, Plot, Table
from nte.evaluation.units import share_threads
from nte.files import make_folder
from nte.jobs import Kind, in_processes, on_cluster, versions_of
from nte.models.registry import make_network
from nte.training.config import TrainConfig, load_train_config
from nte.training.loop import train


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

    Raises NteError for a configuration that does not load, and for a network whose target is not the light of a table
    or plot that shows it.
    """
    wanted = dict.fromkeys(title for situation in comparison.situations for title in situation.runs.values())
    found = []
    for title in wanted:
        network = comparison.networks[title]
        for seed in comparison.seeds_of(title):
            try:
                config = load_train_config(Path(network.config), [*comparison.overrides, *network.overrides])
                target = make_network(config.network).target
            except NteError as error:
                raise NteError(f"networks.{title}: {error}") from error
            config.seed, config.name, config.runs = seed, f"{title}_seed{seed}", str(runs)
            config.resume = True
            if comparison.train:
                config.data.clips = [str(data / folder) for folder in comparison.train]
            _require_target(comparison, title, target)
            found.append(Training(title, seed, config, device))
    return found


def _require_target(comparison: Comparison, title: str, target: str) -> None:
    shown: list[tuple[str, Table | Plot, list[str]]]
    shown = [(f"table '{t.name}'", t, [part.light for part in t.columns]) for t in comparison.tables]
    shown += [(f"plot '{p.name}'", p, [p.light]) for p in comparison.plots]
    for where, entry, named in shown:
        situation = comparison.situation(entry.situation)
        lights = sorted({light or situation.light for light in named})
        if title in situation.networks and title in (entry.methods or situation.titles) and target not in lights:
            raise NteError(
                f"{where} is about {', '.join(lights)}, but network '{title}' denoises '{target}': set its "
                "network.target, or leave it out"
            )


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
    return versions_of("torch", "numpy", "lightning-fabric")


TRAINING = Kind("train", share_threads, _versions)
