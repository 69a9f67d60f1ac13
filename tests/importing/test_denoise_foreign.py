"""`nte denoise` on other renderers' frames: read as an import reads them, written as they were but for the image."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from nte.cli import main
from nte.denoiser import Noisy, Session
from nte.errors import NteError
from nte.filters.taa import Taa
from nte.frames.clip import Clip
from nte.frames.exr import read_layers, write_exr
from nte.importing.recognise import recognise
from nte.sequences import denoise_files
from tests.importing.producers import blender, engine, named, scene, write_layers
from tests.importing.test_maps import arnold, vray
from tests.synthetic import Pixels

Producer = Callable[[Path, Sequence[dict[str, Pixels]]], tuple[Path, list[str]]]
ATTRIBUTES = {"owner": "an artist", "cryptomatte/0a1b2c3/manifest": '{"Cube": "3f8c1b2a"}', "pixelAspectRatio": 1.5}


def silent(line: str) -> None:
    pass


@pytest.fixture
def cycles(tmp_path: Path) -> Path:
    """Three frames of Cycles whose Combined is denoised, with the noisy image beside it, and attributes."""
    folder = blender(tmp_path / "shots [v2] ü", scene(3))
    rng = np.random.default_rng(0)
    for path in folder.iterdir():
        layers = read_layers(path)
        shape = layers["View Layer.001.Combined.R"].shape
        for c in "RGB":
            layers[f"View Layer.001.Noisy Image.{c}"] = layers[f"View Layer.001.Combined.{c}"]
            layers[f"View Layer.001.Combined.{c}"] = np.full(shape, 0.3, np.float32)
        layers["View Layer.001.Combined.A"] = rng.random(shape, np.float32)
        layers["View Layer.001.CryptoObject00.R"] = rng.integers(0, 2**32, shape, np.uint32)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **ATTRIBUTES}
        OpenEXR.File(header, layers).write(str(path))
    return folder


def test_cycles_frames_are_denoised_as_after_an_import_and_keep_everything_else(cycles: Path, tmp_path: Path) -> None:
    assert main(["denoise", str(cycles), "--denoiser", "taa", "--out", str(tmp_path / "out")]) == 0
    assert main(["import", "blender", str(cycles), "--out", str(tmp_path / "clip")]) == 0
    session = Session(Taa())
    paths = sorted(cycles.iterdir())
    assert [path.name for path in sorted((tmp_path / "out").iterdir())] == [path.name for path in paths]
    for path, frame in zip(paths, Clip(tmp_path / "clip"), strict=True):
        before, after = read_layers(path), read_layers(tmp_path / "out" / path.name)
        image = np.stack([after[f"View Layer.001.Combined.{c}"] for c in "RGB"])
        np.testing.assert_allclose(image, session.denoise(frame)[0], rtol=2e-3, atol=1e-3)  # a clip has half floats
        assert before.keys() == after.keys()
        changed = {name for name in before if not np.array_equal(before[name], after[name])}
        assert changed == {f"View Layer.001.Combined.{c}" for c in "RGB"}
        assert all(after[name].dtype == before[name].dtype for name in set(before) - changed)
        with OpenEXR.File(str(tmp_path / "out" / path.name)) as file:
            assert {name: file.parts[0].header[name] for name in ATTRIBUTES} == ATTRIBUTES


def test_what_was_taken_for_what_is_said(cycles: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["denoise", str(cycles), "--denoiser", "noisy", "--out", str(tmp_path / "out")])
    said = capsys.readouterr().out
    assert "read as Blender Cycles (--map blender)" in said
    assert "color from View Layer.001.Noisy Image" in said


def test_the_sequence_is_in_order_whatever_the_folder_holds_besides(cycles: Path, tmp_path: Path) -> None:
    (cycles / "notes.txt").write_text("mine")
    (cycles / "sub").mkdir()
    for path in sorted(cycles.glob("*.exr")):
        path.rename(path.with_name(f"shot.-{int(path.stem[-3:]):04d}.exr"))  # backwards: −3 comes first
    written = denoise_files([cycles], Noisy(), tmp_path / "out", say=silent)
    assert [path.name for path in written] == ["shot.-0003.exr", "shot.-0002.exr", "shot.-0001.exr"]
    files = sorted(cycles.glob("*.exr"))  # the same files, named one by one, in another order
    denoise_files(files, Taa(), tmp_path / "one", say=silent)
    denoise_files([cycles], Taa(), tmp_path / "two", say=silent)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


@pytest.mark.parametrize(("make", "name"), [(vray, "vray"), (arnold, "arnold")])
def test_the_map_that_fits_is_found(tmp_path: Path, make: Producer, name: str) -> None:
    folder, _ = make(tmp_path, scene(2))
    first = sorted(folder.glob("*.exr"))[0]
    assert recognise(first) == name
    written = denoise_files([folder], Noisy(), tmp_path / "out", say=silent)
    before, after = read_layers(first), read_layers(written[0])
    for key in before:
        np.testing.assert_allclose(after[key], before[key], rtol=1e-6)  # the input itself, back in its place


def test_a_map_of_ones_own_and_stored_units(tmp_path: Path) -> None:
    folder, map_path = engine(tmp_path, scene(2))
    stored = "color: {layer: beauty, scale: 2.0, offset: 0.5}"
    map_path.write_text(map_path.read_text().replace("color: beauty", stored))
    written = denoise_files([folder], Noisy(), tmp_path / "out", map_name=str(map_path), say=silent)
    before, after = read_layers(sorted(folder.iterdir())[0]), read_layers(written[0])
    assert before.keys() == after.keys()
    for c in "rgb":
        np.testing.assert_allclose(after[f"beauty.{c}"], before[f"beauty.{c}"], rtol=1e-3, atol=1e-3)


def test_what_no_map_fits_is_one_line_that_says_how_to_go_on(tmp_path: Path) -> None:
    strange = write_layers(tmp_path / "a", [named("mist", "XYZ", np.ones((3, 8, 9), np.float32))] * 2)
    plain = write_layers(tmp_path / "b", [dict(zip("RGB", np.ones((3, 8, 9), np.float32), strict=True))] * 2)
    for folder in (strange, plain):
        with pytest.raises(NteError, match=r"shot\.000\.exr: has no channel of ours.*--map, a file or arn") as error:
            denoise_files([folder], Noisy(), tmp_path / "out")
        assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()
    (tmp_path / "empty").mkdir()
    with pytest.raises(NteError, match=r"no clip\.json and no \.exr frames"):
        denoise_files([tmp_path / "empty"], Noisy(), tmp_path / "out")


def test_a_pass_that_is_missing_in_the_middle_names_the_file(cycles: Path, tmp_path: Path) -> None:
    second = sorted(cycles.iterdir())[1]
    layers = {name: pixels for name, pixels in read_layers(second).items() if ".Vector." not in name}
    write_exr(second, layers)
    with pytest.raises(NteError, match=rf"{second.name}.*'motion'"):
        denoise_files([cycles], Taa(), tmp_path / "out", say=silent)
