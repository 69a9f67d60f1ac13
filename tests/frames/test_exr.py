"""One OpenEXR file: what is written is read again, and what cannot be read is refused by name."""

import os
import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nte.errors import NteError
from nte.frames.exr import read_exr, read_layers, read_parts, split_views, write_exr
from nte.frames.exr_copy import copy_exr
from tests.subsampled import write_subsampled

Planes = dict[str, npt.NDArray[np.float32]]


def planes(seed: int = 0, size: tuple[int, int] = (7, 11), names: tuple[str, ...] = ("a.R", "a.G", "Z")) -> Planes:
    rng = np.random.default_rng(seed)
    return {name: rng.normal(size=size).astype(np.float32) for name in names}


SIZES = st.tuples(st.integers(1, 9), st.integers(1, 9))


@settings(deadline=None, max_examples=30)
@given(st.one_of(arrays(np.float16, SIZES), arrays(np.float32, SIZES)))
def test_every_value_survives_in_its_type(tmp_path_factory: pytest.TempPathFactory, values: npt.NDArray) -> None:
    path = tmp_path_factory.getbasetemp() / "roundtrip.exr"
    write_exr(path, {"layer.V": values})
    (stored,) = read_layers(path).values()
    assert stored.dtype == values.dtype
    np.testing.assert_array_equal(stored, values)  # NaN equals NaN
    (read,) = read_exr(path).values()
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, values.astype(np.float32))


def test_whole_numbers_survive_as_they_are_stored(tmp_path: Path) -> None:
    ids = np.array([[0, 1], [2**31, 2**32 - 1]], np.uint32)
    write_exr(tmp_path / "a.exr", {"crypto.ID": ids})
    np.testing.assert_array_equal(read_layers(tmp_path / "a.exr")["crypto.ID"], ids)


@pytest.mark.parametrize(
    "view",
    [
        lambda a: a[..., 1],
        lambda a: a[::-1, :, 0],
        lambda a: a[:, ::-2, 0],
        lambda a: a[:, :, 0].T,
        lambda a: np.asfortranarray(a[:, :, 0]),
        lambda a: np.broadcast_to(a[:, :1, 0], (8, 9)),
    ],
)
def test_arrays_that_are_not_contiguous_are_written_right(tmp_path: Path, view: object) -> None:
    values = view(np.random.default_rng(0).random((8, 9, 3), np.float32))  # type: ignore[operator]
    write_exr(tmp_path / "a.exr", {"Z": values})
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")["Z"], values)


def test_the_same_channels_give_the_same_bytes_in_any_order(tmp_path: Path) -> None:
    channels = planes()
    write_exr(tmp_path / "a.exr", channels)
    write_exr(tmp_path / "b.exr", dict(reversed(channels.items())))
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    assert list(channels) == ["a.R", "a.G", "Z"]  # what is given is left as it was


def test_sizes_may_change_from_file_to_file(tmp_path: Path) -> None:
    for size in ((7, 11), (3, 2), (20, 5)):
        write_exr(tmp_path / "a.exr", planes(size=size))
        assert read_exr(tmp_path / "a.exr")["Z"].shape == size


def with_windows(path: Path, values: npt.NDArray, data: tuple[int, int], display: tuple[int, int, int, int]) -> None:
    """values with their corner at `data` (x, y); display: x0, y0, x1, y1, inclusive."""
    height, width = values.shape
    x, y = data
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": (np.array([x, y], np.int32), np.array([x + width - 1, y + height - 1], np.int32)),
        "displayWindow": (np.array(display[:2], np.int32), np.array(display[2:], np.int32)),
    }
    with OpenEXR.File(header, {"Z": values.copy()}) as file:
        file.write(str(path))


def test_a_data_window_is_placed_into_the_display_window(tmp_path: Path) -> None:
    values = np.arange(1, 13, dtype=np.float32).reshape(3, 4)
    # Smaller than the display, larger than it, beside it, and a display that does not start at zero.
    for data, display, expected in (
        ((2, 1), (0, 0, 6, 5), np.pad(values, ((1, 2), (2, 1)))),
        ((-1, -1), (0, 0, 1, 1), values[1:3, 1:3]),
        ((10, 10), (0, 0, 2, 2), np.zeros((3, 3))),
        ((5, 6), (6, 6, 9, 7), np.pad(values[:2, 1:], ((0, 0), (0, 1)))),
    ):
        with_windows(tmp_path / "a.exr", values, data, display)
        np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")["Z"], expected)


def test_parts_are_merged_under_their_names(tmp_path: Path) -> None:
    channels = planes(names=("R", "Z", "albedo.R"))
    parts = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"R": channels["R"]}, "color"),
        OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"Z": channels["Z"], "albedo.R": channels["albedo.R"]}, "depth"),
    ]
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "a.exr"))
    found = read_exr(tmp_path / "a.exr")
    assert found.keys() == {"color.R", "depth.Z", "albedo.R"}
    np.testing.assert_array_equal(found["depth.Z"], channels["Z"])


def parts_of(path: Path, *parts: tuple[str, str, Planes]) -> Path:
    """A file of several parts: (name, view, channels)."""
    made = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage} | ({"view": view} if view else {}), dict(layers), name)
        for name, view, layers in parts
    ]
    with OpenEXR.File(made) as file:
        file.write(str(path))
    return path


@pytest.mark.parametrize(
    ("views", "told"), [(("left", "right"), "views 'left' and 'right'"), (("", ""), "parts 'a' and 'b'")]
)
def test_two_parts_with_a_channel_of_one_name_are_not_mixed(tmp_path: Path, views: tuple[str, str], told: str) -> None:
    left, right = planes(1, names=("beauty.R",)), planes(2, names=("beauty.R",))
    path = parts_of(tmp_path / "a.exr", ("a", views[0], left), ("b", views[1], right))
    with pytest.raises(NteError, match=f"a.exr: the {told} both have a channel 'beauty.R': choose one of them"):
        read_layers(path)
    found = read_parts(path)
    assert [(part.name, part.view) for part in found] == [("a", views[0]), ("b", views[1])]
    np.testing.assert_array_equal(found[1].layers["beauty.R"], right["beauty.R"])


def test_parts_that_name_their_own_layer_are_told_apart_by_it(tmp_path: Path) -> None:
    left, right = planes(1, names=("R", "Z")), planes(2, names=("R", "Z"))
    found = read_layers(parts_of(tmp_path / "a.exr", ("left", "left", left), ("right", "right", right)))
    assert found.keys() == {"left.R", "left.Z", "right.R", "right.Z"}
    np.testing.assert_array_equal(found["right.Z"], right["Z"])


def write_views(path: Path, channels: dict[str, npt.NDArray[np.generic]]) -> Path:
    """Channels of two views in one part."""
    header = {"type": OpenEXR.scanlineimage, "multiView": ["left", "right"]}
    with OpenEXR.File(header, dict(channels)) as file:
        file.write(str(path))
    return path


def test_a_channel_that_the_default_view_has_twice_is_not_guessed(tmp_path: Path) -> None:
    path = write_views(tmp_path / "a.exr", planes(names=("R", "left.R", "right.R")))
    with pytest.raises(NteError, match=r"a\.exr: view 'left' has channel 'R' twice, with and without its name: name"):
        split_views(path, read_parts(path))


def test_views_within_a_part_are_cut_apart(tmp_path: Path) -> None:
    names = ("R", "right.R", "diffuse.R", "diffuse.right.R", "left.Z")
    channels = planes(names=names)
    path = write_views(tmp_path / "a.exr", channels)
    assert read_layers(path).keys() == set(names)
    left, right = split_views(path, read_parts(path))
    assert (left.view, set(left.layers)) == ("left", {"R", "diffuse.R", "Z"})
    assert (right.view, set(right.layers)) == ("right", {"R", "diffuse.R"})
    np.testing.assert_array_equal(right.layers["diffuse.R"], channels["diffuse.right.R"])


def test_chroma_at_half_the_size_is_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_exr(tmp_path / "a.exr", planes(names=("Y", "RY")))

    class Halved(OpenEXR.File):  # the library writes no such file
        def __init__(self, *arguments: object, **options: object) -> None:
            super().__init__(*arguments, **options)
            if self.parts[0].channels:  # of the header alone there are none
                self.parts[0].channels["RY"].xSampling = 2

    monkeypatch.setattr(OpenEXR, "File", Halved)
    with pytest.raises(NteError, match=r"a\.exr: channel 'RY' is subsampled: .*luminance and chroma: save it as RGB"):
        read_layers(tmp_path / "a.exr")


def test_a_subsampled_channel_beside_the_picture_is_left_out(tmp_path: Path) -> None:
    picture = planes(size=(8, 12), names=("R", "G", "B"))
    height, width = picture["R"].shape
    extra = {"matte.V": np.ones((height // 2, width // 2), np.float16)}
    file = write_subsampled(tmp_path / "a.exr", picture | extra)
    found = read_layers(file)
    assert found.keys() == picture.keys()
    for name, plane in picture.items():
        np.testing.assert_array_equal(found[name], plane)
    (part,) = read_parts(file)
    assert part.subsampled == ("matte.V",)
    assert read_parts(write_subsampled(tmp_path / "b.exr", picture))[0].subsampled == ()
    with pytest.raises(NteError, match=r"a\.exr: channel 'matte\.V' is subsampled, which cannot be written: remove it"):
        copy_exr(file, tmp_path / "out" / "a.exr", picture)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("compression", ["B44", "DWAA", "PIZ", "PXR24", "ZIP"])
@pytest.mark.parametrize("kind", [np.float16, np.float32, np.uint32])
def test_a_compression_is_lossy_for_the_types_that_it_changes(
    tmp_path: Path, compression: str, kind: type[np.generic]
) -> None:
    picture = {c: (999 * np.random.default_rng(0).random((64, 64))).astype(kind) for c in "RGB"}
    header = {"type": OpenEXR.scanlineimage, "compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    with OpenEXR.File(header, dict(picture)) as file:
        file.write(str(tmp_path / "a.exr"))
    (part,) = read_parts(tmp_path / "a.exr")
    changed = any(not np.array_equal(part.layers[c], picture[c]) for c in "RGB")
    assert part.lossy == (compression if changed else "")


def test_deep_files_are_refused(tmp_path: Path) -> None:
    samples = np.empty((2, 3), object)
    for index in np.ndindex(samples.shape):
        samples[index] = np.ones(2, np.float32)
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}
    with OpenEXR.File(header, {"Z": samples}) as file:
        file.write(str(tmp_path / "deep.exr"))
    with pytest.raises(NteError, match=r"deep\.exr: deep OpenEXR files are not supported"):
        read_exr(tmp_path / "deep.exr")


def test_files_that_are_no_exr(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name, content in (("empty", b""), ("png", b"\x89PNG\r\n\x1a\n" * 9), ("magic", b"\x76\x2f\x31\x01")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(NteError, match=f"{name}: .*(OpenEXR file|the file is empty)") as error:
            read_exr(tmp_path / name)
        assert "\n" not in str(error.value)
    with pytest.raises(NteError, match=r"nowhere\.exr: cannot be read: No such file"):
        read_exr(tmp_path / "nowhere.exr")
    with pytest.raises(NteError, match="cannot be read: Is a directory"):
        read_exr(tmp_path)
    assert capfd.readouterr() == ("", "")


def test_a_file_cut_anywhere_is_refused_without_a_word_from_the_library(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.exr"
    write_exr(path, planes(size=(40, 30)))
    whole = path.read_bytes()
    lengths = {*range(4, 400, 13), *range(400, len(whole), 997), len(whole) - 1}
    for length in sorted(lengths):
        path.write_bytes(whole[:length])
        with pytest.raises(NteError, match=r"cut\.exr: the OpenEXR file is truncated"):
            read_exr(path)
    assert capfd.readouterr() == ("", "")


def test_text_of_another_encoding_is_called_so(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    header = {"type": OpenEXR.scanlineimage, "owner": "M_ller"}
    OpenEXR.File(header, {"R": np.ones((2, 3), np.float32)}).write(str(path))
    path.write_bytes(path.read_bytes().replace(b"M_ller", "Müller".encode("latin-1")))
    with pytest.raises(NteError, match=r"a\.exr: the header has text that is not UTF-8, b'M.xfcller'"):
        read_layers(path)


def test_a_fraction_without_a_value_is_called_so(tmp_path: Path) -> None:
    """A frame rate of 0/0, which the library reads as a Fraction: the attribute goes in front of all others."""
    path = tmp_path / "a.exr"
    write_exr(path, {"Z": np.zeros((1, 1), np.float32)})
    whole, rate = path.read_bytes(), b"captureRate\0rational\0" + struct.pack("<IiI", 8, 0, 0)
    path.write_bytes(whole[:8] + rate + whole[8:])
    with pytest.raises(NteError, match=r"a\.exr: the header has a fraction with the divisor 0"):
        read_exr(path)


def test_an_attribute_that_the_library_cannot_read_is_called_so(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"Z": np.zeros((1, 1), np.float32)})
    whole, state = path.read_bytes(), b"deepImageState\0deepImageState\0" + struct.pack("<IB", 1, 1)
    path.write_bytes(whole[:8] + state + whole[8:])
    with pytest.raises(NteError, match=r"a\.exr: the header has an unsupported attribute type: deepImageState: remove"):
        read_exr(path)


@pytest.mark.parametrize("lost", [1, 200])
def test_a_part_that_is_cut_off_is_no_missing_part(tmp_path: Path, lost: int) -> None:
    """The library gives the parts that it can decode, and an empty one for the part that it cannot."""
    rng = np.random.default_rng(0)
    headers = [{"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "name": n} for n in ("a", "b")]
    channels = [{c: rng.random((20, 30), np.float32)} for c in ("R", "Z")]
    path = tmp_path / "cut.exr"
    OpenEXR.File([OpenEXR.Part(*both) for both in zip(headers, channels, strict=True)]).write(str(path))
    assert sorted(read_layers(path)) == ["a.R", "b.Z"]
    path.write_bytes(path.read_bytes()[:-lost])
    with pytest.raises(NteError, match="truncated"):
        read_layers(path)


def test_a_name_in_another_encoding_is_called_so(tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/gr\xfcn.0001.exr"))
    write_exr(tmp_path / "plain.exr", {"R": np.ones((2, 3), np.float32)})
    (tmp_path / "plain.exr").rename(path)
    with pytest.raises(NteError, match="the name is not UTF-8"):
        read_layers(path)
