"""A check of an OpenEXR header before pixels are allocated: one flipped bit may ask for gigabytes."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import OpenEXR

# OpenEXR compression → (scan lines in a chunk, largest number of pixel bytes that one byte of the file can encode).
# Deflate reaches 1032, run lengths 64; the others encode a constant image in a few bits per block.
_CHUNKS = {
    OpenEXR.NO_COMPRESSION: (1, 1), OpenEXR.RLE_COMPRESSION: (1, 64), OpenEXR.ZIPS_COMPRESSION: (1, 1032),
    OpenEXR.ZIP_COMPRESSION: (16, 1032), OpenEXR.PXR24_COMPRESSION: (16, 2064), OpenEXR.PIZ_COMPRESSION: (32, 20_000),
    OpenEXR.B44_COMPRESSION: (32, 16), OpenEXR.B44A_COMPRESSION: (32, 16),
}  # fmt: skip
_OTHERS = (256, 20_000)  # DWA, HTJ2K and compressions to come
_OFFSET = 8  # bytes of a chunk's entry in the file's table of offsets
_SMALL = 1 << 24  # bytes; a file that promises less is always believed
_LARGEST = 1 << 26  # pixels, 8192×8192: the largest display window around a smaller picture

Header: TypeAlias = Mapping[str, Any]  # attributes of an OpenEXR part, by their names


def unbelievable(headers: Sequence[Header], file_size: int) -> str | None:
    """Say why a file of `file_size` bytes cannot hold the pixels that its parts' headers promise; None if it can."""
    for header in headers:
        data, display = window_size(header["dataWindow"]), window_size(header["displayWindow"])
        if min(*data, *display) < 1:
            return f"its windows are {data[1]}x{data[0]} and {display[1]}x{display[0]}"
        lines, ratio = _CHUNKS.get(header.get("compression"), _OTHERS)
        pixels = data[0] * data[1]
        # Chroma channels have a quarter of the pixels.
        sampled = sum(1 / max(1, c.xSampling * c.ySampling) for c in header.get("channels", ()))
        least = 2 * pixels * (sampled or 1)  # bytes; no type is smaller than half
        chunks = 0 if "tiles" in header else -(-data[0] // lines)
        if chunks * _OFFSET > file_size or least > max(ratio * file_size, _SMALL):
            return f"{file_size} bytes cannot hold the {data[1]}x{data[0]} pixels that its header promises"
        if display[0] * display[1] > max(pixels, _LARGEST):
            return f"its display window is {display[1]}x{display[0]} around {data[1]}x{data[0]} pixels"
    return None


def window_size(corners: Iterable[tuple[int, int]]) -> tuple[int, int]:
    """Return (height, width) of a window, given by its two inclusive corners (x, y)."""
    (left, top), (right, bottom) = corners
    return int(bottom) - int(top) + 1, int(right) - int(left) + 1
