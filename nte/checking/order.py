"""A check that what is nearer hides what is behind it: an inverse depth, as in many z-buffers, turns that around.

Where the vectors of two surfaces lead to the same pixel of the frame before, one of them was hidden there. Depths are
only put in order, within one frame: units, offsets and frames with a scale of their own make no difference.

Wrong vectors of one object put it where something else was seen, too. But then other pixels of it are lost where
nothing else comes from: behind what should they have been? Right vectors lose only what was hidden.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.textures import Textures
from nte.checking.values import Finding
from nte.frames.frame import Frame

APART = 0.1  # least difference of the two depths, as a share of the range of eight tenths of the frame's
FOUND, LOST = 0.01, 0.05  # greatest albedo error of what was seen, and least one of what was hidden
ENOUGH = 20  # least number of pixels that can tell
HIDDEN = 0.5  # least share of the lost pixels that what is farther comes before; of wrong vectors 0 to 0.44
MOST = 0.8  # share of them that must agree; measured on right clips: the nearer one was seen in 0.7 to 1


class Order(NamedTuple):
    """Pixels that two surfaces come from: of which the nearer one was seen there, and the farther one."""

    nearer: int
    farther: int
    lost: int = 0  # pixels of surfaces that were hidden by what is farther: those that their vectors do not find
    behind: int = 0  # those of them to whose place, or beside it, something farther comes

    @property
    def number(self) -> int:
        """Number of pixels that tell."""
        return self.nearer + self.farther


def depth_order(previous: Frame, current: Frame) -> Order:
    """Count the pixels of `previous` that the vectors of two surfaces lead to, by which of the two was seen there.

    Both are PyTorch frames of batch 1 with motion and depth, and with instance or albedo. A surface was seen if one of
    the 3×3 pixels there shows its instance, or has its albedo, and the other one only if none of them does.
    """
    if not any(name in current and name in previous for name in ("instance", "albedo")):
        return Order(0, 0)
    # Where only instances tell, any albedo will do.
    bare = (
        f if "albedo" in f else f.with_channels(albedo=0 * f["depth"].expand(-1, 3, -1, -1))
        for f in (previous, current)
    )
    textures = Textures(*bare)
    at, _, within = textures.target(textures.centres + current["motion"][0].flatten(1))
    depth = current["depth"].flatten()
    comes = within & (depth > 0) & depth.isfinite()
    if int(comes.sum()) < ENOUGH:
        return Order(0, 0)
    ends = torch.full_like(depth, torch.inf), torch.full_like(depth, -torch.inf)
    near, far = (
        end.scatter_reduce(0, at[comes], depth[comes], how) for end, how in zip(ends, ("amin", "amax"), strict=True)
    )
    tenth, count = -(-int(comes.sum()) // 10), int(comes.sum())
    low, high = (depth[comes].kthvalue(k).values for k in (tenth, count - tenth + 1))
    pixels = (comes & (far[at] - near[at] > APART * (high - low))).nonzero()[:, 0]
    there = at[pixels]
    seen, hidden = _seen_and_hidden(textures, pixels, there)

    def any_at(mask: Tensor) -> Tensor:
        found = torch.zeros_like(depth, dtype=torch.bool)
        found[there[mask]] = True
        return found

    nearest, farthest = depth[pixels] == near[there], depth[pixels] == far[there]
    nearer = any_at(nearest & seen) & ~any_at(nearest & hidden) & any_at(farthest & hidden) & ~any_at(farthest & seen)
    farther = any_at(farthest & seen) & ~any_at(farthest & hidden) & any_at(nearest & hidden) & ~any_at(nearest & seen)
    if not farther.any():
        return Order(int(nearer.sum()), 0)
    lost = _lost(textures, pixels[nearest & hidden & farther[there]], comes, at)
    over = F.max_pool2d(far.view(1, 1, *current.size), 3, 1, 1).flatten()[at[lost]]
    behind = over - depth[lost] > APART * (high - low)
    return Order(int(nearer.sum()), int(farther.sum()), len(lost), int(behind.sum()))


def _lost(textures: Textures, pixels: Tensor, comes: Tensor, at: Tensor) -> Tensor:
    """List the pixels (n,) of the surfaces of `pixels` (P,) that are not seen where their vectors lead.

    comes: bool (H·W,), pixels with a depth whose vectors end in the picture, at `at` (H·W,). Without instances, pixels
    of all surfaces are listed.
    """
    if "instance" in textures.surface:
        now, _ = textures.surface["instance"]
        comes = comes & torch.isin(now, now[pixels].unique())
    else:
        comes = comes & textures.usable
    able = comes.nonzero()[:, 0]
    _, hidden = _seen_and_hidden(textures, able, at[able])
    # A large object is seen where any short vectors lead, but not the same place of it.
    elsewhere = textures.usable[able] & (textures.error(able, at[able], textures.wide) > LOST)
    return able[hidden | elsewhere]


def _seen_and_hidden(textures: Textures, pixels: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
    """Tell which pixels (P,) are seen among the 3×3 pixels around `at` (P,) of the frame before, and which are not."""
    if "instance" in textures.surface:
        now, before = (ids.view(textures.height, textures.width) for ids in textures.surface["instance"])
        row, column = at // textures.width, at % textures.width
        seen = torch.zeros_like(at, dtype=torch.bool)
        for y, x in product((-1, 0, 1), (-1, 0, 1)):
            beside = (row + y).clamp(0, textures.height - 1), (column + x).clamp(0, textures.width - 1)
            seen |= before[beside] == now.flatten()[pixels]
        return seen, ~seen
    error = textures.error(pixels, at, textures.wide)
    return error <= FOUND, error > LOST


def judge_order(pairs: Sequence[Order]) -> Iterator[Finding]:
    """Yield a fault if nearly everything that hides something is farther away, in most pairs of frames.

    Two pairs at least must agree, unless there is only one. pairs: of frames whose vectors are plausible, as others
    lead anywhere.
    """
    telling = [pair for pair in pairs if pair.number]
    wrong = [pair for pair in telling if pair.farther > MOST * pair.number and pair.behind >= HIDDEN * pair.lost]
    farther, pixels = sum(pair.farther for pair in wrong), sum(pair.number for pair in wrong)
    if pixels >= ENOUGH and 2 * len(wrong) > len(telling) and len(wrong) >= min(2, len(pairs)):
        count = f"in {farther} of {pixels} pixels"
        found = f"what hides is farther away than what it hides, {count}: inverse depth, as in a z-buffer"
        yield Finding("depth", found, "the distance along the view axis, in scene units")


def is_known(pairs: Sequence[Order]) -> bool:
    """Tell whether enough pixels show what hides what."""
    return sum(pair.number for pair in pairs) >= ENOUGH
