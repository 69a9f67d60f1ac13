"""Pictures that are demosaiced already: linear EXR, and PNG as it is displayed."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from nte.errors import NteError
from nte.files import make_folder
from nte.frames.exr import read_exr, write_exr
from nte.frames.show import quantise, write_png

Pixels = npt.NDArray[np.float32]
SUFFIXES = (".exr", ".png")
_RGB = (("color.R", "color.G", "color.B"), ("R", "G", "B"))


def read_picture(path: Path) -> Pixels:
    """(3, H, W), linear, from a .exr (layer `color`, or R, G, B) or a .png of 8 bits (decoded from sRGB).

    Bad pixels (NaN, inf) become 0. Raises NteError for another file, or other layers.
    """
    if not path.is_file():
        raise NteError(f"{path}: {'is a folder' if path.exists() else 'does not exist'}: expected a picture")
    if path.suffix.lower() == ".exr":
        layers = read_exr(path)
        for names in _RGB:
            if all(name in layers for name in names):
                return np.nan_to_num(np.stack([layers[name] for name in names]), nan=0, posinf=0, neginf=0)
        raise NteError(f"{path}: has {', '.join(layers)}: expected the layers R, G and B, or those of color")
    try:
        with Image.open(path) as picture:
            if picture.mode not in ("RGB", "RGBA", "P", "L") or _depth(path) == 16:
                raise NteError(f"{path}: a PNG of {picture.mode}, {_depth(path)} bits: expected 8 bits, or save as EXR")
            display = np.asarray(picture.convert("RGB"), np.float32).transpose(2, 0, 1) / 255
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise NteError(f"{path}: the PNG cannot be read: {error}") from error
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4).astype(np.float32)


def write_picture(path: Path, image: Pixels) -> None:
    """Write linear (3, H, W) as .exr (R, G, B, float32), or as .png in sRGB, where [0, 1] is what shows."""
    if path.suffix.lower() == ".exr":
        write_exr(path, dict(zip("RGB", image, strict=True)))
        return
    make_folder(path.parent)
    shown = image.clip(0, 1)
    write_png(path, quantise(np.where(shown <= 0.0031308, shown * 12.92, 1.055 * shown ** (1 / 2.4) - 0.055)))


def _depth(path: Path) -> int:
    """Bits per channel, which stand in the header's fixed place: Pillow reads 16-bit colour as 8 bits silently."""
    with path.open("rb") as file:
        return file.read(25)[-1]
