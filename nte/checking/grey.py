"""A check that albedo has the colours of what is seen: a grey one may be the luminance of coloured textures.

Light is albedo times illumination, which hardly changes across an edge of a texture. Divided by an albedo that is grey
and right, its components have no step there, or step together, where gloss hides the texture. Divided by the luminance
of a coloured albedo, some of them step up and others down: their mean hardly changes.
"""

from collections.abc import Iterator

from torch import Tensor

from nte.checking.borrowed import EXPECTED
from nte.checking.values import Finding

STEP, EVEN = 0.1, 0.01  # least step of the logarithm of albedo that tells, and greatest one that is none
VISIBLE = 0.05  # least albedo that tells
GREY, MOST = 0.01, 0.99  # greatest difference between the components of a grey, and least share of the pixels that are
ENOUGH = 200  # least number of steps
# Least mean square of the steps of colour that are left; measured: up to 0.028 in rendered clips whose textures were
# made grey, 0.04 to 0.38 with the luminance of textures of strong colours, 0.004 to 0.007 of brown ones
COLOURED = 0.03
BEYOND = 3.0  # times as large as where albedo is even: shadows have colours, and so has noise
# Greatest ratio of the mean square of their means to that; measured: 0 to 0.46 with the luminance or the mean of most
# coloured textures, 1.5 and 5.7 where gloss hides a grey texture. Gloss of one component alone would have 0.5
TOGETHER = 0.47


def is_grey(albedo: Tensor) -> bool:
    """Tell whether albedo (2, 3, n) has no colour in nearly all pixels."""
    apart = albedo.amax(1) - albedo.amin(1)
    return float((apart < GREY).double().mean()) > MOST


def judge_grey(albedo: Tensor, light: Tensor) -> Iterator[Finding]:
    """Yield a doubt if grey albedo is the luminance of textures whose colours the light has.

    albedo, and the logarithm of light: (2, 3, n), at both ends of steps within surfaces.
    """
    grey = albedo.mean(1).log()
    step = grey[1] - grey[0]
    left = (light[1] - light[0] - step).clamp(-1, 1)  # of light divided by albedo
    visible = (albedo.mean(1) > VISIBLE).all(0)
    strong, even = visible & (step.abs() > STEP), visible & (step.abs() < EVEN)
    if int(strong.sum()) < ENOUGH:
        return
    (together, coloured), (by_chance, of_light) = (_squares(left[:, where]) for where in (strong, even))
    if coloured < max(COLOURED, BEYOND * of_light):
        return
    if together - by_chance < TOGETHER * (coloured - of_light):
        found = "is grey, and textures in reference have colours of which it is the luminance"
        yield Finding("albedo", found, EXPECTED, False, True)


def _squares(steps: Tensor) -> tuple[float, float]:
    """Mean squares of the steps (3, n) that components make together, and of those beside; 0 without steps."""
    if not steps.shape[1]:
        return 0.0, 0.0
    mean = steps.mean(0)
    return 3 * float(mean.square().mean()), float((steps - mean).square().sum(0).mean())
