"""Checks of single channels: finite values, ranges, unit lengths, whole numbers, visible surfaces."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from nte.frames.bad import count_bad
from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame
from nte.frames.usable import ABSOLUTE

SANITISED = ("radiance", "reflectance")  # kinds whose bad pixels denoisers sanitise
NEVER_BLACK = ("color", "albedo")  # channels that are 0 everywhere only by mistake
UNIT_SCALARS = ("roughness", "visibility", "reference_visibility", "time")  # scalars in [0, 1]
BELOW = 0.01  # negative light that is a greater share of all light is a fault; lossy compression and filters have less
DARK = 0.02  # albedo that is nowhere greater is darker than soot
MANY = 0.01  # a greater share of pixels with impossible values is a fault of the channel, not of a few pixels
MOST = 0.5  # a greater share of vectors longer than four images is a fault: they have another unit
ROUNDING = 0.005  # greatest error of half floats and of averages
ENCODED = 0.02  # greatest error of the length of directions that are surely encoded
SAMPLED = 4096  # directions of a frame that are looked at, up to twice as many


@dataclass(frozen=True)
class Finding:
    """Something unexpected about a channel: a fault fails the check, a doubt leaves it undecidable, or it is a note."""

    channel: str
    found: str
    expected: str
    fault: bool = True
    doubt: bool = False  # what is found may be a fault, or right: the files do not tell


@dataclass
class Tally:
    """Counts and ranges of one channel over a clip; counts are of pixels unless they say otherwise."""

    pixels: int = 0
    low: float = float("inf")
    high: float = -float("inf")
    least: float = float("inf")  # above 0
    total: float = 0.0
    negative: float = 0.0  # sum of the negative values
    finite: int = 0  # number of finite values
    lost: int = 0  # pixels with a value that is not finite, or absurd
    bad: int = 0  # unusable (nte.frames.bad) for light, reflectance, gradients and covariances; not finite for others
    first_bad: int | None = None  # first frame with bad pixels
    far: int = 0  # vectors longer than four images, or, if noisy, than 64
    first_far: int | None = None  # first frame with such vectors
    impossible: int = 0  # pixels outside the channel's range, or with an id that is not whole
    seen: int = 0  # pixels that are not all zero
    directions: list[Tensor] = field(default_factory=list)  # (3, n), a sample of the directions that are not zero

    @property
    def mean(self) -> float:
        """Mean of the finite values; NaN without any."""
        return self.total / self.finite if self.finite else float("nan")


def tally_values(tallies: Mapping[str, Tally], frame: Frame) -> None:
    """Add a PyTorch frame of batch 1 to the tallies of its channels.

    tallies: channel → Tally; must make missing entries by itself, as a defaultdict does.
    """
    bad = count_bad(frame)
    for name, values in frame.channels.items():
        entry = tallies[name]
        entry.pixels += values[0, 0].numel()
        finite = values[values.isfinite()]
        if finite.numel():
            entry.low, entry.high = min(entry.low, float(finite.min())), max(entry.high, float(finite.max()))
            entry.least = min(entry.least, float(torch.where(finite > 0, finite, torch.inf).min()))
            entry.total += float(finite.double().sum())
            entry.negative -= float(finite.clamp(max=0).double().sum())
            entry.finite += finite.numel()
        row = CHANNELS[name]
        # Other channels are judged below, by their ranges.
        counted = row.kind in SANITISED or (row.nan_means and row.kind != "motion")
        number = bad.get(name, 0) if counted else int(_not_finite(name, values).sum())
        entry.lost += int((~(values.abs() <= ABSOLUTE)).any(1).sum())
        if row.kind == "motion" and (far := bad.get(name, 0) - number):
            entry.far += far
            entry.first_far = frame.index if entry.first_far is None else entry.first_far
        if number:
            entry.bad += number
            entry.first_bad = frame.index if entry.first_bad is None else entry.first_bad
        entry.seen += int((values.nan_to_num() != 0).any(1).sum())
        entry.impossible += int(_impossible(name, values).any(1).sum())
        if row.kind == "direction":
            vectors = values[0].flatten(1)
            vectors = vectors[:, vectors.isfinite().all(0) & (vectors != 0).any(0)]
            entry.directions.append(vectors[:, :: max(1, vectors.shape[1] // SAMPLED)])


def _not_finite(name: str, values: Tensor) -> Tensor:
    """Mark the pixels (1, H, W) of values (1, C, H, W) that are not finite, without a NaN that has a meaning."""
    lost = (~values.isfinite()).any(1)
    return lost & ~values.isnan().any(1) if CHANNELS[name].nan_means else lost


def _impossible(name: str, values: Tensor) -> Tensor:
    """Mark the finite values (1, C, H, W) that the channel cannot have."""
    kind = CHANNELS[name].kind
    if kind == "id":
        return values.isfinite() & ((values != values.round()) | (values < 0))
    if kind == "depth":
        return values.isfinite() & (values < 0)
    if kind == "reflectance" or name in UNIT_SCALARS:
        return values.isfinite() & ((values < -ROUNDING) | (values > 1 + ROUNDING))
    return torch.zeros_like(values, dtype=torch.bool)


def judge_values(tallies: Mapping[str, Tally]) -> list[Finding]:
    """List what is impossible, or worth a note, about the channels of a clip."""
    found = [finding for name, entry in tallies.items() for finding in _judge(name, entry)]
    depth = tallies.get("depth")
    if depth and not depth.seen:
        others = [n for n in ("normal", "instance", "position", "albedo") if n in tallies and tallies[n].seen]
        shown = (n for n in others if n != "albedo" or tallies[n].low < tallies[n].high)  # some give the sky an albedo
        if any(tallies[name].seen > MANY * tallies[name].pixels for name in shown):
            expected = "above 0 wherever a surface is seen: too small, negative or infinite depths count as misses"
            found.append(Finding("depth", f"0 everywhere, though {' and '.join(others)} show surfaces", expected))
    if "normal" in tallies and "position" not in tallies:  # which shows the surfaces
        found += _one_normal(tallies["normal"])
    return found


def _one_normal(entry: Tally) -> Iterator[Finding]:
    vectors = torch.cat([*entry.directions, torch.empty(3, 0)], 1)
    if vectors.numel() and float((vectors.amax(1) - vectors.amin(1)).max()) < ROUNDING:
        found = f"({', '.join(f'{component:.3g}' for component in vectors.mean(1).tolist())}) everywhere"
        yield Finding("normal", found, "the direction of each surface: it may stand for none at all", fault=False)


def _judge(name: str, entry: Tally) -> Iterator[Finding]:
    row = CHANNELS[name]
    many = MANY * entry.pixels
    if entry.bad:
        what, expected, fault = "not finite", "finite", True
        if row.kind in SANITISED:
            what, expected = "not finite, or negative", "finite and not negative; denoisers sanitise these pixels"
            fault = entry.lost > many or entry.negative > BELOW * (entry.total + entry.negative)
        found = f"{what} in {entry.bad} pixels of {name}, the first in frame {entry.first_bad}"
        yield Finding(name, found, expected, fault)
    if entry.far:  # a point near the camera's plane was seen far outside the image
        images = "64" if row.noisy else "four"
        found = f"longer than {images} images in {entry.far} pixels of {name}, the first in frame {entry.first_far}"
        expected = "vectors that end in the image, or not far from it; longer ones count as unknown"
        yield Finding(name, found, expected, entry.far > MOST * entry.pixels)
    if name in NEVER_BLACK and not entry.seen:
        yield Finding(name, "0 everywhere", "values above 0: it may come from another layer than meant", fault=False)
    elif name == "albedo" and entry.least == entry.high:
        found = f"{entry.high:.4g} everywhere" + (", or 0" if entry.low < entry.high else "")
        yield Finding(name, found, "the colour of each surface: it may stand for none at all", fault=False)
    elif name == "albedo" and 0 < entry.high < DARK:
        found = f"{entry.high:.4g} at the most: darker than soot"
        yield Finding(name, found, "the share of the light that is reflected, in [0, 1]", fault=False)
    if row.kind == "direction":
        yield from _judge_directions(name, entry)
    elif entry.impossible:
        share = f"in {entry.impossible / entry.pixels:.2%} of the pixels"
        if row.kind == "id":
            yield Finding(name, f"fractions, or negative, {share}", "whole numbers: ids are never averaged")
        elif row.kind == "depth":
            yield Finding(name, f"negative {share}", "distances in front of the camera, 0 for a miss")
        elif entry.impossible > entry.bad:
            found = f"{entry.low:.4g} to {entry.high:.4g}, outside {share}"
            yield Finding(name, found, "within [0, 1]", entry.impossible > many)


def _judge_directions(name: str, entry: Tally) -> Iterator[Finding]:
    if not entry.directions:
        return
    vectors = torch.cat(entry.directions, 1)
    if not vectors.numel():
        if name == "normal":
            yield Finding(name, "0 everywhere", "unit vectors where a surface is seen", fault=False)
        return
    length = vectors.norm(dim=0)
    typical = float(length.median())
    off = float(((length - 1).abs() > 0.1).float().mean())
    if is_encoded(vectors):
        expected = "unit vectors with components in [−1, 1]"
        # Normalised, all that is nearly grey looks like that.
        surely = float(((2 * vectors - 1).norm(dim=0) - 1).abs().median()) < ENCODED
        what = "stored as n/2 + 1/2" if surely else "stored as n/2 + 1/2, or another channel"
        yield Finding(name, f"no component is negative: {what}", expected)
    elif abs(typical - 1) > 0.05:
        yield Finding(name, f"vectors of length {typical:.3g}", "length 1")
    elif off > 0.05:
        yield Finding(name, f"{off:.1%} of the vectors are not of length 1", "length 1, but for a few edges", False)


def is_encoded(vectors: Tensor) -> bool:
    """Tell whether directions (3, n) look like unit vectors n stored as n/2 + 1/2, possibly normalised afterwards.

    No component of such a v is negative, and 2v − 1 has length 1. If v was normalised to u, |2su − 1| = 1 has a
    solution s exactly if u's components add up to √2 or more, that is within 35° of the diagonal. Real directions may
    lie there by chance if they are nearly parallel, so directions that hardly vary must fit unnormalised.
    """
    if float((vectors < -ROUNDING).any(0).float().mean()) > MANY:
        return False
    unit = vectors / vectors.norm(dim=0)
    if float(unit.mean(1).norm()) > 0.995:  # a mean angle of 6° or less to their mean
        off = ((2 * vectors - 1).norm(dim=0) - 1).abs() < ENCODED
        return float(off.float().mean()) > 0.95 and float((vectors.norm(dim=0) - 1).abs().median()) > 0.05
    return float((unit.sum(0) > 2**0.5 - 0.02).float().mean()) > 0.97
