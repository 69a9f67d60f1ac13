"""Pixels and those beside them, as views."""

from torch import Tensor


def pairs(image: Tensor, axis: int, k: int) -> tuple[Tensor, Tensor]:
    """Views of the pixels that have one k steps further along the axis, and of those."""
    count = image.shape[axis] - k
    return image.narrow(axis, 0, count), image.narrow(axis, k, count)
