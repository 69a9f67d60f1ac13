"""A check that planes are straight in 1 / depth: where a camera sees a plane, 1 / z is a linear function of x and y.

Three pixels of a plane, evenly spaced along a row or a column, have depths a, b, c, with p = b − a and q = c − b. The
bend t = b (p − q) / 2pq has no unit, and tells of which kind the depth is:

    the distance along the view axis       t = −1
    inverse, or a z-buffer, A + B / z      t = 0           (also the distance, for an orthographic camera)
    counted from another plane, F ± z      t = b / (F − b)
    a logarithm, log(z) / k                t = −k b / 2

On curved surfaces t is anything, and nothing agrees. This needs no vectors, normals or cameras, and one frame.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from nte.checking.values import Finding
from nte.frames.frame import Frame

STEPS = 32  # the three pixels are about this part of the shorter side apart, and two pixels at least
SAMPLED = 16384  # triples of pixels along an axis that are looked at, up to four times as many
ENOUGH = 200  # least number of bent triples that can tell
QUANTA = 8  # least bend in rounding steps of the depth: rounded values are evenly spaced by chance
FEW, WHOLE = 8, 0.1  # fewer differences prove nothing; greatest distance from a whole number of what is a multiple
UNEVEN = 2.0  # greatest ratio of p and q: a greater one is seen across silhouettes
INVERSE = "inverse, or a z-buffer"
BUFFER = 0.9  # if nearly all depths lie between this and 1, they look like those of a z-buffer
CLOSE = 0.1  # triples agree with a kind if their bend is off by at most this share of it
SOME = 0.25  # share of the triples that must agree; measured: 0.3 to 0.99 have t = −1, 0.04 without planes
RATHER = 4.0  # another kind must explain this many times as many triples as the distance along the view axis
EXPECTED = "the distance along the view axis"


class PlaneTally:
    """Tally of the bends of depth in some frames of a clip without positions, which tell more."""

    def __init__(self) -> None:
        self._middles: list[Tensor] = []
        self._bends: list[Tensor] = []
        self._looked = False  # at frames whose depth planes can tell
        self._range = float("inf"), 0.0  # least depth, but for the nearest tenth of a frame's surfaces; greatest depth
        self._perspective = True  # in all frames cameras are known, and have a centre

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1."""
        if "depth" not in frame or ("position" in frame and frame["position"].any()):
            return
        last = None if frame.projection is None else frame.projection[0, 3]
        centred = last is not None and bool(last[:3].abs().max() > 1e-6 * last.abs().max())
        self._perspective &= centred
        if last is not None and not centred:
            return  # an orthographic camera sees planes straight in z
        self._looked = True
        depth = frame["depth"][0, 0].double().nan_to_num(0, 0, 0)
        instance = frame["instance"][0, 0] if "instance" in frame else torch.zeros_like(depth)
        if (hits := depth[depth > 0]).numel():
            low, high = self._range
            tenth = float(hits.kthvalue(-(-hits.numel() // 10)).values)
            self._range = min(low, tenth), max(high, float(hits.max()))
        steps = _rounding(depth)
        for along in ((depth, instance, steps), (depth.T, instance.T, steps.T)):
            middle, bend = _bends_along(*along)
            self._middles.append(middle)
            self._bends.append(bend)

    def judge(self) -> Iterator[Finding]:
        """Yield a finding if another kind of depth makes planes straight. It is no fault if the camera may do that."""
        kinds = self._kinds()
        found = max(kinds, key=lambda kind: kinds[kind], default="")
        if not found or kinds[found] < SOME:
            yield from self._judge_range()
            return
        if kinds[found] < RATHER * kinds[EXPECTED]:
            return
        told = f"planes are straight in it only if it is {found}, in {kinds[found]:.0%} of what bends"
        doubt = found == INVERSE and not self._perspective
        if doubt:
            told += "; or the camera is orthographic, which cameras would tell"
        yield Finding("depth", told, EXPECTED, not doubt, doubt)

    def _judge_range(self) -> Iterator[Finding]:
        low, high = self._range
        if BUFFER < low <= high <= 1:
            found = f"nine tenths lie between {low:.4g} and {high:.4g}, as in a z-buffer, and no slanted plane tells"
            yield Finding("depth", found, EXPECTED, False, True)

    def not_judged(self, ordered: bool) -> str:
        """Say what could not be judged, and why; "" if planes told. ordered: it is known that what is nearer hides."""
        if not self._looked or max(self._kinds().values(), default=0.0) >= SOME:
            return ""
        what = "whether it is linear" if ordered else "whether it is linear, or inverse"
        return f"{what}: there is no position, and no slanted plane" + (
            "" if ordered else "; nothing moves before anything"
        )

    def _kinds(self) -> dict[str, float]:
        """Share of the bent triples that each kind of depth explains, by its name; empty if there are too few."""
        if sum(len(bend) for bend in self._bends) < ENOUGH:
            return {}
        b, t = torch.cat(self._middles), torch.cat(self._bends)
        origins, lengths = b * (1 + 1 / t), b / t
        origin, length = float(origins.median()), float(lengths.median())

        def share(agree: Tensor) -> float:
            return float(agree.double().mean())

        return {
            EXPECTED: share((t + 1).abs() < CLOSE),
            INVERSE: share(t.abs() < CLOSE),
            f"counted from a plane at {origin:.4g}": share((origins - origin).abs() < CLOSE * (origin - b).abs()),
            "a logarithm": share((lengths - length).abs() < CLOSE * abs(length)) if length < 0 else 0.0,
        }


def _bends_along(depth: Tensor, instance: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
    """Return the depth in the middle and the bend (n,) of the triples along the columns of depth (H, W)."""
    step = max(2, round(min(depth.shape) / STEPS))
    if depth.shape[0] <= 2 * step:
        return depth[:0, 0], depth[:0, 0]
    stride = max(1, int((depth.numel() / SAMPLED) ** 0.5))
    ends = [slice(i * step, depth.shape[0] - (2 - i) * step, stride) for i in range(3)]
    a, b, c = (depth[rows, ::stride] for rows in ends)
    first, second, third = (instance[rows, ::stride] for rows in ends)
    p, q = b - a, c - b
    bends = torch.maximum((p - q).abs(), 2 * p * q / b) > QUANTA * steps[ends[1], ::stride]
    even = (p * q > 0) & (p.abs() < UNEVEN * q.abs()) & (q.abs() < UNEVEN * p.abs())
    usable = (torch.minimum(a, c) > 0) & (b > 0) & even & (first == second) & (second == third) & bends
    return b[usable], (b * (p - q) / (2 * p * q))[usable]


def _rounding(depth: Tensor) -> Tensor:
    """Estimate the steps (H, W) to which depth (H, W) is rounded, as halves, bytes and other whole numbers are.

    Within a factor of two the differences between rounded values are multiples of the least one.
    """
    values = torch.unique(depth[depth > 0])
    octaves, octave = values.log2().floor(), depth.clamp(min=1e-30).log2().floor()
    steps = 4 * torch.finfo(torch.float32).eps * depth
    for each in torch.unique(octaves):
        gaps = values[octaves == each].diff()
        if len(gaps):
            multiples = gaps / gaps.min()
            if len(gaps) < FEW or bool(((multiples - multiples.round()).abs() < WHOLE).all()):
                steps = torch.where(octave == each, torch.maximum(steps, gaps.min()), steps)
    return steps
