"""Copies of OpenEXR files in which some channels get new pixels and all else is kept."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenEXR

from nte.errors import NteError
from nte.files import make_folder, write_whole
from nte.frames.clip import half_keeps
from nte.frames.exr import load_exr, merge_parts
from nte.frames.exr_header import Header, window_size
from nte.frames.quiet import quiet

# Lossless compressions: the channels that stay are decoded and encoded again, and must not change.
_LOSSLESS = {
    OpenEXR.NO_COMPRESSION,
    OpenEXR.RLE_COMPRESSION,
    OpenEXR.ZIPS_COMPRESSION,
    OpenEXR.ZIP_COMPRESSION,
    OpenEXR.PIZ_COMPRESSION,
}
Place = tuple[int, str]  # the number of a part, and a channel's name in it
Planes = Mapping[str, npt.NDArray[np.floating]] | Mapping[Place, npt.NDArray[np.floating]]


def copy_exr(source: Path, out: Path, planes: Planes, dark_counts: bool = True) -> None:
    """Copy `source` to `out` with new pixels in the channels of `planes`: full layered name, or Place → (H, W).

    A Place is the number of a part and a channel's name in that part. The new pixels have the size of the display
    window, as `read_layers` gives it. Parts, views, windows, attributes (chromaticities, owner, pixel aspect, manifests
    of Cryptomatte) and all other channels are kept, and so are the pixels of a replaced channel that lie outside the
    display window. A channel keeps its type with two exceptions: half floats become float32 if they cannot hold the new
    pixels (`nte.frames.clip.half_keeps`, with the same dark_counts), and whole numbers become float32 if the new pixels
    are not whole numbers that fit. A file with lossy compression gets ZIP compression, so that nothing more is lost.
    Mip maps keep only the full size. Raises NteError, and writes nothing, for a channel that the file does not have,
    for a name that two parts have, for a file with subsampled channels, and for new pixels of another size.
    """
    file, parts = load_exr(source)
    if reduced := [name for part in parts for name in part.subsampled]:
        what = f"channel '{reduced[0]}' is subsampled, which cannot be written"
        raise NteError(f"{source}: {what}: remove it, or import the frames as a clip")
    left: dict[str | Place, npt.NDArray[np.floating]] = dict(planes.items())
    if any(isinstance(key, str) for key in left):
        merge_parts(source, parts)  # raises if two channels have one name
    several = len(file.parts) > 1
    for number, part in enumerate(file.parts):
        if part.header["compression"] not in _LOSSLESS:
            part.header["compression"] = OpenEXR.ZIP_COMPRESSION
        if "tiles" in part.header:
            part.header["tiles"].mode = OpenEXR.ONE_LEVEL  # the library writes no other
        for name, channel in part.channels.items():
            alone = f"{part.header.get('name', '')}.{name}" if several and "." not in name else name
            key: str | Place = alone if alone in left else (number, name)
            if key in left:
                plane, size = left.pop(key), window_size(part.header["displayWindow"])
                if plane.shape != size:
                    both = f"{size[1]}x{size[0]}, the new pixels are {plane.shape[1]}x{plane.shape[0]}"
                    raise NteError(f"{source}: is {both}: expected one size; was the file replaced after it was read?")
                channel.pixels = _placed(plane, channel.pixels, part.header, dark_counts)
            else:
                channel.pixels = np.ascontiguousarray(channel.pixels)
    if left:
        raise NteError(f"{source}: has no channel '{min(map(str, left))}' to replace")
    make_folder(out.parent)

    def write(temporary: Path) -> None:
        with quiet():
            file.write(str(temporary))

    write_whole(out, write)


def _placed(
    plane: npt.NDArray[np.floating], stored: npt.NDArray[np.generic], header: Header, dark_counts: bool
) -> npt.NDArray[np.generic]:
    """Return the stored pixels of a data window, with those inside the display window replaced by `plane`."""
    data, display = np.array(header["dataWindow"]), np.array(header["displayWindow"])
    low, high = np.maximum(data[0], display[0]), np.minimum(data[1], display[1]) + 1
    kind = stored.dtype if _keeps(stored.dtype, plane, dark_counts) else np.dtype(np.float32)
    placed = np.array(stored, kind)
    if (low < high).all():
        inside, shown = (_rectangle(low - corner, high - corner) for corner in (data[0], display[0]))
        placed[inside] = plane[shown]
    return placed


def _keeps(kind: np.dtype[np.generic], plane: npt.NDArray[np.floating], dark_counts: bool) -> bool:
    """Tell whether one of OpenEXR's types (half, float, 32-bit whole numbers) can hold these values."""
    if kind == np.float16:
        return half_keeps(plane.astype(np.float32, copy=False), dark_counts)
    return kind == np.float32 or bool(((plane == np.floor(plane)) & (plane >= 0) & (plane < 2**32)).all())


def _rectangle(low: npt.NDArray[np.generic], high: npt.NDArray[np.generic]) -> tuple[slice, slice]:
    """Rows and columns between two corners (x, y); `high` is exclusive."""
    return slice(low[1], high[1]), slice(low[0], high[0])
