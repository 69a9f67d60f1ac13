"""Tags of a DNG that LibRaw does not hand on: black levels of any pattern, and the exposure that the file asks for."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from nte.errors import NteError, needs_extra

# Tags of Adobe's specification (DNG 1.7, chapter 4).
_VERSION, _BLACK_SIZE, _BLACK, _BLACK_H, _BLACK_V = 50706, 50713, 50714, 50715, 50716
_BASELINE_EXPOSURE, _ACTIVE_AREA, _FILTER_ARRAYS = 50730, 50829, (32803, 34892)  # CFA, LinearRaw
_SMALL_PREVIEW = 254  # NewSubFileType: 0 for the photograph itself

_Page: TypeAlias = Any  # a tifffile.TiffPage, which need not be installed
_Value: TypeAlias = Any  # of a tag: a number, several, or text


@dataclass(frozen=True)
class DngTags:
    """Black levels in sensor units, and BaselineExposure: the stops by which to brighten the photograph."""

    black: npt.NDArray[np.float32]  # (rows, columns) of the pattern, starting at the active area's upper left pixel
    columns: npt.NDArray[np.float32]  # BlackLevelDeltaH, (W,) or empty
    rows: npt.NDArray[np.float32]  # BlackLevelDeltaV, (H,) or empty
    origin: tuple[int, int]  # (y, x) of the active area on the sensor
    exposure: float  # stops

    def levels(self, height: int, width: int, top: int, left: int) -> npt.NDArray[np.float32]:
        """Return the black levels (H, W) of a picture whose upper left pixel is at (top, left) of the sensor."""
        y, x = np.arange(height) + top - self.origin[0], np.arange(width) + left - self.origin[1]
        levels = self.black[np.ix_(y % self.black.shape[0], x % self.black.shape[1])]
        if self.columns.size:
            levels = levels + self.columns[x.clip(0, self.columns.size - 1)]
        if self.rows.size:
            levels = levels + self.rows[y.clip(0, self.rows.size - 1), None]
        return levels.astype(np.float32)


def read_dng(path: Path) -> DngTags | None:
    """Read the tags of a DNG; return None for a raw file of another kind.

    Raises NteError if the number of black levels contradicts their pattern, and if tifffile is missing.
    """
    try:
        import tifffile
    except ImportError as error:
        raise needs_extra("burst", f"{path}: reading raw photographs", error) from error
    try:
        with tifffile.TiffFile(path) as file:
            pages = [file.pages[0], *(file.pages[0].pages or [])]
            if _VERSION not in pages[0].tags:
                return None
            main = [page for page in pages if _number(page, _SMALL_PREVIEW, 0) == 0 and _photograph(page)]
            return _tags(path, main[0] if main else pages[0], pages[0])
    except (tifffile.TiffFileError, ValueError, KeyError, IndexError, TypeError):
        return None  # LibRaw decides whether it is a photograph at all


def _photograph(page: _Page) -> bool:
    return _number(page, 262, 0) in _FILTER_ARRAYS


def _tags(path: Path, page: _Page, first: _Page) -> DngTags:
    rows, columns = (int(n) for n in np.ravel(_value(page, _BLACK_SIZE, (1, 1))))
    black = _numbers(_value(page, _BLACK, (0,)), page, _BLACK)
    if black.size != rows * columns:
        raise NteError(f"{path}: has {black.size} black levels for {rows}x{columns} pixels: expected {rows * columns}")
    area = np.ravel(_value(page, _ACTIVE_AREA, (0, 0, 0, 0)))
    exposure = _numbers(_value(first, _BASELINE_EXPOSURE, (0,)), first, _BASELINE_EXPOSURE)
    return DngTags(
        black.reshape(rows, columns),
        _numbers(_value(page, _BLACK_H, ()), page, _BLACK_H),
        _numbers(_value(page, _BLACK_V, ()), page, _BLACK_V),
        (int(area[0]), int(area[1])),
        float(exposure[0]),
    )


def _value(page: _Page, code: int, default: _Value) -> _Value:
    return page.tags[code].value if code in page.tags else default


def _number(page: _Page, code: int, default: int) -> int:
    return int(_value(page, code, default))


def _numbers(value: _Value, page: _Page, code: int) -> npt.NDArray[np.float32]:
    """Whole numbers or fractions as float32; tifffile gives a fraction as two numbers."""
    numbers = np.ravel(np.asarray(value, float))
    if code in page.tags and int(page.tags[code].dtype) in (5, 10):
        numbers = numbers[::2] / np.where(numbers[1::2] == 0, 1, numbers[1::2])
    return numbers.astype(np.float32)
