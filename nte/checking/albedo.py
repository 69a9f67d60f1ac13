"""A check that albedo is linear, with its components in the order of the light: steps of texture within one surface.

Light is albedo times illumination, which hardly changes across an edge of a texture. So the logarithm of the reference
steps there as that of albedo does, or less, where a surface shines as well. Encoded for display (sRGB), albedo steps by
less than half of that, and decoding it makes the steps equal. What a step has of colour, beyond brightness, has the
direction of that of the reference only in the right order of components. Where the light does not step with albedo at
all, albedo is another picture's, or another channel; or only gloss is seen.
"""

from collections.abc import Iterator
from itertools import pairwise, permutations
from math import inf

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.borrowed import BorrowedTally
from nte.checking.grey import is_grey, judge_grey
from nte.checking.textures import ONE_SURFACE
from nte.checking.values import Finding
from nte.frames.frame import Frame

APART = 2  # pixels between the two whose step is measured: pixel filters blur what is closer
SMOOTH = 0.995  # least cosine between the normals of neighbours
STEP, COLOUR = 0.1, 0.05  # least step of the logarithm of albedo that tells its encoding, and its order
MUCH = 0.5  # least share of a step that is colour: gloss that is blue, as the sky's is, bends what is less
USABLE = 0.02, 0.98  # albedo that tells an order
BRIGHT = 0.2  # least albedo that tells an encoding: some albedo has a share of gloss, which matters in the dark
VISIBLE = 0.05  # least albedo that tells whether the light steps at all
TEXTURED = 0.04  # least share of such steps that are strong: fewer lie by chance where shadows end
FOLLOWS, AGAINST = 0.1, -0.2  # least step of the light in those of albedo; measured: 0.3 to 1.2, −0.03 to 0.03 with the
# albedo of another clip, −1.5 to −0.2 with 1 − albedo
ENOUGH = 200  # least number of steps that tell, up and down together
ENCODED = 1.4  # steps of the light in those of albedo, from which on it is encoded
BETTER = 0.5  # decoded, the ratio is off from 1 by at most this share
ALIKE, UNLIKE = 0.9, 0.5  # cosines between colours of steps: of the order that is named, and of the one that is given
TIED = 0.02  # difference of cosines up to which the simplest order is named
LINEAR = "linear albedo, not encoded for display"
ORDER = "the order of components of the light"
SEEN = "the albedo of what is seen: light that steps where it does"

# Albedo at the two ends of each step, and the logarithm of light there, both (2, 3, n)
Steps = tuple[Tensor, Tensor]


class AlbedoTally:
    """Tally of the steps of albedo and reference within the surfaces of some frames."""

    def __init__(self) -> None:
        self._steps: tuple[list[Steps], list[Steps]] = [], []  # as they are, and of the means of 3×3 pixels
        self._borrowed = BorrowedTally()

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1; steps need albedo, reference, and one of instance and depth."""
        self._borrowed.add(frame)
        if not ("albedo" in frame and "reference" in frame and ("instance" in frame or "depth" in frame)):
            return
        usable = ("albedo", "reference", "instance", "depth", "normal", "shutter_motion")
        names = [name for name in usable if name in frame]
        means = {name: F.avg_pool2d(frame[name], 3, 1, 1, count_include_pad=False) for name in names[:2]}
        for steps, given in zip(self._steps, (frame, frame.with_channels(**means)), strict=True):
            for sideways in (True, False):
                channels = {name: given[name][0] if sideways else given[name][0].transpose(1, 2) for name in names}
                if channels["albedo"].shape[2] > APART:
                    steps.append(_steps(channels))

    def judge(self) -> Iterator[Finding]:
        """Yield a fault for albedo that is another channel, of another order of components, or encoded.

        A doubt if it is not seen, or is grey.
        """
        borrowed = list(self._borrowed.judge())
        yield from borrowed
        if borrowed or not self._steps[0]:
            return
        (albedo, ends), (means, ends_of_means) = [
            [torch.cat([step[i] for step in steps], 2) for i in range(2)] for steps in self._steps
        ]
        light = ends[1] - ends[0]
        # Aliased, fine textures step at random, but not their means.
        seen = max(_seen(albedo, light), _seen(means, ends_of_means[1] - ends_of_means[0]))
        if seen < FOLLOWS:
            found = f"the logarithm of reference steps {seen:.2g} times as far at its edges"
            against = seen < AGAINST
            told = "it is inverted" if against else "it is another picture's, another channel, or only gloss is seen"
            yield Finding("albedo", f"{found}: {told}", SEEN, against, not against)
            return
        if is_grey(albedo):
            yield from judge_grey(albedo, ends)
        order = _order(albedo, light)
        if order != (0, 1, 2):
            names = "".join("RGB"[i] for i in order)
            yield Finding("albedo", f"its components are in the order {names}, as edges in reference show", ORDER)
        light = light[list(order)]
        strong, up = _strong(albedo, BRIGHT), albedo[1].mean(0) > albedo[0].mean(0)
        # Light that falls off along a texture adds to steps one way, and takes from those the other way.
        each = (albedo, _decoded(albedo))
        ways = [[_ratio(strong & way, v, light, ENOUGH // 2) or 0.0 for v in each] for way in (up, ~up)]
        given, decoded = min(ways)
        if given > ENCODED and abs(decoded - 1) < BETTER * (given - 1):
            steps = f"the logarithm of reference steps {given:.3g} times as far at edges of textures"
            yield Finding("albedo", f"is encoded, as sRGB is: {steps}, decoded {decoded:.3g} times", LINEAR)


def _steps(channels: dict[str, Tensor]) -> Steps:
    """Steps along the rows of channels (C, H, W), within one smooth surface: albedo (2, 3, n), and light (3, n)."""
    width = channels["albedo"].shape[2]
    shifted = [{n: v[..., i : width - APART + i] for n, v in channels.items()} for i in range(APART + 1)]
    albedo, light = (torch.stack([shifted[i][name] for i in (0, -1)]) for name in ("albedo", "reference"))
    low, high = USABLE
    good = ((albedo > low) & (albedo < high) & (light > 0) & light.isfinite()).all(0).all(0)
    for one, other in pairwise(shifted):
        if "instance" in one:
            good &= (one["instance"] == other["instance"])[0]
        if "depth" in one:
            near, far = torch.stack([one["depth"], other["depth"]]).aminmax(dim=0)
            good &= ((near > 0) & (far < ONE_SURFACE * near))[0]
        if "normal" in one:
            good &= (one["normal"] * other["normal"]).sum(0) > SMOOTH
        if "shutter_motion" in one:  # in light that is blurred along it, steps are lost
            good &= one["shutter_motion"].norm(dim=0) < APART
    return albedo[:, :, good].double(), light[:, :, good].double().log()


def _seen(albedo: Tensor, light: Tensor) -> float:
    """Return the ratio of `_ratio` where albedo is visible; infinite if it has hardly any texture."""
    visible = _strong(albedo, VISIBLE)
    ratio = _ratio(visible, albedo, light)
    return inf if ratio is None or int(visible.sum()) < TEXTURED * len(visible) else ratio


def _strong(albedo: Tensor, least: float) -> Tensor:
    """Mark the strong steps (n,) of albedo (2, 3, n) that is at least so large at both ends."""
    steps = (albedo[1].log() - albedo[0].log()).mean(0)
    return (albedo > least).all(0).all(0) & (steps.abs() > STEP)


def _ratio(strong: Tensor, albedo: Tensor, light: Tensor, least: int = ENOUGH) -> float | None:
    """Median of how many times as far as that of albedo (2, 3, n) the logarithm of light (3, n) steps; None if unknown.

    strong: bool (n,), steps that tell, of which there must be so many at least.
    """
    if int(strong.sum()) < least:
        return None
    steps = (albedo[1, :, strong].mean(0) / albedo[0, :, strong].mean(0)).log()
    return float((light[:, strong].mean(0) / steps).median())


def _order(albedo: Tensor, light: Tensor) -> tuple[int, ...]:
    """Find the order of the components of light (3, n) that those of albedo (2, 3, n) have; (0, 1, 2) if unknown."""
    steps = albedo[1].log() - albedo[0].log()
    colours, of_light = steps - steps.mean(0), light - light.mean(0)
    strong = colours.norm(dim=0) > (MUCH * steps.norm(dim=0)).clamp(min=COLOUR)
    right = (0, 1, 2)
    if int(strong.sum()) < ENOUGH:
        return right
    colours, of_light = colours[:, strong], of_light[:, strong]
    sizes = (colours.norm(dim=0) * of_light.norm(dim=0)).clamp(min=1e-30)
    alike = {p: float(((colours * of_light[list(p)]).sum(0) / sizes).median()) for p in permutations(range(3))}
    best = max(alike.values())
    if best < ALIKE or alike[right] > UNLIKE:
        return right
    # Two that are exchanged are simpler than all three.
    return max((p for p in alike if alike[p] > best - TIED), key=lambda p: sum(i == c for i, c in enumerate(p)))


def _decoded(values: Tensor) -> Tensor:
    return torch.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
