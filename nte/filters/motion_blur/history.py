"""Step 5, the temporal filter (section 4.4): the previous frame's buffers, found by following motion back and forth."""

import torch
from torch import Tensor

from nte.filters.motion_blur.first_stage import (
    MOVING_ALL,
    MOVING_MOTION,
    MOVING_WEIGHT,
    STATIC_COLOR,
    STATIC_WEIGHT,
)
from nte.filters.motion_blur.options import MotionBlurOptions
from nte.filters.motion_blur.samples import PixelList, gather, in_chunks, square
from nte.filters.motion_blur.weight import kernel, motion_weight


def find(
    history: Tensor, pixels: PixelList, motion: Tensor, shutter: Tensor, options: MotionBlurOptions
) -> tuple[Tensor, Tensor]:
    """Find for each pixel the history pixel that moves to it: offsets (K, 2), int64, and where one was accepted (K,).

    motion (K, 2): the first stage's, px over the open shutter. shutter (K,): the open share of the frame.
    """
    p, shutter = pixels.centres()[:, 0], shutter[:, None]
    offset = -motion / shutter
    accepted = torch.zeros(len(p), dtype=torch.bool, device=p.device)
    lost = motion.square().sum(1) == 0
    for _ in range(options.iterations):
        whole = (p + offset).floor() - (p - 0.5)
        there, _, inside = (part[:, 0] for part in gather(history, pixels, whole.long()[:, None]))
        lost = lost | (~accepted & ~(inside & (there[:, MOVING_WEIGHT] > 0)))
        # δ lies between the half-way points of the motion over a whole frame, not over its open shutter.
        q = p + offset
        delta = (p - motion / shutter / 2) - (q + there[:, MOVING_MOTION] / shutter / 2)
        error = delta.square().sum(1)
        accepted = accepted | (~lost & (error < options.accept**2))
        lost = lost | (~accepted & (error > options.drop**2))
        offset = torch.where((accepted | lost)[:, None], offset, offset + delta)
    return ((p + offset).floor() - (p - 0.5)).long(), accepted


def add_history(
    sums: Tensor, history: Tensor, pixels: PixelList, reach: Tensor, shutter: Tensor, options: MotionBlurOptions
) -> tuple[Tensor, Tensor]:
    """Add the history rows to the sums (K, 10); returns the new sums and where moving history was accepted (K,).

    reach (K,): c_a c_l, px. shutter (K,): the open share of the frame.
    """
    motion = sums[:, MOVING_MOTION] / sums[:, MOVING_WEIGHT, None].clamp(min=1e-12)
    offset, accepted = find(history, pixels, motion, shutter, options)

    def work(some: PixelList, chunk: Tensor) -> Tensor:
        return _fetch(
            history, some, offset[chunk], motion[chunk], accepted[chunk], reach[chunk], shutter[chunk], options
        )

    return sums + options.weight * in_chunks(pixels, 25, work), accepted


def _fetch(
    history: Tensor, pixels: PixelList, offset: Tensor, own_motion: Tensor, accepted: Tensor, reach: Tensor,
    shutter: Tensor, options: MotionBlurOptions,
) -> Tensor:  # fmt: skip
    """The sums (K, 10) over the history's 5×5 pixels around the found ones, each moved on by one frame, at t = 0.5."""
    values, places, inside = gather(history, pixels, offset[:, None] + square(2, history.device))
    motion = values[..., MOVING_MOTION]
    # As in δ, each frame's vector counts for half the way, so that changing motion leaves no error of first order.
    now = places + (motion + own_motion[:, None]) / 2 / shutter[:, None, None]
    half = torch.full_like(now[..., 0], 0.5)
    known = inside & accepted[:, None]
    b3 = kernel(history.device)
    if options.fetch == "tent":
        # History is blurred along the motion already, so only its position between pixels needs interpolation.
        # A neighbour that moves differently belongs to another object.
        differs = (motion - own_motion[:, None]).square().sum(-1).sqrt() / 2 / shutter[:, None]
        weight = (1 - (now - pixels.centres()).abs()).clamp(min=0).prod(-1) * (differs < options.accept)
    else:
        weight = b3 * motion_weight(pixels.centres(), now, motion, half, reach[:, None])
    weight = (weight * known * values[..., MOVING_WEIGHT])[..., None]
    own = history[pixels.index]
    if options.static == "place":
        static = own[:, STATIC_COLOR] * own[:, STATIC_WEIGHT, None]
        static_weight = own[:, STATIC_WEIGHT, None]
    else:
        share = (b3 * known * values[..., STATIC_WEIGHT])[..., None]
        static, static_weight = (share * values[..., STATIC_COLOR]).sum(1), share.sum(1)
    return torch.cat([(weight * values[..., MOVING_ALL]).sum(1), weight.sum(1), static, static_weight], 1)
