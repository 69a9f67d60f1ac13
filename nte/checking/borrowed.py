"""A check that albedo is not another channel of the same frames, in a layer that was taken for it.

Normals and depth move with their surfaces, too, so right vectors lead to them as they lead to albedo. Color counts
where the reference tells that it is noisy: in an even light without noise it is the albedo. So is the reference, unless
albedo is what reflects more than all light, too.
"""

from collections import defaultdict
from collections.abc import Iterator
from statistics import median

import torch
from torch import Tensor

from nte.checking.values import MANY, Finding
from nte.frames.frame import Frame

ENOUGH = 200  # least number of pixels that can tell
SAME = 0.01  # greatest difference of what is the same, but for rounding
VARIES = 0.05  # least standard deviation of the albedo; a single colour may be any other channel's
BRIGHT = 1.05  # light that no albedo is
MOST = 0.9  # least share of the pixels that are the same
LEVELS = 32  # least number of levels, of 256, of a grey that is depth: a few of them are a function of it by chance
EXPECTED = "the share of the light that is reflected, in each of three components"
SHADES = {"normal": 1.0, "normal, stored as n/2 + 1/2": 0.5}  # what albedo may be → factor of normals, about the middle


class BorrowedTally:
    """Tally of how much of the albedo of some frames is the same as another channel."""

    def __init__(self) -> None:
        self._bright: list[float] = []  # shares of the pixels that are, though brighter than any albedo
        self._shares: dict[str, list[float]] = defaultdict(list)  # what albedo may be → share of the pixels of a frame

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1; albedo, and one of normal, depth, and color with reference are needed."""
        if "albedo" not in frame:
            return
        albedo = frame["albedo"][0].nan_to_num(0, 0, 0)
        if "normal" in frame:
            normal = frame["normal"][0].nan_to_num(0, 0, 0)
            shown = (normal != 0).any(0)
            if _varies(albedo[:, shown]):
                for name, half in SHADES.items():
                    apart = albedo - (half * normal + 1 - half).clamp(0, 1)
                    self._shares[name].append(_same(apart[:, shown]))
        if "color" in frame and "reference" in frame:
            light = frame["reference"][0].nan_to_num(0, 0, 0)
            color, reference = frame["color"][0].nan_to_num(0, 0, 0).clamp(0, 1), light.clamp(0, 1)
            shown = (albedo != 0).any(0)
            if _varies(albedo[:, shown]):
                if _same((color - reference)[:, shown]) < MOST:
                    self._shares["color"].append(_same((albedo - color)[:, shown]))
                same = (albedo.clamp(0, 1) - reference).abs().amax(0) < SAME
                self._shares["reference"].append(float(same[shown].float().mean()))
                bright = same & (light.amax(0) > BRIGHT)
                if "emission" in frame:  # what shines is brighter than its albedo, which may be 1
                    bright &= ~(frame["emission"][0] > 0).any(0)
                self._bright.append(float(bright[shown].float().mean()))
        if "depth" in frame:
            depth = frame["depth"][0, 0].nan_to_num(0, 0, 0)
            grey = (albedo - albedo[:1]).abs().amax(0) < SAME
            shown = (depth > 0) & (albedo[0] > SAME) & (albedo[0] < 1 - SAME) & grey
            if 2 * int(shown.sum()) > int((depth > 0).sum()) and _varies(albedo[:1, shown]):
                self._shares["depth"].append(_function(albedo[0, shown].double(), depth[shown].double()))

    def judge(self) -> Iterator[Finding]:
        """Yield a fault for albedo that is another channel; a note where one light of 1 explains it."""
        for name, shares in self._shares.items():
            if median(shares) > MOST:
                found = f"is {name}, in {median(shares):.0%} of the pixels"
                fault = name != "reference" or median(self._bright) > MANY
                told = found if fault else f"{found}; or one light of 1 falls on everything"
                yield Finding("albedo", told, EXPECTED, fault)
                return


def _varies(albedo: Tensor) -> bool:
    return albedo.shape[1] >= ENOUGH and float(albedo.std(dim=1).max()) > VARIES


def _same(apart: Tensor) -> float:
    return float((apart.abs().amax(0) < SAME).float().mean())


def _function(grey: Tensor, depth: Tensor) -> float:
    """Share of the greys (n,) that are a linear function of depth (n,), or of its inverse, whichever is greater."""
    if len(torch.unique((255 * grey).round())) < LEVELS:
        return 0.0
    found = []
    for values in (depth / depth.median(), depth.median() / depth):
        rows = torch.stack([values, torch.ones_like(values)], 1)
        kept = torch.ones_like(grey, dtype=torch.bool)
        for _ in range(3):  # again without edges, which show means of surfaces
            fitted = rows @ torch.linalg.lstsq(rows[kept], grey[kept, None]).solution
            apart = (fitted[:, 0] - grey).abs()
            kept = apart <= 3 * apart.median() + 1e-6
        found.append(float((apart < SAME).double().mean()))
    return max(found)
