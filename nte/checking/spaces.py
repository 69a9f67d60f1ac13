"""A check that normals and positions are given in the world: what stands still keeps them from frame to frame.

In the space of a moving camera, all of them change alike: one rotation takes the normals of a frame to those of the
next, and one rigid motion takes the positions. A picture in which everything turns as one body looks the same, so this
is a note and no fault.
"""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from nte.checking.values import Finding
from nte.frames.frame import Frame
from nte.motion.warp import warp

ENOUGH = 200  # least number of pixels that can tell
SAMPLED = 4096  # pixels of a pair of frames that are looked at, up to twice as many
MOST = 0.75  # share of the pixels that must have changed, and that one motion must explain
TURNED = 0.3  # one motion explains a change if it leaves at most this share of it
NORMAL = 0.004  # least change of a normal that counts: 0.2°, several times the rounding of half floats
FOOTPRINT = 1.5  # least change of a position that counts, in distances between pixels: jitter shifts less

Spaces = dict[str, bool]  # channel → whether its values changed alike between two frames


def changed_alike(previous: Frame, current: Frame, visible: Tensor) -> Spaces:
    """Tell for normals and positions whether one rigid motion explains how they changed, and they did change.

    Both are PyTorch frames of batch 1 with motion. visible: bool mask (1, 1, H, W) of the pixels of `current` whose
    surface is seen in `previous`. Channels that too few pixels show are left out, and so are all if cameras say that
    they stand still.
    """
    found: Spaces = {}
    if current.view is not None and previous.view is not None and torch.equal(current.view, previous.view):
        return found
    for name in (name for name in ("normal", "position") if name in previous and name in current):
        now, before = current[name], warp(previous[name], current["motion"].nan_to_num(0, 0, 0)).image
        shown = (torch.cat([now, before], 1).isfinite() & (now != 0).any(1, keepdim=True)).all(1, keepdim=True)
        chosen = (visible & shown)[0, 0]
        if int(chosen.sum()) < ENOUGH:
            continue
        step = max(1, int(chosen.sum()) // SAMPLED)
        least = NORMAL
        if name == "position":
            least = FOOTPRINT * float(now.diff(dim=3).norm(dim=1)[0][chosen[:, :-1]].median().nan_to_num(0))
        ours, theirs = (values[0].double()[:, chosen][:, ::step] for values in (now, before))
        found[name] = _alike(ours, theirs, least, centred=name == "position")
    return found


def _alike(now: Tensor, before: Tensor, least: float, centred: bool) -> bool:
    """Tell whether vectors (3, n) changed by `least` or more, and by one rotation: about the origin, or the centre."""
    change = (now - before).norm(dim=0)
    if float(change.quantile(1 - MOST)) < least:
        return False
    good = torch.ones_like(change, dtype=torch.bool)
    rest = change
    for _ in range(2):  # again without what moves by itself
        centres = [values[:, good].mean(1, keepdim=True) * centred for values in (now, before)]
        ours, theirs = now - centres[0], before - centres[1]
        u, _, v = torch.linalg.svd(ours[:, good] @ theirs[:, good].T)
        rest = (ours - u @ v @ theirs).norm(dim=0)
        good = rest <= 3 * rest.median() + 1e-12
    return float(rest.quantile(MOST)) < TURNED * float(change.median())


def judge_spaces(pairs: Sequence[Spaces]) -> Iterator[Finding]:
    """Yield a note for each channel that changed alike in most pairs of frames.

    pairs: of frames whose vectors are plausible, as others lead anywhere.
    """
    for name, motion in (("normal", "rotation"), ("position", "rigid motion")):
        told = [pair[name] for pair in pairs if name in pair]
        if told and 2 * sum(told) > len(told):
            found = f"one {motion} takes those of a frame to those of the next, as in the space of a moving camera"
            yield Finding(name, found, "world space: what stands still keeps its values", False)
