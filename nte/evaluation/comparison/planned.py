"""A situation of a comparison with its clips, and the units of work that it consists of."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from nte.errors import NteError
from nte.evaluation.comparison.clips import matching_clips, require_same_channels
from nte.evaluation.comparison.numbers import Method
from nte.evaluation.comparison.schema import Comparison, Situation
from nte.evaluation.units import ClipUnit
from nte.frames.clip import Clip
from nte.frames.clip_files import clip_labels


@dataclass
class Planned:
    """A situation with its clips, and the methods that are evaluated on them."""

    situation: Situation
    clips: dict[str, Path]  # label → folder
    lights: tuple[str, ...]  # light components that are scored
    methods: list[Method] = field(default_factory=list)

    def units(self, device: str) -> dict[str, ClipUnit]:
        """Make the unit of each clip, by a name that no other situation has."""
        specs = tuple(spec for method in self.methods for spec in method.specs)
        shown = tuple(method.specs[0] for method in self.methods if method.specs)  # one seed of a network
        labels = list(self.clips)
        count = min(self.situation.pictures, len(labels))
        pictured = {labels[i * len(labels) // count] for i in range(count)}
        first = self.situation.first or 0
        return {
            unit_name(self.situation, label): ClipUnit(
                label, clip, specs, first, self.lights, device, shown if label in pictured else ()
            )
            for label, clip in self.clips.items()
        }


def unit_name(situation: Situation, label: str) -> str:
    """Name the unit of a clip in a situation."""
    return f"{situation.name}/{label}"


def plan_situation(comparison: Comparison, situation: Situation, data: Path) -> Planned:
    """Find the clips of a situation, and the lights that are shown of them.

    Raises NteError for a pattern without clips, and for clips that do not fit.
    """
    where = f"situation '{situation.name}'"
    clips = matching_clips(situation.clips, data, where)
    require_same_channels(clips, where)
    shown = [part.light for table in comparison.tables if table.situation == situation.name for part in table.columns]
    shown += [plot.light for plot in comparison.plots if plot.situation == situation.name]
    lights = tuple(dict.fromkeys([situation.light, *filter(None, shown)]))
    return Planned(situation, dict(zip(clip_labels(clips), clips, strict=True)), lights)


def require_clips(patterns: Sequence[str], data: Path, name: str, plan: Planned, first: int | None) -> list[Path]:
    """Find the clips of a part of a table, or of a plot, among those of its situation; without patterns all of them.

    first: index of the first frame that counts. Raises NteError for a pattern without any clip, and for a clip that
    ends before that frame.
    """
    found: list[Path] = []
    for pattern in patterns:
        clips = matching_clips([pattern], data, f"'{name}'")
        own = [clip for clip in clips if clip in plan.clips.values()]
        if not own:
            raise NteError(f"'{name}': {clips[0]} is not a clip of its situation '{plan.situation.name}'")
        found += own
    found = list(dict.fromkeys(found)) or list(plan.clips.values())
    for folder in found:
        if first is not None and first >= (count := len(Clip(folder))):
            raise NteError(f"'{name}': {folder} has {count} frames, and frame {first} is the first that counts")
    return found
