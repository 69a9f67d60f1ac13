"""The closing report of an import: missing channels, the verdict of `nte check`, and what to change in the map."""

from dataclasses import asdict
from typing import Any

from nte.checking import check, describe
from nte.errors import printable
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.importing.convert import revert_vectors
from nte.importing.exr import Imported

WITHOUT = {
    "reference": "no training and no scores",
    "albedo": "no demodulation; nte check cannot judge the vectors",
    "normal": "only denoisers that need none, such as taa",
    "depth": "only denoisers that need none; the sky is not known; disocclusion masks are coarse",
    "motion": "no history from the previous frame, unless vectors are estimated",
}


def tell(imported: Imported) -> int:
    """Print a new clip's channels, what it lacks, and what `nte check` says; return the exit status.

    The status is 2 if the clip is implausible, else 0. For vectors of another convention the map's values that would
    fit are printed as well. Raises NteError for files that cannot be read.
    """
    clip = Clip(imported.folder)
    print(f"{imported.folder}: {len(clip)} frames, {clip.width}x{clip.height}: {', '.join(clip.channels)}")
    for name, what in WITHOUT.items():
        if name not in clip.channels:
            source = f" ({imported.called[name]})" if name in imported.called else ""
            print(printable(f"  without {name}{source}: {what}"))
    known = {*clip.channels, *WITHOUT}
    if others := ", ".join(f"{name} ({source})" for name, source in imported.called.items() if name not in known):
        print(printable(f"  also without {others}"))
    report = check(clip)
    print(describe(report))
    if report.verdict != "implausible":
        return 0
    advice = _advice(clip, imported)
    print(f"{advice}; the clip is kept" if advice else "the clip is kept")
    return 2


def _advice(clip: Clip, imported: Imported) -> str:
    """Advice on which values of the map would make the vectors fit; empty if none would."""
    if "motion" not in clip.channels:
        return ""
    fits = check(_AsStored(clip, imported)).convention
    if fits is None:
        return ""
    better = asdict(type(imported.vectors).of(fits))
    if fits.forward:
        ours = asdict(type(imported.vectors)())
        change = "the layers under 'channels.forward_motion' instead of 'channels.motion'"
        change += "".join(f", forward_motion.{key}: {better[key]}" for key in better if better[key] != ours[key])
    else:
        now = asdict(imported.vectors)
        differing = [key for key in better if better[key] != now[key]]
        change = ", ".join(f"{imported.group}.{key}: {better[key]} (now {now[key]})" for key in differing)
    if not change:
        return ""
    if imported.map is None:
        return f"the vectors would fit with {change}: the file does not follow this producer's convention"
    return f"the vectors would fit with {change}: change it in {imported.map} and import again with --force"


class _AsStored(Clip):
    """The clip with its vectors as the producer stored them, before the map was applied."""

    def __init__(self, clip: Clip, imported: Imported) -> None:
        super().__init__(clip.folder)
        self._convention = imported.vectors.convention()

    def frame(self, *arguments: Any, **options: Any) -> Frame:
        found = super().frame(*arguments, **options)
        return found.with_channels(motion=revert_vectors(found["motion"][0], self._convention)[None])
