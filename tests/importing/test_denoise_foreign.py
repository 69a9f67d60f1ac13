"""`nte denoise` on other renderers' frames: read as an import reads them, written as they were but for the image."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from nte.cli import main
from nte.denoiser import Noisy, Result
from nte.errors import NteError
from nte.filters.taa import Taa
from nte.frames.clip import Clip
from nte.frames.exr import read_layers, read_parts, write_exr
from nte.frames.frame import Frame
from nte.importing.recognise import recognise
from nte.sequences.denoise import denoise_files
from nte.session import Session
from tests.importing.producers import blender, engine, named, scene, write_layers, write_map
from tests.importing.test_maps import arnold, falcor, vray
from tests.synthetic import Pixels

Producer = Callable[[Path, Sequence[dict[str, Pixels]]], tuple[Path, list[str]]]
ATTRIBUTES = {"owner": "an artist", "cryptomatte/0a1b2c3/manifest": '{"Cube": "3f8c1b2a"}', "pixelAspectRatio": 1.5}

RNG = np.random.default_rng(3)


class Guided(Noisy):
    """One that looks at guides where they are."""

    optional = ("albedo", "normal")


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


def test_a_layer_that_is_not_there_is_not_replaced_by_another(cycles: Path, tmp_path: Path) -> None:
    with pytest.raises(NteError, match=r"shot\.001\.exr: no layer Beauty for the denoised image to replace"):
        denoise_files([cycles], Noisy(), tmp_path / "out", overrides=["result=Beauty"], say=silent)
    assert not list((tmp_path / "out").glob("*.exr"))
    for path in cycles.iterdir():  # «Combined» is a pass that may be switched off
        write_exr(path, {name: pixels for name, pixels in read_layers(path).items() if ".Combined." not in name})
    written = denoise_files([cycles], Noisy(), tmp_path / "out", say=silent)
    assert "View Layer.001.Noisy Image.R" in read_layers(written[0])


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


def test_a_change_to_no_map_and_a_folder_beside_others_are_told(tmp_path: Path) -> None:
    layers = {f"color.{c}": np.ones((8, 9), np.float32) for c in "RGB"}
    one, other = (write_layers(tmp_path / name, [layers] * 2) for name in ("one", "other"))
    told = r"shot\.000\.exr: shutter=0\.5 changes a channel map, but these are nte's own channels: leave --set out, or"
    with pytest.raises(NteError, match=told):
        denoise_files([one], Noisy(), tmp_path / "out", overrides=["shutter=0.5"], say=silent)
    with pytest.raises(NteError, match="one: is a folder beside others: expected one folder, or the files of one seq"):
        denoise_files([one, other], Noisy(), tmp_path / "out", say=silent)


def test_what_no_map_fits_is_one_line_that_says_how_to_go_on(tmp_path: Path) -> None:
    strange = write_layers(tmp_path / "a", [named("mist", "XYZ", np.ones((3, 8, 9), np.float32))] * 2)
    plain = write_layers(tmp_path / "b", [dict(zip("RGB", np.ones((3, 8, 9), np.float32), strict=True))] * 2)
    for folder, more in (
        (strange, "$"),
        (plain, r"; of R, G and B a file with the line 'channels: \{color: \.\}' is enough$"),
    ):
        match = rf"shot\.000\.exr: has no channel of ours.*--map, a file or arn.*vray{more}"
        with pytest.raises(NteError, match=match) as error:
            denoise_files([folder], Noisy(), tmp_path / "out")
        assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()
    (tmp_path / "empty").mkdir()
    with pytest.raises(NteError, match=r"no clip\.json and no \.exr frames"):
        denoise_files([tmp_path / "empty"], Noisy(), tmp_path / "out")


@pytest.mark.parametrize(
    "layers",
    [
        "R G B albedo.R albedo.G albedo.B sh_normal.X sh_normal.Y sh_normal.Z depth.T position.X position.Y position.Z",
        "R G B Z N.R N.G N.B P.R P.G P.B MotionVectors.R MotionVectors.G",
        "R G B Z normals.X normals.Y normals.Z velocity.X velocity.Y",
    ],
    ids=["Mitsuba's kinds, whose depth is the ray's length", "Redshift", "an engine's own"],
)
def test_names_that_many_engines_use_tell_no_renderer(tmp_path: Path, layers: str) -> None:
    path = tmp_path / "shot.1.exr"
    write_exr(path, {name: np.full((4, 4), i, np.float32) for i, name in enumerate(layers.split())})
    with pytest.raises(NteError, match=r"shot\.1\.exr: has names that many engines use; it has .*--map, a file or ar"):
        recognise(path)


def test_colour_alone_is_read_by_a_map_of_one_line_and_has_no_guides_to_tell_of(tmp_path: Path) -> None:
    folder = write_layers(tmp_path / "plain", [dict(zip("RGB", np.ones((3, 8, 9), np.float32), strict=True))] * 2)
    (tmp_path / "rgb.yaml").write_text("channels: {color: .}")
    said: list[str] = []
    denoise_files([folder], Guided(), tmp_path / "out", map_name=str(tmp_path / "rgb.yaml"), say=said.append)
    assert said == ["read as OpenEXR files (--map rgb)", "read color from R G B"]


def test_a_pass_that_is_missing_in_the_middle_names_the_file(cycles: Path, tmp_path: Path) -> None:
    second = sorted(cycles.iterdir())[1]
    layers = {name: pixels for name, pixels in read_layers(second).items() if ".Vector." not in name}
    write_exr(second, layers)
    with pytest.raises(NteError, match=rf"{second.name}.*'motion'"):
        denoise_files([cycles], Taa(), tmp_path / "out", say=silent)


def test_frames_that_are_called_like_those_of_a_clip(cycles: Path, tmp_path: Path) -> None:
    for index, path in enumerate(sorted(cycles.iterdir())):
        path.rename(cycles / f"frame_{index:04d}.exr")
    assert len(denoise_files([cycles], Noisy(), tmp_path / "out", say=silent)) == 3


def test_one_file_a_channel(tmp_path: Path) -> None:
    folder, _ = falcor(tmp_path, scene(2))
    written = denoise_files([folder], Noisy(), tmp_path / "out", map_name="falcor", say=silent)
    assert [path.name for path in written] == ["Mogwai.PathTracer.color.98.exr", "Mogwai.PathTracer.color.99.exr"]


def test_files_that_a_map_finds_itself_are_not_chosen_one_by_one(tmp_path: Path) -> None:
    """Those in the folder that were not given would be denoised as well."""
    folder, _ = falcor(tmp_path, scene(3))
    with pytest.raises(NteError, match=r"color.99.exr: the channel map names .* \('\*\.color\.#\.exr'\): expected"):
        denoise_files(
            [folder / "Mogwai.PathTracer.color.99.exr"], Noisy(), tmp_path / "out", map_name="falcor", say=silent
        )
    written = denoise_files([folder], Noisy(), tmp_path / "out", map_name="falcor", say=silent, wanted=range(99, 100))
    assert [path.name for path in written] == ["Mogwai.PathTracer.color.99.exr"]


def test_a_folder_a_channel(tmp_path: Path) -> None:
    """The folder that is named holds no frame itself."""
    folder, _ = falcor(tmp_path, scene(2))
    for path in list(folder.iterdir()):
        output = path.name.split(".")[2]
        (folder / output).mkdir(exist_ok=True)
        path.rename(folder / output / path.name)
    files = {name: {"file": f"{output}/*.#.exr"} for name, output in (("color", "color"), ("motion", "mvec"))}
    below = str(write_map(tmp_path / "below.yaml", {"channels": files}))
    written = denoise_files([folder], Noisy(), tmp_path / "out", map_name=below, say=silent)
    assert [path.name for path in written] == ["Mogwai.PathTracer.color.98.exr", "Mogwai.PathTracer.color.99.exr"]
    for path in (folder / "mvec").iterdir():
        path.rename(path.with_name(path.name.replace("GBufferRT.mvec", "PathTracer.color")))
    with pytest.raises(NteError, match="mvec: holds the noisy frames themselves"):
        denoise_files([folder], Noisy(), folder / "mvec", map_name=below, say=silent, force=True)
    with pytest.raises(NteError, match=r"no \.exr file in it"):
        denoise_files([folder], Noisy(), tmp_path / "out", map_name="arnold", say=silent)


def test_scaled_radiance_goes_back_to_its_units(tmp_path: Path) -> None:
    """1e-8 of the unit, in float: half floats would hold none of it."""
    given = {f"beauty.{c}": np.float32(1e-8) * RNG.random((8, 9), np.float32) for c in "RGB"}
    folder = write_layers(tmp_path / "shots", [given])
    about = {"channels": {"color": {"layer": "beauty", "scale": 1e8}}}
    map_path = write_map(tmp_path / "map.yaml", about)
    written = denoise_files([folder], Noisy(), tmp_path / "out", map_name=str(map_path), say=silent)
    found = read_layers(written[0])
    for name, plane in given.items():
        np.testing.assert_allclose(found[name], plane, rtol=1e-5)


def test_a_grey_image_stays_grey(tmp_path: Path) -> None:
    folder = write_layers(tmp_path / "shots", [{"Y": RNG.random((8, 9), np.float32)}])
    map_path = write_map(tmp_path / "map.yaml", {"channels": {"color": "."}})

    class Tinted(Noisy):
        def step(self, *arguments: Any, **options: Any) -> tuple[Result, Any]:
            result, state = super().step(*arguments, **options)
            return Result(result.image * np.reshape([0.5, 1.0, 3.0], (1, 3, 1, 1)).astype(np.float32)), state

    written = denoise_files([folder], Tinted(), tmp_path / "out", map_name=str(map_path), say=silent)
    before, after = read_layers(sorted(folder.iterdir())[0]), read_layers(written[0])
    np.testing.assert_allclose(after["Y"], 1.5 * before["Y"], rtol=1e-5)


@pytest.mark.parametrize("change", ["view=right", "part=right", "part=1"])
def test_one_eye_of_a_stereo_file(tmp_path: Path, change: str) -> None:
    folder = tmp_path / "shots"
    folder.mkdir()
    parts = [
        OpenEXR.Part(
            {"name": view, "view": view, "type": OpenEXR.scanlineimage},
            {c: np.full((8, 9), value, np.float32) for c in "RGB"},
        )
        for view, value in (("left", 1.0), ("right", 2.0))
    ]
    OpenEXR.File(parts).write(str(folder / "a.1.exr"))
    layer = "right" if change.startswith("view") else "."
    map_path = write_map(tmp_path / "map.yaml", {"channels": {"color": {"layer": layer, "scale": 0.5}}})
    spec = ["denoise", str(folder), "--denoiser", "noisy", "--map", str(map_path), "--out", str(tmp_path / "out")]
    assert main([*spec, "--exposure", "1", "--set", change]) == 0
    before, after = (read_parts(path / "a.1.exr") for path in (folder, tmp_path / "out"))
    for c in "RGB":
        np.testing.assert_array_equal(after[0].layers[c], before[0].layers[c])
        np.testing.assert_array_equal(after[1].layers[c], before[1].layers[c])


def test_of_two_view_layers_one_is_chosen(cycles: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in cycles.iterdir():
        layers = read_layers(path)
        write_exr(path, layers | {name.replace("View Layer.001", "Hair"): p for name, p in layers.items()})
    spec = ["denoise", str(cycles), "--denoiser", "taa", "--out", str(tmp_path / "out")]
    assert main(spec) == 2
    assert "has the layers Hair, View Layer.001: choose one with prefix=NAME" in capsys.readouterr().err
    assert main([*spec, "--set", "prefix=Hair"]) == 0
    path = sorted(cycles.iterdir())[2]
    before, after = read_layers(path), read_layers(tmp_path / "out" / path.name)
    changed = {name for name in before if not np.array_equal(before[name], after[name])}
    assert changed == {f"Hair.Combined.{c}" for c in "RGB"}


def test_two_passes_of_cycles_are_enough(tmp_path: Path) -> None:
    folder = blender(tmp_path / "shots", scene(1))
    path = next(folder.iterdir())
    write_exr(path, {n: p for n, p in read_layers(path).items() if n.split(".")[2] in ("Combined", "Depth")})
    assert recognise(path) == "blender"


def test_only_the_whole_image_is_put_in_anothers_file(cycles: Path, tmp_path: Path) -> None:
    other = Noisy()
    other.target = "indirect"
    with pytest.raises(NteError, match=r"shot\.001\.exr: has no 'indirect', which this denoiser gives"):
        denoise_files([cycles], other, tmp_path / "out", say=silent)


def test_the_shutter_and_the_cameras_of_the_map_reach_the_denoiser(tmp_path: Path) -> None:
    folder, map_path = engine(tmp_path, scene(2))
    seen: list[Frame] = []

    class Looking(Noisy):
        def step(self, frame: Frame, *arguments: Any, **options: Any) -> tuple[Result, Any]:
            seen.append(frame)
            return super().step(frame, *arguments, **options)

    changes = ["shutter=0.5"]
    denoise_files([folder], Looking(), tmp_path / "out", None, False, False, str(map_path), changes, silent)
    for frame in seen:
        assert frame.shutter == 0.5
        assert np.shape(frame.view) == (1, 4, 4)


def test_one_eye_of_a_part_that_holds_both(tmp_path: Path) -> None:
    names = ("R", "G", "B", "right.R", "right.G", "right.B")  # the first view goes without its name
    layers = {name: np.full((8, 9), 1 + ("right" in name), np.float32) for name in names}
    (tmp_path / "shots").mkdir()
    header = {"type": OpenEXR.scanlineimage, "multiView": ["left", "right"]}
    OpenEXR.File(header, dict(layers)).write(str(tmp_path / "shots" / "a.1.exr"))
    map_path = str(write_map(tmp_path / "map.yaml", {"channels": {"color": "."}}))
    black = Noisy()
    black.step = lambda frame, *_: (Result(0 * frame["color"]), ())  # type: ignore[method-assign,assignment]
    changes = ["view=right"]
    denoise_files([tmp_path / "shots"], black, tmp_path / "out", 1.0, False, False, map_path, changes, silent)
    after = read_layers(tmp_path / "out" / "a.1.exr")
    assert {name: float(pixels.max()) for name, pixels in after.items()} == {
        name: 0.0 if "right" in name else 1.0 for name in names
    }
