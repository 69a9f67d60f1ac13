"""A check that depth is that of what is seen: where it steps, albedo, normals or ids change, too.

What stands before something else has an outline, and hardly ever the albedo, the normal and the id of what is behind.
The steps of another clip's depth lie there by chance: as often as the others change anywhere. Steps are looked for in
1 / z, in which planes are straight, however steep; a step is more than twice as high as those beside it.
"""

from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.textures import ONE_SURFACE
from nte.checking.values import Finding
from nte.frames.frame import Frame

ALONE = 2.0  # times that a step is at least as high as those on both sides, along its axis
CHANGES = {"albedo": 0.1, "normal": 0.3, "instance": 0.0}  # channel → least change of a component that counts
ENOUGH = 200  # least number of steps that tell
EVERYWHERE = 0.7  # a greater share of the pixels in which something changes tells nothing
# Least share of the steps, beyond chance, at which something changes; measured: 0.6 to 1 in right clips, 0.44 at the
# least in 28×28 pixels of them, below 0.3 in 97 % of those with the depth of another clip.
MET = 0.35


class OutlineTally:
    """Tally of the steps of depth in some frames, and of those at which something else changes."""

    def __init__(self) -> None:
        self._steps = self._met = self._changes = self._pairs = 0  # pairs of neighbouring pixels
        self._names: list[str] = []

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1; depth, albedo, and one of normal and instance are needed."""
        names = [name for name in CHANGES if name in frame]
        if "depth" not in frame or "albedo" not in names or len(names) < 2:
            return
        self._names = names
        for sideways in (True, False):
            values = {n: frame[n] if sideways else frame[n].transpose(2, 3) for n in ("depth", *names)}
            if values["depth"].shape[3] < 2:
                continue
            steps = _steps(values.pop("depth"))
            changes = torch.stack([_changes(v.nan_to_num(0, 0, 0), CHANGES[n]) for n, v in values.items()]).any(0)
            beside = F.max_pool2d(changes.float(), (1, 3), 1, (0, 1)) > 0  # pixel filters move outlines by one
            self._steps += int(steps.sum())
            self._met += int((steps & beside).sum())
            self._changes += int(beside.sum())
            self._pairs += steps.numel()

    def judge(self) -> Iterator[Finding]:
        """Yield a doubt if depth steps where nothing else changes, about as often as anywhere."""
        if self._steps < ENOUGH or not self._steps < self._changes < EVERYWHERE * self._pairs:
            return
        met, chance = self._met / self._steps, self._changes / self._pairs
        if met - chance < MET * (1 - chance):
            others = f"{', '.join(self._names[:-1])} or {self._names[-1]}"
            found = f"at {met:.0%} of its steps {others} changes, and by chance it would at {chance:.0%}"
            yield Finding("depth", found, "the depth of what the other channels show, of the same frame", False, True)


def _steps(depth: Tensor) -> Tensor:
    """Mark the steps (1, 1, H, W − 1) of depth (1, 1, H, W) between neighbours in a row."""
    near = torch.where((depth > 0) & depth.isfinite(), 1 / depth.clamp(min=1e-30), 0.0)
    left, right = near[..., :-1], near[..., 1:]
    heights = F.pad((right - left).abs(), (1, 1))
    beside = torch.maximum(heights[..., :-2], heights[..., 2:])
    high = torch.maximum(left, right) > ONE_SURFACE * torch.minimum(left, right)
    return high & (heights[..., 1:-1] > ALONE * beside)


def _changes(values: Tensor, least: float) -> Tensor:
    """Mark where values (1, C, H, W) change between neighbours in a row, by more than `least`: (1, 1, H, W − 1)."""
    return values.diff(dim=3).abs().amax(1, keepdim=True) > least
