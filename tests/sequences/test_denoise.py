"""`nte denoise` on files: linear EXR in and out, every other layer as it was, nothing lost."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nte.cli import main
from nte.denoiser import Noisy, Result
from nte.errors import NteError
from nte.filters.taa import Taa, TaaOptions
from nte.frames.clip import Clip, read_frame
from nte.frames.clip_files import frame_path
from nte.frames.clip_info import write_clip_info
from nte.frames.exr import read_layers, write_exr
from nte.frames.frame import Frame
from nte.sequences.denoise import denoise_files
from nte.sequences.pictures import PictureSettings
from nte.session import Session
from tests.synthetic import disc_clip


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def engine_frames(folder: Path, count: int = 3, first: int = 7) -> list[Path]:
    """Frames as an engine writes them: float albedo, one whole reference, ids, a layer that nobody knows."""
    rng = np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"shot.{number:04d}.exr" for number in range(first, first + count)]
    for path in paths:
        layers = {f"{name}.{c}": rng.random((8, 9), np.float32) for name in ("albedo", "reference") for c in "RGB"}
        layers |= {f"color.{c}": rng.random((8, 9), np.float32).astype(np.float16) for c in "RGB"}
        layers |= {f"{name}.{c}": np.zeros((8, 9), np.float32) for name in ("motion", "forward_motion") for c in "XY"}
        layers |= {"crypto.ID": rng.integers(0, 2**32, (8, 9), np.uint32), "mist.V": rng.random((8, 9), np.float32)}
        write_exr(path, layers)
    return paths


def test_a_clip_stays_a_clip_with_the_denoised_image_in_place_of_the_noisy(noisy_disc: Path, tmp_path: Path) -> None:
    written = denoise_files([noisy_disc], Taa(), tmp_path / "out")
    clip = Clip(tmp_path / "out")
    assert written == [frame_path(clip.folder, i) for i in range(4)]
    running = Session(Taa())
    for frame, source in zip(clip, Clip(noisy_disc), strict=True):
        assert set(frame.channels) == set(source.channels)
        expected = running.denoise(source)
        np.testing.assert_allclose(frame["color"], expected, rtol=1e-3, atol=1e-4)
        for name in source.channels:
            if name != "color":
                np.testing.assert_array_equal(frame[name], source[name])


def test_a_clip_tells_the_exposure_that_was_used(noisy_disc: Path, tmp_path: Path) -> None:
    denoise_files([noisy_disc], Noisy(), tmp_path / "estimated")
    denoise_files([noisy_disc], Noisy(), tmp_path / "given", exposure=2.5)
    assert Clip(tmp_path / "given").info["exposure"] == 2.5
    assert Clip(tmp_path / "estimated").info["exposure"] not in (1, 2.5)
    denoise_files([tmp_path / "given"], Noisy(), tmp_path / "again")
    assert Clip(tmp_path / "again").info["exposure"] == 2.5


def test_every_other_layer_is_kept_bit_for_bit(tmp_path: Path) -> None:
    paths = engine_frames(tmp_path / "in")
    written = denoise_files(paths, Taa(TaaOptions("none")), tmp_path / "out")
    assert [path.name for path in written] == [path.name for path in paths]
    for path, source in zip(written, paths, strict=True):
        ours, theirs = read_layers(path), read_layers(source)
        assert ours.keys() == theirs.keys()
        for name, values in theirs.items():
            assert ours[name].dtype == values.dtype
            if not name.startswith("color."):
                np.testing.assert_array_equal(ours[name], values)
    last = read_frame(written[-1])["color"]
    assert not np.array_equal(last, read_frame(paths[-1])["color"])


def test_loose_frames_are_taken_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    paths = engine_frames(tmp_path / "in", count=4, first=8)  # 8, 9, 10, 11
    ordered = denoise_files(paths, Taa(TaaOptions("none")), tmp_path / "a")
    shuffled = denoise_files([paths[i] for i in (2, 0, 3, 1)], Taa(TaaOptions("none")), tmp_path / "b")
    assert [p.name for p in ordered] == [p.name for p in shuffled] == [p.name for p in paths]
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert not (tmp_path / "a" / "clip.json").exists()


class Trusting(Noisy):
    """Leaves the image as it is, and remembers what it is told of the guides, as OIDN takes it into account."""

    optional: tuple[str, ...] = ("albedo",)

    def __init__(self) -> None:
        super().__init__()
        self.told: list[bool | None] = []

    def step(self, frame: Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[Result, tuple[()]]:
        self.told.append(frame.clean_guides)
        return Result(frame["color"]), ()


@pytest.mark.parametrize("noisy", [False, True])
def test_four_of_the_loose_frames_tell_whether_their_guides_are_clean(tmp_path: Path, noisy: bool) -> None:
    """Open Image Denoise would denoise guides of which it does not know that they are clean, for twice the time."""
    y, x = np.mgrid[:48, :64]
    said, denoiser, paths = list[str](), Trusting(), [tmp_path / f"shot.{number}.exr" for number in range(9)]
    for number, path in enumerate(paths):  # noise comes in half-way, where one frame at the beginning would not tell
        spread = 0.2 if noisy and number > 3 else 0.0
        rng = np.random.default_rng(number)
        albedo = np.stack([0.5 + 0.3 * np.sin((x + number) / 9), y / 60, 0.3 + 0 * x]) + spread * rng.random(
            (3, 48, 64)
        )
        layers = dict(zip(("albedo.R", "albedo.G", "albedo.B"), albedo.astype("f"), strict=True))
        write_exr(path, layers | {f"color.{c}": rng.random((48, 64), np.float32) for c in "RGB"})
    denoise_files(paths, denoiser, tmp_path / "out", say=said.append)
    assert denoiser.told == [not noisy] * 9
    assert said[0].startswith("read as nte's own channels: color, albedo; if they are another renderer's, give --map")
    assert [line.startswith("albedo or normal is noisy or aliased") for line in said[1:]] == [True] * noisy


def test_a_clip_that_says_whether_its_guides_are_clean_is_believed(tmp_path: Path) -> None:
    for known in (True, False):
        denoiser, clip = Trusting(), Clip(disc_clip(tmp_path / str(known), frames=2))
        write_clip_info(clip.folder, {**clip.info, "clean_guides": known})
        denoise_files([clip.folder], denoiser, tmp_path / f"{known} out")
        assert denoiser.told == [known] * 2


def test_pictures_beside_the_frames(noisy_disc: Path, tmp_path: Path) -> None:
    written = denoise_files([noisy_disc], Noisy(), tmp_path / "out", pictures=PictureSettings(png=True))
    for path in written:
        with Image.open(path.with_suffix(".png")) as picture:
            assert picture.size == (40, 24)


def test_nothing_is_overwritten_without_force(noisy_disc: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    denoise_files([noisy_disc], Noisy(), out, pictures=PictureSettings(png=True))
    before = contents(out)
    frame = engine_frames(tmp_path / "in", count=1)
    for sources, png, named in (
        ([noisy_disc], False, r"frame_0000\.exr"),
        (frame, False, r"clip\.json"),  # another clip lives there
    ):
        with pytest.raises(NteError, match=f"{named}: exists: choose another folder, or overwrite it with --force"):
            denoise_files(sources, Noisy(), out, pictures=PictureSettings(png=png))
    loose = tmp_path / "loose"
    loose.mkdir()
    (loose / "shot.0007.png").write_bytes(b"mine")
    with pytest.raises(NteError, match=r"shot\.0007\.png: exists"):
        denoise_files(frame, Noisy(), loose, pictures=PictureSettings(png=True))
    assert contents(out) == before
    denoise_files([noisy_disc], Taa(), out, force=True)
    assert contents(out) != before


class Stopping(Noisy):
    """Gives three frames, and then stops as a killed process would, or does something else first."""

    def __init__(self, then: Callable[[], object] = lambda: None) -> None:
        super().__init__()
        self._then, self._frames = then, 0

    def step(self, frame: Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[Result, object]:
        self._frames += 1
        if self._frames == 4:
            self._then()
            raise KeyboardInterrupt
        return super().step(frame, state, extras)


def test_what_was_stopped_begins_again_with_the_same_command_and_no_other(noisy_disc: Path, tmp_path: Path) -> None:
    out, whole = tmp_path / "out", tmp_path / "whole"
    denoise_files([noisy_disc], Taa(), whole)
    with pytest.raises(KeyboardInterrupt):
        denoise_files([noisy_disc], Stopping(), out, spec="taa")
    left = contents(out)
    assert len(left) == 4  # three frames and the mark
    png = PictureSettings(png=True)
    changes: list[dict[str, object]] = [{"spec": "noisy"}, {"spec": None}, {"exposure": 2.0}, {"pictures": png}]
    for change in changes:
        with pytest.raises(NteError, match=r"frame_0000\.exr: exists"):
            denoise_files([noisy_disc], Taa(), out, **{"spec": "taa", **change})
    with pytest.raises(NteError, match=r"frame_0000\.exr: exists"):
        denoise_files(sorted(noisy_disc.glob("*.exr")), Taa(), out, spec="taa")
    assert contents(out) == left
    denoise_files([noisy_disc], Taa(), out, spec="taa")
    assert contents(out) == contents(whole)
    with pytest.raises(NteError, match=r"frame_0000\.exr: exists"):  # now it is finished
        denoise_files([noisy_disc], Taa(), out, spec="taa")


def test_a_second_denoise_into_one_folder_is_refused_while_the_first_writes(
    noisy_disc: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    finished = [frame_path(out, index) for index in range(2)]  # while the third is written

    def second() -> None:
        before = [path.read_bytes() for path in finished]
        for more in ([], ["--force"], ["--png", "--exposure", "2"]):
            assert main(["denoise", str(noisy_disc), "--denoiser", "noisy", "--out", str(out), *more]) == 2
            (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("nte: ")]
            assert "out: another process is writing to it: wait for it, or choose another folder" in line
        assert [path.read_bytes() for path in finished] == before

    with pytest.raises(KeyboardInterrupt):
        denoise_files([noisy_disc], Stopping(second), out)


def test_the_noisy_frames_themselves_are_never_overwritten(tmp_path: Path) -> None:
    clip = disc_clip(tmp_path / "clip", frames=2)
    before = contents(clip)
    (tmp_path / "link").symlink_to(clip)
    for out in (clip, tmp_path / "link"):
        with pytest.raises(NteError, match="holds the noisy frames themselves: choose another folder"):
            denoise_files([clip], Noisy(), out, force=True)
    links = tmp_path / "links"
    links.mkdir()
    for path in clip.glob("*.exr"):
        (links / path.name).symlink_to(path)
    with pytest.raises(NteError, match="holds the noisy frames themselves"):
        denoise_files(sorted(links.iterdir()), Noisy(), clip, force=True)
    assert contents(clip) == before


def test_a_mistake_does_not_touch_what_was_there_even_with_force(noisy_disc: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    denoise_files([noisy_disc], Noisy(), out)
    before = contents(out)
    bare = tmp_path / "bare"
    disc_clip(bare, frames=2)
    frame_path(bare, 0).write_bytes(frame_path(bare, 0).read_bytes()[:300])
    denoiser = Noisy()
    denoiser.needs = ("color", "glossy")
    for sources, what in (([bare], Noisy()), ([noisy_disc], denoiser), ([tmp_path / "frame_0000.exr"], Noisy())):
        with pytest.raises(NteError):
            denoise_files(sources, what, out, force=True)
    assert contents(out) == before


def test_what_does_not_fit_is_named(noisy_disc: Path, tmp_path: Path) -> None:
    paths = engine_frames(tmp_path / "in", count=4)
    out = tmp_path / "out"
    other = engine_frames(tmp_path / "other", count=1)
    write_exr(tmp_path / "shot.0008.exr", {f"color.{c}": np.ones((9, 9), np.float32) for c in "RGB"})
    write_exr(tmp_path / "strange.exr", {"mist.V": np.ones((9, 9), np.float32)})
    for sources, exposure, message in (
        ([paths[0], paths[2]], None, r"frame 8 is missing: after shot\.0007\.exr comes shot\.0009\.exr"),
        ([paths[0], paths[0]], None, r"frame 7 is there twice \(shot\.0007\.exr"),
        ([*paths[:1], *other], None, "frame 7 is there twice"),
        ([paths[0], tmp_path / "shot.0008.exr"], None, r"shot\.0008\.exr: 9x9 after 9x8: frames must have one size"),
        ([tmp_path / "strange.exr"], None, r"strange\.exr: has no channel of ours"),
        ([tmp_path / "nowhere.exr"], None, r"nowhere\.exr: cannot be read: No such file"),
        ([tmp_path], None, r"strange\.exr: has no frame number"),  # and shot.0008.exr has one
        ([noisy_disc, noisy_disc], None, "is a folder beside others: expected one folder"),
        *((paths, bad, "exposure is .*, expected a positive number") for bad in (0.0, -1.0, np.nan, np.inf)),
    ):
        with pytest.raises(NteError, match=message):
            denoise_files(sources, Noisy(), out, exposure=exposure)


def test_a_channel_that_one_of_the_loose_frames_lacks_or_has_alone_names_the_file(tmp_path: Path) -> None:
    """Open Image Denoise would denoise that frame without its albedo, the others with theirs."""
    paths = engine_frames(tmp_path / "in", count=3)
    for odd, others in ((paths[1], "lacks"), (paths[0], "has")):
        whole = odd.read_bytes()
        write_exr(odd, {name: pixels for name, pixels in read_layers(odd).items() if not name.startswith("albedo.")})
        with pytest.raises(NteError, match=rf"shot\.0008\.exr: {others} 'albedo', unlike shot\.0007\.exr"):
            denoise_files(paths, Trusting(), tmp_path / "out", say=lambda line: None)
        odd.write_bytes(whole)


def test_hidden_files_are_no_frames(tmp_path: Path) -> None:
    paths = engine_frames(tmp_path / "in")
    (tmp_path / "in" / "._shot.0007.exr").write_bytes(b"what macOS leaves on a network drive")
    (tmp_path / "in" / "shot.0010.exr").mkdir()
    written = denoise_files([tmp_path / "in"], Noisy(), tmp_path / "out")
    assert [path.name for path in written] == [path.name for path in paths]


def test_a_link_to_nothing_does_not_shorten_a_sequence(tmp_path: Path) -> None:
    engine_frames(tmp_path / "in", count=2)
    (tmp_path / "in" / "shot.0009.exr").symlink_to(tmp_path / "gone.exr")
    with pytest.raises(NteError, match=r"shot\.0009\.exr: cannot be read: No such file"):
        denoise_files([tmp_path / "in"], Noisy(), tmp_path / "out")


def test_a_file_without_a_number_beside_a_sequence_is_refused(tmp_path: Path) -> None:
    engine_frames(tmp_path / "in", count=2, first=9)[1].rename(tmp_path / "in" / "shot.10.exr")
    (tmp_path / "in" / "mask.exr").write_bytes((tmp_path / "in" / "shot.10.exr").read_bytes())
    with pytest.raises(NteError, match=r"mask\.exr: has no frame number in its name"):
        denoise_files([tmp_path / "in"], Noisy(), tmp_path / "out")


def test_float_channels_stay_as_precise_as_they_are(tmp_path: Path) -> None:
    """Half floats would keep 1/3 to 1e-4 only, and 1e-9 not at all."""
    for index, size in enumerate((1 / 3, 1e-9)):
        given = {f"color.{c}": np.full((8, 9), size, np.float32) for c in "RGB"}
        path = tmp_path / f"in.{index}.exr"
        write_exr(path, given)
        found = read_layers(denoise_files([path], Noisy(), tmp_path / "out")[0])
        np.testing.assert_array_equal(found["color.R"], given["color.R"])
