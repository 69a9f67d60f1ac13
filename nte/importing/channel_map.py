"""Channel maps: YAML files that say which layers of foreign EXR files are which channel, in which conventions.

The group `channels` says where values are and how they are stored; the other groups say what the values mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

from omegaconf import MISSING

from nte.config import load_config
from nte.errors import NteError, expected_one_of
from nte.importing.source import Entry, Source, as_typed, override, read_source, spell_out
from nte.motion.conventions import UNITS, Convention

MAPS = Path(__file__).parent / "maps"  # the maps that ship with nte, NAME.yaml each
NORMALS = ("normal", "geometric_normal")  # channels that follow the map's group `normal`
DEPTHS = ("depth", "shutter_depth")  # channels that follow the group `depth`
_CHOICES = {
    "points": ("to", "from"), "axes": ("xy", "yx"), "y_axis": ("down", "up"), "unit": ("pixels", "uv", "ndc"),
    "space": ("world", "camera"), "along": ("axis", "ray"), "over": ("shutter", "frame"),
}  # fmt: skip


@dataclass
class Vectors:
    """The convention of motion vectors. The defaults are nte's own convention."""

    points: str = "to"  # to the other frame (motion: previous, forward_motion: next); or from it: the opposite sign
    axes: str = "xy"  # or yx: the first component is y
    y_axis: str = "down"  # or up
    unit: str = "pixels"  # or uv: [0, 1] over the image; or ndc: [−1, 1]

    def convention(self) -> Convention:
        """Return these values as a `Convention` of nte.motion.conventions, which can convert vectors."""
        x = 1 if self.points == "to" else -1
        y = x if self.y_axis == "down" else -x
        unit = next(name for name in UNITS if name.lower().startswith(self.unit))
        return Convention((x, y), self.axes == "yx", unit)

    @classmethod
    def of(cls, convention: Convention) -> "Vectors":
        """Return a map's values for a convention: those of `forward_motion` if it is forward, else of `motion`."""
        x, y = convention.signs
        return cls(
            points="to" if x > 0 else "from",
            axes="yx" if convention.swapped else "xy",
            y_axis="down" if x == y else "up",
            unit=convention.unit.split(",")[0].lower(),
        )


@dataclass
class ShutterVectors(Vectors):
    """The convention of motion over the shutter; `points: to` is forward in time."""

    over: str = "shutter"  # motion over the open shutter; or frame: over the whole frame, of which `shutter` is open


@dataclass
class Normals:
    """The convention of normals."""

    space: str = "world"  # or camera: the view space of `cameras`
    encoded: bool = False  # true if n is stored as n/2 + 1/2


@dataclass
class Depths:
    """The convention of depth."""

    along: str = "axis"  # depth along the view axis; or ray: the distance from the camera
    scale: float = 1.0  # scene units per stored unit; negative if stored depths are negative
    sky: float = 1e9  # stored depths of this size or more are misses; so are 0, the other sign and non-finite values


@dataclass
class ChannelMap:
    """A channel map: `channels` is required; the rest says where the files differ from nte's conventions."""

    channels: dict[str, Entry] = field(default_factory=lambda: MISSING)  # nte's channel → where it is
    prefix: str = ""  # text before every layer's name; * stands for any, if there is only one
    prefix_not: list[str] = field(default_factory=list)  # prefixes that * does not stand for, if there is another
    file: str = ""  # file, part and view of the channels that name none themselves
    part: str = ""
    view: str = ""
    result: str = ""  # the layer that a denoised image replaces; empty: that of color
    optional: bool = False  # true if channels other than color may be missing, each from every frame
    still: bool = False  # true if only the camera moves: missing motion and depth are then made from position
    motion: Vectors = field(default_factory=Vectors)
    forward_motion: Vectors = field(default_factory=Vectors)
    shutter_motion: ShutterVectors = field(default_factory=ShutterVectors)
    normal: Normals = field(default_factory=Normals)
    depth: Depths = field(default_factory=Depths)
    cameras: str = ""  # JSON in the map's folder: a list of {"view", "projection"} per frame, as in clip.json
    vertical_fov: float = 0.0  # degrees; enough instead of cameras if depth is along the ray
    shutter: float = 1.0  # open share of the frame, in (0, 1], for clip.json
    producer: str = "OpenEXR files"  # name of the renderer, for clip.json


def find_map(name: str | Path) -> Path:
    """Return the file of a channel map, given by its path or by the name of one that ships with nte.

    Raises NteError, which lists the maps that ship, for a name that is neither. A path need not exist.
    """
    path = Path(name)
    shipped = MAPS / f"{name}.yaml"
    if path.suffix or path.is_file() or path.parent != Path():
        return path
    if not shipped.is_file():
        maps = expected_one_of(name, sorted(p.stem for p in MAPS.glob("*.yaml")))
        raise NteError(f"--map {name}: neither a file nor a map that ships{maps}, or a path")
    return shipped


def load_channel_map(path: Path, overrides: Sequence[str] = ()) -> ChannelMap:
    """Read and check a channel map, with `key=value` overrides.

    The override `channels.depth=Z` names another layer and leaves how the map says that it is stored, as a file does
    that is based on another one; `channels.depth.file=z.#.exr` changes one key of the entry. Raises NteError, naming
    the file and the key, for a map that is not valid.
    """
    of_channels = [item for item in overrides if item.startswith(("channels.", "channels="))]
    others = [as_typed(item) for item in overrides if item not in of_channels]
    found = load_config(ChannelMap, path, others, contained=True, spell_out=spell_out)
    common = Source(file=found.file, part=found.part, view=found.view)
    found.channels = {
        name: read_source(path, name, entry, common) for name, entry in override(found.channels, of_channels).items()
    }
    if "color" not in found.channels:
        raise NteError(f"{path}: 'channels.color' is missing: name the layer with the noisy image")
    for group in ("motion", "forward_motion", "shutter_motion", "normal", "depth"):
        for key, value in vars(getattr(found, group)).items():
            if key in _CHOICES and value not in _CHOICES[key]:
                raise NteError(f"{path}: '{group}.{key}' is '{value}'{expected_one_of(value, _CHOICES[key])}")
    if not found.depth.scale or not isfinite(found.depth.scale):
        raise NteError(f"{path}: 'depth.scale' is {found.depth.scale}, expected a number that is not 0")
    if not found.depth.sky > 0:
        raise NteError(f"{path}: 'depth.sky' is {found.depth.sky}, expected a size from which on there is no surface")
    if not 0 <= found.vertical_fov < 180:
        raise NteError(f"{path}: 'vertical_fov' is {found.vertical_fov}, expected degrees between 0 and 180")
    if not 0 < found.shutter <= 1:
        raise NteError(f"{path}: 'shutter' is {found.shutter}, expected the open share of the frame, in (0, 1]")
    for name in NORMALS if found.normal.encoded else ():
        if name in found.channels and min(scale := found.channels[name].scale) < 0:  # n/2 + 1/2 is never negative
            instead = f"scale: {[2 * k for k in scale]}, offset: {[-1 if k > 0 else 1 for k in scale]}"
            raise NteError(
                f"{path}: 'channels.{name}.scale' is {scale}, which acts on what is stored, before 'normal.encoded': "
                f"instead of both give {instead}"
            )
    for name in (*NORMALS, *DEPTHS):
        if name in found.channels and not found.optional and (needed := needs_camera(found, name)):
            raise NteError(f"{path}: {needed}")
    return found


def needs_camera(how: ChannelMap, name: str) -> str:
    """Say in words for the user what camera a channel of the map lacks; return an empty text if it lacks none."""
    if name in NORMALS and how.normal.space == "camera" and not how.cameras:
        return "'normal.space' is camera: 'cameras' must name the JSON file of the cameras"
    if name in DEPTHS and how.depth.along == "ray" and not (how.cameras or how.vertical_fov):
        return "'depth.along' is ray: give 'vertical_fov' in degrees, or 'cameras'"
    return ""
