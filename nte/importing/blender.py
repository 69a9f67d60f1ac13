"""`nte import blender`: multi-layer EXR files of Cycles.

Layers are named `<view layer>.<pass>.<component>`; Blender 5 has given some passes longer names. Depth is
along the view axis and 1e10 for a miss; normals are in world space. Vector.XY leads to the previous frame
and −Vector.ZW to the next one, in pixels, y upwards. Cycles writes 0 for the sky: its motion is made from the
cameras that the Position pass tells.
"""

from pathlib import Path

import numpy as np

from nte.errors import NteError
from nte.frames.clip import Pixels
from nte.importing.channel_map import ChannelMap, Vectors
from nte.importing.exr import Imported, Layers, find, matching_files, read_frames
from nte.importing.sky import with_sky_motion
from nte.importing.write import refuse_existing, write_imported

# pass → its name up to Blender 4; the keys are those of Blender 5
_OLD_NAMES = {
    "Diffuse Color": "DiffCol", "Glossy Color": "GlossCol", "Transmission Color": "TransCol", "Emission": "Emit",
    "Environment": "Env", "Object Index": "IndexOB",
}  # fmt: skip
# channels that one pass holds
_SIMPLE = {
    "color": "Combined", "normal": "Normal", "depth": "Depth", "position": "Position", "instance": "Object Index",
}  # fmt: skip
_CONVENTIONS = ChannelMap(
    channels={}, motion=Vectors(y_axis="up"), forward_motion=Vectors(points="from", y_axis="up")
)  # fmt: skip
_DARK = 1e-3  # a diffuse colour below this is that of a surface without a diffuse lobe


def import_blender(source: Path, out: Path, reference: Path | None = None, force: bool = False) -> Imported:
    """Import multi-layer EXR frames of Cycles as the clip `out`; returns when the clip is whole.

    source, reference: folders, files or glob patterns; of the reference only the Combined pass is used. Every
    pass but Combined may be missing. Raises NteError as nte.importing.exr.import_exr does.
    """
    refuse_existing(out, force)
    files, references = matching_files(source, reference)

    def pick_reference(path: Path, layers: Layers) -> dict[str, Pixels]:
        return {"reference": passes_to_channels(path, layers)["color"]}

    frames = read_frames(files, references, passes_to_channels, pick_reference, _CONVENTIONS)
    write_imported(out, with_sky_motion(frames), len(files), "Blender Cycles")
    called = {name: f"the {title} pass" for name, title in _SIMPLE.items()}
    called |= {"albedo": "the Diffuse Color pass", "motion": "the Vector pass", "reference": "--reference"}
    return Imported(out, _CONVENTIONS.motion, called=called)


def passes_to_channels(path: Path, layers: Layers) -> dict[str, Pixels]:
    """The channels (C, H, W) that a file's passes give, in Blender's conventions.

    albedo is the diffuse colour; where there is none, the glossy and transmitted colour (metals, glass).
    emission is what is seen of emitters and of the environment. Raises NteError without a Combined pass.
    """
    view_layer = _view_layer(path, layers)
    prefixes = {name: f"{view_layer}.{name}" for name in (*_SIMPLE.values(), *_OLD_NAMES, "Vector")}
    prefixes |= {new: old for new, name in _OLD_NAMES.items() if _has(layers, old := f"{view_layer}.{name}")}
    there = {name: prefix for name, prefix in prefixes.items() if _has(layers, prefix)}

    def rgb(name: str) -> Pixels:
        return find(path, layers, "color", [there[name]])

    given = {ours: find(path, layers, ours, [there[name]]) for ours, name in _SIMPLE.items() if name in there}
    if "Diffuse Color" in there:
        diffuse = rgb("Diffuse Color")
        others = [rgb(name) for name in ("Glossy Color", "Transmission Color") if name in there]
        given["albedo"] = np.where(diffuse.max(0) < _DARK, sum(others, diffuse), diffuse)
    seen = [rgb(name) for name in ("Emission", "Environment") if name in there]
    if seen:
        given["emission"] = np.sum(seen, axis=0)
    if "Vector" in there:
        for ours, components in (("motion", "XY"), ("forward_motion", "ZW")):
            given[ours] = find(path, layers, ours, [f"{there['Vector']}.{c}" for c in components])
    return given


def _has(layers: Layers, prefix: str) -> bool:
    return any(key.startswith(f"{prefix}.") for key in layers)


def _view_layer(path: Path, layers: Layers) -> str:
    """The view layer that the file holds; the compositor's own layer counts only if there is no other."""
    found = sorted({key.removesuffix(".Combined.R") for key in layers if key.endswith(".Combined.R")})
    rendered = [name for name in found if name != "Composite"] or found
    if not rendered:
        have = ", ".join(sorted(layers))
        raise NteError(f"{path}: no Combined pass: expected Blender's OpenEXR MultiLayer output; the file has {have}")
    if len(rendered) > 1:
        raise NteError(f"{path}: has the view layers {', '.join(rendered)}: write one view layer per file")
    return rendered[0]
