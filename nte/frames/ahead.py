"""The next frame as channels of a frame, for denoisers that look ahead: who has all frames need not wait for it."""

from collections.abc import Iterable, Iterator

from nte.frames.frame import Frame

# channel → the channel of the next frame that it is
NEXT = {f"next_{name}": name for name in ("color", "albedo", "depth", "motion")}


def with_next(frames: Iterable[Frame], wanted: Iterable[str]) -> Iterator[Frame]:
    """Yield the frames of a sequence with the channels of NEXT that are wanted, such as those that a denoiser reads.

    They share the next frame's arrays. The last frame has none, nor has one before a `reset`. If any is wanted, a frame
    is yielded when the one after it is there, so one more than otherwise is in memory.
    """
    names = {name: NEXT[name] for name in wanted if name in NEXT}
    if not names:
        yield from frames
        return
    before: Frame | None = None
    for frame in frames:
        if before is not None:
            cut = frame.reset is not None and bool((frame.reset > 0).any())
            yield (
                before
                if cut
                else before.with_channels(**{name: frame[own] for name, own in names.items() if own in frame})
            )
        before = frame
    if before is not None:
        yield before
