"""What a header promises is believed as far as the file can hold it, and the check costs neither time nor memory."""

import resource
import struct
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from nte.errors import NteError
from nte.frames.clip import Clip, write_frame
from nte.frames.clip_files import frame_path
from nte.frames.exr import read_layers, write_exr
from nte.frames.exr_header import unbelievable
from tests.synthetic import disc_clip, disc_frame

COMPRESSIONS = [
    getattr(OpenEXR, name)
    for name in dir(OpenEXR)
    if name.endswith("_COMPRESSION") and not name.startswith(("LJ2K", "ZSTD"))
]


def promising(path: Path, attribute: bytes, width: int, height: int) -> Path:
    """The file with a window of another size written over the one it has."""
    content = bytearray(path.read_bytes())
    place = content.index(attribute + b"\0box2i\0") + len(attribute) + 7 + 4
    content[place : place + 16] = struct.pack("<4i", 0, 0, width - 1, height - 1)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("compression", COMPRESSIONS, ids=str)
@pytest.mark.parametrize("value", ["black", "noise"])
def test_what_the_library_writes_is_believed(tmp_path: Path, compression: object, value: str) -> None:
    size = (2048, 3000)  # black, the smallest that a file of that size can be
    pixels = np.zeros(size, np.float16) if value == "black" else np.random.default_rng(0).random((70, 90), np.float32)
    path = tmp_path / "a.exr"
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"a.R": pixels, "a.G": pixels.copy()}).write(str(path))
    assert read_layers(path)["a.R"].shape == pixels.shape


def test_a_wide_black_frame_of_few_bytes_is_believed(tmp_path: Path) -> None:
    """8K, of which HTJ2K makes less than six kilobytes."""
    black = {c: np.zeros((2048, 7680), np.float16) for c in "RGB"}
    with OpenEXR.File({"compression": OpenEXR.HTJ2K256_COMPRESSION, "type": OpenEXR.scanlineimage}, black) as file:
        file.write(str(tmp_path / "a.exr"))
    assert not read_layers(tmp_path / "a.exr")["R"].any()


@pytest.mark.parametrize(("width", "height"), [(16384, 16384), (128, 536870944), (2**30, 2**30), (128, -5)])
@pytest.mark.parametrize("attribute", [b"dataWindow", b"displayWindow"])
def test_a_window_that_the_file_cannot_hold_asks_for_no_memory(
    tmp_path: Path, attribute: bytes, width: int, height: int
) -> None:
    path = tmp_path / "a.exr"
    rng = np.random.default_rng(0)
    write_exr(path, {f"color.{c}": rng.random((96, 128), np.float32).astype(np.float16) for c in "RGB"})
    promising(path, attribute, width, height)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    with pytest.raises(NteError, match=r"a\.exr: the OpenEXR file is (damaged|truncated)") as error:
        read_layers(path)
    assert "\n" not in str(error.value)
    assert time.monotonic() - start < 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 * 1024  # KiB


@pytest.mark.parametrize("parts", [1, 4])
def test_a_large_display_window_counts_the_channels_of_all_parts(parts: int, tmp_path: Path) -> None:
    """Pictures of 4 pixels; what surrounds them would take more than 1 GB, no part of four that much."""
    path, side = tmp_path / "a.exr", 2000
    names = [[f"{n}.{i}.R" for i in range(100 // parts)] for n in range(parts)]
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    made = [OpenEXR.Part({**header, "name": n[0]}, {k: np.zeros((2, 2), np.float32) for k in n}) for n in names]
    OpenEXR.File(made).write(str(path))
    assert len(read_layers(path)) == 100
    window = b"displayWindow\0box2i\0" + struct.pack("<i", 16)
    was, large = (window + struct.pack("<4i", 0, 0, side - 1, side - 1) for side in (2, side))
    path.write_bytes(path.read_bytes().replace(was, large))
    with pytest.raises(NteError, match=r"display window is 2000x2000 around 2x2 pixels, which may take 1\.[26] GB"):
        read_layers(path)


def test_a_frame_of_another_size_than_its_clip_is_refused_before_it_is_read(tmp_path: Path) -> None:
    clip = Clip(disc_clip(tmp_path / "clip", frames=2, seed=1))
    write_frame(frame_path(clip.folder, 1), disc_frame(1, (12, 18)))
    promising(frame_path(clip.folder, 1), b"displayWindow", 4000, 3000)  # a picture in a corner of a large one
    with pytest.raises(NteError, match=r"frame_0001\.exr: is 4000x3000, clip\.json says"):
        clip.frame(1)


def test_chroma_at_half_the_size_is_no_damage() -> None:
    """Luminance and chroma, uncompressed, of 3000×3000 half floats: what is wrong with it is said on reading it."""
    window = (np.array([0, 0], np.int32), np.array([2999, 2999], np.int32))
    channels = [OpenEXR.Channel("Y", 1, 1), OpenEXR.Channel("RY", 2, 2), OpenEXR.Channel("BY", 2, 2)]
    header = {"dataWindow": window, "displayWindow": window, "compression": OpenEXR.NO_COMPRESSION}
    stored = 2 * 3000 * 3000 * 3 // 2
    assert unbelievable([{**header, "channels": channels}], stored + 8 * 3000 + 400) is None
    assert unbelievable([{**header, "channels": channels}], stored - 1) is not None
