"""The sanitiser of input values that no renderer can mean, driven by the table of channels.

radiance     [0, cap]. Negative components become 0, brighter ones the cap. A pixel that is NaN, infinite or
             beyond FAULT caps becomes black, and a mask marks it as unusable (`usable_frame`).
reflectance  [0, 1], clamped. A pixel that is not finite becomes 0, which nte.color.divisor does not divide by.
depth        [1e-15, 1e15] scene units; anything else becomes 0, a miss.
direction    Length up to 1.01; a longer one becomes a unit vector; a broken one 0: no normal, no sample.
point        Up to 1e15; anything else becomes 0.
motion       Up to 4 images along each axis, 64 if noisy; anything else becomes NaN: unknown, so there is no history.
covariance   Up to the squared diagonal of 64 images; anything else becomes NaN.
scalar       [0, 1] if the unit is 1, clamped; a value that is not finite becomes 0, or mid-shutter for a time. If
             NaN has a meaning, a value that is not finite, negative or too large becomes NaN.
id           Finite, else 0.

Arrays are (N, C, H, W), NumPy or PyTorch: the network calls the same functions, so training, inference and the
exported graph agree. Usable values come out bit for bit.
"""

from collections.abc import Callable, Iterable
from math import inf

import numpy as np
import numpy.typing as npt

from nte.frames.channels import CHANNELS, GUIDES, Channel, Kind
from nte.frames.frame import Array, Frame
from nte.frames.scalars import FARTHEST, given_exposure, known_exposure

# The cap of exposed radiance. Here x/(1 + x) is within half a 16-bit step of white, and half floats end: a brighter
# light looks the same, while one sample of it would outweigh a history of any length.
BRIGHTEST = 65504.0
FAULT = 65504.0  # in caps; a value beyond is a fault, not light
ABSOLUTE = 1e15  # radiance; the cap for any exposure: divided by an albedo of 1e-3 and squared it is still finite
NEAREST = 1e-15  # scene units; a smaller depth is a miss
FINITE = float(np.finfo(np.float32).max)
UNIT, LONG = 1.01, 1e3  # longest rounded unit vector; largest component of a direction that can still be normalised
IMAGES, NOISY_IMAGES = 4.0, 64.0  # longest motion, in images; a shadow or a reflection may come from far away
LIT = 1 / 16  # the level of light is unknown unless more than this share of the 8×8 blocks has light


def within(values: Array, largest: Array | float = FINITE) -> Array:
    """Mark the pixels (N, 1, H, W) all of whose components (N, C, H, W) are at most `largest` away from 0; NaN is not.

    Component by component: ONNX Runtime takes four times as long to ask for all at once.
    """
    each = abs(values) <= largest
    found = each[:, :1]
    for component in range(1, values.shape[1]):
        found = found & each[:, component : component + 1]
    return found


def usable_radiance(values: Array, brightest: Array | float) -> Array:
    """Sanitise light (N, C, H, W) to [0, brightest]; pixels that are a fault (`says_something`) become black.

    brightest: the cap in the units of `values`, (N, 1, 1, 1) or a number.
    """
    return _where(says_something(values, brightest), values, 0.0).clip(0.0).clip(None, brightest)


def says_something(values: Array, brightest: Array | float) -> Array:
    """Mark the pixels of light (N, C, H, W) that are no fault, as a bool mask (N, 1, H, W).

    In a fault some component is NaN, infinite, or beyond 65504 times `brightest`, a number or (N, 1, 1, 1).
    """
    return within(values, brightest * FAULT)


def usable_reflectance(values: Array) -> Array:
    """Clamp reflectance (N, C, H, W) to [0, 1]; a pixel with a component that is not finite becomes 0."""
    return _where(within(values), values, 0.0).clip(0.0, 1.0)


def usable_depth(values: Array) -> Array:
    """Sanitise depth (N, 1, H, W), scene units: a value outside [1e-15, 1e15] becomes 0, a miss."""
    return _where((values >= NEAREST) & (values <= FARTHEST), values, 0.0)


def usable_direction(values: Array) -> Array:
    """Sanitise directions (N, 3, H, W): longer than 1.01 they become unit vectors, broken ones become 0.

    A direction is broken if a component is NaN, infinite or beyond 1000.
    """
    values = _where(within(values, LONG), values, 0.0)
    squared = (values * values).sum(1)[:, None]
    return values / _where(squared > UNIT * UNIT, squared, 1.0) ** 0.5


def usable_vector(values: Array, images: float = IMAGES) -> Array:
    """Sanitise motion vectors (N, 2, H, W) in pixels: NaN in both components if one is not finite or too long.

    images: the longest motion along an axis, in image widths or heights.
    """
    height, width = values.shape[-2:]
    x, y = abs(values[:, :1]) <= images * width, abs(values[:, 1:]) <= images * height
    return _where(x & y, values, float("nan"))


def usable(row: Channel, values: Array, brightest: Array | float = ABSOLUTE) -> Array:
    """Sanitise a channel's values (N, C, H, W) as this module's table says.

    brightest: cap of radiance, a number or (N, 1, 1, 1).
    """
    return _USABLE[row.kind](row, values, brightest)


def mask_of(name: str) -> str:
    """Name the mask (N, 1, H, W) that `usable_frame` adds for a channel: 1 where it is usable, else 0."""
    return f"{name} usable"


def usable_frame(frame: Frame, names: Iterable[str], cap: npt.NDArray[np.float32]) -> Frame:
    """Sanitise the named channels of a frame, and add a mask (`mask_of`) for noisy light and noisy scalars.

    A guide (albedo, normal) gets a mask if it has faults: pixels that are not finite, or beyond 1000. names: channels
    that the frame or the table lacks are skipped. cap: radiance (N,) at which light is capped.
    """
    found: dict[str, Array] = {}
    for row in (CHANNELS[name] for name in dict.fromkeys(names) if name in frame and name in CHANNELS):
        values, mask = frame[row.name], mask_of(row.name)
        brightest = _like(cap.reshape(-1, 1, 1, 1), values)
        fine = all_usable(row, values, float(cap.min()))
        if not fine:
            found[row.name] = usable(row, values, brightest)
        # A wrapper passes on a frame that is sanitised already, where faults are black: its mask stays.
        if mask in frame:
            continue
        if row.noisy and row.kind in ("radiance", "scalar"):
            first = values[:, :1]
            found[mask] = first * 0 + 1 if fine else _like(says_something(values, brightest), values)
        elif row.name in GUIDES and not fine:
            known = within(values, LONG)
            if not known.all():
                found[mask] = _like(known, values)
    return frame.with_channels(**found)


def all_usable(row: Channel, values: Array, brightest: float = ABSOLUTE) -> bool:
    """Tell cheaply, from the minimum and the maximum alone, whether all values are usable.

    False means that the values must be looked at one by one.
    """
    height, width = values.shape[-2:]
    reach = (NOISY_IMAGES if row.noisy else IMAGES) * min(height, width)
    ranges: dict[Kind, tuple[float, float]] = {
        "radiance": (0.0, brightest),
        "reflectance": (0.0, 1.0),
        "depth": (NEAREST, FARTHEST),
        "point": (-FARTHEST, FARTHEST),
        "motion": (-reach, reach),
    }
    low, high = (0.0, 1.0) if row.kind == "scalar" else ranges.get(row.kind, (inf, -inf))
    return bool(values.min() >= low) and bool(values.max() <= high)  # NaN is neither


def light_cap(frame: Frame, carried: npt.NDArray[np.float32] | None) -> npt.NDArray[np.float32]:
    """Return the radiance (N,) at which a sequence's light is capped, in the frame's units: 65504 / exposure.

    carried: the cap (N,) of the previous frame; None at the start. If the frame gives no exposure, the exposure is
    estimated from the first frame that has light, and again only when something exceeds the cap. The cap rises if
    the scene becomes brighter and never falls, so it does not pump. NaN: unknown yet. Raises NteError if the frame's
    own exposure is not positive.
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
    # True where something is brighter than the cap, or NaN, or the cap is unknown: comparisons with NaN are false.
    # Each sequence is judged by itself, or its cap in a batch would differ from its cap alone.
    beyond = ~np.array([bool(image.max() <= float(cap)) for image, cap in zip(light, carried, strict=True)])
    if not beyond.any():
        return carried
    own = BRIGHTEST / known_exposure(_numpy(light), LIT)
    return np.asarray(np.where(beyond, np.fmax(carried, own), carried), np.float32)


def known_cap(cap: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the cap (N,) to use: at most 1e15 (ABSOLUTE), and 1e15 where the cap is unknown (NaN)."""
    return np.fmin(cap, np.float32(ABSOLUTE))


def _light(frame: Frame) -> Array | None:
    """All light (N, 3, H, W) that the frame has: `color`, or the sum of its components; None without any."""
    for names in (("color",), ("emission", "direct", "indirect", "glossy"), ("indirect_radiance",)):
        parts = [frame[name] for name in names if name in frame]
        if parts:
            return sum(_where(abs(part) <= ABSOLUTE * FAULT, part, 0.0) for part in parts[1:]) + parts[0]
    return None


def _scalar(row: Channel, values: Array, brightest: Array | float) -> Array:
    """Clamp a share (unit 1) to [0, 1] and keep other numbers; a value that is not finite becomes 0, or 0.5 for a time.

    In channels where NaN has a meaning, a pixel with a component that is negative, too large or not finite is NaN.
    """
    share = row.unit == "1"
    if row.nan_means:
        high = 1.0 if share else brightest * FAULT
        return _where(((values >= 0) & (values <= high)).all(1)[:, None], values, float("nan"))
    values = _where(abs(values) < float("inf"), values, 0.5 if row.name == "time" else 0.0)
    return values.clip(0.0, 1.0) if share else values


def _vector(row: Channel, values: Array, _: Array | float) -> Array:
    return usable_vector(values, NOISY_IMAGES if row.noisy else IMAGES)


def _covariance(row: Channel, values: Array, _: Array | float) -> Array:
    height, width = values.shape[-2:]
    largest = (NOISY_IMAGES * NOISY_IMAGES) * (height * height + width * width)
    return _where(within(values, largest), values, float("nan"))


_USABLE: dict[Kind, Callable[[Channel, Array, Array | float], Array]] = {
    "radiance": lambda row, values, brightest: usable_radiance(values, brightest),
    "reflectance": lambda row, values, brightest: usable_reflectance(values),
    "scalar": _scalar,
    "depth": lambda row, values, brightest: usable_depth(values),
    "point": lambda row, values, brightest: _where(within(values, FARTHEST), values, 0.0),
    "direction": lambda row, values, brightest: usable_direction(values),
    "id": lambda row, values, brightest: _where(within(values), values, 0.0),
    "motion": _vector,
    "covariance": _covariance,
}


def _where(keep: Array, values: Array, other: Array | float) -> Array:
    """Select values where `keep`, else `other`: a function in NumPy, a method in PyTorch."""
    if isinstance(values, np.ndarray):
        return np.where(keep, values, other)
    return values.where(keep, other)


def _like(array: Array, like: Array) -> Array:
    """Convert an array to float32 of the kind, and on the device, of another."""
    if isinstance(like, np.ndarray):
        return np.asarray(array, np.float32)
    if isinstance(array, np.ndarray):
        return like.new_tensor(array)
    return array.to(like.dtype)


def _numpy(array: Array) -> npt.NDArray[np.float32]:
    return np.asarray(array.detach().cpu() if hasattr(array, "detach") else array)
