"""Step 5, the temporal filter (section 4.4): the previous frame's buffers, found by going back and forth."""

from typing import NamedTuple

import torch
from torch import Tensor

from nte.filters.motion_blur.first_stage import (
    FACTOR,
    MOVING_ALL,
    MOVING_MOTION,
    MOVING_WEIGHT,
    STATIC_COLOR,
    STATIC_WEIGHT,
    passing,
)
from nte.filters.motion_blur.samples import Pixels, gather, in_chunks, square
from nte.filters.motion_blur.weight import kernel, motion_weight


class Reprojection(NamedTuple):
    """How history is found and added; see MotionBlur."""

    iterations: int = 2
    accept: float = 0.5
    drop: float = 8.0
    tent: bool = True
    in_place: bool = True
    weight: float = 1.0


def find(
    history: Tensor, pixels: Pixels, motion: Tensor, shutter: Tensor, settings: Reprojection
) -> tuple[Tensor, Tensor, Tensor]:
    """Offsets (K, 2) int64 from the pixels to those of the history that move to them; where one was accepted, (K,)
    bool; and where, (K,), nothing that moves was seen on the way, which says as much of the factor.

    motion (K, 2): the first stage's, px over the open shutter. shutter (K,): its share of the frame.
    """
    p, shutter = pixels.centres()[:, 0], shutter[:, None]
    offset = -motion / shutter
    accepted = torch.zeros(len(p), dtype=torch.bool, device=p.device)
    empty = accepted
    lost = motion.square().sum(1) == 0
    for _ in range(settings.iterations):
        whole = (p + offset).floor() - (p - 0.5)
        there, _, inside = (part[:, 0] for part in gather(history, pixels, whole.long()[:, None]))
        moves = there[:, MOVING_WEIGHT] > 0
        empty = empty | (~accepted & ~lost & inside & ~moves)
        lost = lost | (~accepted & ~(inside & moves))
        # δ between the half-way points, of a frame rather than of its shutter
        q = p + offset
        delta = (p - motion / shutter / 2) - (q + there[:, MOVING_MOTION] / shutter / 2)
        error = delta.square().sum(1)
        accepted = accepted | (~lost & (error < settings.accept**2))
        lost = lost | (~accepted & (error > settings.drop**2))
        offset = torch.where((accepted | lost)[:, None], offset, offset + delta)
    return ((p + offset).floor() - (p - 0.5)).long(), accepted, empty


def add_history(
    sums: Tensor, history: Tensor, pixels: Pixels, near: Tensor, reach: Tensor, shutter: Tensor,
    settings: Reprojection,
) -> tuple[Tensor, Tensor]:
    """The sums (K, 11) with those of the history rows added, and where moving history was accepted (K,).

    near (K, 2): vectors of what moves near pixels that saw nothing move themselves. For them as for the others the
    factor has a history: if it depended on what a pixel happened to see, light would be made or lost.
    """  # fmt: skip
    motion = passing(sums, near)
    offset, accepted, empty = find(history, pixels, motion, shutter, settings)
    covered = accepted | empty
    accepted = accepted & (sums[:, MOVING_WEIGHT] > 0)

    def work(some: Pixels, chunk: Tensor) -> Tensor:
        of_each = (values[chunk] for values in (offset, motion, accepted, covered, reach, shutter))
        return _fetch(history, some, *of_each, settings)

    found = in_chunks(pixels, 25, work)
    total = sums[:, :FACTOR] + settings.weight * found[:, :FACTOR]
    # The factor is a mean already, and so is what is added to it: where motion converges, more than one pixel's worth
    # of history arrives, and counts as one.
    known, counts = found[:, FACTOR + 1], settings.weight * found[:, FACTOR + 1].clamp(max=1)
    factor = (sums[:, FACTOR] + counts * found[:, FACTOR] / known.clamp(min=1e-12)) / (1 + counts)
    return torch.cat([total, factor[:, None]], 1), accepted


def _fetch(
    history: Tensor, pixels: Pixels, offset: Tensor, own_motion: Tensor, accepted: Tensor, covered: Tensor,
    reach: Tensor, shutter: Tensor, settings: Reprojection,
) -> Tensor:  # fmt: skip
    """Sums (K, 12) of the history's 5×5 pixels around the found ones, each moved on by its frame, t = 0.5.

    The last two columns are the factor's sum and its weights, which do not know how many moving samples a pixel had:
    it had more where it happened to see more of what moves, and light would be made of that.
    """
    values, places, inside = gather(history, pixels, offset[:, None] + square(2, history.device))
    moves = values[..., MOVING_WEIGHT] > 0
    # Where history saw nothing that moves, it says how little of the shutter was covered on this way.
    motion = torch.where(moves[..., None], values[..., MOVING_MOTION], own_motion[:, None])
    # As in δ, half the way by the vector of either frame, so that motion that changes leaves no error of first order.
    now = places + (motion + own_motion[:, None]) / 2 / shutter[:, None, None]
    half = torch.full_like(now[..., 0], 0.5)
    known = inside & accepted[:, None]
    told = inside & covered[:, None] & ~values[..., FACTOR].isnan()
    b3 = kernel(history.device)
    if settings.tent:
        # What history holds is blurred along the motion already: nothing but its place between pixels is left.
        # A neighbour that moves otherwise belongs to something else.
        differs = (motion - own_motion[:, None]).square().sum(-1).sqrt() / 2 / shutter[:, None]
        weight = (1 - (now - pixels.centres()).abs()).clamp(min=0).prod(-1) * (differs < settings.accept)
    else:
        weight = b3 * motion_weight(pixels.centres(), now, motion, half, reach[:, None])
    place = weight * told
    weight = (weight * known * values[..., MOVING_WEIGHT])[..., None]
    own = history[pixels.index]
    if settings.in_place:
        static = own[:, STATIC_COLOR] * own[:, STATIC_WEIGHT, None]
        static_weight = own[:, STATIC_WEIGHT, None]
    else:
        share = (b3 * known * values[..., STATIC_WEIGHT])[..., None]
        static, static_weight = (share * values[..., STATIC_COLOR]).sum(1), share.sum(1)
    total = weight.sum(1)
    return torch.cat(
        [(weight * values[..., MOVING_ALL]).sum(1), total, static, static_weight,
         (place * values[..., FACTOR].nan_to_num()).sum(1, keepdim=True), place.sum(1, keepdim=True)], 1,
    )  # fmt: skip
