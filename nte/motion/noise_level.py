"""How noisy an image is, told from the image alone."""

import torch.nn.functional as F
from torch import Tensor

# Blind to planes; its response to white noise has 6 times the noise's σ. Immerkær 1996, «Fast Noise Variance
# Estimation», whose mean is a median here.
_KERNEL = ((1.0, -2.0, 1.0), (-2.0, 4.0, -2.0), (1.0, -2.0, 1.0))
_GAIN = 6.0
_MEDIAN = 0.6745  # of |x| for Gaussian x of σ 1
_STEP = 3  # pixels from one response to the next: a ninth of them tells as much


def noise_level(image: Tensor) -> Tensor:
    """(N,) standard deviation of white noise in images (N, C, H, W), in their unit; the largest of the channels.

    The median response of a filter that does not see slopes: edges and the texture of less than half of the pixels do
    not count, and neither does noise of less than half of them. 0 for images of less than 3×3 pixels.
    """
    count, channels, height, width = image.shape
    if min(height, width) < 3:
        return image.new_zeros(count)
    kernel = image.new_tensor(_KERNEL)[None, None]
    response = F.conv2d(image.reshape(count * channels, 1, height, width), kernel, stride=_STEP).abs()
    sigma: Tensor = response.flatten(1).median(1).values / (_GAIN * _MEDIAN)
    return sigma.view(count, channels).amax(1)
