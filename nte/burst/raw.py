"""Raw photographs: reading the sensor's values with LibRaw, and demosaicing a merged mosaic with it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nte.burst.dng import read_dng
from nte.burst.mosaic import Mosaic, pattern_of
from nte.errors import NteError, needs_extra
from nte.frames.clip import Pixels

_WHITE = 65535


@dataclass(frozen=True)
class Raw:
    """Linear values of the sensor (H, W): 0 is the black level (noise goes below), 1 the white level; and its camera.

    mosaic: None for a sensor of one colour. brightness: stops by which the file asks to be brightened.
    """

    values: Pixels
    mosaic: Mosaic | None
    camera: tuple[float, ...]  # colour matrices and white level, the same in all photographs of a burst
    exposure: tuple[float, float, float]  # ISO, seconds, aperture; 0 if the file does not say
    brightness: float = 0.0  # DNG's BaselineExposure


def read_raw(path: Path) -> Raw:
    """Read the visible part of the sensor. Raises NteError for a file that LibRaw cannot read or that has no mosaic."""
    with _open(path) as raw:
        try:
            one_colour = raw.num_colors == 1
            mosaic = None if one_colour else pattern_of(raw.raw_colors_visible, raw.color_desc.decode())
        except NteError as error:
            raise NteError(f"{path}: {error}") from error
        tags, white = read_dng(path), float(raw.white_level)
        if tags:  # of a pattern larger than 2×2, LibRaw hands on only the least level
            height, width = raw.raw_image_visible.shape
            black = tags.levels(height, width, raw.sizes.top_margin, raw.sizes.left_margin)
        else:
            levels = np.array(raw.black_level_per_channel, np.float32)
            black = levels[np.zeros_like(raw.raw_colors_visible) if one_colour else raw.raw_colors_visible]
        if not (black < white).all():
            raise NteError(f"{path}: has a black level of {black.max():g} and a white level of {white:g}")
        values = (raw.raw_image_visible.astype(np.float32) - black) / (white - black)
        camera = (*np.asarray(raw.color_matrix, float).ravel(), *np.asarray(raw.rgb_xyz_matrix, float).ravel(), white)
        other = raw.other
        exposure = other.iso_speed, other.shutter_speed, other.aperture
        return Raw(values, mosaic, camera, exposure, tags.exposure if tags else 0.0)


def develop(path: Path, values: Pixels) -> Pixels:
    """Develop the raw file with `values` (H, W) in place of its mosaic; returns the photograph (3, H, W).

    LibRaw demosaics (AHD; X-Trans by its own method), balances white as the camera did, converts to linear sRGB
    primaries in [0, 1], and turns the picture as the camera was held. Values beyond [0, 1] are clipped, as LibRaw does
    itself. The values use all 16 bits, since the mean of N frames is finer than the sensor's steps. Raises NteError if
    LibRaw fails, as it does for X-Trans images under 512 pixels.
    """
    import rawpy

    with _open(path) as raw:
        raw.raw_image_visible[:] = np.round(values.clip(0, 1) * _WHITE).astype(np.uint16)
        try:
            image = raw.postprocess(
                output_bps=16, gamma=(1, 1), no_auto_bright=True, use_camera_wb=True, adjust_maximum_thr=0,
                user_black=0, user_cblack=[0, 0, 0, 0], user_sat=_WHITE,
            )  # fmt: skip
        except rawpy.LibRawError as error:
            raise NteError(f"{path}: LibRaw cannot demosaic it: {_reason(error)}") from error
    # A sensor of one colour gives one channel.
    channels = np.broadcast_to(image, (*image.shape[:2], 3)).transpose(2, 0, 1)
    return np.ascontiguousarray(channels, np.float32) / np.float32(_WHITE)


def _open(path: Path) -> Any:
    """Open and unpack a file with a flat mosaic; raises NteError for any other."""
    try:
        import rawpy
    except ImportError as error:
        raise needs_extra("burst", f"{path}: reading raw photographs", error) from error
    if not path.is_file():
        raise NteError(f"{path}: {'is a folder' if path.exists() else 'does not exist'}: expected a raw photograph")
    try:
        raw = rawpy.imread(str(path))
        raw.unpack()  # else LibRaw would read the pixels, or find them missing, only at their first use
    except (rawpy.LibRawError, OSError) as error:
        raise NteError(
            f"{path}: not a photograph that can be read ({_reason(error)}): expected a raw file, .exr or .png"
        ) from error
    if raw.raw_type != rawpy.RawType.Flat or raw.raw_image is None:
        raw.close()
        raise NteError(f"{path}: has no mosaic (it is demosaiced already, or of a layered sensor): expected one")
    return raw


def _reason(error: Exception) -> str:
    """LibRaw's message, which is bytes, as text."""
    what = error.args[0] if error.args else type(error).__name__
    return what.decode() if isinstance(what, bytes) else str(what)
