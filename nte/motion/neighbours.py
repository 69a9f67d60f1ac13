"""Views of pixels and of their neighbours."""

from torch import Tensor


def pairs(image: Tensor, axis: int, k: int) -> tuple[Tensor, Tensor]:
    """Return views of all pairs of pixels k steps apart along an axis: the first pixels, and the second ones."""
    count = image.shape[axis] - k
    return image.narrow(axis, 0, count), image.narrow(axis, k, count)
