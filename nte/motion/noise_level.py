"""The noise level of an image, estimated from the image alone."""

import torch.nn.functional as F
from torch import Tensor

# This kernel ignores linear gradients, and its response to white noise has 6 times the noise's σ. Immerkær 1996, «Fast
# Noise Variance Estimation», with a median in place of the mean.
_KERNEL = ((1.0, -2.0, 1.0), (-2.0, 4.0, -2.0), (1.0, -2.0, 1.0))
_GAIN = 6.0
_MEDIAN = 0.6745  # of |x| for Gaussian x of σ 1
_STEP = 3  # px from one response to the next: a ninth of them gives nearly the same median
_ROUNDING = 2.5e-3  # of the largest value: what half floats make of a gradient; a response below this is no noise


def noise_level(image: Tensor) -> Tensor:
    """Estimate the standard deviation (N,) of white noise in images (N, C, H, W), in their unit.

    Each image gets the largest value of its channels. The estimate is the median response of a filter that ignores
    linear gradients. Areas without noise, such as a sky, do not count, but the constant sides of an edge do. Edges and
    texture on less than half of the pixels that count do not affect the estimate. Images under 3×3 pixels give 0.
    """
    count, channels, height, width = image.shape
    if min(height, width) < 3:
        return image.new_zeros(count)
    kernel = image.new_tensor(_KERNEL)[None, None]
    planes = image.reshape(count * channels, 1, height, width)
    response = F.conv2d(planes, kernel, stride=_STEP).abs()
    varies = F.max_pool2d(response, 3, 1, 1) > _ROUNDING * planes.abs().amax((2, 3), keepdim=True)
    middle = response.where(varies, float("nan")).flatten(1).nanmedian(1).values.nan_to_num(0)
    sigma: Tensor = middle / (_GAIN * _MEDIAN)
    return sigma.view(count, channels).amax(1)
