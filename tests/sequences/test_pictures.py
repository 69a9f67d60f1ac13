"""What `nte denoise` writes to look at: pictures beside the frames, a video, and one that is half noisy."""

import sys
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from nte.cli import main
from nte.denoiser import Noisy
from nte.errors import NteError
from nte.filters.taa import Taa, TaaOptions
from nte.frames.clip import Clip, read_frame, write_frame
from nte.frames.clip_files import frame_path
from nte.frames.show import quantise, show
from nte.frames.views import find_view
from nte.sequences.denoise import denoise_files
from nte.sequences.pictures import PictureSettings
from nte.sequences.video import open_video

FRAMES = 4


def picture_of(path: Path) -> npt.NDArray[np.uint8]:
    with Image.open(path) as picture:
        return np.asarray(picture)


def decoded(path: Path) -> list[npt.NDArray[np.uint8]]:
    with av.open(str(path)) as file:
        return [frame.reformat(format="rgb24").to_ndarray() for frame in file.decode(video=0)]


def test_the_left_half_is_noisy_and_the_right_one_denoised(noisy_disc: Path, tmp_path: Path) -> None:
    both = tmp_path / "pictures" / "both.png"
    settings = PictureSettings(before_after=both)
    written = denoise_files([noisy_disc], Taa(TaaOptions("none")), tmp_path / "out", pictures=settings)
    exposure = float(Clip(tmp_path / "out").info["exposure"])
    before, after = (show("color", read_frame(path)["color"], exposure).pixels
                     for path in (frame_path(noisy_disc, FRAMES // 2), written[FRAMES // 2]))  # fmt: skip
    found = picture_of(both)
    middle = found.shape[1] // 2
    assert np.abs(before.astype(int) - after).mean() > 3
    np.testing.assert_array_equal(found[:, :middle], before[:, :middle])
    np.testing.assert_array_equal(found[:, middle], 255)
    np.testing.assert_allclose(found[:, middle + 1 :].astype(int), after[:, middle + 1 :], atol=1)  # half floats
    assert not list((tmp_path / "out").glob("*.png"))


def test_a_video_shows_every_frame_in_its_colours(tmp_path: Path) -> None:
    # Large coloured areas: chroma is stored for blocks of pixels, and what is judged are the colours and the order.
    colours = np.array([[1.5, 0.1, 0.1], [0.1, 0.6, 0.05], [0.02, 0.1, 0.9]], np.float32)
    frames = [tmp_path / "in" / f"frame_{i:04d}.exr" for i in range(3)]
    for path, colour in zip(frames, colours, strict=True):
        write_frame(path, {"color": np.broadcast_to(colour[:, None, None], (3, 45, 71)).copy()})
    video = tmp_path / "film.MP4"
    denoise_files(frames, Noisy(), tmp_path / "out", pictures=PictureSettings(video=video, fps=12.5, view="standard"))
    found = decoded(video)
    assert [picture.shape for picture in found] == [(46, 72, 3)] * 3  # an odd size gets a column and a row
    for picture, colour in zip(found, colours, strict=True):
        expected = quantise(find_view("standard")(colour[:, None, None], 1.0))
        np.testing.assert_allclose(picture.astype(int), np.broadcast_to(expected, picture.shape), atol=6)
    with av.open(str(video)) as file:
        stream = file.streams.video[0]
        assert float(stream.average_rate) == 12.5
        assert (stream.codec_context.colorspace, stream.codec_context.color_primaries) == (1, 1)


def test_a_moving_picture_shows_both_halves_of_every_frame_for_ever(noisy_disc: Path, tmp_path: Path) -> None:
    moving, film = tmp_path / "both.webp", tmp_path / "film.webp"
    settings = PictureSettings(png=True, before_after=moving, video=film, fps=12.5)
    written = denoise_files([noisy_disc], Taa(TaaOptions("none")), tmp_path / "out", pictures=settings)
    exposure = float(Clip(tmp_path / "out").info["exposure"])
    with Image.open(moving) as both, Image.open(film) as alone:
        frames = [getattr(picture, "n_frames", 1) for picture in (both, alone)]
        assert (*frames, both.info["loop"]) == (len(written), len(written), 0)
        for index, path in enumerate(written):
            both.seek(index)
            both.load()  # only then Pillow knows the duration
            alone.seek(index)
            assert both.info["duration"] == 80
            before = show("color", read_frame(frame_path(noisy_disc, index))["color"], exposure).pixels.astype(int)
            after = picture_of(path.with_suffix(".png")).astype(int)
            found, filmed = (np.asarray(picture.convert("RGB")).astype(int) for picture in (both, alone))
            middle = after.shape[1] // 2
            left, right = np.s_[:, :middle], np.s_[:, middle + 1 :]
            lost = np.abs(found[left] - before[left]).mean()  # noise has much colour, of which WebP keeps a quarter
            assert lost < 8
            assert index == 0 or lost < 0.5 * np.abs(found[left] - after[left]).mean()
            assert np.abs(found[right] - after[right]).mean() < 8
            assert np.abs(filmed - after).mean() < 8


def test_a_moving_picture_follows_light_that_changes_slowly(tmp_path: Path) -> None:
    """Encoders of animations like to keep what hardly changes, in blocks that are seen."""
    ramp = np.linspace(60, 100, 96)[:, None] + np.linspace(0, 40, 128)
    pictures = [np.repeat((ramp + i)[..., None], 3, 2).round().astype(np.uint8) for i in range(10)]
    with open_video(tmp_path / "slow.webp", 24) as add:
        for picture in pictures:
            add(picture)
    with Image.open(tmp_path / "slow.webp") as found:
        for index, picture in enumerate(pictures):
            found.seek(index)
            assert np.abs(np.asarray(found.convert("RGB")).astype(int) - picture).max() <= 3


@pytest.mark.parametrize("name", ["film.mp4", "film.webp"])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError("another file")])
def test_a_video_that_is_stopped_leaves_no_file_and_the_error_as_it_is(
    name: str, error: BaseException, tmp_path: Path
) -> None:
    def stopped() -> None:
        with open_video(tmp_path / name, 24) as add:
            add(np.zeros((16, 16, 3), np.uint8))
            raise error

    with pytest.raises(type(error)) as caught:
        stopped()
    assert caught.value is error
    assert not list(tmp_path.iterdir())


def test_light_without_a_stated_exposure_is_as_bright_as_it_is(tmp_path: Path) -> None:
    frame = tmp_path / "in" / "frame_0000.exr"
    light = np.random.default_rng(1).uniform(0, 0.02, (3, 9, 11)).astype(np.float32)
    write_frame(frame, {"color": light})
    for exposure, factor in ((None, 1.0), (8.0, 8.0)):
        settings = PictureSettings(png=True, view="standard")
        (written,) = denoise_files([frame], Noisy(), tmp_path / "out", exposure, settings, force=True)
        expected = quantise(find_view("standard")(read_frame(frame)["color"], factor))
        np.testing.assert_array_equal(picture_of(written.with_suffix(".png")), expected)


def test_bad_pixels_of_the_noisy_image_are_magenta(tmp_path: Path) -> None:
    frame = tmp_path / "in" / "frame_0000.exr"
    light = np.full((3, 8, 8), 0.2, np.float32)
    light[1, 2, 3] = np.nan
    write_frame(frame, {"color": light})
    settings = PictureSettings(before_after=tmp_path / "both.png", view="standard")
    denoise_files([frame], Noisy(), tmp_path / "out", pictures=settings)
    assert picture_of(tmp_path / "both.png")[2, 3].tolist() == [255, 0, 255]


def test_the_last_line_names_every_picture_that_is_not_beside_the_frames(
    noisy_disc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    pictures = ["--png", "--video", "film.webp", "--before-after", "both.png"]
    assert main(["denoise", str(noisy_disc), "--denoiser", "noisy", "--out", "out", *pictures]) == 0
    assert capsys.readouterr().out == "4 frames in out, film.webp, both.png\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--video", "film.avi"], "film.avi: expected a name that ends in .mp4 or .webp"),
        (["--before-after", "both.jpg"], "both.jpg: expected a name that ends in .png or .mp4 or .webp"),
        (["--view", "agx2", "--png"], "no view 'agx2' in ocio://default, which has "),
        (["--video", "film.mp4", "--fps", "0"], "fps is 0, expected a number of frames per second from 0.01 to 1000"),
        (["--video", "film.mp4", "--fps", "nan"], "fps is nan, expected a number"),
        (["--video", "mine.mp4"], "mine.mp4: exists"),
        (["--before-after", "mine.png"], "mine.png: exists"),
        (["--video", "a.webp", "--before-after", "out/../a.webp"], "a.webp: two files would have this name"),
        (["--png", "--before-after", "out/frame_0001.png"], "frame_0001.png: two files would have this name"),
    ],
)
def test_what_cannot_be_is_one_line_before_anything_is_written(
    options: list[str], message: str, noisy_disc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("OCIO", raising=False)
    for name in ("mine.mp4", "mine.png"):
        Path(name).write_bytes(b"mine")
    assert main(["denoise", str(noisy_disc), "--denoiser", "noisy", "--out", "out", *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == ["mine.mp4", "mine.png"]
    assert not Path("out").exists()


@pytest.mark.parametrize("name", ["wide.webp", "wide.mp4"])
def test_a_picture_that_no_encoder_takes_is_one_line(name: str, tmp_path: Path) -> None:
    with (
        pytest.raises(NteError, match=rf"{name}: 17000x2 cannot be encoded \(.*\): use --png, or a smaller picture$"),
        open_video(tmp_path / name, 24) as add,
    ):
        add(np.zeros((2, 17000, 3), np.uint8))
    assert not list(tmp_path.iterdir())


def test_a_view_is_for_light_only(tmp_path: Path) -> None:
    frame = tmp_path / "in" / "frame_0000.exr"
    write_frame(frame, {"color": np.ones((3, 8, 8), np.float32), "visibility": np.ones((1, 8, 8), np.float32)})
    noisy = Noisy()
    noisy.target, noisy.needs = "visibility", ("visibility",)
    with pytest.raises(NteError, match="the denoiser gives 'visibility', which is no light and has no view"):
        denoise_files([frame], noisy, tmp_path / "out", pictures=PictureSettings(png=True, view="standard"))


def test_without_pyav_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with (
        pytest.raises(NteError, match=r"a video needs the package 'av': .*\[video\]"),
        open_video(tmp_path / "film.mp4", 24),
    ):
        pass
