"""A check that no channel is lost in single frames: engines and broken renders write 0 for a pass that is missing.

Channels of one group show the same thing, surfaces or light. One that is 0 everywhere in a frame, while another one of
its group is not, is missing there. These are notes: a sky may have an id, and a single sample may miss all the light.
Vectors may be 0 while a camera rests, but not while the picture changes as it does where they are not.
"""

from collections import defaultdict
from collections.abc import Iterator
from statistics import median

from nte.checking.values import MANY, Finding
from nte.frames.frame import Frame

MOVING_PX = 1.0  # pixels: frames whose vectors are at least so long on average show how much the picture changes
AS_MUCH = 0.5  # least share of that change in a frame that moves, too
OTHERS = 2  # least number of frames that show it

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


class StoppedTally:
    """Tally of the frames whose vectors are 0, and of how much the picture changes in all frames."""

    def __init__(self) -> None:
        self._stopped: dict[int, float] = {}  # frame → change since the frame before
        self._moving: list[float] = []
        self._frames = 0

    def add(self, previous: Frame, current: Frame) -> None:
        """Add two consecutive PyTorch frames of batch 1 that have motion; albedo tells what changes, or instances."""
        name = next((name for name in ("albedo", "instance") if name in previous and name in current), None)
        if name is None:
            return
        apart = (current[name].nan_to_num() - previous[name].nan_to_num()).abs()
        change = float(apart.mean() if name == "albedo" else (apart > 0).float().mean())
        self._frames += 1
        length = current["motion"].square().sum(1).sqrt().nan_to_num()
        if not length.any():
            self._stopped[current.index] = change
        elif float(length.mean()) >= MOVING_PX:
            self._moving.append(change)

    def judge(self) -> Iterator[Finding]:
        """Yield a note if vectors are 0 in single frames in which the picture changes as in the others."""
        if len(self._moving) < OTHERS or len(self._stopped) > len(self._moving):
            return
        least = AS_MUCH * median(self._moving)
        if lost := [frame for frame, change in self._stopped.items() if change > 0 and change >= least]:
            where = f"in {len(lost)} of {self._frames} frames, the first is {lost[0]}"
            found = f"0 everywhere {where}, though the picture changes as it does where it is not"
            yield Finding("motion", found, "vectors to the frame before; after a cut another clip", False)
