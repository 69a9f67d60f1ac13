"""Ways to find motion in two images, to be compared: ours, and the optical flow of OpenCV and of eFOLKI.

Each takes current and previous, (1, 1, H, W) in [0, 1], and gives motion (1, 2, H, W) in pixels, current → previous.
Needs the extra `compare`.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch
from gefolki.algorithm import EFolki
from torch import Tensor

from nte.motion.correspondence import find_correspondence
from nte.motion.search import SEARCHES, Search

Find = Callable[[Tensor, Tensor], Tensor]


def _bytes(grey: Tensor) -> npt.NDArray[np.uint8]:
    values: npt.NDArray[np.uint8] = np.rint(grey[0, 0].clamp(0, 1).numpy() * 255).astype(np.uint8)
    return values


def _motion(flow: Any) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(flow.transpose(2, 0, 1), np.float32))[None]


def zero(current: Tensor, previous: Tensor) -> Tensor:
    """Nothing moves."""
    return torch.zeros(1, 2, *current.shape[2:])


def farneback(current: Tensor, previous: Tensor) -> Tensor:
    """Farnebäck 2003, with the parameters of Hanika et al. 2021: the values of OpenCV's documentation."""
    flow = cv2.calcOpticalFlowFarneback(_bytes(current), _bytes(previous), None, 0.5, 3, 15, 3, 5, 1.2, 0)
    return _motion(flow)


def dis(current: Tensor, previous: Tensor) -> Tensor:
    """Dense inverse search (Kroeger et al. 2016), OpenCV's medium preset."""
    library: Any = cv2  # whose stubs lack it
    method = library.DISOpticalFlow_create(library.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return _motion(method.calc(_bytes(current), _bytes(previous), None))


def dual_tv_l1(current: Tensor, previous: Tensor) -> Tensor:
    """Dual TV-L1 (Zach et al. 2007; Sánchez Pérez et al. 2013), OpenCV's defaults."""
    library: Any = cv2
    method = library.optflow.DualTVL1OpticalFlow_create()
    return _motion(method.calc(_bytes(current), _bytes(previous), None))


def efolki(current: Tensor, previous: Tensor) -> Tensor:
    """With the parameters of the package's own demonstration, whose images are of this size."""
    images = (image[0, 0].numpy().astype(np.float32) for image in (current, previous))
    return _motion(np.stack(EFolki(*images, iteration=2, radius=[8, 4], rank=4, levels=3), 2))


FLOWS: dict[str, Find] = {"Farnebäck": farneback, "DIS": dis, "Dual TV-L1": dual_tv_l1, "eFOLKI": efolki}


def ours(noise: str, half: bool | None = None) -> Find:
    """The patch search for this noise (nte.motion.correspondence.SEARCHES), at its own or the given resolution."""
    return searching(SEARCHES[noise] if half is None else replace(SEARCHES[noise], half=half))


def searching(search: Search) -> Find:
    """The patch search with these settings."""
    return lambda current, previous: find_correspondence(current, previous, search).motion


def noise_of(spp: int) -> str:
    """The search for so many samples per pixel: what a user would choose, the same in every scene."""
    return "noisy" if spp < 4 else "moderate"
