import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR
import pytest
import yaml

from nte.cli import main
from nte.errors import NteError
from nte.files import temporary_name
from nte.frames.clip import Clip
from nte.frames.exr import read_exr, write_exr
from nte.importing.channel_map import load_channel_map
from nte.importing.convert import with_motion
from nte.importing.write import write_imported
from tests.importing.producers import MOVING, engine, named, scene, write_layers, write_map
from tests.subsampled import write_subsampled
from tests.synthetic import disc_frame


def change(map_path: Path, **groups: Any) -> None:
    about = yaml.safe_load(map_path.read_text())
    for name, values in groups.items():
        about[name] = {**about[name], **values} if isinstance(values, dict) and name in about else values
    write_map(map_path, about)


def run(source: Path, map_path: Path, out: Path, *more: str) -> int:
    return main(["import", "exr", str(source), "--map", str(map_path), "--out", str(out), *more])


def test_an_engines_conventions_become_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = scene()
    source, map_path = engine(tmp_path, frames)
    assert run(source, map_path, tmp_path / "clip") == 0
    assert "clip: plausible" in capsys.readouterr().out
    clip = Clip(tmp_path / "clip")
    assert len(clip.info["cameras"]) == 4
    for index, frame in enumerate(frames):
        found = clip.frame(index)
        for name in ("color", "reference", "albedo", "normal", "depth", "instance", "motion"):
            np.testing.assert_allclose(found[name][0], frame[name], rtol=1e-3, atol=1e-3, err_msg=name)


def test_the_documented_map_is_valid(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "datasets" / "IMPORT.md").read_text(encoding="utf-8")
    map_path = tmp_path / "map.yaml"
    map_path.write_text(page.split("```yaml\n")[1].split("```")[0])
    assert load_channel_map(map_path).channels["color"].layer == ["beauty"]


def test_a_field_of_view_is_enough_for_ray_lengths(tmp_path: Path) -> None:
    frames = scene(2)
    source, map_path = engine(tmp_path, frames)
    change(map_path, normal={"space": "world"}, cameras="", vertical_fov=50.0)
    assert run(source, map_path, tmp_path / "clip") == 0
    found = Clip(tmp_path / "clip").frame(1)
    np.testing.assert_allclose(found["depth"][0], frames[1]["depth"], rtol=1e-4)


@pytest.mark.parametrize("aspect", [2.0, 0.5, 1.0])
def test_a_field_of_view_with_pixels_that_are_not_square(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], aspect: float
) -> None:
    """A wall across the view axis: the length of its rays follows from where pixels lie when they are shown."""
    height, width = size = 24, 36
    y, x = np.mgrid[:height, :width] + 0.5
    focal = height / 2 / np.tan(np.radians(25))
    rays = 5 * np.sqrt(1 + ((x - width / 2) * aspect / focal) ** 2 + ((y - height / 2) / focal) ** 2)
    layers = {name: np.ones(size, np.float32) for name in "RGB"} | {"Z": rays.astype(np.float32)}
    (tmp_path / "shots").mkdir()
    header = {"type": OpenEXR.scanlineimage, "pixelAspectRatio": aspect}
    with OpenEXR.File(header, layers) as file:
        file.write(str(tmp_path / "shots" / "a.1.exr"))
    about = {"channels": {"color": ".", "depth": "Z"}, "depth": {"along": "ray"}, "vertical_fov": 50.0}
    assert run(tmp_path / "shots", write_map(tmp_path / "map.yaml", about), tmp_path / "clip") == 0
    np.testing.assert_allclose(Clip(tmp_path / "clip").frame(0)["depth"], 5, rtol=1e-4)
    told = f"not square: pixels are {aspect:g} times as wide as high"
    assert (told in capsys.readouterr().out) == (aspect != 1)


def test_subsampled_channels_are_left_out_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "shots").mkdir()
    layers = {name: np.ones((8, 12), np.float32) for name in "RGB"} | {"matte.V": np.ones((4, 6), np.float32)}
    write_subsampled(tmp_path / "shots" / "a.1.exr", layers)
    about: dict[str, Any] = {"channels": {"color": ".", "roughness": "matte"}, "optional": True}
    assert run(tmp_path / "shots", write_map(tmp_path / "map.yaml", about), tmp_path / "clip") == 0
    assert "left out: matte.V: subsampled, without a value for every pixel" in capsys.readouterr().out
    assert Clip(tmp_path / "clip").channels == ("color",)
    write_map(tmp_path / "map.yaml", about | {"optional": False})
    assert run(tmp_path / "shots", tmp_path / "map.yaml", tmp_path / "other") == 2
    assert "the file has B, G, R; without a value for every pixel: matte.V" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"points": "to"}, "motion.points: from (now to)"),
        ({"y_axis": "down"}, "motion.y_axis: up (now down)"),
        ({"axes": "yx"}, "motion.axes: xy (now yx)"),
        ({"unit": "pixels"}, "motion.unit: uv (now pixels)"),
        ({"unit": "ndc"}, "motion.unit: uv (now ndc)"),
        ({"points": "to", "y_axis": "down", "unit": "pixels"}, "points: from (now to), motion.y_axis: up (now down)"),
    ],
)
def test_a_wrong_map_is_told_what_would_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], wrong: dict[str, str], told: str
) -> None:
    source, map_path = engine(tmp_path, scene())
    change(map_path, motion=wrong)
    assert run(source, map_path, tmp_path / "clip") == 2
    said = capsys.readouterr().out
    assert "clip: implausible" in said
    assert told in said
    assert f"change it in {map_path}" in said
    assert len(Clip(tmp_path / "clip")) == 4  # kept


def accelerating(folder: Path, channel: str, unit: float = 1.0) -> tuple[Path, Path]:
    """A wall that speeds up, with vectors on each frame's pixels that point to the next one; unit: of x, in px."""
    places = [0.0, 4.0, 9.5, 17.0, 26.5, 38.0]
    written = []
    for i in range(5):
        albedo = disc_frame(1, size=(64, 96), radius=0, wall_velocity=(places[i], 0))["albedo"]
        step = np.full((64, 96), (places[i + 1] - places[i]) / unit, np.float32)
        written.append({"R": albedo[0], "G": albedo[1], "B": albedo[2], "v.x": step, "v.y": 0 * step})
    about = {"channels": {"color": ["R", "G", "B"], "albedo": ["R", "G", "B"], channel: "v"}}
    return write_layers(folder / "wall", written), write_map(folder / "map.yaml", about)


@pytest.mark.parametrize(("unit", "more"), [(1, ""), (96, ", forward_motion.unit: uv")])
def test_forward_vectors_are_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], unit: float, more: str
) -> None:
    assert run(*accelerating(tmp_path, "motion", unit), tmp_path / "clip") == 2
    change = f"the layers under 'channels.forward_motion' instead of 'channels.motion'{more}"
    assert f"the vectors would fit with {change}: change it in" in capsys.readouterr().out


def test_motion_is_made_from_forward_vectors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*accelerating(tmp_path, "forward_motion"), tmp_path / "clip") == 0
    assert "clip: plausible" in capsys.readouterr().out
    found = Clip(tmp_path / "clip")
    assert not found.frame(0)["motion"].any()
    # What came into the image at the left moves as its neighbours do.
    np.testing.assert_allclose(found.frame(3)["motion"][0, 0], -7.5, atol=1e-4)


def test_hidden_pixels_move_like_the_neighbour_at_their_depth(tmp_path: Path) -> None:
    frames = [disc_frame(i, **MOVING) for i in range(3)]  # type: ignore[arg-type]
    layers = [
        {"R": f["color"][0], "G": f["color"][1], "B": f["color"][2], "z": f["depth"][0]}
        | {"v.x": f["forward_motion"][0], "v.y": f["forward_motion"][1]}
        for f in frames
    ]
    about = {"channels": {"color": ["R", "G", "B"], "depth": "z", "forward_motion": "v"}}
    source, map_path = write_layers(tmp_path / "disc", layers), write_map(tmp_path / "map.yaml", about)
    assert run(source, map_path, tmp_path / "clip") == 0
    found = Clip(tmp_path / "clip").frame(2)["motion"][0]
    wrong = np.abs(found - frames[2]["motion"]).max(0) > 1e-3
    assert wrong.mean() < 0.02  # half pixels at the rim of the disc


def test_the_sky_is_behind_what_forward_vectors_leave_open() -> None:
    """A hole on a surface before a wall and the sky: the wall is nearer to it in depth, although the sky's is 0."""
    depth = np.float32([[[0, 0, 3, 7, 7]]])
    forward = np.zeros((2, 1, 5), np.float32)
    forward[0] = 0.25, 0.25, 100, -0.25, -0.25
    frame = {"color": np.ones((3, 1, 5), np.float32), "depth": depth, "forward_motion": forward}
    *_, found = with_motion([frame, frame])
    np.testing.assert_array_equal(found["motion"][0], [[-0.25, -0.25, 0.25, 0.25, 0.25]])


def test_what_is_missing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, map_path = engine(tmp_path, scene(2))
    change(map_path, channels={"channels": None})
    write_map(map_path, {"channels": {"color": "beauty", "depth": "distance"}})
    assert run(source, map_path, tmp_path / "clip") == 0
    said = capsys.readouterr().out
    for name in ("reference", "albedo", "normal", "motion"):
        assert f"without {name}: " in said
    assert "not checked: that needs albedo and motion" in said


def test_each_channel_of_an_optional_map_that_the_files_lack_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A layer that is misspelt, also on the command line, would be missed by nobody else."""
    source, map_path = engine(tmp_path, scene(2))
    about = {"color": "beauty", "roughness": "rough", "geometric_normal": "Ng"}
    write_map(map_path, {"channels": about, "optional": True, "normal": {"space": "camera"}})
    assert run(source, map_path, tmp_path / "clip", "channels.instance=objekt") == 0
    lacks = "'normal.space' is camera: 'cameras' must name the JSON file of the cameras"
    said = f"  also without geometric_normal (left out: {lacks}), roughness ('rough'), instance ('objekt')\n"
    assert said in capsys.readouterr().out
    assert run(source, map_path, tmp_path / "clip", "channels.instance=object", "--force") == 0
    assert "instance (" not in capsys.readouterr().out


def test_reference_files_of_their_own(tmp_path: Path) -> None:
    frames = scene(2)
    source, map_path = engine(tmp_path, frames)
    write_map(map_path, {"channels": {"color": "beauty"}})
    clean = write_layers(tmp_path / "clean", [named("beauty", "RGB", f["reference"]) for f in frames], first=1001)
    assert run(source, map_path, tmp_path / "clip", "--reference", str(clean)) == 0
    np.testing.assert_array_equal(Clip(tmp_path / "clip").frame(1)["reference"][0], frames[1]["reference"])


def test_what_a_map_says_of_the_reference_leaves_the_layer_that_of_color(tmp_path: Path) -> None:
    """As the page says: the map's layer, or that of color; R, G and B of the same file may be another picture."""
    frames = scene(2)
    layers = [named("beauty", "RGB", f["reference"]) | dict(zip("RGB", f["albedo"], strict=True)) for f in frames]
    source = write_layers(tmp_path / "noisy", [named("beauty", "RGB", f["color"]) for f in frames])
    clean = write_layers(tmp_path / "clean", layers)
    map_path = write_map(tmp_path / "map.yaml", {"channels": {"color": "beauty", "reference": {"scale": 2}}})
    run(source, map_path, tmp_path / "clip", "--reference", str(clean))
    np.testing.assert_allclose(Clip(tmp_path / "clip").frame(1)["reference"][0], 2 * frames[1]["reference"], rtol=1e-6)


def test_a_single_reference_of_another_number_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The numbers may be those of samples, or of two frames."""
    layers = {c: np.ones((8, 12), np.float32) for c in "RGB"}
    map_path = write_map(tmp_path / "map.yaml", {"channels": {"color": "."}})
    for name in ("noisy_16spp", "clean_4096spp", "clean_16spp"):
        write_exr(tmp_path / f"{name}.exr", layers)
    told = (
        "reference: clean_4096spp.exr is taken for noisy_16spp.exr, whose number is another: are they the same frame?"
    )
    for name in ("clean_4096spp", "clean_16spp"):
        more = ("--force", "--reference", str(tmp_path / f"{name}.exr"))
        assert run(tmp_path / "noisy_16spp.exr", map_path, tmp_path / "clip", *more) == 0
        assert (told in capsys.readouterr().out) == (name == "clean_4096spp")


def test_a_clip_below_a_folder_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, map_path = engine(tmp_path, scene(2))
    assert run(source, map_path, tmp_path / "nosuch" / ".." / "clip") == 0
    assert "clip: plausible" in capsys.readouterr().out
    assert len(Clip(tmp_path / "clip")) == 2


def breaking(**cases: tuple[Callable[[Path, Path], object], str]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize(("harm", "said"), list(cases.values()), ids=list(cases))


def set_map(**groups: Any) -> Callable[[Path, Path], object]:
    return lambda source, map_path: change(map_path, **groups)


def camera_that(
    **changes: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]],
) -> Callable[[Path, Path], object]:
    """The cameras beside the map with other matrices; they stand away from the origin."""

    def harm(source: Path, map_path: Path) -> None:
        path = map_path.parent / "cameras.json"
        cameras = json.loads(path.read_text())
        for camera in cameras:
            matrices = {key: np.array(matrix) for key, matrix in camera.items()}
            matrices["view"][:3, 3] = 1.0, -2.0, 3.0
            camera.update({k: (changes[k](m) if k in changes else m).tolist() for k, m in matrices.items()})
        path.write_text(json.dumps(cameras))

    return harm


TAA = np.array([[0, 0, 0.008, 0], [0, 0, -0.005, 0], [0] * 4, [0] * 4])  # moves a projection by a part of a pixel


@breaking(
    unknown_key=(set_map(directions="to"), "directions"),
    unknown_group_key=(set_map(motion={"sign": 1}), "motion.sign"),
    unknown_channel=(set_map(channels={"beauty": "x"}), "'channels.beauty': no such channel, expected one of color,"),
    unknown_value=(set_map(motion={"unit": "metres"}), "'motion.unit' is 'metres', expected one of pixels, uv, ndc"),
    wrong_count=(set_map(channels={"albedo": ["a", "b"]}), "'channels.albedo': ['a', 'b']: expected a layer, or the"),
    no_color=(lambda s, m: write_map(m, {"channels": {"albedo": "basecolor"}}), "'channels.color' is missing"),
    no_cameras=(set_map(cameras=""), "'normal.space' is camera: 'cameras' must name"),
    no_fov=(set_map(cameras="", normal={"space": "world"}), "'depth.along' is ray: give 'vertical_fov'"),
    cameras_missing=(set_map(cameras="none.json"), "none.json: cannot be read"),
    cameras_few=(lambda s, m: (m.parent / "cameras.json").write_text("[]"), "0 cameras for 4 frames"),
    cameras_odd=(lambda s, m: (m.parent / "cameras.json").write_text('{"a": 1}'), "expected a JSON list of view and"),
    cameras_singular=(
        lambda s, m: (m.parent / "cameras.json").write_text(
            json.dumps([{"view": np.zeros((4, 4)).tolist(), "projection": np.eye(4).tolist()}] * 4)
        ),
        "camera 0: 'view' is not an invertible 4×4 matrix",
    ),
    cameras_of_rows=(camera_that(view=lambda m: m.T), "camera 0: the last row of 'view' is not 0 0 0 1: transpose"),
    cameras_to_ndc=(
        camera_that(projection=lambda m: np.array([[2, 0, 0, -1], [0, -2, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]]) @ m),
        "camera 0: 'projection' puts the view axis at 0 0: expected [0, 1]",
    ),
    cameras_to_ndc_with_jitter=(
        camera_that(
            projection=lambda m: np.array([[2, 0, 0, -1], [0, -2, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]]) @ m + TAA
        ),
        "camera 0: 'projection' puts the view axis at 0.008 -0.005: expected [0, 1]",
    ),
    cameras_in_pixels=(
        camera_that(projection=lambda m: np.diag([64, 48, 1, 1]) @ m),
        "camera 0: 'projection' puts the view axis at 32 24: expected [0, 1]",
    ),
    layer_missing=(set_map(channels={"albedo": "diffuse"}), "no diffuse for 'albedo' (3 components); the file has"),
    gap=(lambda s, m: (s / "shot.1003.exr").unlink(), "frame 1003 is missing: after shot.1002.exr comes shot.1004.exr"),
    twice=(lambda s, m: (s / "shot.01003.exr").write_bytes(b""), "frame 1003 is there twice (shot.01003.exr and shot."),
    two=(
        lambda s, m: (s / "b.1003.exr").write_bytes(b""),
        "holds 2 sequences, b.1003.exr (1 file) and shot.1001.exr (4 files): choose one by a pattern",
    ),
    unnumbered=(lambda s, m: (s / "b.exr").write_bytes(b""), "b.exr: has no frame number"),
    no_exr=(lambda s, m: [p.rename(p.with_suffix(".png")) for p in s.iterdir()], "no .exr file in it"),
    not_exr=(lambda s, m: (s / "shot.1002.exr").write_text("text"), "shot.1002.exr: not an OpenEXR file"),
    other_size=(
        lambda s, m: write_layers(s, [{n: np.ones((8, 8)) for n in LAYERS}], first=1002),
        "shot.1002.exr: 'color' is 8x8, expected 64x48 like",
    ),
)
def test_bad_input_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], harm: Callable[[Path, Path], object], said: str
) -> None:
    source, map_path = engine(tmp_path, scene())
    harm(source, map_path)
    before = set(tmp_path.iterdir())
    assert run(source, map_path, tmp_path / "clip") == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert said in error[0]
    assert set(tmp_path.iterdir()) == before


LAYERS = [
    *("beauty.r", "beauty.g", "beauty.b", "clean.R", "clean.G", "clean.B", "N.X", "N.Y", "N.Z", "object.ID"),
    *("basecolor.R", "basecolor.G", "basecolor.B", "velocity.U", "velocity.V", "distance"),
]


def test_sequences_of_unequal_length(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, map_path = engine(tmp_path, scene())
    shorter = tmp_path / "shorter"
    shorter.mkdir()
    for path in sorted(source.iterdir())[:3]:
        (shorter / path.name).write_bytes(path.read_bytes())
    assert run(source, map_path, tmp_path / "clip", "--reference", str(shorter)) == 2
    assert "has 3 frames (1001 to 1003)" in capsys.readouterr().err


def test_only_a_clip_is_replaced_and_only_with_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, map_path = engine(tmp_path, scene(2))
    out = tmp_path / "clip"
    out.mkdir()
    assert run(source, map_path, out) == 0  # an empty folder is as good as none
    assert run(source, map_path, out) == 2
    assert "exists: choose another name, or replace the clip with --force" in capsys.readouterr().err
    change(map_path, depth={"scale": 1.0})
    assert run(source, map_path, out, "--force") == 0
    assert Clip(out).frame(0)["depth"].max() > 100
    assert {path.name for path in tmp_path.iterdir()} == {"clip", "cameras.json", "engine", "map.yaml"}
    # A failure leaves the clip that is there.
    (source / "shot.1002.exr").write_text("broken")
    assert run(source, map_path, out, "--force") == 2
    assert len(Clip(out)) == 2
    for name in ("renders/1.png", "seed_01/notes.txt"):
        mine = out / name
        mine.parent.mkdir()
        mine.write_text("…")
        assert run(source, map_path, out, "--force") == 2
        assert (
            f"clip: has '{name}', which is no part of a clip and would be lost: move it elsewhere"
            in capsys.readouterr().err
        )
        assert mine.is_file()
        mine.unlink()
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("…")
    assert run(source, map_path, mine, "--force") == 2
    assert "is not a clip, so --force does not replace it" in capsys.readouterr().err
    assert (mine / "thesis.txt").exists()


def test_wrong_forward_vectors_are_told_by_their_own_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, map_path = accelerating(tmp_path, "forward_motion")
    change(map_path, forward_motion={"points": "from"})
    assert run(source, map_path, tmp_path / "clip") == 2
    assert "would fit with forward_motion.points: to (now from)" in capsys.readouterr().out


def test_albedo_in_another_scale_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, map_path = engine(tmp_path, scene(2))
    change(map_path, channels={"albedo": {"layer": "basecolor", "scale": 255}})
    run(source, map_path, tmp_path / "clip")
    said = capsys.readouterr().out
    assert "cut to [0, 1]: 9" in said
    assert "channels.albedo.scale" in said
    assert run(*engine(tmp_path, scene(2)), tmp_path / "right") == 0
    assert "cut to [0, 1]" not in capsys.readouterr().out


def test_depth_of_the_other_sign_is_told_where_there_is_no_albedo(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, map_path = engine(tmp_path, scene(2))
    write_map(map_path, {"channels": {"color": "beauty", "normal": "N", "depth": {"layer": "distance", "scale": -1}}})
    run(source, map_path, tmp_path / "clip")
    said = capsys.readouterr().out
    assert "no pixel shows a surface: depth is stored as -" in said
    assert "see depth.scale, negative where depth counts downwards" in said


def test_a_pattern_without_quotes_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The shell has replaced it by names, of which only the first would be SOURCE."""
    source, map_path = engine(tmp_path, scene(2))
    first, second = map(str, sorted(source.iterdir()))
    assert main(["import", "exr", first, second, "--map", str(map_path), "--out", str(tmp_path / "clip")]) == 2
    assert f"'{second}': expected key=value after one SOURCE: quote a pattern" in capsys.readouterr().err


def test_the_current_folder_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The shell that is in it would be in a folder that is gone."""
    source, map_path = engine(tmp_path, scene(2))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert run(source, map_path, Path()) == 2
    assert ".: is the current folder, which the clip would replace" in capsys.readouterr().err
    assert not any(Path().iterdir())


def test_typed_cameras_are_those_of_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, map_path = engine(tmp_path, scene(2))
    mine = tmp_path / "shot"
    mine.mkdir()
    cameras = json.loads((tmp_path / "cameras.json").read_text())
    cameras[1]["view"][0][3] += 2.0
    (mine / "cameras.json").write_text(json.dumps(cameras))
    monkeypatch.chdir(mine)
    run(source, map_path, tmp_path / "clip", "cameras=cameras.json")
    assert Clip(tmp_path / "clip").info["cameras"][1]["view"] == cameras[1]["view"]


def test_cameras_in_a_file_of_windows(tmp_path: Path) -> None:
    """It begins with the mark of UTF-8, as a channel map may."""
    source, map_path = engine(tmp_path, scene(2))
    for path in (tmp_path / "cameras.json", map_path):
        path.write_text(path.read_text(encoding="utf-8"), encoding="utf-8-sig")
    assert run(source, map_path, tmp_path / "clip") == 0
    assert len(Clip(tmp_path / "clip").info["cameras"]) == 2


@pytest.mark.parametrize("cameras", ["[" * 100_000, '[{"view": [[' + "9" * 400 + ']], "projection": 0}]'])
def test_cameras_that_json_can_hardly_mean(tmp_path: Path, capsys: pytest.CaptureFixture[str], cameras: str) -> None:
    source, map_path = engine(tmp_path, scene(2))
    (tmp_path / "cameras.json").write_text(cameras)
    assert run(source, map_path, tmp_path / "clip") == 2
    assert "cameras.json: expected a JSON list of view and projection matrices" in capsys.readouterr().err


def test_a_clip_says_whether_its_guides_are_clean(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    source, map_path = engine(tmp_path, scene(2))
    flat = {f"basecolor.{c}": np.full((48, 64), 0.4, np.float32) for c in "RGB"}
    for noise, clean in ((0.0, True), (0.2, False)):
        for path in source.iterdir():
            noisy = {n: (p + noise * rng.normal(size=p.shape)).astype(np.float32) for n, p in flat.items()}
            write_exr(path, {**read_exr(path), **noisy})
        run(source, map_path, tmp_path / "clip", "--force")
        assert Clip(tmp_path / "clip").info["clean_guides"] is clean
    write_map(map_path, {"channels": {"color": "beauty"}})
    run(source, map_path, tmp_path / "clip", "--force")
    assert Clip(tmp_path / "clip").clean_guides is False  # there are none


def test_one_writer_and_nothing_that_came_meanwhile_is_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source, map_path = engine(tmp_path, scene())
    with monkeypatch.context() as patch:
        patch.setattr(os, "getpid", os.getppid)
        other = temporary_name(tmp_path / "clip")
    other.mkdir()
    assert run(source, map_path, tmp_path / "clip") == 2
    assert "clip: another process is writing it" in capsys.readouterr().err
    other.rmdir()
    (tmp_path / "late").mkdir()
    (tmp_path / "late" / "mine.txt").write_text("mine")
    with pytest.raises(NteError, match="late: exists"):
        write_imported(tmp_path / "late", [disc_frame(0)], 1, "test")
    assert [path.name for path in (tmp_path / "late").iterdir()] == ["mine.txt"]
    assert not list(tmp_path.glob(".*"))
