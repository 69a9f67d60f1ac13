"""A comparison from rendered clips to tables: networks are trained, clips evaluated, results put together."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from nte.config import load_config
from nte.errors import NteError
from nte.evaluation.comparison.kept import keep, read_kept, unit_digest
from nte.evaluation.comparison.methods import Methods, load_methods, require_fitting
from nte.evaluation.comparison.numbers import Method
from nte.evaluation.comparison.planned import Planned, plan_situation, require_clips, unit_name
from nte.evaluation.comparison.schema import Comparison, Situation
from nte.evaluation.comparison.write import write_results
from nte.evaluation.metric_table import Row
from nte.evaluation.units import ClipScores, elsewhere, evaluate_clip
from nte.files import refuse_links, remove, write_whole
from nte.frames.clip import Clip
from nte.jobs import require_jobs
from nte.progress import Progress
from nte.writers import only_writer

if TYPE_CHECKING:
    from nte.evaluation.comparison.networks import Training

MARK = "comparison.yaml"  # says which comparison a folder holds


class Failure(NamedTuple):
    """A method, a seed of a network, or a clip, that takes no further part."""

    method: str | None  # None: a clip
    seed: int | None
    situation: str  # "" if it failed in training, and so everywhere
    what: str
    clip: str | None = None  # its label


def run_comparison(
    comparison: Comparison,
    data: Path,
    out: Path,
    runs: Path = Path("runs"),
    force: bool = False,
    device: str = "cpu",
    jobs: int = 1,
    scheduler: str | None = None,
    progress: bool = True,
) -> Row:
    """Train the networks, evaluate every situation on the rendered clips in `data`, and write the results to `out`.

    A run that is trained is kept, and one that was interrupted goes on; runs lie in the folder `runs`. Clips that are
    evaluated are kept in `out`/<situation>/clips: the same comparison goes on with the others, and one in which only
    tables or plots were changed evaluates nothing. force: replace another comparison, and evaluate everything anew.

    jobs, scheduler: processes, or a Dask cluster, that do a training or a clip at a time. progress: show it on stderr.
    Returns the content of summary.json; its `failures` tell which seeds, methods or clips failed while the others went
    on.
    Raises NteError, before any work, for faulty patterns, clips, denoisers and configurations, and for an `out` that
    holds anything else.
    """
    require_jobs(jobs)
    planned = [plan_situation(comparison, situation, data) for situation in comparison.situations]
    for table in comparison.tables:
        for part in table.columns:
            require_clips(part.clips, data, table.name, _of(planned, table.situation), part.first)
    for plot in comparison.plots:
        if len(require_clips([plot.clip], data, plot.name, _of(planned, plot.situation), plot.first)) > 1:
            raise NteError(f"'{plot.name}': several clips match '{plot.clip}': expected one")
    networks = _Networks(comparison, data, runs, device)
    require_fitting(planned, networks.load_methods(comparison, device))
    networks.require_clips()
    with only_writer(out):
        _claim(out, comparison, force)
        failures = networks.train(out, jobs, scheduler, progress)
        for plan in planned:
            plan.methods = [networks.method(plan.situation, title) for title in plan.situation.titles]
        scores = _evaluate(planned, out, device, jobs, scheduler, progress)
        for plan in planned:
            failures += _failures(plan, scores)
        return write_results(comparison, planned, scores, [failure._asdict() for failure in failures], data, out)


def _of(planned: Sequence[Planned], situation: str) -> Planned:
    return next(plan for plan in planned if plan.situation.name == situation)


def check_methods(comparison: Comparison, data: Path, runs: Path, device: str) -> None:
    """Raise NteError for a network whose configuration is faulty, and for a method that does not load.

    Also for one that gives no light of a table or plot that shows it. Needs no clips.
    """
    _Networks(comparison, data, runs, device).load_methods(comparison, device)


class _Networks:
    """The networks of a comparison and their runs. PyTorch's training is imported only if there are any."""

    def __init__(self, comparison: Comparison, data: Path, runs: Path, device: str) -> None:
        self._units: dict[str, Training] = {}
        self._faults: dict[str, str] = {}
        if any(situation.runs for situation in comparison.situations):
            from nte.evaluation.comparison.networks import trainings

            self._units = {unit.name: unit for unit in trainings(comparison, data, runs, device)}

    def load_methods(self, comparison: Comparison, device: str) -> Methods:
        """Load all methods, with networks that are not trained."""
        if not self._units:
            return load_methods(comparison, {}, device)
        from nte.evaluation.comparison.networks import stand_ins

        with stand_ins(self._units.values()) as runs:
            return load_methods(comparison, runs, device)

    def require_clips(self) -> None:
        """Raise NteError if training clips do not fit, or if networks would learn from different ones."""
        if self._units:
            from nte.evaluation.comparison.networks import require_clips

            require_clips(self._units.values())

    def train(self, out: Path, jobs: int, scheduler: str | None, progress: bool) -> list[Failure]:
        """Train what is not trained, and return what failed."""
        if self._units:
            from nte.evaluation.comparison.networks import train_all

            with Progress("train", len(self._units), "run", progress) as told:

                def done(name: str, fault: str) -> None:
                    if fault:
                        self._faults[name] = fault
                    told.advance(1)
                    told.say(f"{name} failed: {fault}" if fault else name)

                logs = next(iter(self._units.values())).folder.parent
                told.say(f"train: each run writes to its log, {logs / '*.log'}")
                train_all(self._units, out, jobs, scheduler, done)
        return [
            Failure(unit.title, unit.seed, "", self._faults[name])
            for name, unit in self._units.items()
            if name in self._faults
        ]

    def method(self, situation: Situation, title: str) -> Method:
        """Return a method of a situation; a network, or one that uses it, with those of its seeds that were trained."""
        network = situation.runs.get(title)
        if network is None:
            return Method(title, (situation.methods[title],))
        trained = [u for name, u in self._units.items() if u.title == network and name not in self._faults]
        specs = tuple(situation.with_run(title, str(unit.folder)) for unit in trained)
        return Method(title, specs, tuple(unit.seed for unit in trained))


def _claim(out: Path, comparison: Comparison, force: bool) -> None:
    """Make `out` the folder of this comparison. Raises NteError if it holds anything else, unless `force`."""
    refuse_links(out)
    text, mark = comparison.evaluated(), out / MARK
    if not force and any(out.iterdir()) and _held(mark) != text:
        what = "holds another comparison" if mark.is_file() else "exists and is not empty"
        raise NteError(f"{out}: {what}: choose another folder, or replace what is there with --force")
    if force and mark.is_file():  # else nothing there is ours
        for path in out.glob("*/clips/**/*.npz"):
            remove(path)
    write_whole(mark, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _held(mark: Path) -> str:
    """The comparison that a folder holds, as `evaluated` says it now: keys that are new since have their defaults."""
    try:
        return load_config(Comparison, mark).evaluated()
    except NteError:
        return ""


def _evaluate(
    planned: Sequence[Planned], out: Path, device: str, jobs: int, scheduler: str | None, progress: bool
) -> dict[str, ClipScores]:
    """Evaluate all clips of all situations but those that are kept; name of the unit → scores."""
    units = {name: unit for plan in planned for name, unit in plan.units(device).items()}
    digests = {name: unit_digest(unit) for name, unit in units.items()}
    paths = {name: out / _file_of(name) for name in units}
    kept = {name: read_kept(paths[name], digests[name]) for name in units}
    scores = {name: found for name, found in kept.items() if found is not None}
    left = {name: unit for name, unit in units.items() if name not in scores}
    frames = {name: len(Clip(unit.clip)) for name, unit in left.items()}
    with Progress("evaluate", sum(frames.values()), "frame", progress) as told:

        def done(name: str, found: ClipScores) -> None:
            if not found.fault:
                keep(paths[name], digests[name], found)
            scores[name] = found
            told.say(f"{name} failed: {found.fault}" if found.fault else name)

        if left and (jobs > 1 or scheduler is not None):
            elsewhere(left, out, jobs, scheduler, done, told.advance)
        else:
            for name, unit in left.items():
                done(name, evaluate_clip(unit, lambda index: told.advance(1)))
    return scores


def _file_of(name: str) -> Path:
    """The file of a unit's scores, relative to the results: <situation>/clips/<clip>.npz."""
    situation, _, label = name.partition("/")
    return Path(situation, "clips", f"{label}.npz")


def _failures(plan: Planned, scores: Mapping[str, ClipScores]) -> list[Failure]:
    """Take clips that cannot be scored, and methods that failed on one of the others, out of a situation; say why."""
    of_clips = {label: scores[unit_name(plan.situation, label)] for label in plan.clips}
    failures = [
        Failure(None, None, plan.situation.name, found.fault, label) for label, found in of_clips.items() if found.fault
    ]
    plan.clips = {label: folder for label, folder in plan.clips.items() if not of_clips[label].fault}
    faults: dict[str, str] = {}
    for label in plan.clips:
        for spec, what in of_clips[label].failed.items():
            faults.setdefault(spec, what)
    methods = []
    for method in plan.methods:
        seeds = method.seeds or (None,)
        pairs = list(zip(method.specs, seeds, strict=True)) if method.specs else []
        failures += [
            Failure(method.title, seed, plan.situation.name, faults[spec]) for spec, seed in pairs if spec in faults
        ]
        good = [(spec, seed) for spec, seed in pairs if spec not in faults]
        own = tuple(seed for _, seed in good if seed is not None)
        methods.append(Method(method.title, tuple(spec for spec, _ in good), own))
    plan.methods = methods
    return failures
