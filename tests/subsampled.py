"""A writer of OpenEXR files with subsampled channels, which the library reads but does not write."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

_TYPES = {"uint32": 0, "float16": 1, "float32": 2}


def write_subsampled(path: Path, channels: Mapping[str, npt.NDArray[Any]]) -> Path:
    """Write uncompressed scan lines; a channel at half the size of the largest has a value for every 2×2 pixels."""
    height, width = np.max([plane.shape for plane in channels.values()], 0).tolist()
    steps = {name: height // plane.shape[0] for name, plane in channels.items()}
    names = sorted(channels)
    listed = b"".join(
        name.encode() + struct.pack("<x4i", _TYPES[channels[name].dtype.name], 0, steps[name], steps[name])
        for name in names
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = {
        ("channels", "chlist"): listed + b"\0", ("compression", "compression"): b"\0",
        ("dataWindow", "box2i"): window, ("displayWindow", "box2i"): window, ("lineOrder", "lineOrder"): b"\0",
        ("pixelAspectRatio", "float"): struct.pack("<f", 1), ("screenWindowCenter", "v2f"): bytes(8),
        ("screenWindowWidth", "float"): struct.pack("<f", 1),
    }  # fmt: skip
    head = b"\x76\x2f\x31\x01\x02\0\0\0" + b"".join(
        name.encode() + b"\0" + kind.encode() + struct.pack("<xi", len(value)) + value
        for (name, kind), value in attributes.items()
    )
    lines = []
    for y in range(height):
        pixels = b"".join(channels[name][y // steps[name]].tobytes() for name in names if y % steps[name] == 0)
        lines.append(struct.pack("<2i", y, len(pixels)) + pixels)
    places = np.cumsum([len(head) + 1 + 8 * height, *map(len, lines)])[:-1]
    path.write_bytes(head + b"\0" + struct.pack(f"<{height}Q", *places.tolist()) + b"".join(lines))
    return path
