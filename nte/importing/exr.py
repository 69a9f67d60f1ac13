"""`nte import exr`: EXR sequences of any engine, described by a channel map."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from nte.frames.frame import About
from nte.importing.channel_map import MAPS, Vectors
from nte.importing.sequence import ForeignSequence
from nte.importing.write import refuse_existing, write_imported


@dataclass(frozen=True)
class Imported:
    """A finished clip, with notes on how it was read."""

    folder: Path
    vectors: Vectors  # the convention in which `motion` was read, or the forward motion that it was made from
    map: Path | None = None  # the user's own channel map, which may be corrected; None for one that ships
    called: Mapping[str, str] = field(
        default_factory=dict
    )  # channel → the name of its source in the map, or why it was left out
    notes: Sequence[str] = ()  # which layer became which channel, and how values were repaired
    group: str = "motion"  # the group of the map that `vectors` come from


def import_exr(
    source: Path,
    map_name: Path | str,
    out: Path,
    reference: Path | None = None,
    force: bool = False,
    overrides: Sequence[str] = (),
) -> Imported:
    """Import numbered EXR frames as the clip `out`; returns when the clip is whole.

    source, reference: a folder, a file or a glob pattern each. map_name: a channel map, or the name of one that ships;
    overrides: `key=value` for it. The reference image is what the map calls `reference`, or else `color`, in the
    files of `reference`. force: replace a clip that exists at `out`. Raises NteError, with nothing left behind, for a
    faulty map, layers that are missing, sequences that do not match, and an `out` that exists without `force` or that
    is not a clip.
    """
    refuse_existing(out, force)
    sequence = ForeignSequence(source, map_name, reference, overrides)
    how, shutter = sequence.how, sequence.how.shutter
    about: About = {"shutter": shutter} if shutter != 1 else {}
    write_imported(out, sequence.frames(), len(sequence), how.producer, sequence.cameras, force, **about)
    called = {name: f"'{' '.join(s.layer) or s.file}'" for name, s in how.channels.items() if s.layer or s.file}
    called |= {name: f"left out: {lacks}" for name, lacks in sequence.left_out.items()}
    own_map = sequence.map if sequence.map.parent != MAPS else None
    group = "motion" if sequence.has("motion") or not sequence.has("forward_motion") else "forward_motion"
    return Imported(out, getattr(how, group), own_map, called, list(sequence.notes()), group)
