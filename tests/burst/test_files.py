"""`nte merge-burst` on real files: raw photographs through LibRaw, EXR and PNG, and one line for every mistake."""

import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from nte.burst.files import merge_files
from nte.burst.pictures import read_picture, write_picture
from nte.burst.raw import develop, read_raw
from nte.cli import main
from nte.errors import NteError
from nte.frames.exr import write_exr
from nte.frames.srgb import decode_srgb
from tests.burst.dng import BAYER, XTRANS, write_dng
from tests.burst.scenes import NOISE, PATTERNS, mosaic_of, psnr, scene, sense

rawpy = pytest.importorskip("rawpy")
SIZE = 528, 540  # LibRaw demosaics X-Trans from 512 px on
SHIFTS = [(0, 0), (2.4, -1.3), (-5.2, 3.8), (7.1, 6.6)]
BLACK, WHITE = (60, 64, 68, 64), 4095


def raw_values(mosaic: np.ndarray, levels: tuple[int, ...] = BLACK) -> np.ndarray:
    """12 bits, as a sensor gives them, of a linear mosaic (H, W); each pixel of a square has its black level."""
    height, width = mosaic.shape
    side = round(len(levels) ** 0.5)
    black = np.tile(np.reshape(levels, (side, side)), (-(-height // side), -(-width // side)))[:height, :width]
    return np.round(black + mosaic * (WHITE - black)).clip(0, WHITE).astype(np.uint16)


def raw_burst(folder: Path, name: str, size: tuple[int, int] = SIZE, frames: int = 4) -> tuple[list[Path], np.ndarray]:
    """The files, and the scene that the first shows, (3, H, W)."""
    mosaic, paths, clean = mosaic_of(name), [], [scene(size, shift) for shift in SHIFTS[:frames]]
    for i, image in enumerate(clean):
        values = raw_values(sense(image, mosaic, NOISE, i)[0, 0].numpy())
        paths.append(write_dng(folder / f"{i}.dng", values, PATTERNS[name], BLACK, WHITE))
    return paths, clean[0][0].numpy()


@pytest.mark.slow
@pytest.mark.parametrize("name", PATTERNS)
def test_raw_photographs_are_merged_before_demosaicing(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four files in, one linear EXR out, nearer to the truth than LibRaw's picture of the first alone."""
    paths, clean = raw_burst(tmp_path, name)
    out = tmp_path / "out" / "merged.exr"
    assert main(["merge-burst", *map(str, paths), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "noise: variance = " in said
    assert "the mean of 3." in said
    merged, truth = read_picture(out), torch.from_numpy(clean)
    alone = develop(paths[0], read_raw(paths[0]).values)
    gains = psnr(torch.from_numpy(merged), truth, 32) - psnr(torch.from_numpy(alone), truth, 32)
    assert gains > 2.5  # of 10·log₁₀ 4 = 6.0; what demosaicing itself costs is in both


def levels(side: int) -> tuple[int, ...]:
    """Black levels of a square of pixels, no two alike: the values of one say nothing of another's."""
    return tuple(60 + 7 * (5 * i % side**2) for i in range(side**2))


@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("side", [1, 2, 4, 6])
def test_a_raw_file_is_read_to_its_last_bit_and_developed_without_a_change_of_level(
    name: str, side: int, tmp_path: Path
) -> None:
    """Half a step of 12 bits: a twentieth of the difference between two black levels."""
    colour = torch.tensor([0.2, 0.4, 0.6]).view(1, 3, 1, 1).expand(1, 3, *SIZE)
    mosaic = sense(colour, mosaic_of(name), None, 0)[0, 0].numpy()
    path = write_dng(tmp_path / "flat.dng", raw_values(mosaic, levels(side)), PATTERNS[name], levels(side), WHITE)
    raw = read_raw(path)
    assert raw.mosaic == mosaic_of(name)
    np.testing.assert_allclose(raw.values, mosaic, rtol=0, atol=0.51 / (WHITE - max(levels(side))))
    developed = develop(path, mosaic)
    np.testing.assert_allclose(developed, colour[0].numpy(), atol=2e-4)


def test_the_black_pattern_starts_at_the_active_area(tmp_path: Path) -> None:
    """Masked pixels around it shift the visible pattern by their number."""
    mosaic = np.full((96, 120), 0.3, np.float32)
    sensor = np.zeros((104, 132), np.uint16)
    sensor[5:101, 7:127] = raw_values(mosaic, levels(4))
    path = write_dng(tmp_path / "masked.dng", sensor, BAYER, levels(4), WHITE, active=(5, 7, 101, 127))
    values = read_raw(path).values
    np.testing.assert_allclose(values, 0.3, rtol=0, atol=1.5e-4)


def test_a_sensor_of_one_colour_is_merged_as_one_colour(tmp_path: Path) -> None:
    clean = [scene((96, 120), shift)[:, 1:2] for shift in SHIFTS]
    for i, image in enumerate(clean):
        values = raw_values(sense(image, None, NOISE, i)[0, 0].numpy(), (64,))
        write_dng(tmp_path / f"{i}.dng", values, None, (64,), WHITE)
    paths, out = [tmp_path / f"{i}.dng" for i in range(4)], tmp_path / "grey.exr"
    assert main(["merge-burst", *map(str, paths), "--out", str(out)]) == 0
    merged, alone = torch.from_numpy(read_picture(out)), torch.from_numpy(read_raw(paths[0]).values)
    assert torch.equal(merged[0], merged[1])
    assert torch.equal(merged[0], merged[2])
    assert psnr(merged[:1], clean[0][0]) > psnr(alone[None], clean[0][0]) + 4


def test_the_picture_is_turned_balanced_and_exposed_as_the_file_asks(tmp_path: Path) -> None:
    """Held upright, a white that the sensor saw as (0.5, 1, 0.8), and to be made brighter by one stop."""
    neutral, grey = torch.tensor([0.5, 1.0, 0.8]).view(1, 3, 1, 1), torch.full((1, 3, 96, 120), 0.1)
    grey[..., :48, :] = 0.05  # the top of the sensor
    values = raw_values(sense(grey * neutral, mosaic_of("bayer"), None, 0)[0, 0].numpy())
    for name in ("a", "b"):
        write_dng(tmp_path / f"{name}.dng", values, BAYER, BLACK, WHITE, 0.02, 6, (0.5, 1.0, 0.8), 1.0)
    files, out = [str(tmp_path / f"{name}.dng") for name in ("a", "b")], str(tmp_path / "out.exr")
    given = ["--noise", "1e-4", "1e-6", "--out", out]
    assert main(["merge-burst", *files, *given]) == 0
    picture = read_picture(Path(out))
    assert picture.shape == (3, 120, 96)
    np.testing.assert_allclose(picture[:, 8:-8, 8:40], 0.2, atol=2e-3)  # 6: turned clockwise, what was left is above
    np.testing.assert_allclose(picture[:, 8:-8, 56:-8], 0.1, atol=2e-3)
    assert main(["merge-burst", *files, *given, "--brightness", "-2", "--force"]) == 0
    np.testing.assert_allclose(read_picture(Path(out)), picture / 4, rtol=1e-6)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_sixteen_bits_hold_what_eight_cannot(suffix: str, tmp_path: Path) -> None:
    image = np.stack([np.linspace(low, low + 0.02, 64 * 80).reshape(64, 80) for low in (0.0, 0.3, 0.97)])
    path = tmp_path / f"one{suffix}"
    write_picture(path, image.astype(np.float32))
    np.testing.assert_allclose(read_picture(path), image, atol=2e-5)
    assert len(np.unique(read_picture(path)[1])) > 600
    write_picture(path, image.astype(np.float32), 8)
    np.testing.assert_allclose(read_picture(path), image, atol=5e-3)
    assert len(np.unique(read_picture(path)[1])) < 12


def test_the_patterns_of_the_files_are_those_of_the_sensors(tmp_path: Path) -> None:
    for pattern in (BAYER, XTRANS):
        path = write_dng(tmp_path / "one.dng", np.full(SIZE, 500, np.uint16), pattern)
        with rawpy.imread(str(path)) as raw:
            assert raw.raw_pattern.shape == pattern.shape


@pytest.mark.parametrize("suffix", [".exr", ".png", ".tif"])
def test_pictures_are_merged_at_full_resolution(suffix: str, tmp_path: Path) -> None:
    clean = [scene((200, 240), shift) for shift in SHIFTS]
    paths = [tmp_path / f"{i}{suffix}" for i in range(4)]
    for i, (path, image) in enumerate(zip(paths, clean, strict=True)):
        write_picture(path, sense(image, None, NOISE, i)[0].numpy())
    out = tmp_path / f"out{suffix}"
    assert main(["merge-burst", *map(str, paths), "--out", str(out), "--reference", "2"]) == 0
    merged, alone = (torch.from_numpy(read_picture(path)) for path in (out, paths[1]))
    assert psnr(merged, clean[1][0]) > psnr(alone, clean[1][0]) + 4.5


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("unit", [1e-7, 1 / 64, 64.0])
def test_the_unit_of_a_linear_picture_does_not_matter(unit: float, given: bool, tmp_path: Path) -> None:
    """A .exr has no white level: radiance may have any unit, and what moves leaves no ghost in any of them."""
    clean = [scene((96, 128), shift, (40.0 + 9 * i, 50.0)) for i, shift in enumerate(SHIFTS)]
    found = {}
    for factor in (1.0, unit):
        paths = [tmp_path / f"{i}.exr" for i in range(len(SHIFTS))]
        for i, (path, image) in enumerate(zip(paths, clean, strict=True)):
            write_picture(path, factor * sense(image, None, NOISE, i)[0].numpy())
        out = tmp_path / "out.exr"
        done = merge_files(paths, out, noise=NOISE.scaled(factor) if given else None, force=True)
        found[factor] = read_picture(out) / factor
        model = done.noise.scaled(1 / factor)
        assert model.variance(torch.tensor(0.4)) == pytest.approx(float(NOISE.variance(torch.tensor(0.4))), rel=0.25)
    apart = np.abs(found[unit] - found[1.0])
    assert np.quantile(apart, 0.999) < 2e-4  # where two shifts fit alike, rounding decides
    assert apart.max() < 0.02
    assert psnr(torch.from_numpy(found[unit]), clean[0][0]) > 30


@pytest.mark.parametrize("light", [1e4, 1e10, 1e30])
def test_a_bright_speck_in_a_linear_picture_spoils_nothing_but_its_place(light: float, tmp_path: Path) -> None:
    """What moves leaves no ghost beside it, as it leaves none without it."""
    clean, errors = [scene((96, 192), shift, (40.0 + 9 * i, 50.0)) for i, shift in enumerate(SHIFTS)], []
    for speck in (0.0, light):
        for i, image in enumerate(clean):
            pixels = sense(image, None, NOISE, i)[0].numpy().copy()
            pixels[:, 80 + i, 170] += speck
            write_picture(tmp_path / f"{i}.exr", pixels)
        merge_files([tmp_path / f"{i}.exr" for i in range(len(clean))], tmp_path / "out.exr", force=True)
        apart = read_picture(tmp_path / "out.exr") - clean[0][0].numpy()
        errors.append(float(np.square(apart[..., :120]).mean()))
    assert errors[1] < 1.2 * errors[0]


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_a_picture_is_read_upright(suffix: str, orientation: int, turns: int, tmp_path: Path) -> None:
    shown = np.random.default_rng(0).integers(0, 256, (5, 8, 3), dtype=np.uint8)
    tags = Image.Exif()
    tags[274] = orientation
    Image.fromarray(shown).save(tmp_path / f"a.{suffix}", exif=tags)
    expected = decode_srgb(np.rot90(shown, turns).transpose(2, 0, 1) / 255)
    np.testing.assert_allclose(read_picture(tmp_path / f"a.{suffix}"), expected, atol=1e-6)


def test_of_a_camera_that_stood_still_it_is_told_what_cannot_be_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A star of one pixel stays where it is, and so does a hot pixel; if the camera moves, only the latter does."""
    out, given = str(tmp_path / "out.png"), ["--noise", str(NOISE.a), str(NOISE.b), "--force"]
    for shift in ((0.0, 0.0), (6.0, 4.0)):
        paths = []
        for i, moved in enumerate(((0.0, 0.0), shift)):
            mosaic = sense(scene((96, 120), moved), mosaic_of("bayer"), NOISE, i)[0, 0]
            mosaic[41, 61] = 0.9
            paths.append(write_dng(tmp_path / f"{i}.dng", raw_values(mosaic.numpy()), BAYER, BLACK, WHITE))
        assert main(["merge-burst", *map(str, paths), "--out", out, *given]) == 0
        said = capsys.readouterr().out
        assert "1 pixels of the sensor are hot" in said
        assert ("the camera stood still" in said) == (shift == (0.0, 0.0))
    assert main(["merge-burst", *map(str, paths), "--out", out, *given, "--keep-defects"]) == 0
    assert "hot or dead" not in capsys.readouterr().out


def test_a_given_model_is_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without noise to speak of, nothing of other frames fits but what is equal."""
    paths, _ = raw_burst(tmp_path, "bayer", (96, 120), 2)
    out = str(tmp_path / "out.png")
    assert main(["merge-burst", *map(str, paths), "--out", out, "--noise", "0", "1e-9", "--radii", "2", "2"]) == 0
    assert "the mean of 1.0 photographs" in capsys.readouterr().out
    assert main(["merge-burst", *map(str, paths), "--out", out, "--noise", "1", "1", "--force"]) == 0
    assert "the mean of 2.0 photographs" in capsys.readouterr().out


Told = Callable[..., str]


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Told:
    """In a folder with files good and bad: run what must fail, and return the one line that it says."""
    monkeypatch.chdir(tmp_path)
    raw = np.full((96, 120), 500, np.uint16)
    for name in ("a", "b"):
        write_dng(Path(f"{name}.dng"), raw, BAYER)
    write_dng(Path("small.dng"), raw[:80], BAYER)
    write_dng(Path("tiny.dng"), raw[:40, :40], BAYER)
    write_dng(Path("xtrans.dng"), raw, XTRANS)
    write_dng(Path("longer.dng"), raw, BAYER, seconds=0.1)
    write_dng(Path("other.dng"), raw, BAYER, white=4095)
    Path("bad.dng").write_bytes(Path("a.dng").read_bytes()[:100])
    Path("text.nef").write_text("no photograph")
    for name, size in (("a", 96), ("b", 96), ("c", 80)):
        write_picture(Path(f"{name}.exr"), np.full((3, size, 120), 0.5, np.float32))
    write_exr(Path("depth.exr"), {"depth.Z": np.ones((96, 120), np.float32)})
    write_picture(Path("a.png"), np.full((3, 96, 120), 0.5, np.float32))
    Image.fromarray(np.zeros((96, 120), np.float32)).save("float.tif")
    Path("bad.tif").write_bytes(b"II*\0")
    write_picture(Path("b.tif"), np.full((3, 96, 120), 0.5, np.float32))
    write_dng(Path("levels.dng"), raw, BAYER, (64, 64, 64))
    write_dng(Path("white.dng"), raw, BAYER, (1023,) * 4)
    Path("bad.png").write_bytes(b"\x89PNG\r\n")
    Path("exists.exr").write_bytes(b"mine")

    def run(*arguments: str) -> str:
        assert main(["merge-burst", *arguments]) == 2
        said = capsys.readouterr().err
        assert said.startswith("nte: ")
        assert said.count("\n") == 1
        assert Path("exists.exr").read_bytes() == b"mine"
        assert not Path("out.exr").exists()
        return said

    return run


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ("a.dng", "a burst of 1 file: expected at least two"),
        ("a.dng b.dng a.dng", "a.dng: is given twice"),
        ("a.dng small.dng", "small.dng: is 120x80, a.dng is 120x96"),
        ("a.dng xtrans.dng", "xtrans.dng: of another camera than a.dng"),
        ("a.dng other.dng", "other.dng: of another camera than a.dng"),
        ("a.dng longer.dng", "longer.dng: taken with ISO 0, 0.1 s"),
        ("tiny.dng a.dng", "tiny.dng: is 40x40: expected at least 64"),
        ("a.dng bad.dng", "bad.dng: not a photograph that can be read"),
        ("text.nef a.dng", "text.nef: not a photograph that can be read"),
        ("a.dng nowhere.dng", "nowhere.dng: does not exist"),
        ("a.dng a.exr", "a.exr: is .exr, a.dng is raw"),
        ("a.exr a.png", "a.png: is .png, a.exr is .exr"),
        ("a.exr c.exr", "c.exr: is 120x80, a.exr is 120x96"),
        ("a.exr depth.exr", "depth.exr: has depth.Z: expected the layers R, G and B"),
        ("a.png float.tif", "float.tif: is .tif, a.png is .png"),
        ("float.tif b.tif", "float.tif: the TIFF cannot be read: expected a whole file of 8 or 16 bits"),
        ("bad.tif b.tif", "bad.tif: the TIFF cannot be read"),
        ("levels.dng a.dng", "levels.dng: has 3 black levels for 2x2 pixels: expected 4"),
        ("white.dng a.dng", "white.dng: has a black level of 1023 and a white level of 1023"),
        ("a.png bad.png", "bad.png: the PNG cannot be read"),
        ("a.exr b.exr --reference 3", "--reference 3: expected the number of a file, from 1 to 2"),
        ("a.exr b.exr --noise -1 0", "noise model a = -1.0, b = 0.0"),
        ("a.exr b.exr --radii -1", "radii are (-1,)"),
    ],
)
def test_a_mistake_is_told_in_a_line(told: Told, files: str, message: str) -> None:
    assert message in told(*files.split(), "--out", "out.exr")


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("exists.exr", "exists.exr: exists"),
        ("out.jpg", "out.jpg: expected a name that ends in .exr"),
        ("b.exr", "b.exr: is a file of the burst"),
    ],
)
def test_the_name_of_the_result_is_checked_first(told: Told, out: str, message: str) -> None:
    assert message in told("a.exr", "b.exr", "--out", out, *(["--force"] if out == "b.exr" else []))


def test_a_missing_rawpy_is_told_with_its_extra(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)
    assert "pip install 'nte-denoiser[burst]'" in told("a.dng", "b.dng", "--out", "out.exr")


def test_a_raw_file_whose_pixels_are_not_there_is_named(tmp_path: Path) -> None:
    path = write_dng(tmp_path / "a.dng", np.full((64, 64), 500, np.uint16), np.array([[0, 1], [1, 2]]))
    content = path.read_bytes()
    place = content.index(struct.pack("<HHI", 273, 4, 1)) + 8  # where the pixels are, in the directory
    path.write_bytes(content[:place] + struct.pack("<I", len(content) - 100) + content[place + 4 :])
    with pytest.raises(NteError, match=r"a\.dng: not a photograph that can be read"):
        read_raw(path)
