"""A check that channels have the resolution of the light: some engines render guides at half size and enlarge them.

Enlarged rows follow a pattern of which what they show knows nothing. Nearest neighbours give runs of pixels one value:
all steps lie between runs. Linear interpolation by two makes every second step the mean of the two beside it. The light
is asked for the same pattern, since a picture that consists of blocks has it in all channels.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from nte.checking.edges import picture
from nte.checking.flips import PICTURES
from nte.checking.values import Finding
from nte.frames.frame import Frame

FACTORS = {(2,): "2", (3,): "3", (4,): "4", (1, 2): "1.5", (2, 1): "1.5"}  # lengths of runs of pixels → factor
LIGHT = "color", "reference"
CHECKED = (*LIGHT, *PICTURES, "position", "motion", "forward_motion")
STRONG = "light"  # what counts the strong steps of the light
ENOUGH = 200  # least number of large steps that follow a pattern
LARGE = 0.01  # least step that is large, in standard deviations of the channel: others may be rounding
EVERYWHERE = 0.6  # least share of the lines between runs that have some: of those of 2, in blocks of 4, only half do
# Measured: 0.46 to 1.3 in 16 rendered clips, 0.75 at the least without instances
AGAINST = 0.05  # greatest ratio of the share of large steps where a pattern allows none to that elsewhere
FINE = 0.5  # least such ratio of light of full resolution
EXPECTED = "the resolution of the light: a smaller picture lacks its details and outlines"


class EnlargedTally:
    """Tally of the steps between neighbouring pixels in some frames, and of what they differ by from those beside."""

    def __init__(self) -> None:
        # channel, axis, steps or bends → how many are large between each two columns, or rows: (n,)
        self._large: dict[tuple[str, str, str], Tensor] = {}
        self._light = ""

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1."""
        self._light = next((name for name in reversed(LIGHT) if name in frame), "")
        for name in (name for name in CHECKED if name in frame):
            image = frame[name][0].nan_to_num(0, 0, 0)
            if name in LIGHT:  # the brightest pixels would outweigh all others
                image = picture(frame, name, frame.size)[0]
            for axis, values in (("columns", image), ("rows", image.transpose(1, 2))):
                steps = values.double().diff(dim=2)
                bends = steps[..., 1:-1] - (steps[..., :-2] + steps[..., 2:]) / 2
                for what, each in (("steps", steps), ("bends", bends)):
                    sizes = each.norm(dim=0)
                    self._count(name, axis, what, sizes > LARGE * values.std(correction=0))
                    if name == self._light:  # shading makes small steps everywhere, also between those of blocks
                        self._count(STRONG, axis, what, sizes > sizes.square().mean().sqrt())

    def _count(self, name: str, axis: str, what: str, large: Tensor) -> None:
        self._large[name, axis, what] = self._large.get((name, axis, what), 0) + large.sum(0)

    def judge(self) -> Iterator[Finding]:
        """Yield a doubt for each guide that is enlarged, beside a reference that is not; else a note."""
        told = set()
        for (name, axis, what), large in self._large.items():
            if name == STRONG:
                continue
            for how, none in _patterns(what, len(large)):
                ratio = _against(large, none)
                if name in told or ratio is None or not ratio <= AGAINST:
                    continue
                light = _against(self._large[STRONG, axis, what], none) if self._light else None
                if name not in LIGHT and light is not None and light < FINE:
                    continue
                told.add(name)
                doubt = name not in LIGHT and self._light == "reference" and light is not None
                yield Finding(name, f"its {axis} are enlarged, {how}", EXPECTED, False, doubt)


def _against(large: Tensor, none: Tensor) -> float | None:
    """Compute how often steps are large at the lines, bool (n,), where there are none by a pattern, and elsewhere.

    large: (n,), numbers of large ones. Returns the ratio of the two means; None if there are too few of them.
    """
    elsewhere = large[~none].double()
    if float(elsewhere.sum()) < ENOUGH or float((elsewhere > 0).double().mean()) < EVERYWHERE:
        return None
    return float(large[none].double().mean() / elsewhere.mean())


def _patterns(what: str, lines: int) -> Iterator[tuple[str, Tensor]]:
    """Yield how a picture may be enlarged, in words, and at which lines, bool (n,), its steps or bends are then 0."""
    if what == "bends":  # of which the first belongs to the second step
        yield "by 2, interpolated", torch.arange(lines) % 2 == 1
        return
    for lengths, factor in FACTORS.items():
        times = torch.tensor(lengths).repeat(lines + 1)
        runs = torch.arange(len(times)).repeat_interleave(times)[: lines + 1]
        yield f"by {factor}, without interpolation", runs.diff() == 0
