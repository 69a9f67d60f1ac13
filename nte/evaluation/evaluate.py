"""The comparison of denoisers over clips, for `nte evaluate`."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from nte.denoiser import Denoiser, require_denoiser
from nte.errors import NteError
from nte.evaluation.report import PLAYED
from nte.evaluation.report.page import write_report
from nte.evaluation.results import Evaluation, gathered
from nte.evaluation.table_files import CSV, LATEX
from nte.evaluation.units import ClipScores, ClipUnit, elsewhere, require_scorable, score_clip
from nte.files import already_there
from nte.frames.clip import Clip
from nte.frames.clip_files import clip_labels, find_clips
from nte.jobs import require_jobs
from nte.registry import load_denoiser
from nte.unfinished import MARK, begin, finish, is_unfinished
from nte.viewer.page import clear
from nte.viewer.recorder import FOLDER, Recording
from nte.writers import only_writer

OURS = ("metrics.json", CSV, LATEX, "index.html", "layers")  # all that an evaluation writes, and that force replaces
CHANNELS = ("albedo", "normal", "depth", "motion")  # that the report shows besides what is compared
Advance = Callable[[int, int, str], None]  # frames done, frames in all, clip and frame


def evaluate(
    clips: Iterable[Path | str] | Path | str,
    denoisers: Iterable[str] | Mapping[str, Denoiser],
    out: Path | str,
    first: int = 1,
    lights: Sequence[str] | None = None,
    force: bool = False,
    device: str = "cpu",
    progress: Advance | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    played: int = PLAYED,
) -> Evaluation:
    """Run every denoiser over every clip, score its frames, and write `out`/metrics.json and index.html, the report.

    The report plays `played` frames of each clip, around the one with the most disoccluded pixels; their linear values
    lie in `out`/layers. Its tables are also written to `out`/tables.csv and, in LaTeX, to tables.tex.

    clips: clip folders, or folders that hold clips. denoisers: specifications as for `load_denoiser`, or a mapping from
    a name for the rows to a denoiser. first: index of the first frame that is scored; every denoiser starts at frame 0.
    lights: the light components that are scored besides each denoiser's own target; None takes all that it gives.
    progress: called after each frame with the frames done, the frames in all and the frame's name. jobs: number of
    processes, each of which evaluates a clip at a time. scheduler: address of a Dask scheduler, whose workers evaluate
    instead; they must see `out` and the working directory under the same paths. Both need specifications, and progress
    is then told about once a second, with no name before the end. The numbers are the same, except for times. One frame
    of one clip is in memory at a time, besides the denoisers' states. Raises NteError, before any work is done, for
    missing clips, channels or denoisers, and for an `out` that holds anything without `force`, unless the same
    evaluation was killed there.

    >>> found = nte.evaluate("data/clips", ["noisy", "taa"], "report")
    >>> means = found.metrics["means"]
    >>> means["taa"]["psnr"] > means["noisy"]["psnr"]  # in decibels, over all clips and frames but the first
    True
    >>> sorted(path.name for path in Path("report").iterdir())
    ['index.html', 'layers', 'metrics.json', 'tables.csv', 'tables.tex']
    """
    require_jobs(jobs)
    if played < 1:
        raise NteError(f"played is {played}: expected at least one frame of each clip")
    if isinstance(denoisers, Mapping) and (jobs > 1 or scheduler is not None):
        raise NteError("denoisers are objects of this process: give specifications, or leave out jobs and scheduler")
    out = Path(out)
    folders = find_clips(Path(clip) for clip in ([clips] if isinstance(clips, str | Path) else clips))
    opened = dict(zip(clip_labels(folders), map(Clip, folders), strict=True))
    loaded = _loaded(denoisers, device)
    for label, clip in opened.items():
        require_scorable(label, clip, loaded, first)
    named = None if lights is None else tuple(lights)
    command = {"evaluate": folders, "denoisers": [*loaded], "first": first, "lights": named, "played": played}
    with only_writer(out):
        _require_free(out, force or is_unfinished(out, command))
        begin(out, command)
        clear(out)
        recording = Recording(out / FOLDER, played, CHANNELS, extras=True)
        units = {
            label: ClipUnit(label, clip.folder, tuple(loaded), first, named, device, recording=recording)
            for label, clip in opened.items()
        }
        frames = {label: len(clip) for label, clip in opened.items()}
        try:
            if jobs > 1 or scheduler is not None:
                scores = _elsewhere(units, frames, out, jobs, scheduler, progress)
            else:
                scores = _here(units, frames, loaded, progress)
        except NteError:  # nothing comes of this command: leave nothing of it
            clear(out)
            if scheduler is None:  # workers may still write: the mark lets the same command begin again
                finish(out)
            raise
        found = gathered([scores[label] for label in units])
        found.write(out)
        write_report(found, out)
        finish(out)
    return found


def _loaded(denoisers: Iterable[str] | Mapping[str, Denoiser], device: str) -> dict[str, Denoiser]:
    if isinstance(denoisers, str):
        raise NteError(f"denoisers is '{denoisers}': expected a list of them")
    if isinstance(denoisers, Mapping):
        loaded = dict(denoisers)
        for name, denoiser in loaded.items():
            require_denoiser(denoiser, name)
    else:
        loaded = {spec: load_denoiser(spec, device) for spec in dict.fromkeys(denoisers)}
    if not loaded:
        raise NteError("no denoisers to evaluate: name at least one, for example noisy")
    return loaded


def _here(
    units: Mapping[str, ClipUnit],
    frames: Mapping[str, int],
    denoisers: Mapping[str, Denoiser],
    progress: Advance | None,
) -> dict[str, ClipScores]:
    """Score clips one after the other."""
    scores, before, total = {}, 0, sum(frames.values())
    for label, unit in units.items():

        def tick(index: int, label: str = label, before: int = before) -> None:
            if progress:
                progress(before + index + 1, total, f"{label}, frame {index}")

        scores[label] = score_clip(unit, denoisers, tick)
        before += frames[label]
    return scores


def _elsewhere(
    units: Mapping[str, ClipUnit],
    frames: Mapping[str, int],
    out: Path,
    jobs: int,
    scheduler: str | None,
    progress: Advance | None,
) -> dict[str, ClipScores]:
    """Score clips in other processes."""
    scores: dict[str, ClipScores] = {}
    scored, total = 0, sum(frames.values())

    def advance(count: int) -> None:
        nonlocal scored
        scored += count
        if progress and count and scored < total:
            progress(scored, total, "")

    def done(label: str, found: ClipScores) -> None:
        if found.fault or found.failed:
            raise NteError(found.fault or next(iter(found.failed.values())))
        scores[label] = found
        if progress and len(scores) == len(units):
            progress(total, total, label)

    elsewhere(units, out, jobs, scheduler, done, advance)
    return scores


def _require_free(out: Path, force: bool) -> None:
    """Raise NteError if the folder for results holds something already, without `force`."""
    if not force and any(path.name != MARK for path in out.iterdir()):
        raise already_there(out, "folder", f"replace its {', '.join(OURS[:-1])} and {OURS[-1]}")
