"""`nte import blender`: multi-layer EXR files of Cycles, by the channel map that ships (maps/blender.yaml)."""

from collections.abc import Sequence
from pathlib import Path

from nte.importing.exr import Imported, import_exr


def import_blender(
    source: Path, out: Path, reference: Path | None = None, force: bool = False, overrides: Sequence[str] = ()
) -> Imported:
    """Import multi-layer EXR frames of Cycles as the clip `out`; returns when the clip is whole.

    source, reference: folders, files or glob patterns; of the reference only the image is used. Every pass but that
    may be missing from all frames. overrides: `key=value` for the map, such as `view=left` or `prefix=ViewLayer`.
    Raises NteError as nte.importing.exr.import_exr does.
    """
    return import_exr(source, "blender", out, reference, force, overrides)
