"""A copy differs from its source in the named channels, and in nothing else that the file says."""

import struct
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from nte.errors import NteError
from nte.frames.exr import read_layers, read_parts, write_exr
from nte.frames.exr_copy import copy_exr

RNG = np.random.default_rng(0)
SAID = {
    "owner": "somebody", "pixelAspectRatio": 2.0, "comments": "keep me", "capDate": "2024:01:02 03:04:05",
    "chromaticities": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),  # ACEScg
    "cryptomatte/f834d0a/manifest": '{"Cube": "3f8c1b2a"}', "cryptomatte/f834d0a/name": "CryptoObject",
}  # fmt: skip
WINDOWS = {  # overscan on all sides, unequal
    "dataWindow": (np.array([-3, -2], np.int32), np.array([12, 9], np.int32)),
    "displayWindow": (np.array([0, 0], np.int32), np.array([9, 6], np.int32)),
}
DATA, SHOWN, CORNER = (12, 16), (7, 10), (slice(2, 9), slice(3, 13))


def stored(size: tuple[int, int]) -> dict[str, Any]:
    colour = {f"ViewLayer.Combined.{c}": RNG.random(size, np.float32).astype(np.float16) for c in "RGBA"}
    ids = {"ViewLayer.CryptoObject00.R": RNG.integers(0, 2**32, size, np.uint32)}
    return colour | ids | {"ViewLayer.Depth.Z": RNG.random(size, np.float32)}


def written(path: Path, header: dict[str, Any], channels: dict[str, Any]) -> dict[str, Any]:
    OpenEXR.File(dict(header), dict(channels)).write(str(path))
    return channels


def everything(path: Path) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Header and pixels of each part, without what names the objects of this reading."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return [
            (
                {key: str(value) for key, value in part.header.items() if key != "channels"},
                {name: (c.pixels.dtype, c.pixels.tobytes()) for name, c in part.channels.items()},
            )
            for part in file.parts
        ]


@pytest.mark.parametrize("compression", ["ZIP", "PIZ", "RLE", "NO", "ZIPS"])
def test_attributes_windows_and_other_channels_stay(tmp_path: Path, compression: str) -> None:
    kind = {"type": OpenEXR.scanlineimage, "compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    source, out = tmp_path / "a [1] ü.exr", tmp_path / "new" / "b.exr"
    channels = written(source, kind | SAID | WINDOWS, stored(DATA))
    new = {f"ViewLayer.Combined.{c}": RNG.random(SHOWN, np.float32).astype(np.float16) for c in "RGB"}
    copy_exr(source, out, new)
    (header, before), (header_after, after) = everything(source)[0], everything(out)[0]
    assert header_after == header
    assert {name for name in before if before[name] != after[name]} == set(new)
    assert {name: kind for name, (kind, _) in after.items()} == {name: kind for name, (kind, _) in before.items()}
    with OpenEXR.File(str(out), separate_channels=True) as file:
        for name, plane in new.items():
            pixels = file.parts[0].channels[name].pixels
            np.testing.assert_array_equal(pixels[CORNER], plane)
            outside = np.ones(DATA, bool)
            outside[CORNER] = False
            np.testing.assert_array_equal(pixels[outside], channels[name][outside])  # overscan as it was


def test_parts_and_views_stay_apart(tmp_path: Path) -> None:
    planes = [stored(SHOWN) for _ in range(2)]
    kinds = {"type": OpenEXR.scanlineimage}, {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    parts = [
        OpenEXR.Part(
            {"name": view, "view": view, "owner": view, **kind}, {f"{view[0]}.{n}": p for n, p in given.items()}
        )
        for view, kind, given in zip(("left", "right"), kinds, planes, strict=True)
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    new = {"r.ViewLayer.Depth.Z": np.full(SHOWN, 7, np.float32)}
    copy_exr(tmp_path / "a.exr", tmp_path / "b.exr", new)
    (left, right), (left_after, right_after) = everything(tmp_path / "a.exr"), everything(tmp_path / "b.exr")
    assert left_after == left
    assert right_after[0] == right[0]
    assert {name for name in right[1] if right[1][name] != right_after[1][name]} == set(new)


def test_values_beyond_half_floats_are_kept_and_loss_is_not_repeated(tmp_path: Path) -> None:
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.DWAA_COMPRESSION}
    written(tmp_path / "a.exr", header, {name: RNG.random((64, 64)).astype(np.float16) for name in ("R", "G", "B")})
    new = {"R": np.full((64, 64), 70000, np.float32), "G": np.full((64, 64), 0.3, np.float16)}
    copy_exr(tmp_path / "a.exr", tmp_path / "b.exr", new)
    before, after = read_layers(tmp_path / "a.exr"), read_layers(tmp_path / "b.exr")
    np.testing.assert_array_equal(after["R"], new["R"])
    np.testing.assert_array_equal(after["G"], new["G"])
    assert after["G"].dtype == np.float16
    np.testing.assert_array_equal(after["B"], before["B"])  # to the bit, which DWAA does not keep


def test_a_channel_that_is_not_there_and_another_size_write_nothing(tmp_path: Path) -> None:
    written(tmp_path / "a.exr", {"type": OpenEXR.scanlineimage}, stored(SHOWN))
    for planes, message in (
        ({"color.R": np.zeros(SHOWN, np.float32)}, r"a\.exr: has no channel 'color.R' to replace"),
        ({"ViewLayer.Depth.Z": np.zeros((3, 4), np.float32)}, r"\.exr: is 10x7, the new pixels are 4x3"),
    ):
        with pytest.raises(NteError, match=message):
            copy_exr(tmp_path / "a.exr", tmp_path / "b.exr", planes)
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


def test_one_of_two_alike_parts_is_named_by_its_place(tmp_path: Path) -> None:
    parts = [
        OpenEXR.Part({"name": view, "view": view, "type": OpenEXR.scanlineimage}, {"c.R": np.ones(SHOWN, np.float32)})
        for view in ("left", "right")
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    with pytest.raises(NteError, match=r"the views 'left' and 'right' both have a channel 'c\.R'"):
        copy_exr(tmp_path / "a.exr", tmp_path / "b.exr", {"c.R": np.zeros(SHOWN, np.float32)})
    copy_exr(tmp_path / "a.exr", tmp_path / "b.exr", {(1, "c.R"): np.zeros(SHOWN, np.float32)})
    assert [part.layers["c.R"].max() for part in read_parts(tmp_path / "b.exr")] == [1, 0]
    with pytest.raises(NteError, match="has no channel"):
        copy_exr(tmp_path / "a.exr", tmp_path / "c.exr", {(2, "c.R"): np.zeros(SHOWN, np.float32)})


def mip_mapped(path: Path, image: np.ndarray[Any, Any]) -> Path:
    """A channel R in tiles of 16×16 at every size down to one pixel, byte by byte: the library does not write them."""

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value

    height, width = image.shape
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = b"\x76\x2f\x31\x01" + struct.pack("<I", 2 | 0x200)
    header += attribute("channels", "chlist", b"R\0" + struct.pack("<iBBBBii", 2, 0, 0, 0, 0, 1, 1) + b"\0")
    header += attribute("compression", "compression", b"\0") + attribute("lineOrder", "lineOrder", b"\0")
    header += attribute("dataWindow", "box2i", window) + attribute("displayWindow", "box2i", window)
    header += attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    header += attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0))
    header += attribute("screenWindowWidth", "float", struct.pack("<f", 1))
    header += attribute("tiles", "tiledesc", struct.pack("<IIB", 16, 16, 1)) + b"\0"
    chunks = []
    for level in range(max(image.shape).bit_length()):
        small = image[: max(1, height >> level), : max(1, width >> level)]
        for y, x in product(range(0, small.shape[0], 16), range(0, small.shape[1], 16)):
            data = np.ascontiguousarray(small[y : y + 16, x : x + 16], "<f4").tobytes()
            chunks.append(struct.pack("<5i", x // 16, y // 16, level, level, len(data)) + data)
    places = np.cumsum([len(header) + 8 * len(chunks), *map(len, chunks)])[:-1]
    path.write_bytes(header + places.astype("<u8").tobytes() + b"".join(chunks))
    return path


def test_of_mip_maps_the_full_size_stays(tmp_path: Path) -> None:
    image = RNG.random((40, 50), np.float32)
    source = mip_mapped(tmp_path / "a.exr", image)
    np.testing.assert_array_equal(read_layers(source)["R"], image)
    copy_exr(source, tmp_path / "b.exr", {"R": 2 * image})
    np.testing.assert_array_equal(read_layers(tmp_path / "b.exr")["R"], 2 * image)


def test_whole_numbers_become_floats_where_the_new_pixels_are_not_whole(tmp_path: Path) -> None:
    source = {c: np.arange(12, dtype=np.uint32).reshape(3, 4) for c in "RGB"}
    write_exr(tmp_path / "a.exr", source)
    new = {"R": np.full((3, 4), 0.25, np.float32), "G": np.full((3, 4), 7, np.float32)}
    copy_exr(tmp_path / "a.exr", tmp_path / "b.exr", new)
    found = read_layers(tmp_path / "b.exr")
    assert {name: plane.dtype.name for name, plane in found.items()} == {"R": "float32", "G": "uint32", "B": "uint32"}
    for name, plane in {**source, **new}.items():
        np.testing.assert_array_equal(found[name], plane)


def test_a_frame_is_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_exr(tmp_path / "a.exr", {"R": np.ones((3, 4), np.float32)})
    decoded = []
    opened = OpenEXR.File

    def count(*arguments: Any, **options: Any) -> Any:
        decoded.append(options.get("header_only", False))
        return opened(*arguments, **options)

    monkeypatch.setattr(OpenEXR, "File", count)
    copy_exr(tmp_path / "a.exr", tmp_path / "b.exr", {"R": np.zeros((3, 4), np.float32)})
    assert decoded.count(False) == 1
