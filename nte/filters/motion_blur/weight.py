"""Step 3, the weight: whether a sample could be seen at a pixel at another time (Eq. 1 and section 4.3)."""

import torch
from torch import Tensor

B3 = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)  # of the à-trous wavelet transform (Dammertz et al. 2010)
_ROUNDING = 1e-4  # tolerance as a share of l, so that a sample at t = 0 or t = 1 lies on its own segment


def segment_distance(p: Tensor, q: Tensor, motion: Tensor, time: Tensor) -> Tensor:
    """Compute d(p, q) of Eq. 1, px: the distance from p to the path q₀q₁ of a sample, infinite beyond its ends.

    p and q (…, 2): positions, px. motion (…, 2): px over the open shutter, forward in time. time (…): of the sample, in
    [0, 1].
    """
    away = p - (q - motion * time[..., None])
    squared = motion.square().sum(-1)
    place = (away * motion).sum(-1) / squared.clamp(min=1e-12)
    across = away[..., 0] * motion[..., 1] - away[..., 1] * motion[..., 0]
    passes = (place >= -_ROUNDING) & (place <= 1 + _ROUNDING) & (squared > 1e-8)
    return torch.where(passes, across.abs() * squared.clamp(min=1e-12).rsqrt(), float("inf"))


def motion_weight(p: Tensor, q: Tensor, motion: Tensor, time: Tensor, reach: Tensor) -> Tensor:
    """Compute w(p, q) = max(0, 1 − d/reach), with d from `segment_distance` and reach = c_a c_l, px."""
    return (1 - segment_distance(p, q, motion, time) / reach).clamp(min=0)


def kernel(device: torch.device) -> Tensor:
    """Return the weights (1, 25) of 5×5 pixels in the order of `square(2)`; they sum to 1."""
    line = torch.tensor(B3, device=device)
    return torch.outer(line, line).view(1, 25)
