"""A check that no channel is lost in single frames: engines and broken renders write 0 for a pass that is missing.

Channels of one group show the same thing, surfaces or light. One that is 0 everywhere in a frame, while another one of
its group is not, is missing there. These are notes: a sky may have an id, and a single sample may miss all the light.
"""

from collections import defaultdict
from collections.abc import Iterator

from nte.checking.values import MANY, Finding
from nte.frames.frame import Frame

SURFACES = ("albedo", "normal", "depth", "position", "instance")
LIGHT = ("color", "reference")


class BlankTally:
    """Tally of the frames in which a channel shows nothing and another one of its group does."""

    def __init__(self) -> None:
        self._blank: dict[str, list[int]] = defaultdict(list)  # channel → frames
        self._seen: set[str] = set()  # channels that are not 0 in some frame
        self._frames = 0

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1."""
        self._frames += 1
        for group in (SURFACES, LIGHT):
            shares = {n: float((frame[n].nan_to_num() != 0).any(1).float().mean()) for n in group if n in frame}
            self._seen |= {name for name, share in shares.items() if share}
            # Some give the sky an albedo.
            if any(share > MANY for name, share in shares.items() if name != "albedo"):
                for name in (name for name, share in shares.items() if not share):
                    self._blank[name].append(frame.index)

    def judge(self) -> Iterator[Finding]:
        """Yield a note for each channel that is 0 in some frames; other checks tell what is 0 in all of them.

        Except positions, and instances: these may be 0 where nothing has an id.
        """
        for name, frames in self._blank.items():
            if name in self._seen or name == "position":
                others = "surfaces" if name in SURFACES else "light"
                where = f"in {len(frames)} of {self._frames} frames, the first is {frames[0]}"
                found = f"0 everywhere {where}, though other channels show {others}"
                yield Finding(name, found, "every channel in every frame", False)
