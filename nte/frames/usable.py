"""What a denoiser makes of values that no renderer can mean: the one sanitiser, driven by the table of channels.

radiance     [0, cap]. Negative components become 0, brighter ones the cap. A pixel that is NaN, infinite or
             beyond FAULT caps becomes black, and a mask says that it tells nothing (`usable_frame`).
reflectance  [0, 1], clamped. A pixel that is not finite becomes 0, which nte.color.divisor does not divide by.
depth        [1e-15, 1e15] scene units; anything else is 0, a miss.
direction    Length up to 1.01; a longer one is made a unit vector; no number at all is 0: no normal, no sample.
point        Up to 1e15; anything else is 0.
motion       Up to 4 images along each axis, noisy ones 64; anything else is NaN: unknown, so there is no history.
covariance   Up to the square of 64 images; anything else is NaN.
scalar       Finite, a share (unit 1) in [0, 1]; else 0, mid-shutter for a time, NaN where NaN has a meaning.
id           Finite, else 0.

Arrays are (N, C, H, W), NumPy or PyTorch alike: the network calls the same functions, so training, inference and
the exported graph agree. Usable values come out bit for bit.
"""

from collections.abc import Callable, Iterable
from math import inf

import numpy as np
import numpy.typing as npt

from nte.frames.channels import CHANNELS, Channel, Kind
from nte.frames.frame import Array, Frame
from nte.frames.scalars import FARTHEST, given_exposure, known_exposure

# Of exposed radiance. x/(1 + x) is within half a step of white in 16 bits, and half floats end here: a light that is
# brighter looks the same, while one sample of it would outweigh a history of any length.
BRIGHTEST = 65504.0
FAULT = 65504.0  # caps: beyond, it is no light but a fault
ABSOLUTE = 1e15  # cap whatever the exposure: divided by an albedo of 1e-3 and squared it still is finite
NEAREST = 1e-15
UNIT, LONG = 1.01, 1e3  # longest unit vector, rounded, and largest component of one that has lost its length
IMAGES, NOISY_IMAGES = 4.0, 64.0  # a shadow or a reflection may really have been that far away
LIT = 1 / 16  # of the 8×8 blocks must have light, or the level of the light is unknown


def usable_radiance(values: Array, brightest: Array | float) -> Array:
    """Light (N, C, H, W) in [0, brightest]; pixels that say nothing are black. brightest: (N, 1, 1, 1) or a number."""
    values = _where(says_something(values, brightest), values, 0.0)
    values = _where(values >= 0, values, 0.0)
    return _where(values <= brightest, values, brightest)


def says_something(values: Array, brightest: Array | float) -> Array:
    """(N, 1, H, W) bool: no component of the pixel's light is NaN, infinite or beyond any light."""
    return (abs(values) <= brightest * FAULT).all(1)[:, None]


def usable_reflectance(values: Array) -> Array:
    """Reflectance (N, C, H, W) in [0, 1]; 0 in all components where one is not finite."""
    return _where(_finite(values), values, 0.0).clip(0.0, 1.0)


def usable_depth(values: Array) -> Array:
    """Depth (N, 1, H, W), 0 = miss; so is what is no distance."""
    return _where((values >= NEAREST) & (values <= FARTHEST), values, 0.0)


def usable_direction(values: Array) -> Array:
    """Vectors (N, 3, H, W) of length 1 at the most; 0 where they are broken."""
    values = _where((abs(values) <= LONG).all(1)[:, None], values, 0.0)
    squared = (values * values).sum(1)[:, None]
    return values / _where(squared > UNIT * UNIT, squared, 1.0) ** 0.5


def usable_vector(values: Array, images: float = IMAGES) -> Array:
    """Vectors (N, 2, H, W) px; NaN in both components where one is not finite or longer than so many images."""
    height, width = values.shape[-2:]
    x, y = abs(values[:, :1]) <= images * width, abs(values[:, 1:]) <= images * height
    return _where(x & y, values, float("nan"))


def usable(row: Channel, values: Array, brightest: Array | float = ABSOLUTE) -> Array:
    """The channel's values (N, C, H, W) as the table above says."""
    return _USABLE[row.kind](row, values, brightest)


def mask_of(name: str) -> str:
    """The channel (N, 1, H, W) of a usable frame that is 1 where light of this name tells something, else 0."""
    return f"{name} usable"


def usable_frame(frame: Frame, names: Iterable[str], cap: npt.NDArray[np.float32]) -> Frame:
    """The frame with these channels usable, and `mask_of` those that are noisy light. cap: (N,), of radiance."""
    found: dict[str, Array] = {}
    for row in (CHANNELS[name] for name in dict.fromkeys(names) if name in frame and name in CHANNELS):
        values, mask = frame[row.name], mask_of(row.name)
        brightest = _like(cap.reshape(-1, 1, 1, 1), values)
        fine = all_usable(row, values, float(cap.min()))
        if not fine:
            found[row.name] = usable(row, values, brightest)
        # A wrapper's frame has been looked at before: what told nothing then is black now.
        if row.noisy and row.kind in ("radiance", "scalar") and mask not in frame:
            first = values[:, :1]
            found[mask] = first * 0 + 1 if fine else _like(says_something(values, brightest), values)
    return frame.with_channels(**found)


def all_usable(row: Channel, values: Array, brightest: float = ABSOLUTE) -> bool:
    """Whether two numbers, the least and the greatest, show that nothing is to be done: the usual case, and cheap."""
    height, width = values.shape[-2:]
    reach = (NOISY_IMAGES if row.noisy else IMAGES) * min(height, width)
    ranges: dict[Kind, tuple[float, float]] = {
        "radiance": (0.0, brightest), "reflectance": (0.0, 1.0), "depth": (NEAREST, FARTHEST),
        "point": (-FARTHEST, FARTHEST), "motion": (-reach, reach),
    }  # fmt: skip
    low, high = (0.0, 1.0) if row.kind == "scalar" else ranges.get(row.kind, (inf, -inf))
    return bool(values.min() >= low) and bool(values.max() <= high)  # NaN is neither


def light_cap(frame: Frame, carried: npt.NDArray[np.float32] | None) -> npt.NDArray[np.float32]:
    """Radiance (N,) at which a sequence's light is capped, in the frame's units: BRIGHTEST over its exposure.

    carried: that of the frame before; None starts. Where the frame does not give the exposure it is estimated from
    the first frame that has light, and again only where something exceeds the cap. It rises if the scene has
    become brighter and never falls, so it does not pump. NaN: unknown yet.
    """
    exposure = given_exposure(frame)
    if exposure is not None:
        return np.asarray(BRIGHTEST / exposure, np.float32)
    if carried is None or len(carried) != frame.batch:
        carried = np.full(frame.batch, np.nan, np.float32)
    if frame.reset is not None:
        carried = np.where(_numpy(frame.reset) > 0, np.float32(np.nan), carried)
    light = _light(frame)
    if light is None:
        return carried
    # Something is brighter than the cap, or NaN, or the cap unknown: comparisons with NaN are false. Each sequence by
    # itself, or one of a batch would have another cap than alone.
    beyond = ~np.array([bool(image.max() <= float(cap)) for image, cap in zip(light, carried, strict=True)])
    if not beyond.any():
        return carried
    own = BRIGHTEST / known_exposure(_numpy(light), LIT)
    return np.asarray(np.where(beyond, np.fmax(carried, own), carried), np.float32)


def known_cap(cap: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """The cap (N,) to use: ABSOLUTE where none is known, and at the most."""
    return np.fmin(cap, np.float32(ABSOLUTE))


def _light(frame: Frame) -> Array | None:
    """All light (N, 3, H, W) that the frame has: `color`, or the sum of what it is made of; None without any."""
    for names in (("color",), ("emission", "direct", "indirect", "glossy"), ("indirect_radiance",)):
        parts = [frame[name] for name in names if name in frame]
        if parts:
            return sum(_where(abs(part) <= ABSOLUTE * FAULT, part, 0.0) for part in parts[1:]) + parts[0]
    return None


def _scalar(row: Channel, values: Array, brightest: Array | float) -> Array:
    """A share is clamped, any other number left as it is; what is not finite is NaN where that has a meaning."""
    share = row.unit == "1"
    if row.nan_means:
        high = 1.0 if share else brightest * FAULT
        return _where(((values >= 0) & (values <= high)).all(1)[:, None], values, float("nan"))
    values = _where(abs(values) < float("inf"), values, 0.5 if row.name == "time" else 0.0)
    return values.clip(0.0, 1.0) if share else values


def _finite(values: Array) -> Array:
    return (abs(values) < float("inf")).all(1)[:, None]


def _vector(row: Channel, values: Array, _: Array | float) -> Array:
    return usable_vector(values, NOISY_IMAGES if row.noisy else IMAGES)


def _covariance(row: Channel, values: Array, _: Array | float) -> Array:
    height, width = values.shape[-2:]
    largest = (NOISY_IMAGES * NOISY_IMAGES) * (height * height + width * width)
    return _where((abs(values) <= largest).all(1)[:, None], values, float("nan"))


_USABLE: dict[Kind, Callable[[Channel, Array, Array | float], Array]] = {
    "radiance": lambda row, values, brightest: usable_radiance(values, brightest),
    "reflectance": lambda row, values, brightest: usable_reflectance(values),
    "scalar": _scalar,
    "depth": lambda row, values, brightest: usable_depth(values),
    "point": lambda row, values, brightest: _where((abs(values) <= FARTHEST).all(1)[:, None], values, 0.0),
    "direction": lambda row, values, brightest: usable_direction(values),
    "id": lambda row, values, brightest: _where(_finite(values), values, 0.0),
    "motion": _vector,
    "covariance": _covariance,
}


def _where(keep: Array, values: Array, other: Array | float) -> Array:
    """values where `keep`, else `other`: NumPy has it as a function, PyTorch as a method."""
    if isinstance(values, np.ndarray):
        return np.where(keep, values, other)
    return values.where(keep, other)


def _like(array: Array, like: Array) -> Array:
    """An array as float32 of the kind, and on the device, of another."""
    if isinstance(like, np.ndarray):
        return np.asarray(array, np.float32)
    if isinstance(array, np.ndarray):
        return like.new_tensor(array)
    return array.to(like.dtype)


def _numpy(array: Array) -> npt.NDArray[np.float32]:
    return np.asarray(array.detach().cpu() if hasattr(array, "detach") else array)
