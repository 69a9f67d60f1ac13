"""Votes for and against a clip's motion vectors, and who else explains what they do not."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from torch import Tensor

from nte.frames.frame import Frame
from nte.motion.conventions import CONVENTIONS, Convention

RIVALS = tuple(convention for convention in CONVENTIONS if convention != Convention())
Vector = tuple[float, float]  # (x, y) in pixels


class Against(NamedTuple):
    """A piece of the picture that contradicts its vectors: which rivals explain it, its vector, what it really does."""

    explained_by: frozenset[Convention]
    given: Vector | None = None  # mean over the piece; None where what the picture does is not known
    seen: Vector | None = None


@dataclass
class Votes:
    """Pieces of the picture that speak for the vectors, and against them; of a pair of frames, or of a clip."""

    good: int = 0
    compared: int = 0  # good ones that rivals were tried on: those of frames in which something contradicts
    good_by: Counter[Convention] = field(default_factory=Counter)  # of these, how many a rival explains as well
    against: list[Against] = field(default_factory=list)
    weight_against: float = 0.0  # how many would contradict, had all been looked at

    def add(self, other: "Votes") -> None:
        """Add the votes of another pair of frames."""
        self.good += other.good
        self.compared += other.compared
        self.good_by.update(other.good_by)
        self.against += other.against
        self.weight_against += other.weight_against

    def bad_by(self, rival: Convention) -> int:
        """How many of the pieces that contradict the vectors a rival explains."""
        return sum(rival in piece.explained_by for piece in self.against)


def rival_vectors(previous: Frame, current: Frame) -> Iterator[tuple[Convention, Tensor]]:
    """Our vectors (1, 2, H, W) if `motion` of two consecutive frames followed each other convention; NaN: unknown."""
    motion = current["motion"]
    depth = motion.new_zeros(motion[:, :1].shape) if "depth" not in previous else previous["depth"]
    for rival in RIVALS:
        yield rival, rival.convert(motion, previous["motion"], depth)
