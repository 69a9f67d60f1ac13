"""Hot and dead pixels of the sensor: found in two frames at the same place, and filled from their neighbours."""

import torch
from torch import Tensor

from nte.burst.mosaic import Mosaic
from nte.burst.noise import NoiseModel

_REACH = 2  # px; this close, every pixel of a Bayer or X-Trans array has neighbours of its colour
_DEVIATIONS = 8.0  # of noise: least distance of a defect from its brightest (darkest) neighbour,
_LEAST = 0.01  # plus this share of the white level


def find_defects(first: Tensor, second: Tensor, noise: NoiseModel, mosaic: Mosaic | None) -> Tensor:
    """Find hot and dead pixels, as a bool mask (1, 1, H, W).

    A defect is brighter (or darker) than all neighbours of its colour by 8 standard deviations of noise plus a
    hundredth of the white level, in both frames. first, second: frames (1, 1, H, W) as the sensor gives them, not
    aligned: between them the scene moves and the sensor does not. mosaic: None for a sensor of one colour.
    """
    far = [_outstanding(frame, noise, mosaic) for frame in (first, second)]
    return (far[0] == far[1]) & (far[0] != 0)


def mend(frame: Tensor, defects: Tensor, mosaic: Mosaic | None) -> Tensor:
    """Fill the defects of a frame (1, 1, H, W) with the median of their sound neighbours of the same colour.

    defects: bool (1, 1, H, W). A defect without sound neighbours stays as it is.
    """
    height, width = frame.shape[-2:]
    colours = _colours(mosaic, height, width).to(frame.device)
    y, x = defects[0, 0].nonzero().unbind(1)
    values = []
    for dy, dx in _around():
        there_y, there_x = y + dy, x + dx
        inside = (there_y >= 0) & (there_y < height) & (there_x >= 0) & (there_x < width)
        there_y, there_x = there_y.clamp(0, height - 1), there_x.clamp(0, width - 1)
        sound = inside & (colours[there_y, there_x] == colours[y, x]) & ~defects[0, 0, there_y, there_x]
        values.append(torch.where(sound, frame[0, 0, there_y, there_x], torch.nan))
    mended = frame.clone()
    if len(y):
        median = torch.stack(values).nanmedian(0).values
        mended[0, 0, y, x] = torch.where(median.isnan(), frame[0, 0, y, x], median)
    return mended


def _outstanding(frame: Tensor, noise: NoiseModel, mosaic: Mosaic | None) -> Tensor:
    """Mark pixels as 1 if brighter than all neighbours by more than noise, −1 if darker, else 0: (1, 1, H, W)."""
    height, width = frame.shape[-2:]
    colours = _colours(mosaic, height, width).to(frame.device)
    brightest, darkest = torch.full_like(frame, -torch.inf), torch.full_like(frame, torch.inf)
    for dy, dx in _around():
        here = (..., slice(max(-dy, 0), height - max(dy, 0)), slice(max(-dx, 0), width - max(dx, 0)))
        there = (..., slice(max(dy, 0), height - max(-dy, 0)), slice(max(dx, 0), width - max(-dx, 0)))
        same = colours[here] == colours[there]
        brightest[here] = torch.where(same, torch.maximum(brightest[here], frame[there]), brightest[here])
        darkest[here] = torch.where(same, torch.minimum(darkest[here], frame[there]), darkest[here])
    known = brightest.isfinite()
    above, below = (
        _DEVIATIONS * noise.variance(limit.nan_to_num(0, 0, 0)).sqrt() + _LEAST for limit in (brightest, darkest)
    )
    return (known & (frame > brightest + above)).int() - (known & (frame < darkest - below)).int()


def _around() -> list[tuple[int, int]]:
    steps = range(-_REACH, _REACH + 1)
    return [(dy, dx) for dy in steps for dx in steps if (dy, dx) != (0, 0)]


def _colours(mosaic: Mosaic | None, height: int, width: int) -> Tensor:
    return torch.zeros(height, width, dtype=torch.int64) if mosaic is None else mosaic.colours(height, width)
