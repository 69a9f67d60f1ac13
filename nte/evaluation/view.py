"""`nte view`: clips in the viewer, with what denoisers make of them, and scores where they can be had."""

import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from nte.denoiser import Denoiser, require_channels
from nte.errors import DISTRIBUTION, NteError
from nte.evaluation.metric_table import Row
from nte.evaluation.record import record_extras, record_frame, record_kernels, record_output
from nte.files import already_there
from nte.frames.ahead import with_next
from nte.frames.channels import reference_of
from nte.frames.clip import Clip
from nte.frames.clip_files import clip_labels, find_clips
from nte.session import Session
from nte.unfinished import begin, finish, is_unfinished
from nte.viewer.page import PAGE, clear, write_page
from nte.viewer.recorder import FOLDER, Recorder, Recording, recorder_of
from nte.writers import only_writer

if TYPE_CHECKING:
    from nte.evaluation.score_clip import ClipRun
    from nte.models.applied import Application

Advance = Callable[[int, int, str], None]  # frames done, frames in all, clip and frame
_SCORING = ("torch", "torchmetrics", "flip_evaluator")


class CutShortWarning(UserWarning):
    """Warning that a clip ends before the last frame that was asked for."""


def view(
    clips: Iterable[Path | str],
    denoisers: Mapping[str, Denoiser],
    out: Path,
    frames: range | None = None,
    channels: tuple[str, ...] | None = None,
    force: bool = False,
    device: str = "cpu",
    progress: Advance | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> Path:
    """Write a page that shows clips, and every denoiser's output for them, to the folder `out`; return its path.

    clips: clip folders, or folders that hold clips. denoisers: name → denoiser; each starts at frame 0. frames: those
    to show; None shows all. channels: those to show besides what is compared; None shows all. Outputs are scored where
    a clip has a reference and the packages for scores are installed. A denoiser that fails on a clip, or lacks a
    channel of it, is left out there, and the page says why; at the end `say` is called with a line for each such
    denoiser. What was stopped begins again with the same call. Warns (CutShortWarning) if clips end before the last
    frame to show. Raises NteError for missing clips, for a first frame that no clip has, and for an `out` that exists
    without `force`.
    """
    folders = find_clips(map(Path, clips))
    opened = dict(zip(clip_labels(folders), map(Clip, folders), strict=True))
    shown = frames or range(max(map(len, opened.values())))
    first, last = shown.start, shown.stop - 1
    if not 0 <= first <= last or all(first >= len(clip) for clip in opened.values()):
        longest = max(map(len, opened.values()))
        raise NteError(f"--frames {first}-{last}: expected a range from 0 to {longest - 1}, which the clips have")
    if frames:
        _tell_of_short_clips(opened, first, last)
    command = {"view": folders, "denoisers": [*denoisers], "frames": (first, last), "channels": channels}
    total = sum(min(last + 1, len(clip)) for clip in opened.values())
    done = 0
    entries, rows = [], []
    failed: dict[str, dict[str, str]] = {}  # denoiser → clip → why
    with only_writer(out):
        if any(out.iterdir()) and not (force or is_unfinished(out, command)):
            raise already_there(out, "folder", f"replace its {PAGE} and {FOLDER}")
        begin(out, command)
        clear(out)
        recording = Recording(out / FOLDER, None, channels, True, first, last)
        for label, clip in opened.items():
            recorder = recorder_of(recording, label, clip)
            run = _run(label, clip, denoisers, device, recorder)
            for index in range(min(last + 1, len(clip))):
                run.advance(index)
                done += 1
                if progress:
                    progress(done, total, f"{label}, frame {index}")
            rows += run.rows()
            entries.append(recorder.entry())
            for name, why in recorder.failed.items():
                failed.setdefault(name, {})[label] = why.removeprefix(f"{label}: ")
        page = write_page(out, _data(entries, rows), "")
        finish(out)
    for name, reasons in failed.items():
        label, why = next(iter(reasons.items()))
        others = f" and {len(reasons) - 1} more of {len(opened)} clips" if len(reasons) > 1 else ""
        say(f"{name} failed on {label}{others}: {why}")
    return page


def _tell_of_short_clips(clips: Mapping[str, Clip], first: int, last: int) -> None:
    """Warn if the range to show, `first` to `last`, goes beyond the end of clips."""
    short = [f"{label} (its last frame is {len(clip) - 1})" for label, clip in clips.items() if len(clip) <= last]
    if short:
        more = f" and {len(short) - 3} more" if len(short) > 3 else ""
        named = ", ".join(short[:3]) + more
        text = f"--frames {first}-{last} goes beyond the end of {named}: what there is of the range is shown"
        warnings.warn(text, CutShortWarning, stacklevel=3)


def _run(
    label: str, clip: Clip, denoisers: Mapping[str, Denoiser], device: str, recorder: Recorder
) -> "ClipRun | _Plain":
    """Make the run over a clip: one that scores if it can, else one that only records."""
    usable = {}
    for name, denoiser in denoisers.items():
        try:
            require_channels(denoiser, clip.channels, label)
            usable[name] = denoiser
        except NteError as error:
            recorder.drop(name, str(error))
    missing = [name for name in _SCORING if find_spec(name) is None]
    unknown = sorted({ref for d in usable.values() if (ref := reference_of(d.target)) not in clip.channels})
    if unknown:  # which nothing that is installed can replace
        recorder.notes.append(f"No scores: the clip has no {', '.join(unknown)}.")
    elif missing and usable:
        recorder.notes.append(f"No scores: pip install '{DISTRIBUTION}[eval]' installs what they need.")
    if missing or unknown or ("color" not in clip.channels and "exposure" not in clip.info):
        return _Plain(clip, usable, recorder)
    from nte.evaluation.score_clip import ClipRun

    return ClipRun(label, clip, usable, device, first=min(1, len(clip) - 1), recorder=recorder)


class _Plain:
    """Denoisers on a clip without scores: for a clip without a reference, and where PyTorch is not installed."""

    def __init__(self, clip: Clip, denoisers: Mapping[str, Denoiser], recorder: Recorder) -> None:
        self.clip, self.recorder = clip, recorder
        self.sessions = {name: Session(denoiser) for name, denoiser in denoisers.items()}
        self._frames = with_next(clip, [name for denoiser in denoisers.values() for name in denoiser.optional])
        recorder.centre(recorder.recording.first)  # of which kernels are kept

    def advance(self, index: int) -> None:
        """Read a frame, let every denoiser step, and record the outputs. Frames must come in order from 0."""
        frame = next(self._frames)
        targets = list(dict.fromkeys(session.denoiser.target for session in self.sessions.values()))
        record_frame(self.recorder, frame, targets)
        for name, session in list(self.sessions.items()):
            denoiser = session.denoiser
            visible = {key: frame[key] for key in (*denoiser.needs, *denoiser.optional) if key in frame}
            try:
                with _overheard() as applications:
                    result = session.step(replace(frame, channels=visible), denoiser.extras)
            except NteError as error:
                self.recorder.drop(name, str(error))
                del self.sessions[name]
                continue
            record_output(self.recorder, index, name, denoiser.target, result.image)
            record_extras(self.recorder, index, name, result.extras)
            record_kernels(self.recorder, index, name, denoiser.components, applications)

    def rows(self) -> list[Row]:
        """Return no rows: nothing is scored."""
        return []


def _overheard() -> "AbstractContextManager[list[Application]]":
    """Collect the kernels that networks apply; there are no networks where nobody has imported PyTorch."""
    if sys.modules.get("torch") is None:
        return nullcontext([])
    from nte.models.applied import overheard

    return overheard()


def _data(entries: list[Row], rows: list[Row]) -> Row:
    """Collect what the viewer reads."""
    names = ", ".join(entry["name"] for entry in entries[:3]) + (", …" if len(entries) > 3 else "")
    data: Row = {
        "title": names, "summary": "", "notes": [], "note": "", "clips": entries, "rows": rows, "metrics": [],
        "tables": [], "about": [],
    }  # fmt: skip
    if rows:
        from nte.evaluation.report.how import how_it_is_computed
        from nte.evaluation.report.numbers import metric_table, tables

        data |= {"metrics": metric_table(), "tables": tables(rows), "about": how_it_is_computed(rows, None)}
    return data
