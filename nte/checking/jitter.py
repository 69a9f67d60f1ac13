"""Contradictions that camera jitter explains: each frame samples its pixels elsewhere, and vectors leave that out.

The two frames of a pair are then shifted against each other by up to a pixel along each axis, and another pair by
something else. What wrong vectors lack follows from the vectors instead: a wrong length, sign or axis order is a linear
map of them, the same one in all pairs. So contradictions that are no larger than jitter count only if one such map
explains them, and if they come from two pairs at least.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch

from nte.checking.votes import Against, Votes

REACH = 2.0  # pixels along an axis: one of jitter, and one by which the displacement that is found may be off
LEFT = 0.5  # greatest share of the differences' root mean square that the map may leave
PARALLEL = 1e-3  # vectors whose second singular value is below this share of the first are all parallel


def without_jitter(pairs: Sequence[Votes]) -> list[Votes]:
    """Leave out the votes of pairs of frames that camera jitter may explain.

    All stay if wrong vectors explain them, or if most contradictions are larger than jitter.
    """
    small = [[piece for piece in pair.against if _within_reach(piece)] for pair in pairs]
    pieces = [piece for found in small for piece in found]
    if 2 * len(pieces) < sum(piece.seen is not None for pair in pairs for piece in pair.against):
        return list(pairs)
    if sum(map(bool, small)) >= min(2, len(pairs)) and _follow_vectors(pieces):
        return list(pairs)
    return [without_small(pair) for pair in pairs]


def _within_reach(piece: Against) -> bool:
    if piece.given is None or piece.seen is None:
        return False
    return all(abs(seen - given) <= REACH for given, seen in zip(piece.given, piece.seen, strict=True))


def _follow_vectors(pieces: Sequence[Against]) -> bool:
    """Tell whether one linear map takes the vectors of pieces to what they lack."""
    given, seen = (torch.tensor([piece[i] for piece in pieces], dtype=torch.float64) for i in (1, 2))
    lacking = seen - given
    left = lacking - given @ (torch.linalg.pinv(given, rtol=PARALLEL) @ lacking)
    return float(left.norm()) <= LEFT * float(lacking.norm())


def without_small(pair: Votes) -> Votes:
    """Leave out the votes of a pair of frames against the vectors that are within reach of jitter."""
    kept = [piece for piece in pair.against if not _within_reach(piece)]
    return replace(pair, against=kept, weight_against=pair.weight_against * len(kept) / max(1, len(pair.against)))
