"""The comparison of denoisers over clips, for `nte evaluate`."""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from nte.denoiser import Denoiser, require_channels
from nte.errors import NteError
from nte.evaluation.metric_table import Row
from nte.evaluation.report.page import write_report
from nte.evaluation.results import FORMAT, Evaluation, means_of
from nte.evaluation.score_clip import ClipRun, Shown
from nte.files import already_there, only_writer, write_whole
from nte.frames.channels import reference_of
from nte.frames.clip import Clip, find_clips
from nte.registry import load_denoiser

OURS = ("metrics.json", "index.html")  # all files that an evaluation writes, and that force replaces
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
    titles: Mapping[str, str] | None = None,
) -> Evaluation:
    """Run every denoiser over every clip, score its frames, and write `out`/metrics.json and index.html, the report.

    clips: clip folders, or folders that hold clips. denoisers: specifications as for `load_denoiser`, or a mapping from
    a name for the rows to a denoiser. first: index of the first frame that is scored; every denoiser starts at frame 0.
    lights: the light components that are scored besides each denoiser's own target; None takes all that it gives.
    progress: called after each frame with the frames done, the frames in all and the frame's name. titles: the
    report's title for a denoiser → the denoiser. One frame of one clip is in memory at a time, besides the denoisers'
    states. Raises NteError, before any work is done, for missing clips, channels or denoisers, and for an `out` that
    exists without `force`.

    >>> found = nte.evaluate("data/clips", ["noisy", "taa"], "report")
    >>> means = found.metrics["means"]
    >>> means["taa"]["psnr"] > means["noisy"]["psnr"]  # in decibels, over all clips and frames but the first
    True
    >>> sorted(path.name for path in Path("report").iterdir())
    ['index.html', 'metrics.json']
    """
    out = Path(out)
    folders = find_clips(Path(clip) for clip in ([clips] if isinstance(clips, str | Path) else clips))
    opened = dict(zip(clip_labels(folders), map(Clip, folders), strict=True))
    loaded = _loaded(denoisers, device)
    for label, clip in opened.items():
        _require_scorable(label, clip, loaded, first)
    prepare_folder(out, force)
    with only_writer(out):
        found = _evaluated(opened, loaded, first, lights, device, progress)
        text = json.dumps(found.metrics, indent=1, allow_nan=False) + "\n"
        write_whole(out / "metrics.json", lambda temporary: temporary.write_text(text, encoding="utf-8"))
        write_report(found.titled(titles) if titles else found, out, titles)
    return found


def _loaded(denoisers: Iterable[str] | Mapping[str, Denoiser], device: str) -> dict[str, Denoiser]:
    if isinstance(denoisers, str):
        raise NteError(f"denoisers is '{denoisers}': expected a list of them")
    if isinstance(denoisers, Mapping):
        loaded = dict(denoisers)
    else:
        loaded = {spec: load_denoiser(spec, device) for spec in dict.fromkeys(denoisers)}
    if not loaded:
        raise NteError("no denoisers to evaluate: name at least one, for example noisy")
    return loaded


def _evaluated(
    opened: Mapping[str, Clip], denoisers: Mapping[str, Denoiser], first: int, lights: Sequence[str] | None,
    device: str, progress: Advance | None,
) -> Evaluation:  # fmt: skip
    """Run and score denoisers on clips, both checked before."""
    total, done = sum(map(len, opened.values())), 0
    rows: list[Row] = []
    shown: list[Shown] = []
    for label, clip in opened.items():
        run = ClipRun(label, clip, denoisers, device, first, lights)
        for index in range(len(clip)):
            run.advance(index)
            done += 1
            if progress:
                progress(done, total, f"{label}, frame {index}")
        rows += run.rows()
        shown += run.shown.values()
    return Evaluation({"format": FORMAT, "rows": rows, "means": means_of(rows)}, shown)


def clip_labels(folders: Sequence[Path]) -> list[str]:
    """Make a short unique name for each clip: the folder's name, with its parents if several folders have that name."""
    resolved = [folder.resolve() for folder in folders]
    names = [folder.name for folder in resolved]
    common = Path(os.path.commonpath([folder.parent for folder in resolved])) if resolved else Path()
    return [
        folder.relative_to(common).as_posix() if names.count(folder.name) > 1 else folder.name for folder in resolved
    ]


def prepare_folder(out: Path, force: bool) -> None:
    """Make the folder for results. Raises NteError if it is a file or, without `force`, holds something already."""
    if out.exists() and not out.is_dir():
        raise NteError(f"{out}: is a file: expected a folder for the results")
    if not force and out.is_dir() and any(out.iterdir()):
        raise already_there(out, "folder", f"replace its {' and '.join(OURS)}")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NteError(f"{out}: cannot be made: {error.strerror}") from error


def _require_scorable(label: str, clip: Clip, denoisers: Mapping[str, Denoiser], first: int) -> None:
    """Raise NteError for a clip that cannot be evaluated, before an hour of work is lost."""
    if len(clip) == first == 1:
        raise NteError(f"{clip.folder}: has one frame, and the first frame is not scored: use --first-frame")
    if len(clip) <= first:
        raise NteError(f"{clip.folder}: has {len(clip)} frames, and frame {first} is the first that is scored")
    if "color" not in clip.channels and "exposure" not in clip.info:
        have = ", ".join(clip.channels)
        raise NteError(
            f"{clip.folder}: no channel 'color' to measure the exposure of, in which scores are taken; it has {have}: "
            "set 'exposure' in its clip.json"
        )
    for spec, denoiser in denoisers.items():
        require_channels(denoiser, clip.channels, f"{label}: {spec}")
        name = reference_of(denoiser.target)
        if name not in clip.channels:
            have = ", ".join(clip.channels)
            raise NteError(f"{clip.folder}: no channel '{name}' to compare {spec} with; it has {have}")
