"""Reader and writer of one OpenEXR file as a table of layered channel names."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import OpenEXR

from nte.errors import NteError
from nte.files import make_folder, refuse_pipe, write_whole
from nte.frames.exr_header import MAGIC, Header, unbelievable, window_size
from nte.frames.quiet import quiet

Value = TypeVar("Value", bound=np.generic)
HALF_MAX = 65504.0
# compression that changes values → the types of those that it changes
_LOSSY = {
    "B44": (np.float16,), "B44A": (np.float16,), "PXR24": (np.float32,),
    "DWAA": (np.float16, np.float32), "DWAB": (np.float16, np.float32), "LJ2K": (np.float16, np.float32),
}  # fmt: skip
REC_709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)  # chromaticities of red, green, blue and white
HALF_TINY = 2.0**-14  # smallest normal half float; smaller ones have fewer digits


def read_exr(path: Path, size: tuple[int, int] | None = None) -> dict[str, npt.NDArray[np.float32]]:
    """Read every channel of an OpenEXR file as float32: full layered name → array (H, W).

    size: the (height, width) that is expected. Raises NteError as `read_layers` does.
    """
    return {name: np.asarray(pixels, np.float32) for name, pixels in read_layers(path, size).items()}


class Part(NamedTuple):
    """One part of an OpenEXR file, or one view of a part that holds several."""

    name: str  # empty if the file has only one part
    view: str  # one view of a stereo image, such as left; empty if the file does not say
    layers: dict[str, npt.NDArray[np.generic]]  # channel name → (H, W), as stored
    views: tuple[str, ...] = ()  # all views of a part that holds several, the default one first
    outside: npt.NDArray[np.bool_] | None = None  # (H, W): outside the data window, where layers are 0; None: nowhere
    overscan: bool = False  # the data window has pixels outside the display window, which are left out
    subsampled: tuple[str, ...] = ()  # channels that are no layers, as they have less than one value per pixel
    aspect: float = 1.0  # width of a pixel in units of its height
    lossy: str = ""  # name of a compression that changes values of the part
    primaries: tuple[float, ...] = REC_709  # chromaticities x, y of red, green, blue and white
    space: str = ""  # what the file calls its colour space (colorInteropID), such as lin_rec709_scene

    def full(self, channel: str) -> str:
        """Return the full layered name of a channel: the part's name is the layer of a channel that names none."""
        return f"{self.name}.{channel}" if self.name and "." not in channel else channel


def read_layers(path: Path, size: tuple[int, int] | None = None) -> dict[str, npt.NDArray[np.generic]]:
    """Read every channel of an OpenEXR file: full layered name → array (H, W), float16, float32 or uint32 as stored.

    The arrays have the size of the display window; pixels outside the data window are 0, and subsampled channels are
    left out. Parts of a multi-part file are merged; the part's name is the layer of a channel that names none itself.
    size: the (height, width) that is expected. Raises NteError for a file that is missing, not OpenEXR, truncated, deep
    or of luminance and subsampled chroma; for a file that has another size or promises more pixels than it can hold,
    before any memory is allocated for them; and if two parts have a channel of the same name, as the two eyes of a
    stereo image do.
    """
    return merge_parts(path, read_parts(path, size))


def read_parts(path: Path, size: tuple[int, int] | None = None) -> list[Part]:
    """Read the parts of an OpenEXR file without merging them.

    size: the (height, width) that is expected. Raises NteError as `read_layers` does, except that two parts may have
    channels of the same name.
    """
    return load_exr(path, size)[1]


def load_exr(path: Path, size: tuple[int, int] | None = None) -> tuple[OpenEXR.File, list[Part]]:
    """Read an OpenEXR file; return it as the library's object and as its parts.

    The object can be changed and written again. size: the (height, width) that is expected. Raises NteError as
    `read_layers` does, except that two parts may have channels of the same name.
    """
    path = Path(path)
    if not _is_text(path):
        raise NteError(f"{path}: the name is not UTF-8, which the OpenEXR library needs: rename it")
    try:
        refuse_pipe(path)
        with path.open("rb") as opened:
            magic = opened.read(len(MAGIC))
    except OSError as error:
        raise NteError(f"{path}: cannot be read: {error.strerror}") from error
    if magic != MAGIC:
        what = f"not an OpenEXR file (it starts with {magic!r})" if magic else "the file is empty"
        raise NteError(f"{path}: {what}: expected a .exr frame")
    try:
        with quiet(), OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
            headers = [dict(part.header) for part in file.parts]  # closing the file empties them
        _require_headers(path, headers, size)
        with quiet():
            file = OpenEXR.File(str(path), separate_channels=True)
            parts = [_read_part(path, part, len(file.parts) > 1) for part in file.parts]
    except UnicodeDecodeError as error:  # which the library raises for attributes and names alike
        text = ascii(error.object)
        raise NteError(f"{path}: the header has text that is not UTF-8, {text:.60}: write it again in UTF-8") from error
    except ZeroDivisionError as error:  # which the library raises for a rate of 0/0
        raise NteError(f"{path}: the header has a fraction with the divisor 0: remove or correct it") from error
    except (RuntimeError, ValueError, OSError) as error:
        if (what := str(error)).startswith("unsupported attribute type"):
            raise NteError(f"{path}: the header has an {what}: remove the attribute") from error
        raise NteError(f"{path}: the OpenEXR file is truncated or damaged: render or copy it again") from error
    promised = [bool(header.get("channels")) for header in headers]
    # How the library reports some truncated files: a part that it could not decode has no channels.
    if [bool(part.layers or part.subsampled) for part in parts] != promised or not any(promised):
        raise NteError(f"{path}: the OpenEXR file is truncated or empty: render or copy it again")
    return file, parts


def _is_text(path: Path) -> bool:
    """Tell whether a path is UTF-8: Python cannot encode a name that the disk has in another encoding."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True


def write_exr(path: Path, channels: Mapping[str, npt.NDArray[np.generic]]) -> None:
    """Write (H, W) float16, float32 or uint32 arrays under their layered names, ZIP-compressed (lossless).

    The file is written under a temporary name and renamed when it is complete. A missing folder is made.
    Raises NteError if the disk is full or the folder cannot be written to.
    """
    # OpenEXR silently writes non-contiguous arrays wrongly, and it changes the dictionaries that it is given.
    pixels = {name: np.ascontiguousarray(values) for name, values in sorted(channels.items())}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}

    def write(temporary: Path) -> None:
        with quiet(), OpenEXR.File(header, pixels) as file:
            file.write(str(temporary))

    make_folder(Path(path).parent)
    write_whole(path, write)


def _require_headers(path: Path, headers: Sequence[Header], size: tuple[int, int] | None) -> None:
    """Raise NteError, before pixels are read, for a file that cannot hold the promised pixels or has another size."""
    if why := unbelievable(headers, path.stat().st_size):
        raise NteError(f"{path}: the OpenEXR file is damaged: {why}: render or copy it again")
    for header in headers:
        found = window_size(header["displayWindow"])
        if size not in (None, found):
            both = f"is {found[1]}x{found[0]}, clip.json says {size[1]}x{size[0]}"
            raise NteError(f"{path}: {both}: render or copy the frame in that size, or correct clip.json")


def merge_parts(path: Path, parts: Sequence[Part]) -> dict[str, npt.NDArray[np.generic]]:
    """Merge the channels of several parts: full layered name → (H, W).

    Raises NteError, naming `path`, for a name that two parts or two views have.
    """
    merged: dict[str, npt.NDArray[np.generic]] = {}
    first: dict[str, Part] = {}
    for part in parts:
        for channel, pixels in part.layers.items():
            name = part.full(channel)
            if name in merged:
                both = " and ".join(f"'{p.view or p.name}'" for p in (first[name], part))
                kind = "views" if part.view else "parts"
                raise NteError(f"{path}: the {kind} {both} both have a channel '{name}': choose one of them")
            merged[name], first[name] = pixels, part
    return merged


def split_views(path: Path, parts: Iterable[Part]) -> list[Part]:
    """Cut each part that holds several views (the attribute multiView) into one part per view; keep all others.

    In a channel's name the view is the last word but one, and is removed; channels of the default view may lack it.
    Raises NteError, naming `path`, for a channel that the default view has with and without its name.
    """
    cut: list[Part] = []
    for part in parts:
        views: dict[str, dict[str, npt.NDArray[np.generic]]] = {view: {} for view in part.views}
        for name, pixels in part.layers.items() if views else ():
            *words, component = name.split(".")
            view = words.pop() if words and words[-1] in views else part.views[0]
            alone = ".".join([*words, component])
            if alone in views[view]:
                both = f"view '{view}' has channel '{alone}' twice, with and without its name"
                raise NteError(f"{path}: {both}: name layers in full in the channel map, instead of the view")
            views[view][alone] = pixels
        cut += [part._replace(view=v, layers=layers, views=()) for v, layers in views.items() if layers] or [part]
    return cut


def _read_part(path: Path, part: OpenEXR.Part, one_of_several: bool) -> Part:
    if part.header["type"] in (OpenEXR.deepscanline, OpenEXR.deeptile):
        raise NteError(f"{path}: deep OpenEXR files are not supported: flatten it first")
    subsampled = tuple(name for name, c in part.channels.items() if (c.xSampling, c.ySampling) != (1, 1))
    if chroma := [name for name in subsampled if name[-2:] in ("RY", "BY")]:  # Y alone would be another picture
        what = f"channel '{chroma[0]}' is subsampled"
        raise NteError(f"{path}: {what}: expected one value per pixel (luminance and chroma: save it as RGB)")
    full = {name: channel.pixels for name, channel in part.channels.items() if name not in subsampled}
    layers = {name: _to_display_window(part.header, pixels) for name, pixels in full.items()}
    name = str(part.header.get("name", "")) if one_of_several else ""
    outside = ~_to_display_window(part.header, np.ones(window_size(part.header["dataWindow"]), np.bool_))
    (left, top), (right, bottom) = np.array(part.header["dataWindow"]) - part.header["displayWindow"]
    overscan = bool(min(left, top) < 0 or max(right, bottom) > 0)
    view, views = str(part.header.get("view", "")), tuple(part.header.get("multiView", ()))
    aspect = float(part.header.get("pixelAspectRatio", 1))
    aspect = aspect if 0 < aspect < np.inf else 1.0
    compression = part.header["compression"].name.removesuffix("_COMPRESSION")
    lossy = compression if any(pixels.dtype in _LOSSY.get(compression, ()) for pixels in full.values()) else ""
    primaries = tuple(map(float, part.header.get("chromaticities", REC_709)))
    beyond = outside if outside.any() else None
    space = str(part.header.get("colorInteropID", ""))
    return Part(name, view, layers, views, beyond, overscan, subsampled, aspect, lossy, primaries, space)


def _to_display_window(header: dict[str, object], pixels: npt.NDArray[Value]) -> npt.NDArray[Value]:
    """Place the data window's pixels (inclusive corners, x first) into the display window."""
    data, display = np.array(header["dataWindow"]), np.array(header["displayWindow"])
    if np.array_equal(data, display):
        return pixels
    width, height = display[1] - display[0] + 1
    low = np.maximum(data[0], display[0])
    high = np.minimum(data[1], display[1]) + 1
    placed = np.zeros((height, width), pixels.dtype)
    if (low < high).all():
        to, source = (low - display[0], high - display[0]), (low - data[0], high - data[0])
        placed[to[0][1] : to[1][1], to[0][0] : to[1][0]] = pixels[
            source[0][1] : source[1][1], source[0][0] : source[1][0]
        ]
    return placed
