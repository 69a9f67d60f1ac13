"""A check of an OpenEXR header before pixels are allocated: one flipped bit may ask for gigabytes."""

import struct
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import OpenEXR

MAGIC = b"\x76\x2f\x31\x01"  # the first bytes of every OpenEXR file
# OpenEXR compression → (scan lines in a chunk, largest number of pixel bytes that one byte of the file can encode).
# Deflate reaches 1032, run lengths 64; the others encode a constant image in a few bits per block, HTJ2K in a few
# bytes per row of wavelets, however wide.
_CHUNKS = {
    OpenEXR.NO_COMPRESSION: (1, 1), OpenEXR.RLE_COMPRESSION: (1, 64), OpenEXR.ZIPS_COMPRESSION: (1, 1032),
    OpenEXR.ZIP_COMPRESSION: (16, 1032), OpenEXR.PXR24_COMPRESSION: (16, 2064), OpenEXR.PIZ_COMPRESSION: (32, 20_000),
    OpenEXR.B44_COMPRESSION: (32, 16), OpenEXR.B44A_COMPRESSION: (32, 16),
    OpenEXR.HTJ2K256_COMPRESSION: (256, 200_000), OpenEXR.HTJ2K32_COMPRESSION: (32, 200_000),
}  # fmt: skip
_OTHERS = (256, 20_000)  # DWA and compressions to come
_LINES = {int(kind): lines for kind, (lines, _) in _CHUNKS.items()}  # by the number in a file
_OFFSET = 8  # bytes of a chunk's entry in the file's table of offsets
_SMALL = 1 << 24  # bytes; a file that promises less is always believed
# Pixels outside the data window take memory as well, and nothing in the file.
_LARGEST = 1 << 30  # bytes; a display window that takes less is always believed
_AROUND = 16  # so many times as large as its data window may a display window be that takes more
_MOST_BYTES = 4  # of a value: the library tells no type before it has read the pixels

Header: TypeAlias = Mapping[str, Any]  # attributes of an OpenEXR part, by their names


def unbelievable(headers: Sequence[Header], file_size: int) -> str | None:
    """Say why a file of `file_size` bytes cannot hold the pixels that its parts' headers promise; None if it can."""
    promised, held, around = 0.0, 0.0, 0.0  # bytes of all parts: of pixels, of the file, of what surrounds the pixels
    for header in headers:
        data, display = window_size(header["dataWindow"]), window_size(header["displayWindow"])
        if min(*data, *display) < 1:
            return f"its windows are {data[1]}x{data[0]} and {display[1]}x{display[0]}"
        lines, ratio = _CHUNKS.get(header.get("compression"), _OTHERS)
        pixels = data[0] * data[1]
        # Chroma channels have a quarter of the pixels.
        sampled = sum(1 / max(1, c.xSampling * c.ySampling) for c in header.get("channels", ()))
        least = 2 * pixels * (sampled or 1)  # bytes; no type is smaller than half
        promised, held = promised + least, held + least / ratio
        chunks = 0 if "tiles" in header else -(-data[0] // lines)
        if chunks * _OFFSET > file_size or (held > file_size and promised > _SMALL):
            return f"{file_size} bytes cannot hold the {data[1]}x{data[0]} pixels that its header promises"
        if display[0] * display[1] > _AROUND * pixels:
            around += _MOST_BYTES * display[0] * display[1] * max(1, len(header.get("channels", ())))
        if around > _LARGEST:
            sizes = f"{display[1]}x{display[0]} around {data[1]}x{data[0]} pixels"
            return f"its display window is {sizes}, which may take {around / 1e9:,.1f} GB"
    return None


def window_size(corners: Iterable[tuple[int, int]]) -> tuple[int, int]:
    """Return (height, width) of a window, given by its two inclusive corners (x, y)."""
    (left, top), (right, bottom) = corners
    return int(bottom) - int(top) + 1, int(right) - int(left) + 1


_OTHER_LAYOUTS = 0x1A00  # flags of tiled, deep and multi-part files
_MOST = 1 << 16  # bytes of a header that are read


def missing_end(path: Path) -> str | None:
    """Say why a file cannot be whole, from its header and its table of chunks; None if nothing is missing.

    The last chunk must lie inside the file, which costs a few reads instead of the pixels. Only files of one part with
    scan lines are looked into, as `write_exr` writes them; of others nothing is known. Layout: «OpenEXR File Layout».
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_MOST)
        try:
            magic, version = struct.unpack_from("<4sI", head)
            if magic != MAGIC:
                return "not an OpenEXR file"
            if version & _OTHER_LAYOUTS:
                return None
            attributes, place = _attributes(head)
            left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
            lines = _LINES.get(attributes["compression"][0], _OTHERS[0])
            count = -(-(bottom - top + 1) // lines)
            if left > right or not 1 <= count <= (size - place) // _OFFSET:
                return "its header or its table of chunks is damaged or cut off"
            file.seek(place)
            last = max(struct.unpack(f"<{count}Q", file.read(count * _OFFSET)))
            file.seek(min(last, size))
            end = last + 8 + struct.unpack("<2i", file.read(8))[1]
        except (struct.error, ValueError, IndexError, KeyError):
            return "its header or its table of chunks is damaged or cut off"
    return None if place + count * _OFFSET <= last and end <= size else "its end is missing"


def _attributes(head: bytes) -> tuple[dict[str, bytes], int]:
    """The attributes of a header, as they are stored, and the place behind it."""
    found, place = {}, 8
    while head[place]:
        name_end = head.index(b"\0", place)
        type_end = head.index(b"\0", name_end + 1)
        (length,) = struct.unpack_from("<i", head, type_end + 1)
        begin = type_end + 5
        if length < 0:
            raise ValueError("a negative length")
        found[head[place:name_end].decode("latin-1")] = head[begin : begin + length]
        place = begin + length
    return found, place + 1
