"""Channel maps: a YAML file that says which layers of foreign EXR files are which channel, and how they are meant."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from omegaconf import MISSING

from nte.config import load_config
from nte.errors import NteError
from nte.frames.channels import CHANNELS
from nte.motion.conventions import UNITS, Convention

_CHOICES = {
    "points": ("to", "from"), "axes": ("xy", "yx"), "y_axis": ("down", "up"), "unit": ("pixels", "uv", "ndc"),
    "space": ("world", "camera"), "along": ("axis", "ray"),
}  # fmt: skip


class Camera(NamedTuple):
    """Matrices (4, 4) for column vectors: world → view, view → homogeneous [0, 1]² with y down."""

    view: npt.NDArray[np.float64]
    projection: npt.NDArray[np.float64]


@dataclass
class Vectors:
    """How motion vectors are stored. The defaults are nte's own convention."""

    points: str = "to"  # the other frame (motion: previous, forward_motion: next); or from it: the opposite sign
    axes: str = "xy"  # or yx: the first component is y
    y_axis: str = "down"  # or up
    unit: str = "pixels"  # or uv: [0, 1] over the image; or ndc: [−1, 1]

    def convention(self) -> Convention:
        """The same in the words of nte.motion.conventions, which knows how to convert."""
        x = 1 if self.points == "to" else -1
        y = x if self.y_axis == "down" else -x
        unit = next(name for name in UNITS if name.lower().startswith(self.unit))
        return Convention((x, y), self.axes == "yx", unit)

    @classmethod
    def of(cls, convention: Convention) -> "Vectors":
        """The map's values for a convention, whose direction is not `forward`."""
        x, y = convention.signs
        return cls(
            points="to" if x > 0 else "from",
            axes="yx" if convention.swapped else "xy",
            y_axis="down" if x == y else "up",
            unit=convention.unit.split(",")[0].lower(),
        )


@dataclass
class Normals:
    """How normals are stored."""

    space: str = "world"  # or camera: the view space of `cameras`


@dataclass
class Depths:
    """How depth is stored."""

    along: str = "axis"  # of the view; or ray: the distance from the camera
    scale: float = 1.0  # scene units per stored unit
    sky: float = 1e9  # stored values from here on are misses; so are 0, negative and non-finite ones


@dataclass
class ChannelMap:
    """A channel map; `channels` is required, the rest says where the files differ from nte's conventions."""

    channels: dict[str, Any] = field(default_factory=lambda: MISSING)  # ours → a layer, or its components by name
    motion: Vectors = field(default_factory=Vectors)
    forward_motion: Vectors = field(default_factory=Vectors)
    normal: Normals = field(default_factory=Normals)
    depth: Depths = field(default_factory=Depths)
    cameras: str = ""  # JSON beside the map: a list of {"view", "projection"} per frame, as in clip.json
    vertical_fov: float = 0.0  # degrees; instead of cameras where depth is along the ray


def load_channel_map(path: Path) -> ChannelMap:
    """Read and check a channel map; raises NteError that names the file and the key."""
    found = load_config(ChannelMap, path)
    for name, layers in found.channels.items():
        if name not in CHANNELS or CHANNELS[name].storage == "derived":
            stored = ", ".join(key for key, row in CHANNELS.items() if row.storage != "derived")
            raise NteError(f"{path}: 'channels.{name}': no such channel; expected one of {stored}")
        names = [layers] if isinstance(layers, str) else layers
        components = CHANNELS[name].components
        named = isinstance(names, list) and all(isinstance(n, str) for n in names)
        if not named or len(names) not in (1, len(components)):
            count = f"the names of {len(components)} channels" if len(components) > 1 else "the name of its channel"
            raise NteError(f"{path}: 'channels.{name}': {layers!r}: expected a layer, or {count}")
        found.channels[name] = names
    if "color" not in found.channels:
        raise NteError(f"{path}: 'channels.color' is missing: name the layer with the noisy image")
    for group in ("motion", "forward_motion", "normal", "depth"):
        for key, value in vars(getattr(found, group)).items():
            if key in _CHOICES and value not in _CHOICES[key]:
                raise NteError(f"{path}: '{group}.{key}' is '{value}', expected one of {', '.join(_CHOICES[key])}")
    _check_cameras(path, found)
    return found


def _check_cameras(path: Path, found: ChannelMap) -> None:
    if found.depth.scale <= 0:
        raise NteError(f"{path}: 'depth.scale' is {found.depth.scale}, expected more than 0")
    if not 0 <= found.vertical_fov < 180:
        raise NteError(f"{path}: 'vertical_fov' is {found.vertical_fov}, expected degrees between 0 and 180")
    if "normal" in found.channels and found.normal.space == "camera" and not found.cameras:
        raise NteError(f"{path}: 'normal.space' is camera: 'cameras' must name the JSON file of the cameras")
    if "depth" in found.channels and found.depth.along == "ray" and not (found.cameras or found.vertical_fov):
        raise NteError(f"{path}: 'depth.along' is ray: give 'vertical_fov' in degrees, or 'cameras'")


def load_cameras(path: Path, frames: int) -> list[Camera]:
    """The cameras of a JSON file, one per frame; raises NteError for anything else in it."""
    try:
        listed = json.loads(path.read_text(encoding="utf-8"))
        found = [Camera(*(np.array(c[key], np.float64) for key in Camera._fields)) for c in listed]
    except OSError as error:
        raise NteError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, KeyError) as error:
        raise NteError(f"{path}: expected a JSON list of view and projection matrices: {error}") from error
    if len(found) != frames:
        raise NteError(f"{path}: {len(found)} cameras for {frames} frames")
    for i, camera in enumerate(found):
        for key, matrix in camera._asdict().items():
            if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or np.linalg.det(matrix) == 0:
                raise NteError(f"{path}: camera {i}: '{key}' is not an invertible 4×4 matrix")
    return found
