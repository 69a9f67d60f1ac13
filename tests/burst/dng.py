"""A raw photograph as a file: a minimal uncompressed DNG (Adobe's specification 1.4) with a colour filter array."""

import struct
from pathlib import Path

import numpy as np

BAYER = np.array([[0, 1], [1, 2]])  # red, green, blue are 0, 1, 2
XTRANS = np.array([
    [1, 2, 1, 1, 0, 1], [0, 1, 0, 2, 1, 2], [1, 2, 1, 1, 0, 1],
    [1, 0, 1, 1, 2, 1], [2, 1, 2, 0, 1, 0], [1, 0, 1, 1, 2, 1],
])  # fmt: skip

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_FORMAT = {_BYTE: "B", _ASCII: "B", _SHORT: "H", _LONG: "I", _RATIONAL: "I", _SRATIONAL: "i"}
_XYZ_TO_SRGB = (3.2404542, -1.5371385, -0.4985314, -0.969266, 1.8760108, 0.041556, 0.0556434, -0.2040259, 1.0572252)


def write_dng(
    path: Path, raw: np.ndarray, pattern: np.ndarray | None, black: tuple[int, ...] = (64,) * 4, white: int = 1023,
    seconds: float = 0.02, orientation: int = 1, neutral: tuple[float, float, float] = (1, 1, 1),
    baseline: float | None = None, active: tuple[int, int, int, int] | None = None,
) -> Path:  # fmt: skip
    """Write raw values (H, W), uint16; the camera's colours are those of sRGB. pattern: None without a filter array.

    black: levels of a square of pixels, row by row: 4 for 2×2, 16 for 4×4. neutral: what the camera saw of white.
    baseline: BaselineExposure, EV. active: top, left, bottom, right of the pixels that are the picture.
    """
    height, width = raw.shape
    rows, columns = (2, 2) if pattern is None else pattern.shape
    side = round(len(black) ** 0.5)
    data = raw.astype("<u2").tobytes()
    seen = [part for value in neutral for part in (round(value * 10000), 10000)]
    matrix = [part for value in _XYZ_TO_SRGB for part in (round(value * 10000), 10000)]
    tags = {
        254: (_LONG, [0]), 256: (_LONG, [width]), 257: (_LONG, [height]), 258: (_SHORT, [16]), 259: (_SHORT, [1]),
        262: (_SHORT, [34892 if pattern is None else 32803]), 271: (_ASCII, b"nte\0"), 272: (_ASCII, b"Test\0"),
        273: (_LONG, [8]), 274: (_SHORT, [orientation]), 277: (_SHORT, [1]), 278: (_LONG, [height]),
        279: (_LONG, [len(data)]), 284: (_SHORT, [1]),
        33421: (_SHORT, [rows, columns]), 33422: (_BYTE, [0] * 4 if pattern is None else pattern.ravel().tolist()),
        33434: (_RATIONAL, [round(seconds * 1000), 1000]),
        50706: (_BYTE, [1, 4, 0, 0]), 50708: (_ASCII, b"Test\0"), 50713: (_SHORT, [side, side]),
        50714: (_SHORT, black),
        50717: (_LONG, [white]), 50721: (_SRATIONAL, matrix), 50728: (_RATIONAL, seen), 50778: (_SHORT, [21]),
    }  # fmt: skip
    if pattern is None:
        del tags[33421], tags[33422]
    if baseline is not None:
        tags[50730] = (_SRATIONAL, [round(baseline * 100), 100])
    if active is not None:
        tags[50829] = (_LONG, list(active))
    directory = 8 + len(data)
    extra = directory + 2 + 12 * len(tags) + 4
    entries, values = b"", b""
    for tag, (kind, content) in sorted(tags.items()):
        packed = struct.pack(f"<{len(content)}{_FORMAT[kind]}", *content)
        count = len(content) // (2 if kind in (_RATIONAL, _SRATIONAL) else 1)
        place = packed.ljust(4, b"\0") if len(packed) <= 4 else struct.pack("<I", extra + len(values))
        values += b"" if len(packed) <= 4 else packed + b"\0" * (len(packed) % 2)
        entries += struct.pack("<HHI", tag, kind, count) + place
    head = b"II*\0" + struct.pack("<I", directory)
    path.write_bytes(head + data + struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0) + values)
    return path
