"""Which frames of a clip are looked at: a few, spread over it, so that its end counts as much as its beginning."""

FRAMES = 4  # largest number of frames whose guides, depth, positions and orientation are looked at
PAIRS = 12  # largest number of pairs of frames whose vectors are judged


def spread(count: int, first: int, end: int) -> set[int]:
    """Choose at most `count` frames from `first` to `end` − 1, both included, evenly spread.

    >>> sorted(spread(4, 0, 10))
    [0, 3, 6, 9]
    """
    return {round(first + i * (end - 1 - first) / max(count - 1, 1)) for i in range(count)} if end > first else set()
