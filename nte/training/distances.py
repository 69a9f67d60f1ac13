"""How far an image is from its reference: an error for every pixel, and one of structure for whole images.

Pixels of a reference that are NaN, infinite or negative carry no information, and are left out.
"""

from collections.abc import Callable
from types import MappingProxyType
from typing import TypeAlias

import torch
from torch import Tensor

from nte.color import per_sequence
from nte.errors import needs_extra

BRIGHTEST = 65504.0  # cap of an exposed reference; nobody sees a difference beyond
SMOOTH = 1e-3  # ε of Charbonnier's distance: below it the distance is quadratic
RELATIVE = (
    1e-2  # ε of SMAPE, as in Vogels et al. 2018, «Denoising with Kernel Prediction and Asymmetric Loss Functions»
)
_WINDOW, _WEIGHTS = 11, (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # of MS-SSIM, by Wang et al. 2003, finest scale first

# Takes a difference and the magnitudes that it is a part of, both (N, C, H, W), and gives the error.
Distance: TypeAlias = Callable[[Tensor, Tensor], Tensor]


def l1(difference: Tensor, magnitude: Tensor) -> Tensor:
    """Compute |d|."""
    return difference.abs()


def charbonnier(difference: Tensor, magnitude: Tensor) -> Tensor:
    """Compute √(d² + ε²) − ε, which has a gradient without a jump (Charbonnier et al. 1994)."""
    return (difference.square() + SMOOTH**2).sqrt() - SMOOTH


def smape(difference: Tensor, magnitude: Tensor) -> Tensor:
    """Compute |d| / (m + ε), in which dark and bright pixels count alike."""
    return difference.abs() / (magnitude + RELATIVE)


DISTANCES = MappingProxyType({"l1": l1, "smape": smape, "charbonnier": charbonnier})


def masked_mean(values: Tensor, usable: Tensor) -> Tensor:
    """Average values (N, C, H, W) over the usable pixels, bool (N, 1, H, W); 0 if there are none.

    Values elsewhere must be finite. If every pixel is usable, the result is the plain mean, bit for bit.
    """
    share = usable.to(values.dtype).mean()
    return (values * usable).mean() / torch.where(share > 0, share, 1.0)


def usable_reference(reference: Tensor, exposure: Tensor) -> tuple[Tensor, Tensor]:
    """Prepare a reference (N, C, H, W) for losses; return it with the bool mask (N, 1, H, W) of its usable pixels.

    A pixel that is NaN, infinite or negative in any component is not usable, and becomes 0. Exposed values are capped
    at 65504. exposure: (N,).
    """
    scale = per_sequence(exposure)
    usable = ((reference >= 0) & (reference * scale < float("inf"))).all(1, keepdim=True)
    return torch.where(usable, reference, 0.0).minimum(BRIGHTEST / scale), usable


def structure_error(image: Tensor, reference: Tensor, usable: Tensor) -> Tensor:
    """Compute 1 − MS-SSIM of images (N, C, H, W) in [0, 1], with as many of its five scales as their size allows.

    usable (N, 1, H, W), bool: both images are black elsewhere. The contrast of each scale enters as (1 + c) / 2, as a
    power below 1 of a contrast of 0 would have an infinite gradient. Images below 11 px have no structure: 0.
    """
    scales = structure_scales(min(image.shape[-2:]))
    if not scales:
        return image.new_zeros(())
    try:
        from torchmetrics.functional.image import multiscale_structural_similarity_index_measure as ms_ssim
    except ImportError as error:
        raise needs_extra("train", "loss.structure", error) from error
    weights = tuple(weight / sum(_WEIGHTS[:scales]) for weight in _WEIGHTS[:scales])
    image, reference = (torch.where(usable, x, 0.0) for x in (image, reference))
    return 1 - ms_ssim(image, reference, kernel_size=_WINDOW, data_range=1.0, betas=weights, normalize="simple")


def structure_scales(side: int) -> int:
    """Return how many scales of MS-SSIM an image with this shorter side has, px: 1 from 11, 3 from 44, 5 from 176."""
    # The window must fit into the coarsest image; the second condition is torchmetrics' own.
    fits = [min(side >> (n - 1), side // max(1, n - 1) ** 2) >= _WINDOW for n in range(1, len(_WEIGHTS) + 1)]
    return sum(fits)
