"""Intel Open Image Denoise: the single-frame denoiser that everybody can install, as a comparator.

Afra, «Intel Open Image Denoise», 2019–; through the package pyoidn. NumPy: it runs without PyTorch.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from nte.denoiser import Result, State, sanitised
from nte.errors import NteError, needs_extra
from nte.frames.frame import Frame

QUALITIES = ("high", "balanced", "fast")


class Oidn:
    """Frame by frame, on HDR radiance; albedo and normal guide it where the frame has them.

    They count as free of noise, as nte's are (`cleanAux`); OIDN chooses its own exposure in each frame.
    It remembers nothing: the state is empty. pyoidn keeps the device and the filter from call to call.
    Raises NteError for an unknown quality, or where pyoidn is not installed.
    """

    needs: tuple[str, ...] = ("color",)
    optional: tuple[str, ...] = ("albedo", "normal")
    target = "color"

    def __init__(self, quality: str = "high") -> None:
        if quality not in QUALITIES:
            raise NteError(f"oidn: quality is '{quality}': expected one of {', '.join(QUALITIES)}")
        try:
            import pyoidn
        except ImportError as error:
            raise needs_extra("compare", "oidn", error) from error
        self.quality = quality
        self._denoise = pyoidn.denoise

    @sanitised
    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Denoise `color` (N, 3, H, W), each image of the batch by itself. Bad pixels count as 0."""
        arrays = frame.numpy()
        color = _interleaved(arrays["color"])
        albedo = _interleaved(arrays["albedo"]) if "albedo" in frame else [None] * len(color)
        normal = _interleaved(arrays["normal"]) if "normal" in frame else [None] * len(color)
        denoised = [
            self._denoise(c, a, n, hdr=True, clean_aux=a is not None or n is not None, quality=self.quality)
            for c, a, n in zip(color, albedo, normal, strict=True)
        ]
        image = np.ascontiguousarray(np.stack(denoised).transpose(0, 3, 1, 2))
        return Result(_like(image, frame["color"])), ()


def _interleaved(values: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """(N, H, W, C) of (N, C, H, W)."""
    return np.ascontiguousarray(values.transpose(0, 2, 3, 1), np.float32)


def _like(image: npt.NDArray[np.float32], given: Any) -> Any:
    """The kind of array that was given, on its device; PyTorch need not be imported for that."""
    return image if isinstance(given, np.ndarray) else given.new_tensor(image)
