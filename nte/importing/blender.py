"""`nte import blender`: multi-layer EXR files of Cycles, read by the channel map maps/blender.yaml."""

from collections.abc import Sequence
from pathlib import Path

from nte.importing.exr import Imported, import_exr


def import_blender(
    source: Path, out: Path, reference: Path | None = None, force: bool = False, overrides: Sequence[str] = ()
) -> Imported:
    """Import multi-layer EXR frames of Cycles as the clip `out`; returns when the clip is whole.

    source, reference: a folder, a file or a glob pattern each; only the image of the reference is used. Any other pass
    than the image may be missing, if it is missing from all frames. overrides: `key=value` for the map, such as
    `view=left` or `prefix=ViewLayer`. force: replace a clip that exists at `out`. Raises NteError, with nothing left
    behind, for layers that are missing, sequences that do not match, and an `out` that exists without `force`.
    """
    return import_exr(source, "blender", out, reference, force, overrides)
