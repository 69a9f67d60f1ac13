"""Videos of pictures by PyAV: H.264 in an MP4 file, or an animated WebP, which a page shows like a picture."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

import numpy as np

from nte.errors import NteError, needs_extra
from nte.files import make_folder, whole, writing
from nte.frames.show import RGB

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream


@dataclass(frozen=True)
class _Format:
    muxer: str
    codec: str
    pixels: str
    options: dict[str, str]
    about: dict[str, str] = field(default_factory=dict)  # of the file


FORMATS: Final = {
    ".mp4": _Format("mp4", "libx264", "yuv420p", {"crf": "18"}),
    # Whole pictures, which are repeated for ever: libwebp_anim leaves out what changes little, in blocks.
    ".webp": _Format("webp", "libwebp", "bgra", {"quality": "80"}, {"loop": "0"}),
}
_BT709, _SRGB_CURVE = 1, 13  # of ITU-T H.273, by which players know the colours


def can_write(ending: str) -> bool:
    """Tell whether a video whose name ends so, such as .webp, can be written here."""
    try:
        import av
    except ImportError:
        return False
    return FORMATS[ending].codec in av.codecs_available


def require_video(path: Path, fps: float) -> None:
    """Raise NteError if PyAV is not installed, cannot encode what `path` ends in, or `fps` is no rate of a video."""
    codec = FORMATS[path.suffix.lower()].codec
    try:
        import av
    except ImportError as error:
        raise needs_extra("video", "a video", error) from error
    if codec not in av.codecs_available:
        raise NteError(f"{path}: this PyAV has no encoder {codec}: install PyAV from PyPI, or use --png")
    if not 0.01 <= fps <= 1000:
        raise NteError(f"fps is {fps:g}, expected a number of frames per second from 0.01 to 1000")


@contextmanager
def open_video(path: Path, fps: float) -> Iterator[Callable[[RGB], None]]:
    """Yield a function that adds a picture (H, W, 3); all have one size. The file is whole after the block, or absent.

    An odd width or height gets one more column or row, since H.264 stores colours for 2×2 pixels. Raises NteError if
    the file cannot be written, and what `require_video` raises.
    """
    require_video(path, fps)
    import av

    form = FORMATS[path.suffix.lower()]
    make_folder(path.parent)
    with whole(path) as temporary:
        with writing(path):
            file = av.open(str(temporary), "w", format=form.muxer, container_options=form.about)
        try:
            stream: VideoStream | None = None

            def add(picture: RGB) -> None:
                nonlocal stream
                even = np.pad(picture, [(0, picture.shape[0] % 2), (0, picture.shape[1] % 2), (0, 0)], mode="edge")
                frame = av.VideoFrame.from_ndarray(even, format="rgb24")
                with writing(path), _encoding(path, even):
                    stream = stream or _begin(file, form, frame, fps)
                    file.mux(stream.encode(frame.reformat(format=form.pixels, dst_colorspace="ITU709")))

            yield add
            with writing(path):
                if stream is not None:
                    file.mux(stream.encode())
                file.close()
        finally:
            with suppress(OSError):  # after another error, which says more
                file.close()


@contextmanager
def _encoding(path: Path, picture: RGB) -> Iterator[None]:
    """Turn an encoder's refusal into an error that names the size: WebP ends at 16383 pixels, H.264 at 16384."""
    import av

    try:
        yield
    except OSError:
        raise  # the file's, not the encoder's
    except av.error.FFmpegError as error:
        size = f"{picture.shape[1]}x{picture.shape[0]}"
        raise NteError(f"{path}: {size} cannot be encoded ({error}): use --png, or a smaller picture") from error


def _begin(file: "OutputContainer", form: _Format, frame: "VideoFrame", fps: float) -> "VideoStream":
    rate = Fraction(fps).limit_denominator(1001)
    stream = cast("VideoStream", file.add_stream(form.codec, rate=rate, options=form.options))
    stream.height, stream.width, stream.pix_fmt = frame.height, frame.width, form.pixels
    if form.muxer == "mp4":
        stream.color_primaries = stream.colorspace = _BT709
        stream.color_trc = _SRGB_CURVE
    return stream
