"""The next frame as channels of a frame, for denoisers that look ahead: who has all frames need not wait for it."""

from collections.abc import Iterable, Iterator, Mapping

from nte.frames.frame import Array, Frame

# channel → the channel of the next frame that it is
NEXT = {f"next_{name}": name for name in ("color", "albedo", "depth", "motion")}


def with_next(frames: Iterable[Frame], wanted: Iterable[str]) -> Iterator[Frame]:
    """Yield the frames of a sequence with the channels of NEXT that are wanted, such as those that a denoiser reads.

    They share the next frame's arrays. The last frame has none, nor has one before a `reset`, or before a frame of
    another size; where some of a batch are reset, the next color of these is black. If any is wanted, a frame is
    yielded when the one after it is there, so one more than otherwise is in memory.
    """
    names = {name: NEXT[name] for name in wanted if name in NEXT}
    if not names:
        yield from frames
        return
    before: Frame | None = None
    for frame in frames:
        if before is not None:
            yield before.with_channels(**_channels_of(frame, before, names))
        before = frame
    if before is not None:
        yield before


def _channels_of(after: Frame, frame: Frame, names: Mapping[str, str]) -> dict[str, Array]:
    """What a frame sees of the one after it: names maps to that one's own."""
    goes_on = None if after.reset is None else after.reset <= 0
    if (after.batch, after.size) != (frame.batch, frame.size) or not (goes_on is None or goes_on.any()):
        return {}
    found = {name: after[own] for name, own in names.items() if own in after}
    if "next_color" in found and not (goes_on is None or goes_on.all()):
        found["next_color"] = found["next_color"] * goes_on[:, None, None, None]
    return found
