"""The table of channels: everything that readers, augmentation, checks and the report know about a channel.

A new channel needs one new row here.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Storage = Literal["half", "float", "derived"]
Kind = Literal["radiance", "reflectance", "scalar", "depth", "point", "direction", "id", "motion", "covariance"]
Augment = Literal["colour", "world", "image", "covariance", "keep"]
Downsample = Literal["mean", "unit", "nearest", "motion"]
Shown = Literal["radiance", "reflectance", "direction", "heat", "labels", "motion"]
Group = Literal["every clip", "components", "shutter"]

RGB = ("R", "G", "B")
XYZ = ("X", "Y", "Z")
XY = ("X", "Y")
LP = ("L", "P")  # values of one surface point now (L) and in the previous frame (P)
NO_PAIR = "no gradient sample in this pixel"


@dataclass(frozen=True)
class Channel:
    """One row of the table: how a channel is stored, its components, and how image operations treat it."""

    name: str
    components: tuple[str, ...]  # suffixes of its layered EXR names: color.R, color.G, color.B
    storage: Storage  # half: float16 if the values survive it; derived: never stored
    unit: str
    kind: Kind
    noisy: bool = False  # differs from seed to seed
    nan_means: str = ""  # the meaning of a NaN; empty where a NaN is a fault
    group: Group = "every clip"  # channels rendered together: always, with light components, with an open shutter

    @property
    def augment(self) -> Augment:
        """How flips, transposes and colour permutations act on the values."""
        return _BEHAVIOUR[self.kind][0]

    @property
    def downsample(self) -> Downsample:
        """How the channel is reduced to a smaller image: ids, depths and motion are never averaged across an edge."""
        return _BEHAVIOUR[self.kind][1]

    @property
    def shown(self) -> Shown:
        """How `nte.frames.show` turns the channel into a picture."""
        return _BEHAVIOUR[self.kind][2]


# kind → augmentation, downsampling, display
_BEHAVIOUR: dict[Kind, tuple[Augment, Downsample, Shown]] = {
    "radiance": ("colour", "mean", "radiance"),
    "reflectance": ("colour", "mean", "reflectance"),
    "scalar": ("keep", "mean", "heat"),
    "depth": ("keep", "nearest", "heat"),
    "point": ("world", "nearest", "direction"),
    "direction": ("world", "unit", "direction"),
    "id": ("keep", "nearest", "labels"),
    "motion": ("image", "motion", "motion"),
    "covariance": ("covariance", "motion", "heat"),
}

_ROWS = (
    Channel("color", RGB, "half", "radiance", "radiance", noisy=True),
    Channel("prior", RGB, "derived", "radiance", "radiance", noisy=True),
    Channel("reference", RGB, "float", "radiance", "radiance"),
    Channel("reference_a", RGB, "float", "radiance", "radiance"),
    Channel("reference_b", RGB, "float", "radiance", "radiance"),
    Channel("albedo", RGB, "half", "1", "reflectance"),
    Channel("normal", XYZ, "half", "1, world", "direction"),
    Channel("roughness", ("V",), "half", "1", "scalar"),
    Channel("emission", RGB, "half", "radiance", "radiance"),
    Channel("depth", ("Z",), "float", "scene units", "depth"),
    Channel("position", XYZ, "float", "scene units, world", "point"),
    Channel("instance", ("ID",), "float", "whole number", "id"),
    Channel("motion", XY, "float", "px, to the previous frame", "motion"),
    Channel("forward_motion", XY, "float", "px, to the next frame", "motion"),
    Channel(
        "previous_forward_motion", XY, "derived", "px, from frame i−1 to frame i", "motion",
        nan_means="unknown: a hole left by scattering",
    ),
    Channel("next_color", RGB, "derived", "radiance", "radiance", noisy=True),
    Channel("next_albedo", RGB, "derived", "1", "reflectance"),
    Channel("next_depth", ("Z",), "derived", "scene units", "depth"),
    Channel("next_motion", XY, "derived", "px, from frame i+1 to frame i", "motion", nan_means="unknown"),
    Channel("motion_error", ("V",), "half", "log distance", "scalar"),
    Channel("motion_mask", ("V",), "half", "1", "scalar"),
    Channel("diffuse_albedo", RGB, "half", "1", "reflectance", group="components"),
    Channel("geometric_normal", XYZ, "half", "1, world", "direction", group="components"),
    Channel("direct", RGB, "half", "radiance", "radiance", group="components"),
    Channel("visibility", ("V",), "half", "1", "scalar", noisy=True, group="components"),
    Channel("indirect", RGB, "half", "radiance", "radiance", noisy=True, group="components"),
    Channel("indirect_radiance", RGB, "half", "radiance", "radiance", noisy=True, group="components"),
    Channel("indirect_direction", XYZ, "half", "1, world; 0 = no sample", "direction", noisy=True, group="components"),
    Channel("glossy", RGB, "half", "radiance", "radiance", noisy=True, group="components"),
    Channel("reference_visibility", ("V",), "half", "1", "scalar", group="components"),
    Channel("reference_indirect", RGB, "half", "radiance", "radiance", group="components"),
    Channel("reference_glossy", RGB, "half", "radiance", "radiance", group="components"),
    Channel(
        "shadow_motion", XY, "float", "px, to the previous frame", "motion", noisy=True,
        nan_means="unshadowed or invalid", group="components",
    ),
    Channel(
        "reflection_motion", XY, "float", "px, to the previous frame", "motion", noisy=True,
        nan_means="not glossy", group="components",
    ),
    Channel(
        "reflection_covariance", ("XX", "XY", "YY"), "float", "px²", "covariance", noisy=True,
        nan_means="not glossy", group="components",
    ),
    Channel("gradient", LP, "float", "luminance", "scalar", noisy=True, nan_means=NO_PAIR, group="components"),
    Channel("gradient_visibility", LP, "half", "1", "scalar", noisy=True, nan_means=NO_PAIR, group="components"),
    Channel(
        "gradient_indirect", LP, "float", "luminance", "scalar", noisy=True, nan_means=NO_PAIR, group="components"
    ),
    Channel("gradient_glossy", LP, "float", "luminance", "scalar", noisy=True, nan_means=NO_PAIR, group="components"),
    Channel("time", ("T",), "half", "open shutter, [0, 1]", "scalar", noisy=True, group="shutter"),
    Channel(
        "shutter_motion", XY, "float", "px over the open shutter, forward in time", "motion", noisy=True,
        group="shutter",
    ),
    Channel("shutter_depth", ("Z",), "float", "scene units", "depth", noisy=True, group="shutter"),
)  # fmt: skip

CHANNELS: dict[str, Channel] = {row.name: row for row in _ROWS}

PRIOR = "prior"  # made by a denoiser that another one builds on: nte.filters.prior
GUIDES = ("albedo", "normal")  # channels of the visible surface; `clean_guides` of a frame says if they are noise-free
COMPONENTS = ("visibility", "glossy", "indirect")  # the noisy parts of `color`; emission and direct have no noise
# Channels that a denoiser may denoise, and may be scored for.
TARGETS = ("color", *COMPONENTS)
# target → the channel that its light is multiplied by, and that demodulation divides by; other targets have none
TEXTURES = {"color": "albedo", "indirect": "diffuse_albedo"}
VECTORS = tuple(row.name for row in _ROWS if row.kind == "motion" and not row.nan_means)  # known in every pixel


def channels_of(group: Group, noisy: bool) -> tuple[str, ...]:
    """Return the names of a group's channels: the noisy ones, which differ from seed to seed, or all others."""
    return tuple(row.name for row in _ROWS if row.group == group and row.noisy == noisy)


def reference_of(target: str) -> str:
    """Name the channel that a denoiser's output is compared with: `reference` for color, else `reference_<target>`."""
    return "reference" if target == "color" else f"reference_{target}"


REFERENCES = tuple(reference_of(target) for target in TARGETS)


def width_of(channel: str) -> int:
    """Return how many components a channel has; raises KeyError for a name that the table does not have."""
    return len(CHANNELS[channel].components)


def way_to(names: Iterable[str]) -> str:
    """Say how nte render is made to write the channels that are missing; "" if every clip that it renders has them."""
    groups = sorted({CHANNELS[name].group for name in names if name in CHANNELS} - {"every clip"})
    return f"; nte render writes it in groups that set {' and '.join(groups)}" if groups else ""
