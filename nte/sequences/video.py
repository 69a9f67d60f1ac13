"""Videos of pictures: H.264 in an MP4 file, by PyAV."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Final

import numpy as np

from nte.errors import NteError, needs_extra
from nte.files import make_folder, write_whole
from nte.frames.show import RGB

CODEC: Final = "libx264"
_BT709, _SRGB_CURVE = 1, 13  # of ITU-T H.273, by which players know the colours


def require_video(fps: float) -> None:
    """Raise NteError if PyAV is not installed, cannot encode H.264, or `fps` is no rate of a video."""
    try:
        import av
    except ImportError as error:
        raise needs_extra("video", "a video", error) from error
    if CODEC not in av.codecs_available:
        raise NteError(f"this PyAV has no encoder {CODEC}, so it makes no video: install PyAV from PyPI, or use --png")
    if not 0 < fps <= 1000:
        raise NteError(f"fps is {fps:g}, expected a number of frames per second above 0, at most 1000")


def write_video(path: Path, pictures: Iterable[RGB], fps: float) -> None:
    """Encode pictures (H, W, 3), all of one size, as they come; the file is whole or absent.

    An odd width or height gets one more column or row, since H.264 stores colours for 2×2 pixels. Raises NteError if
    the file cannot be written, and what `require_video` raises.
    """
    require_video(fps)
    make_folder(path.parent)
    write_whole(path, lambda temporary: _encode(temporary, pictures, fps))


def _encode(path: Path, pictures: Iterable[RGB], fps: float) -> None:
    import av

    with av.open(str(path), "w", format="mp4") as file:
        stream = None
        for picture in pictures:
            even = np.pad(picture, [(0, picture.shape[0] % 2), (0, picture.shape[1] % 2), (0, 0)], mode="edge")
            if stream is None:
                stream = file.add_stream(CODEC, rate=Fraction(fps).limit_denominator(1001), options={"crf": "18"})
                stream.height, stream.width, stream.pix_fmt = even.shape[0], even.shape[1], "yuv420p"
                stream.color_primaries = stream.colorspace = _BT709
                stream.color_trc = _SRGB_CURVE
            frame = av.VideoFrame.from_ndarray(even, format="rgb24")
            file.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace="ITU709")))
        if stream is not None:
            file.mux(stream.encode())
