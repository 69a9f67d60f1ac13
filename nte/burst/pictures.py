"""Reader and writer of demosaiced pictures: linear EXR, and PNG or TIFF in sRGB."""

from pathlib import Path
from types import ModuleType

import numpy as np

from nte.errors import NteError, needs_extra
from nte.files import make_folder, write_whole
from nte.frames.clip import Pixels
from nte.frames.exr import read_exr, write_exr
from nte.frames.quiet import quiet
from nte.frames.srgb import decode_srgb, encode_srgb
from nte.frames.usable import ABSOLUTE

SUFFIXES = (".exr", ".png", ".tif", ".tiff")
_RGB = (("color.R", "color.G", "color.B"), ("R", "G", "B"))


def read_picture(path: Path) -> Pixels:
    """Read a picture as linear (3, H, W) float32, from a .exr, or from a .png or .tif of 8 or 16 bits in sRGB.

    A .exr has the layer `color`, or R, G, B. Bad values (NaN, beyond 10¹⁵) become 0; transparency is ignored. A .png
    or .tif is turned upright, as its orientation says. Raises NteError for a file that cannot be read, and for other
    layers or bits.
    """
    if not path.is_file():
        raise NteError(f"{path}: {'is a folder' if path.exists() else 'does not exist'}: expected a picture")
    if path.suffix.lower() == ".exr":
        layers = read_exr(path)
        for names in _RGB:
            if all(name in layers for name in names):
                pixels = np.stack([layers[name] for name in names])
                return np.where(abs(pixels) <= ABSOLUTE, pixels, np.float32(0))
        raise NteError(f"{path}: has {', '.join(layers)}: expected the layers R, G and B, or those of color")
    shown = _decode(path)
    return decode_srgb(shown).astype(np.float32)


def write_picture(path: Path, image: Pixels, bits: int = 16) -> None:
    """Write linear (3, H, W) as .exr (R, G, B, float32), or as .png or .tif of 8 or 16 bits in sRGB.

    A .png or .tif holds [0, 1]; values beyond are clipped. A missing folder is made. Raises NteError if the file cannot
    be written.
    """
    if path.suffix.lower() == ".exr":
        write_exr(path, dict(zip("RGB", image, strict=True)))
        return
    cv2 = _opencv(path)
    shown = encode_srgb(image.clip(0, 1))
    most = 2**bits - 1
    whole = np.round(shown * most).astype(np.uint16 if bits == 16 else np.uint8)
    coded = cv2.imencode(path.suffix.lower(), np.ascontiguousarray(whole[::-1].transpose(1, 2, 0)))[1]
    make_folder(path.parent)
    write_whole(path, lambda temporary: temporary.write_bytes(coded.tobytes()))


def _decode(path: Path) -> Pixels:
    """Read (3, H, W) in [0, 1], as displayed. Uses OpenCV, since Pillow reads and writes colour in 8 bits only."""
    cv2 = _opencv(path)
    kind = path.suffix.lower()[1:4].upper().replace("TIF", "TIFF")
    coded = np.frombuffer(path.read_bytes(), np.uint8)
    try:
        with quiet():  # libpng and libtiff print complaints about a damaged file
            whole = cv2.imdecode(coded, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error as error:
        raise NteError(f"{path}: the {kind} cannot be read: {str(error).splitlines()[0]}") from error
    if whole is None:
        raise NteError(f"{path}: the {kind} cannot be read: expected a whole file of 8 or 16 bits")
    if whole.dtype not in (np.uint8, np.uint16):
        raise NteError(f"{path}: a {kind} of {whole.dtype}: expected 8 or 16 bits, or save as EXR")
    shown = whole[..., ::-1].transpose(2, 0, 1).astype(np.float32)
    return np.ascontiguousarray(shown / np.float32(np.iinfo(whole.dtype).max))


def _opencv(path: Path) -> ModuleType:
    try:
        import cv2
    except ImportError as error:
        raise needs_extra("burst", f"{path}: pictures as they are displayed", error) from error
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # else it prints errors that are raised as well
    return cv2
