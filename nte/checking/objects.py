"""Votes of objects for and against motion vectors: an object must be found where its vectors lead.

A pixel is found if one of the 3×3 pixels at the end of its vector shows the same instance. An object that was hidden
in the previous frame is found by no convention, and a large one by every convention: neither proves anything.
"""

from itertools import product

import torch
from torch import Tensor

from nte.checking.votes import Against, Votes, rival_vectors
from nte.frames.frame import Frame
from nte.motion.warp import pixel_centres

FOUND, LOST = 0.8, 0.3  # an object is found, or lost, if at least, or at most, this share of its pixels is found
LEAST = 8  # least number of pixels of an object that votes


def object_votes(previous: Frame, current: Frame) -> Votes:
    """Collect the votes of the instances that `current` shows on its `motion`.

    previous, current: consecutive PyTorch frames of batch 1 with instance and motion. An object votes for the vectors
    if they find it while no motion and the opposite motion lose it. It votes against them if they lose it while a
    rival convention finds it.
    """
    motion = current["motion"]
    objects = _Objects(previous["instance"], current["instance"])
    given, still, opposite = (objects.found(vectors) for vectors in (motion, torch.zeros_like(motion), -motion))
    good = (given >= FOUND) & (still <= LOST) & (opposite <= LOST)
    lost = given <= LOST
    votes = Votes(good=int(good.sum()))
    if not votes.good and not lost.any():
        return votes
    shares = {rival: objects.found(vectors) for rival, vectors in rival_vectors(previous, current)}
    votes.good_by.update({rival: int((good & (share >= FOUND)).sum()) for rival, share in shares.items()})
    for i in lost.nonzero()[:, 0].tolist():
        if explained_by := frozenset(rival for rival, share in shares.items() if share[i] >= FOUND):
            votes.against.append(Against(explained_by))
    votes.weight_against = len(votes.against)
    return votes


class _Objects:
    """The instances (1, 1, H, W) of two frames; objects of the current one vote if they have enough pixels."""

    def __init__(self, before: Tensor, now: Tensor) -> None:
        self.height, self.width = now.shape[-2:]
        ids, number, self.size = torch.unique(now.flatten(), return_inverse=True, return_counts=True)
        self.votes = (ids != 0) & (self.size >= LEAST)
        self.pixels = self.votes[number].nonzero()[:, 0]
        self.number, self.now = number[self.pixels], now.flatten()[self.pixels]
        self.before = before.flatten()

    def found(self, motion: Tensor) -> Tensor:
        """Share (objects,) of each object's pixels that vectors (1, 2, H, W) find; NaN for objects that do not vote."""
        x, y = (pixel_centres(motion) + motion)[0].flatten(1)[:, self.pixels]
        within = (x >= 0) & (x <= self.width) & (y >= 0) & (y <= self.height)
        columns, rows = (
            [(torch.where(within, place, 0.0) + step).floor().clamp(0, size - 1).long() for step in (-1, 0, 1)]
            for place, size in ((x, self.width), (y, self.height))
        )
        found = torch.zeros_like(within)
        for row, column in product(rows, columns):
            found |= self.before.index_select(0, row * self.width + column) == self.now
        count = torch.bincount(self.number, (found & within).float(), len(self.size))
        return torch.where(self.votes, count / self.size, float("nan"))
