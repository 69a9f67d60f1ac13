"""A check of what should be the same light under other noise: further noise seeds, and the two halves of the reference.

Each is compared with an image that is known: a seed's colour with that of the first seed, and one half with the other.
An image that is exactly the other one has no noise of its own, and a mean of the two has no less.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

from nte.checking.exposure import ExposureTally
from nte.checking.values import Finding, Tally, judge_values, tally_values
from nte.frames.channels import CHANNELS
from nte.frames.clip import Clip
from nte.frames.frame import Frame


class CopyTally:
    """Tally of the other seeds of some frames, and of the halves of their reference."""

    def __init__(self, clip: Clip) -> None:
        self._clip = clip
        self._light = {seed: ExposureTally(one_noise=True) for seed in range(1, clip.seeds)}
        self._values: dict[int, dict[str, Tally]] = {seed: defaultdict(Tally) for seed in range(1, clip.seeds)}
        self._noisy = [name for name in clip.channels if CHANNELS[name].noisy]
        self._halves = ExposureTally(one_noise=True)

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1 of the clip. Raises NteError for a seed's file that cannot be read."""
        for seed, tallies in self._values.items():
            other = self._clip.frame(frame.index, self._noisy, seeds=(seed,)).torch()
            tally_values(tallies, other)
            if "color" in frame:
                self._light[seed].add(frame.with_channels(reference=other["color"]))
        if "reference_a" in frame and "reference_b" in frame:
            self._halves.add(frame.with_channels(color=frame["reference_a"], reference=frame["reference_b"]))

    def judge(self) -> Iterator[Finding]:
        """Yield what is wrong with other seeds, and with the second half as far as it is unlike the first."""
        for seed, tallies in self._values.items():
            for finding in judge_values(tallies):
                yield replace(finding, found=f"in seed {seed}: {finding.found}")
            yield from _unlike(self._light[seed], "color", "color of seed 0", f"in seed {seed}: ")
        yield from _unlike(self._halves, "reference_b", "reference_a")


def _unlike(light: ExposureTally, channel: str, first: str, where: str = "") -> Iterator[Finding]:
    for finding in light.judge():
        same = "same image" in finding.found
        expected = "the same light with other noise" if same else f"the light of {first}"
        yield Finding(channel, where + finding.found.replace("color", first), expected, finding.fault or same)
