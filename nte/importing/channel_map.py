"""Channel maps: a YAML file that says which layers of foreign EXR files are which channel, and how they are meant.

`channels` says where values are and how they are stored; the other groups, what they mean (datasets/IMPORT.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

from omegaconf import MISSING, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from nte.config import load_config, problem_of, problem_with, refuse_resolvers
from nte.errors import NteError
from nte.frames.channels import CHANNELS, Channel
from nte.motion.conventions import UNITS, Convention

MAPS = Path(__file__).parent / "maps"  # those that ship, by name
SKY = "sky"  # in `unknown`: the vectors of misses
_CHOICES = {
    "points": ("to", "from"), "axes": ("xy", "yx"), "y_axis": ("down", "up"), "unit": ("pixels", "uv", "ndc"),
    "space": ("world", "camera"), "along": ("axis", "ray"), "over": ("shutter", "frame"),
}  # fmt: skip
_LISTS = ("layer", "plus", "where_dark", "scale", "offset", "unknown")  # keys of Source that may be a single value


@dataclass
class Source:
    """Where a channel's values are in the files, and how they are stored. A layer alone stands for {layer: …}."""

    layer: list[str] = field(default_factory=list)  # a layer or its components, one by one; nothing: those of no layer
    plus: list[str] = field(default_factory=list)  # layers that are added where the file has them
    where_dark: list[str] = field(default_factory=list)  # the same, only in pixels where there is nothing so far
    file: str = ""  # of this channel's own files below SOURCE: # is the frame number, * anything
    part: str = ""  # of a multi-part file, by name or number
    view: str = ""  # of a stereo file
    scale: list[float] = field(default_factory=lambda: [1.0])  # value = stored · scale + offset,
    offset: list[float] = field(default_factory=lambda: [0.0])  # each one number or one for each component
    unknown: list[str] = field(default_factory=list)  # vectors: stored values that say nothing; `sky`: those of misses


@dataclass
class Vectors:
    """How motion vectors are meant. The defaults are nte's own convention."""

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
class ShutterVectors(Vectors):
    """How motion over the shutter is meant; `points: to` is forward in time."""

    over: str = "shutter"  # the open shutter; or frame: the whole frame, of which `shutter` is open


@dataclass
class Normals:
    """How normals are meant."""

    space: str = "world"  # or camera: the view space of `cameras`
    encoded: bool = False  # stored as n/2 + 1/2


@dataclass
class Depths:
    """How depth is meant."""

    along: str = "axis"  # of the view; or ray: the distance from the camera
    scale: float = 1.0  # scene units per stored unit; negative where depth counts downwards
    sky: float = 1e9  # stored sizes from here on are misses; so are 0, values of the other sign and non-finite ones


@dataclass
class ChannelMap:
    """A channel map; `channels` is required, the rest says where the files differ from nte's conventions."""

    channels: dict[str, Any] = field(default_factory=lambda: MISSING)  # ours → a layer, components or a Source
    prefix: str = ""  # what stands before every layer's name; * for whatever it is called, if there is only one
    prefix_not: list[str] = field(default_factory=list)  # what * does not stand for, where there is another
    file: str = ""  # file, part and view of the channels that name none themselves
    part: str = ""
    view: str = ""
    result: str = ""  # the layer that a denoised image takes the place of; nothing: that of color
    optional: bool = False  # channels but color may be missing, if they are missing from every frame
    still: bool = False  # nothing moves but the camera: motion and depth that are missing are made from position
    motion: Vectors = field(default_factory=Vectors)
    forward_motion: Vectors = field(default_factory=Vectors)
    shutter_motion: ShutterVectors = field(default_factory=ShutterVectors)
    normal: Normals = field(default_factory=Normals)
    depth: Depths = field(default_factory=Depths)
    cameras: str = ""  # JSON beside the map: a list of {"view", "projection"} per frame, as in clip.json
    vertical_fov: float = 0.0  # degrees; instead of cameras where depth is along the ray
    shutter: float = 1.0  # its open share of the frame, for clip.json
    producer: str = "OpenEXR files"  # for clip.json


def find_map(name: str | Path) -> Path:
    """The file of a channel map: a path, or the name of one that ships; raises NteError that lists those."""
    path = Path(name)
    shipped = MAPS / f"{name}.yaml"
    if path.suffix or path.is_file() or path.parent != Path():
        return path
    if not shipped.is_file():
        listed = ", ".join(sorted(p.stem for p in MAPS.glob("*.yaml")))
        raise NteError(f"--map {name}: neither a file nor a map that ships: expected a path or one of {listed}")
    return shipped


def load_channel_map(path: Path, overrides: Sequence[str] = ()) -> ChannelMap:
    """Read and check a channel map, with `key=value` overrides; raises NteError that names the file and the key.

    `channels.depth=Z` replaces what the map says of a channel, `channels.depth.file=z.#.exr` changes one key of it.
    """
    of_channels = [item for item in overrides if item.startswith("channels.")]
    found = load_config(ChannelMap, path, [item for item in overrides if item not in of_channels])
    given = _override(found.channels, of_channels)
    found.channels = {name: _source(path, name, entry, found) for name, entry in given.items()}
    if "color" not in found.channels:
        raise NteError(f"{path}: 'channels.color' is missing: name the layer with the noisy image")
    for group in ("motion", "forward_motion", "shutter_motion", "normal", "depth"):
        for key, value in vars(getattr(found, group)).items():
            if key in _CHOICES and value not in _CHOICES[key]:
                raise NteError(f"{path}: '{group}.{key}' is '{value}', expected one of {', '.join(_CHOICES[key])}")
    if not found.depth.scale or not isfinite(found.depth.scale):
        raise NteError(f"{path}: 'depth.scale' is {found.depth.scale}, expected a number that is not 0")
    if not found.depth.sky > 0:
        raise NteError(f"{path}: 'depth.sky' is {found.depth.sky}, expected a size from which on there is no surface")
    if not 0 <= found.vertical_fov < 180:
        raise NteError(f"{path}: 'vertical_fov' is {found.vertical_fov}, expected degrees between 0 and 180")
    if not 0 < found.shutter <= 1:
        raise NteError(f"{path}: 'shutter' is {found.shutter}, expected the open share of the frame, in (0, 1]")
    for name in ("normal", "depth"):
        if name in found.channels and not found.optional and (needed := needs_camera(found, name)):
            raise NteError(f"{path}: {needed}")
    return found


def needs_camera(how: ChannelMap, name: str) -> str:
    """What a channel cannot be read without, in words for the user; empty where nothing is missing."""
    if name == "normal" and how.normal.space == "camera" and not how.cameras:
        return "'normal.space' is camera: 'cameras' must name the JSON file of the cameras"
    if name == "depth" and how.depth.along == "ray" and not (how.cameras or how.vertical_fov):
        return "'depth.along' is ray: give 'vertical_fov' in degrees, or 'cameras'"
    return ""


def _override(channels: dict[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """The entries of `channels` with some of their keys replaced; a layer alone counts as the key `layer`."""
    found = dict(channels)
    for item in overrides:
        key, equals, text = item.removeprefix("channels.").partition("=")
        name, _, part = key.partition(".")
        if not equals or "${" in text:
            raise NteError(f"'{item}': expected key=value, with the value itself")
        try:
            value = OmegaConf.to_container(OmegaConf.from_dotlist([f"value={text}"]))["value"]  # type: ignore[index,call-overload]
        except YAMLError as error:
            raise NteError(f"'{item}': not readable as YAML: {problem_of(error)}") from error
        if part:
            entry = found.get(name, {})
            value = {**(entry if isinstance(entry, dict) else {"layer": entry}), part: value}
        found[name] = value
    return found


def _source(path: Path, name: str, given: Any, how: ChannelMap) -> Source:
    """The Source of an entry of `channels`, checked, with what the map says for all channels."""
    where = f"{path}: 'channels.{name}'"
    row = CHANNELS.get(name)
    if row is None or row.storage == "derived":
        stored = ", ".join(key for key, r in CHANNELS.items() if r.storage != "derived")
        raise NteError(f"{where}: no such channel; expected one of {stored}")
    keys = given if isinstance(given, dict) else {"layer": given}
    listed = {key: [value] if key in _LISTS and not isinstance(value, list) else value for key, value in keys.items()}
    # Once more: what is read here was resolved, and two halves may have met.
    refuse_resolvers(str(path), [listed, how.file, how.part, how.view], f"channels.{name}")
    try:
        merged = OmegaConf.merge(OmegaConf.structured(Source(file=how.file, part=how.part, view=how.view)), listed)
        source: Source = OmegaConf.to_object(merged)  # type: ignore[assignment]
    except OmegaConfBaseException as error:
        key = getattr(error, "full_key", None)
        if key and key.startswith("layer"):
            raise NteError(f"{where}: {given!r}: expected a layer, or {_names(row)}") from error
        raise NteError(f"{where.removesuffix(chr(39))}{f'.{key}' if key else ''}': {problem_with(error)}") from error
    _check_source(where, row, given, source)
    return source


def _check_source(where: str, row: Channel, given: Any, source: Source) -> None:
    count = len(row.components)
    # OmegaConf takes containers in a list of strings or numbers.
    nested = [key for key in _LISTS if any(isinstance(value, dict | list) for value in getattr(source, key))]
    unnamed = any(not part.strip() for name in source.layer if isinstance(name, str) for part in name.split("|"))
    if nested or unnamed or len(source.layer) not in (0, 1, count):
        key = f"{nested[0]}: " if nested and nested[0] != "layer" else ""
        expected = "single values" if key else f"a layer, or {_names(row)}"
        raise NteError(f"{where}: {key}{given!r}: expected {expected}")
    for key in ("scale", "offset"):
        numbers = getattr(source, key)
        if len(numbers) not in (1, count) or not all(map(isfinite, numbers)) or (key == "scale" and 0 in numbers):
            raise NteError(f"{where}: '{key}' is {numbers}, expected a number, or {count}, one for each component")
    if source.unknown and row.kind != "motion":
        raise NteError(f"{where}: 'unknown' is for motion vectors")
    for value in source.unknown:
        try:
            float(0 if value == SKY else value)
        except ValueError:
            raise NteError(f"{where}: 'unknown' has '{value}', expected stored values or {SKY}") from None


def _names(row: Channel) -> str:
    count = len(row.components)
    return f"the names of {count} channels" if count > 1 else "the name of its channel"
