"""Methods that find motion between two images, for comparisons: ours, and the optical flow of OpenCV and of eFOLKI.

Each takes current and previous, (1, 1, H, W) in [0, 1], and returns motion (1, 2, H, W) in pixels, current → previous.
`candidates` lists, for each method, the settings among which a benchmark chooses on its train clips. Needs the extra
`compare`.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch
from gefolki.algorithm import EFolki
from torch import Tensor

from nte.motion.correspondence import find_motion
from nte.motion.search import SEARCHES, Search

Find = Callable[[Tensor, Tensor], Tensor]
Grey = npt.NDArray[np.float32]


def _blurred(grey: Tensor, sigma: float) -> Grey:
    """(H, W), blurred by a Gaussian of σ in px, which helps methods that were made for photographs."""
    values = grey[0, 0].clamp(0, 1).numpy().astype(np.float32)
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma), np.float32) if sigma else values


def _bytes(grey: Tensor, sigma: float) -> npt.NDArray[np.uint8]:
    return np.rint(_blurred(grey, sigma) * 255).astype(np.uint8)


def _motion(flow: Any) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(flow.transpose(2, 0, 1), np.float32))[None]


def zero(current: Tensor, previous: Tensor) -> Tensor:
    """Return zero motion."""
    return torch.zeros(1, 2, *current.shape[2:])


def farneback(current: Tensor, previous: Tensor, blur: float = 0.0, levels: int = 3, window: int = 15) -> Tensor:
    """Find motion by Farnebäck 2003.

    The default parameters are those of Hanika et al. 2021: the values of OpenCV's documentation.
    """
    images = _bytes(current, blur), _bytes(previous, blur)
    return _motion(cv2.calcOpticalFlowFarneback(*images, None, 0.5, levels, window, 3, 5, 1.2, 0))


def dis(current: Tensor, previous: Tensor, blur: float = 0.0) -> Tensor:
    """Find motion by dense inverse search (Kroeger et al. 2016), with OpenCV's medium preset."""
    library: Any = cv2  # the stubs of cv2 lack DIS
    method = library.DISOpticalFlow_create(library.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return _motion(method.calc(_bytes(current, blur), _bytes(previous, blur), None))


def dual_tv_l1(current: Tensor, previous: Tensor, blur: float = 0.0) -> Tensor:
    """Find motion by Dual TV-L1 (Zach et al. 2007; Sánchez Pérez et al. 2013), with OpenCV's defaults."""
    library: Any = cv2
    method = library.optflow.DualTVL1OpticalFlow_create()
    return _motion(method.calc(_bytes(current, blur), _bytes(previous, blur), None))


def efolki(current: Tensor, previous: Tensor, blur: float = 0.0, levels: int = 3) -> Tensor:
    """Find motion by eFOLKI; the default parameters are those of the package's own demonstration."""
    images = _blurred(current, blur), _blurred(previous, blur)
    return _motion(np.stack(EFolki(*images, iteration=2, radius=[8, 4], rank=4, levels=levels), 2))


FLOWS: dict[str, Find] = {"Farnebäck": farneback, "DIS": dis, "Dual TV-L1": dual_tv_l1, "eFOLKI": efolki}


def ours(noise: str = "auto", half: bool | None = None) -> Find:
    """Return the patch search for this noise, at its own or the given resolution. `auto`: for the measured noise."""
    if noise == "auto":
        return lambda current, previous: find_motion(current, previous)
    return searching(SEARCHES[noise] if half is None else replace(SEARCHES[noise], half=half))


def searching(search: Search) -> Find:
    """Return the patch search with these settings."""
    return lambda current, previous: find_motion(current, previous, search)


def candidates(slow: bool = True) -> dict[str, dict[str, Find]]:
    """Return method → setting → the function that finds motion with it.

    slow: include Dual TV-L1 and eFOLKI, which take minutes.
    """
    found: dict[str, dict[str, Find]] = {
        "Farnebäck": {
            f"blur {blur}, {levels} levels, window {window}": partial(
                farneback, blur=blur, levels=levels, window=window
            )
            for blur in (0, 1.5, 3)
            for levels, window in ((3, 15), (5, 15), (5, 31))
        },
        "DIS": {f"blur {blur}": partial(dis, blur=blur) for blur in (0, 1.5, 3, 5)},
    }
    if slow:
        found["Dual TV-L1"] = {f"blur {blur}": partial(dual_tv_l1, blur=blur) for blur in (0, 2)}
        found["eFOLKI"] = {
            f"blur {blur}, {levels} levels": partial(efolki, blur=blur, levels=levels)
            for blur, levels in ((0, 3), (2, 3), (0, 5), (2, 5))
        }
    found["ours, tuned"] = {name: ours(name) for name in SEARCHES}
    return found
