"""A check that surfaces take their normals, positions and ids along with them, where vectors that are right lead.

A channel that is another clip's, of another frame or in another order changes along vectors as much as it does in its
own pixels, or more. So does noise, but it changes as much from pixel to pixel. Positions and normals tell only where
most of the picture moves, as of a camera: those of an object change as it travels or turns, and before a camera at rest
hardly in their own pixels (of a globe not at all). Depth and roughness are left out: depth changes as a camera travels,
and roughness hardly varies.
"""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from nte.checking.values import Finding
from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame
from nte.motion.warp import fetch_nearest, pixel_centres

TRAVELS = ("normal", "position", "instance")
MOVING_PX = 1.0  # shorter vectors tell nothing
CAMERA = 0.5  # share of the picture that surfaces which move must fill for it to be the camera
ENOUGH = 200  # least number of pixels that can tell
CHANGE = 0.005  # least mean change along vectors that is told: of components, of positions in units of their extent, or
# the share of the pixels with another id
MOST = 0.85  # least ratio of that to the change in the same pixel; measured: 0.04 to 0.8 in right clips, 0.87 to 3
NOISE = 1.5  # least ratio of that to the change from pixel to pixel

# Channel → sums of changes in the same pixel, along vectors, and from pixel to pixel in one frame; number of pixels
Changes = dict[str, tuple[float, float, float, int]]


def changes(previous: Frame, current: Frame, visible: Tensor, inner: Tensor) -> Changes:
    """Measure how channels of moving surfaces change between two consecutive PyTorch frames of batch 1 with motion.

    visible: bool mask (1, 1, H, W) of the pixels of `current` whose surface was not hidden in `previous`. inner: those
    away from edges, where the nearest pixel may show another surface; ids change at edges alone.
    """
    motion = current["motion"].nan_to_num(0, 0, 0)
    at, moves = pixel_centres(motion) + motion, motion.norm(dim=1, keepdim=True) > MOVING_PX
    found: Changes = {}
    for name in (name for name in TRAVELS if name in previous and name in current):
        now, before = current[name].nan_to_num(0, 0, 0), previous[name].nan_to_num(0, 0, 0)
        of_id = CHANNELS[name].kind == "id"
        if of_id and not {"depth", "previous_forward_motion"} & {*current.channels}:
            continue  # what is uncovered is unknown, and has another id
        # Of surfaces that both frames show: a channel that one of them lost is told elsewhere.
        seen = (now != 0).any(1, keepdim=True) & (before != 0).any(1, keepdim=True)
        if CHANNELS[name].kind == "point":  # scene units may be of any size
            size = _extent(now[0].flatten(1)[:, seen.flatten()])
            now, before = now / size, before / size
        apart = [
            (now != other).float() if of_id else (now - other).abs().mean(1, keepdim=True).clamp(max=1)
            for other in (before, fetch_nearest(before, at), torch.cat([now[..., :1], now[..., :-1]], 3))
        ]
        if not of_id and float((moves & seen).float().mean()) < CAMERA:
            continue
        told = moves & seen & (visible if of_id else inner)
        still, along, beside = (float(values[told].sum()) for values in apart)
        found[name] = still, along, beside, int(told.sum())
    return found


def _extent(points: Tensor) -> float:
    """Median distance of points (3, n) from their mean; never 0."""
    far = (points - points.mean(1, keepdim=True)).norm(dim=0)
    return max(float(far.median()), 1e-30) if far.numel() else 1.0


def judge_changes(pairs: Sequence[Changes]) -> Iterator[Finding]:
    """Yield a doubt for each channel that does not move as its surfaces do, in most pairs as well as in all together.

    pairs: of plausible vectors. Where normals and positions change alike, and ids do not, it is the surface that
    changes, as of an ocean.
    """
    wrong = list[Finding]()
    for name in TRAVELS:
        told = [pair[name] for pair in pairs if name in pair and pair[name][3]]
        still, along, beside, number = (sum(pair[i] for pair in told) for i in range(4))
        lost = sum(_is_lost(*pair) for pair in told)
        if number >= ENOUGH and 2 * lost > len(told) and _is_lost(still, along, beside, number):
            found = f"changes by {along / number:.2g} along motion, and by {still / number:.2g} in the same pixel"
            expected = "the same frames as motion and albedo; or everything turns by itself"
            wrong.append(Finding(name, found, expected, False, True))
    if [finding.channel for finding in wrong] != ["normal", "position"]:
        yield from wrong


def _is_lost(still: float, along: float, beside: float, number: float) -> bool:
    return along > max(CHANGE * number, MOST * still, NOISE * beside)
