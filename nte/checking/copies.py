"""A check of what should be the same light under other noise: further noise seeds, and the two halves of the reference.

Each is compared with an image that is known: a seed's colour with that of the first seed, and one half with the other.
An image that is exactly the other one has no noise of its own, and a mean of the two has no less. Noise hides edges, so
what place and what frame an image shows is asked of one that has less: of seeds the reference, where there is one.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

from torch import Tensor

from nte.checking.displaced import SAME_PLACE, DisplacedTally
from nte.checking.exposure import ExposureTally
from nte.checking.late import SAME_FRAME, LateTally
from nte.checking.values import Finding, Tally, judge_values, tally_values
from nte.frames.channels import CHANNELS
from nte.frames.clip import Clip
from nte.frames.frame import Frame

OTHER_WAY = {"one frame earlier": "one frame later", "one frame later": "one frame earlier"}


class _WhereAndWhen:
    """Tally of the place and the frame that a noisy image shows, compared with one of less noise."""

    def __init__(self) -> None:
        self._place, self._frame = DisplacedTally(), LateTally()

    def add(self, index: int, noisy: Tensor, known: Tensor) -> None:
        """Add images (1, 3, H, W) of a frame."""
        self._place.add(Frame({"color": known, "reference": noisy}, index))

    def add_pair(self, noisy: tuple[Tensor, Tensor], known: tuple[Tensor, Tensor]) -> None:
        """Add images of two consecutive frames."""
        pairs = zip(noisy, known, strict=True)
        self._frame.add(*(Frame({"color": image, "reference": other}) for image, other in pairs))

    def judge(self, channel: str, known: str, where: str = "") -> Iterator[Finding]:
        """Yield a fault if another frame, or else another place is shown. known: the name of what has less noise."""
        beside = list(self._place.judge())
        for finding in self._frame.judge(bool(beside)):
            when = next(other for told, other in OTHER_WAY.items() if told in finding.found)
            yield Finding(channel, f"{where}shows what {known} shows {when}", SAME_FRAME)
            return
        for finding in beside:
            yield Finding(channel, where + finding.found.replace("color", known), SAME_PLACE)


class CopyTally:
    """Tally of the other seeds of some frames, and of the halves of their reference."""

    def __init__(self, clip: Clip) -> None:
        self._clip = clip
        self._light = {seed: ExposureTally(one_noise=True) for seed in range(1, clip.seeds)}
        self._values: dict[int, dict[str, Tally]] = {seed: defaultdict(Tally) for seed in range(1, clip.seeds)}
        self._noisy = [name for name in clip.channels if CHANNELS[name].noisy]
        self._halves = ExposureTally(one_noise=True)
        self._shows = {seed: _WhereAndWhen() for seed in self._values}
        self._half_shows = _WhereAndWhen()

    def add(self, frame: Frame, previous: Frame | None) -> None:
        """Add a PyTorch frame of batch 1 of the clip. Raises NteError for a seed's file that cannot be read.

        previous: the frame before, of which only light is read; None for the first one.
        """
        for seed, tallies in self._values.items():
            other = self._clip.frame(frame.index, self._noisy, seeds=(seed,)).torch()
            tally_values(tallies, other)
            if "color" in frame:
                self._light[seed].add(frame.with_channels(reference=other["color"]))
            if "reference" in frame:
                self._shows[seed].add(frame.index, other["color"], frame["reference"])
                if previous is not None and "reference" in previous:
                    before = self._clip.frame(previous.index, ("color",), seeds=(seed,)).torch()["color"]
                    seen = (before, other["color"]), (previous["reference"], frame["reference"])
                    self._shows[seed].add_pair(*seen)
        if "reference_a" in frame and "reference_b" in frame:
            one, other_half = frame["reference_a"], frame["reference_b"]
            self._halves.add(frame.with_channels(color=one, reference=other_half))
            self._half_shows.add(frame.index, other_half, one)
            if previous is not None and "reference_a" in previous and "reference_b" in previous:
                self._half_shows.add_pair((previous["reference_b"], other_half), (previous["reference_a"], one))

    def judge(self, known: bool = True) -> Iterator[Finding]:
        """Yield what is wrong with other seeds, and with the second half as far as it is unlike the first.

        known: the reference shows the place and the frame of the first seed.
        """
        for seed, tallies in self._values.items():
            for finding in judge_values(tallies):
                yield replace(finding, found=f"in seed {seed}: {finding.found}")
            yield from _unlike(self._light[seed], "color", "color of seed 0", f"in seed {seed}: ")
            if known:
                yield from self._shows[seed].judge("color", "reference", f"in seed {seed}: ")
        yield from _unlike(self._halves, "reference_b", "reference_a")
        yield from self._half_shows.judge("reference_b", "reference_a")


def _unlike(light: ExposureTally, channel: str, first: str, where: str = "") -> Iterator[Finding]:
    for finding in light.judge():
        same = "same image" in finding.found
        expected = "the same light with other noise" if same else f"the light of {first}"
        yield Finding(channel, where + finding.found.replace("color", first), expected, finding.fault or same)
