"""A copy of an OpenEXR file in which some channels have other pixels, and all else is as it was."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR

from nte.errors import NteError
from nte.files import make_folder, write_whole
from nte.frames.exr import quiet, read_layers
from nte.frames.exr_header import window_size

# Compressions that lose nothing: the channels that stay are decoded and encoded again.
_LOSSLESS = {
    OpenEXR.NO_COMPRESSION, OpenEXR.RLE_COMPRESSION, OpenEXR.ZIPS_COMPRESSION, OpenEXR.ZIP_COMPRESSION,
    OpenEXR.PIZ_COMPRESSION,
}  # fmt: skip
Planes = Mapping[str, npt.NDArray[np.floating[Any]]]


def copy_exr(source: Path, out: Path, planes: Planes) -> None:
    """Copy `source` to `out` with other pixels in the channels of `planes`: full layered name → (H, W).

    The sizes are those of the display window, as `read_layers` gives them. Parts, views, windows, attributes
    (chromaticities, owner, pixel aspect, manifests of Cryptomatte) and all other channels stay; so do the pixels of a
    replaced channel that lie outside the display window. A channel keeps its type, except that one of half floats takes
    float32 where it is given float32. What was compressed with loss is not lossy again. Raises NteError, and writes
    nothing, for a channel that the file does not have.
    """
    read_layers(source)  # raises for what is damaged, or has two channels of one name
    left = dict(planes)
    with quiet():
        file = OpenEXR.File(str(source), separate_channels=True)
    several = len(file.parts) > 1
    for part in file.parts:
        if part.header["compression"] not in _LOSSLESS:
            part.header["compression"] = OpenEXR.ZIP_COMPRESSION
        for name, channel in part.channels.items():
            alone = f"{part.header.get('name', '')}.{name}" if several and "." not in name else name
            if alone in left:
                channel.pixels = _placed(left.pop(alone), channel.pixels, part.header)
            else:
                channel.pixels = np.ascontiguousarray(channel.pixels)
    if left:
        raise NteError(f"{source}: has no channel '{min(left)}' to replace")
    make_folder(out.parent)

    def write(temporary: Path) -> None:
        with quiet():
            file.write(str(temporary))

    write_whole(out, write)


def _placed(plane: npt.NDArray[Any], stored: npt.NDArray[Any], header: Mapping[str, Any]) -> npt.NDArray[Any]:
    """The pixels of a data window, with those of the display window taken from `plane`."""
    data, display = np.array(header["dataWindow"]), np.array(header["displayWindow"])
    size = window_size(header["displayWindow"])
    if plane.shape != size:
        raise NteError(f"the new pixels are {plane.shape[1]}x{plane.shape[0]}, the file is {size[1]}x{size[0]}")
    low, high = np.maximum(data[0], display[0]), np.minimum(data[1], display[1]) + 1
    kind = np.float32 if stored.dtype == np.float16 and plane.dtype == np.float32 else stored.dtype
    placed = np.array(stored, kind)
    if (low < high).all():
        inside, shown = (_rectangle(low - corner, high - corner) for corner in (data[0], display[0]))
        placed[inside] = plane[shown]
    return placed


def _rectangle(low: npt.NDArray[Any], high: npt.NDArray[Any]) -> tuple[slice, slice]:
    """Rows and columns between two corners, x first."""
    return slice(low[1], high[1]), slice(low[0], high[0])
