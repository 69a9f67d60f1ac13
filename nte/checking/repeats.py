"""A check that every frame has noise of its own: a frame that was kept, or a seed that stays, brings nothing new."""

from collections.abc import Iterator

from nte.checking.values import Finding
from nte.frames.frame import Frame


class RepeatTally:
    """Tally of the frames whose noisy image is exactly that of the frame before."""

    def __init__(self) -> None:
        self._repeated: list[int] = []
        self._frames = 0

    def add(self, previous: Frame, current: Frame) -> None:
        """Add two consecutive PyTorch frames of batch 1."""
        if "color" not in current or "color" not in previous:
            return
        self._frames += 1
        if bool(current["color"].any()) and bool((current["color"] == previous["color"]).all()):
            self._repeated.append(current.index)

    def judge(self) -> Iterator[Finding]:
        """Yield a note if there are some; a picture without noise that stands still has them, too."""
        if self._repeated:
            where = f"in {len(self._repeated)} of {self._frames} frames, the first is {self._repeated[0]}"
            found = f"is the same image as in the frame before {where}"
            yield Finding("color", found, "new noise in each frame", False)
