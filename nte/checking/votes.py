"""Votes for and against a clip's motion vectors, and the rival conventions that explain the contradictions."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from torch import Tensor

from nte.frames.frame import Frame
from nte.motion.conventions import CONVENTIONS, Convention

RIVALS = tuple(convention for convention in CONVENTIONS if convention != Convention())
Vector = tuple[float, float]  # (x, y) in pixels
STILL_PX = 0.5  # pixels: shorter vectors count as no motion


class Against(NamedTuple):
    """A piece of the picture that contradicts its vectors: the rivals that explain it, its vector, its displacement."""

    explained_by: frozenset[Convention]
    given: Vector | None = None  # mean vector of the piece; None if its true displacement is unknown
    seen: Vector | None = None  # true displacement


@dataclass
class Votes:
    """The pieces of a picture that vote for and against the vectors, of one pair of frames or of a clip."""

    good: int = 0  # pieces that vote for the vectors
    good_by: Counter[Convention] = field(default_factory=Counter)  # rival → number of these that it explains as well
    against: list[Against] = field(default_factory=list)  # pieces that vote against the vectors
    weight_against: float = 0.0  # estimated number of contradictions if all pieces had been searched
    looked: int = 0  # cells whose vectors end in the picture
    explained: int = 0  # number of these that the vectors explain, whatever else explains them as well

    def add(self, other: "Votes") -> None:
        """Add the votes of another pair of frames."""
        self.good += other.good
        self.good_by.update(other.good_by)
        self.against += other.against
        self.weight_against += other.weight_against
        self.looked += other.looked
        self.explained += other.explained

    def bad_by(self, rival: Convention) -> int:
        """Count the pieces against the vectors that a rival explains."""
        return sum(rival in piece.explained_by for piece in self.against)


def rival_vectors(previous: Frame, current: Frame) -> Iterator[tuple[Convention, Tensor]]:
    """Yield each rival convention with the vectors that `motion` would mean in it.

    The vectors (1, 2, H, W) are in nte's convention, pixels, current → previous; NaN where unknown. previous, current:
    consecutive PyTorch frames of batch 1 with motion; `depth` of the previous one is used if it is there.
    """
    motion = current["motion"]
    depth = motion.new_zeros(motion[:, :1].shape) if "depth" not in previous else previous["depth"]
    for rival in RIVALS:
        yield rival, rival.convert(motion, previous["motion"], depth)
