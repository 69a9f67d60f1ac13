"""A check of single frames, in clips whose other frames have right vectors: lost vectors, and cuts.

Where vectors of one frame are wrong, most of its votes are against them. After a cut nothing is: no motion explains
what is new either. But hardly any cell finds its albedo on its surface in the frame before, while in the other frames
nearly all do, whether or not something else explains them as well.
"""

from collections.abc import Container, Iterator, Mapping
from statistics import median

from nte.checking.jitter import without_small
from nte.checking.judge import contradicts
from nte.checking.values import Finding
from nte.checking.votes import Votes

FEW, MOST = 0.2, 0.8  # greatest share of explained cells after a cut, and least median share over the frames
ENOUGH = 10  # least number of cells that tell
OTHERS = 2  # least number of other frames that tell


def unlike_before(votes: Mapping[int, Votes]) -> list[int]:
    """List the frames in which vectors find hardly anything in the frame before, unlike in the clip's other frames."""
    shares = {frame: pair.explained / pair.looked for frame, pair in votes.items() if pair.looked >= ENOUGH}
    if len(shares) <= OTHERS or median(shares.values()) <= MOST:
        return []
    return [frame for frame, share in shares.items() if share < FEW]


def judge_frames(votes: Mapping[int, Votes], rescaled: Container[int] = ()) -> Iterator[Finding]:
    """Yield notes about single frames: their vectors are wrong, or they follow a cut.

    votes: frame → votes, of plausible vectors; rescaled: frames whose depth has another unit, and finds nothing either.
    """
    large = {frame: without_small(pair) for frame, pair in votes.items()}
    bad = [frame for frame, pair in large.items() if contradicts(pair)]
    if bad:
        found = f"contradicts the picture in {_where(bad, votes)}"
        yield Finding("motion", found, "vectors to the frame before; after a cut another clip", False)
    if cuts := [frame for frame in unlike_before(votes) if frame not in bad and frame not in rescaled]:
        found = f"finds hardly anything of the frame before in {_where(cuts, votes)}: a cut, or lost vectors"
        yield Finding("motion", found, "one shot: after a cut another clip", False)


def _where(frames: list[int], votes: Mapping[int, Votes]) -> str:
    return f"{len(frames)} of {len(votes)} frames that were judged, the first is {frames[0]}"
