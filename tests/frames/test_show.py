"""Channels as pictures: the table's `shown` column, each with an answer that can be worked out by hand."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from nte import NteError
from nte.frames import CHANNELS
from nte.frames.show import BAD, Picture, display, grid, heat, png_bytes, quantise, show, write_png


def plane(*components: float) -> np.ndarray:
    """One pixel (C, 1, 1) with these components."""
    return np.array(components, np.float32).reshape(-1, 1, 1)


def pixel(name: str, *components: float, **how: float) -> tuple[int, ...]:
    return tuple(int(v) for v in show(name, plane(*components), **how).pixels[0, 0])


@pytest.mark.parametrize("name", CHANNELS)
def test_every_channel_of_the_table_can_be_shown(name: str) -> None:
    values = np.random.default_rng(0).uniform(0, 5, (len(CHANNELS[name].components), 4, 6)).astype(np.float32)
    picture = show(name, values)
    assert picture.pixels.shape == (4, 6, 3)
    assert picture.pixels.dtype == np.uint8
    assert picture.title == name


def test_radiance_is_exposed_tonemapped_and_srgb_encoded() -> None:
    # 0.5 · 2 = 1, tonemapped 1/2, whose sRGB value is 188
    assert pixel("color", 0.5, 0, 1e9, exposure=2.0) == (188, 0, 255)
    assert show("color", plane(1, 1, 1), exposure=2.0).note == "exposure 2"


def test_reflectance_and_directions_are_linear() -> None:
    assert pixel("albedo", 0.0, 0.2, 1.0) == (0, 51, 255)
    assert pixel("normal", -1.0, 0.2, 1.0) == (0, 153, 255)


def test_bounded_numbers_keep_their_scale_and_others_say_theirs() -> None:
    values = np.array([[[0.0, 0.25]]], np.float32)
    assert show("roughness", values).note == "0 to 1"
    assert "scene units" in show("depth", values * 40).note
    assert "0 to 8" in show("depth", values, scale=8.0).note
    assert pixel("depth", 8.0, scale=8.0) == (0xFD, 0xE7, 0x25)  # the last colour of viridis


def test_motion_shows_direction_as_hue_and_length_as_saturation() -> None:
    assert pixel("motion", 0, 0, scale=4.0) == (255, 255, 255)
    assert pixel("motion", 4, 0, scale=4.0) == (255, 0, 0)
    assert pixel("motion", -4, 0, scale=4.0) == (0, 255, 255)
    assert pixel("motion", 2, 0, scale=4.0) == (255, 128, 128)
    assert show("motion", plane(3, 4)).note == "full colour = 5 px"


def test_labels_are_stable_and_distinct() -> None:
    ids = np.arange(200, dtype=np.float32).reshape(1, 10, 20)
    pixels = show("instance", ids).pixels
    assert tuple(pixels[0, 0]) == (0, 0, 0)
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) == 200
    alone = show("instance", ids[:, 3:4, 5:6]).pixels[0, 0]
    np.testing.assert_array_equal(alone, pixels[3, 5])


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_bad_pixels_are_magenta_and_leave_the_others_alone(name: str, value: float) -> None:
    clean = np.full((len(CHANNELS[name].components), 3, 3), 0.5, np.float32)
    broken = clean.copy()
    broken[-1, 1, 1] = value
    pixels = show(name, broken).pixels
    assert tuple(pixels[1, 1]) == BAD
    np.testing.assert_array_equal(pixels[0], show(name, clean).pixels[0])


def test_the_display_transform_is_that_of_the_metrics() -> None:
    torch = pytest.importorskip("torch")
    from nte.color import display as display_torch

    radiance = np.random.default_rng(1).gamma(0.5, 3, (3, 8, 8)).astype(np.float32)
    expected = display_torch(torch.from_numpy(radiance)[None], torch.tensor([1.7]))[0].numpy()
    np.testing.assert_allclose(display(radiance, 1.7), expected, atol=1e-6)


@given(arrays(np.float32, (1, 4), elements=st.floats(0, 1, width=32)))
def test_heat_is_ordered_by_lightness(values: np.ndarray) -> None:
    lightness = np.tensordot([0.2126, 0.7152, 0.0722], heat(np.sort(values)), 1)
    assert (np.diff(lightness) >= -1e-6).all()


def test_quantise_rounds_clamps_and_takes_grey() -> None:
    np.testing.assert_array_equal(quantise(plane(0.5, -1, 7))[0, 0], [128, 0, 255])
    np.testing.assert_array_equal(quantise(plane(0.2))[0, 0], [51, 51, 51])


def test_grid_holds_every_picture_unscaled_or_enlarged_whole() -> None:
    big = Picture("big", np.full((100, 200, 3), (10, 200, 30), np.uint8))
    small = Picture("small", np.full((4, 4, 3), (200, 10, 30), np.uint8), "a note")
    sheet = grid([big, small, big], columns=2)
    assert (sheet == (10, 200, 30)).all(-1).sum() == 2 * 100 * 200
    assert (sheet == (200, 10, 30)).all(-1).sum() == 192 * 192
    assert (sheet.max(-1) < 100).any()  # captions


def test_png_is_lossless_and_leaves_no_rubbish(tmp_path: Path) -> None:
    pixels = np.random.default_rng(2).integers(0, 256, (5, 7, 3), np.uint8)
    write_png(tmp_path / "x.png", pixels)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "x.png")), pixels)
    assert [p.name for p in tmp_path.iterdir()] == ["x.png"]
    assert (tmp_path / "x.png").read_bytes() == png_bytes(pixels)
    with pytest.raises(NteError, match="cannot be written"):
        write_png(tmp_path / "absent" / "x.png", pixels)


def test_wrong_input_is_told_in_one_line() -> None:
    with pytest.raises(NteError, match="'colour': no such channel"):
        show("colour", plane(1, 2, 3))
    with pytest.raises(NteError, match=r"'motion' \(3, 1, 1\): expected \(2, H, W\)"):
        show("motion", plane(1, 2, 3))
