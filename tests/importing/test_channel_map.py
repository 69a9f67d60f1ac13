"""What a channel map can say: where each channel is, how it is stored, and what counts as unknown."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR
import pytest

from nte.cli import main
from nte.errors import NteError
from nte.frames.clip import Clip
from nte.frames.exr import Part, write_exr
from nte.importing.cameras import camera_of_fov
from nte.importing.channel_map import MAPS, ChannelMap, Depths, Normals, ShutterVectors, Vectors, load_channel_map
from nte.importing.exr import import_exr
from nte.importing.files import files_of_pattern, numbered_files
from nte.importing.ids import UNNAMED, Ids
from nte.importing.layers import Found
from nte.importing.parts import outside
from nte.importing.source import Source
from tests.importing.producers import SIZE, SKY_ROWS, named, rotation, scene, write_layers, write_map
from tests.synthetic import Pixels

Layers = dict[str, npt.NDArray[Any]]
COLOR = {"color": ["R", "G", "B"]}
RNG = np.random.default_rng(7)
SMALL = (6, 9)


def image(*components: str, size: tuple[int, int] = SMALL, rng: np.random.Generator = RNG) -> Layers:
    return {c: rng.random(size, np.float32) for c in components}


def write(folder: Path, frames: Sequence[Layers], name: str = "shot", first: int = 1) -> Path:
    """Numbered files whose layers keep their types."""
    for i, layers in enumerate(frames, start=first):
        write_exr(folder / f"{name}.{i}.exr", layers)
    return folder


def imported(folder: Path, source: Path, about: dict[str, Any], *more: str) -> Clip:
    """The clip that a map makes of a source; whatever the check says of it."""
    map_path = write_map(folder / "map.yaml", about)
    status = main(["import", "exr", str(source), "--map", str(map_path), "--out", str(folder / "clip"), *more])
    assert status in (0, 2)
    assert (folder / "clip").is_dir()
    return Clip(folder / "clip")


def refused(folder: Path, source: Path, about: dict[str, Any], capsys: pytest.CaptureFixture[str], *more: str) -> str:
    """The one line of an import that fails, which must leave nothing behind."""
    map_path = write_map(folder / "map.yaml", about)
    before = {path.name for path in folder.iterdir()}
    assert main(["import", "exr", str(source), "--map", str(map_path), "--out", str(folder / "clip"), *more]) == 2
    assert {path.name for path in folder.iterdir()} == before
    error = capsys.readouterr().err.strip().splitlines()
    errors = [line for line in error if line.startswith("nte: ")]
    assert len(errors) == 1, error
    return errors[0]


UV = {"motion": {"unit": "uv"}}
UNIT = np.array([[0.6, -0.8, 0.0], [0.0, 0.6, 0.8]], np.float32)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("channel", "stored", "entry", "groups", "expected"),
    [
        ("normal", UNIT / 2 + 0.5, {}, {"normal": {"encoded": True}}, UNIT),
        ("normal", UNIT / 2 + 0.5, {"scale": 2, "offset": -1}, {}, UNIT),
        ("normal", UNIT * [1, -1, 1] / 2 + 0.5, {"scale": [2, -2, 2], "offset": [-1, 1, -1]}, {}, UNIT),
        ("geometric_normal", UNIT / 2 + 0.5, {}, {"normal": {"encoded": True}}, UNIT),
        ("normal", UNIT * [1, 1, -1], {"scale": [1, 1, -1]}, {}, UNIT),
        ("normal", 255 * (UNIT / 2 + 0.5), {"scale": 1 / 255}, {"normal": {"encoded": True}}, UNIT),
        ("depth", [[-3.0], [-7.0]], {}, {"depth": {"scale": -1}}, [[3], [7]]),
        ("depth", [[-300.0], [0.0]], {}, {"depth": {"scale": -0.01}}, [[3], [0]]),
        ("depth", [[300.0], [2e8]], {}, {"depth": {"scale": 0.01, "sky": 1e8}}, [[3], [0]]),
        ("depth", [[0.25], [1.0]], {"scale": 40, "offset": 2}, {}, [[12], [42]]),
        ("depth", [[300.0], [1e10]], {"scale": 0.01}, {}, [[3], [0]]),
        ("depth", [[-0.25], [-20.0]], {"scale": 400}, {"depth": {"scale": -0.01, "sky": 20}}, [[1], [0]]),
        ("depth", [[np.inf], [np.nan]], {}, {}, [[0], [0]]),
        ("depth", [[3.4e38], [2.0]], {}, {"depth": {"scale": 100}}, [[0], [200]]),
        ("depth", [[3.4e38], [2.0]], {"scale": 100}, {}, [[0], [200]]),
        ("instance", [[-1.0], [4.0]], {"offset": 1}, {}, [[0], [5]]),
        ("instance", [[0.0], [0.25]], {"scale": 12}, {}, [[0], [3]]),
        ("shutter_depth", [[-300.0], [1e9]], {}, {"depth": {"scale": -0.01}}, [[3], [0]]),
        ("albedo", [[51.0, 255, 0], [300, 102, 0]], {"scale": "0.00392156862745098"}, {}, [[0.2, 1, 0], [1, 0.4, 0]]),
        ("roughness", [[0.25], [1.0]], {"scale": -1, "offset": 1}, {}, [[0.75], [0]]),
        ("motion", [[3.0, -2], [0.5, 1]], {"scale": [-1, 1]}, {}, [[-3, -2], [-0.5, 1]]),
        ("motion", [[0.75, 0.5], [0.5, 0]], {"scale": 2, "offset": -1}, UV, [[4.5, 0], [0, -6]]),
        ("motion", [[3.0, -2], [0.5, 1]], {}, {"motion": {"points": "from", "y_axis": "up"}}, [[-3, -2], [-0.5, 1]]),
        ("shutter_motion", [[3.0, -2], [1, 1]], {}, {"shutter_motion": {"points": "from"}}, [[-3, 2], [-1, -1]]),
        (
            "shutter_motion", [[0.5, -0.5], [0, 1]], {},
            {"shutter_motion": {"unit": "ndc", "y_axis": "up", "axes": "yx"}}, [[-2.25, -1.5], [4.5, 0]],
        ),
        (
            "shutter_motion", [[4.0, -2], [1, 1]], {}, {"shutter_motion": {"over": "frame"}, "shutter": 0.25},
            [[1, -0.5], [0.25, 0.25]],
        ),
        ("time", [[-0.25], [0.25]], {"scale": 2, "offset": 0.5}, {"shutter": 0.5}, [[0], [1]]),
    ],
)  # fmt: skip
def test_every_way_of_storing_a_channel(
    tmp_path: Path, channel: str, stored: object, entry: dict[str, Any], groups: dict[str, Any], expected: object
) -> None:
    values = np.asarray(stored, np.float32)  # of the left and the right half of the image, by component
    half = np.arange(SMALL[1]) >= SMALL[1] // 2
    planes = np.where(half, values[1][:, None, None], values[0][:, None, None]) * np.ones((1, *SMALL), np.float32)
    layers = image("R", "G", "B") | named("x", "RGB"[: len(planes)], np.float32(planes))
    source = write(tmp_path / "shots", [layers] * 2)
    clip = imported(tmp_path, source, {"channels": COLOR | {channel: {"layer": "x", **entry}}, **groups})
    found = clip.frame(1)[channel][0]
    np.testing.assert_allclose(found[:, 0, [0, -1]].T, expected, atol=1e-3)
    np.testing.assert_array_equal(found[:, :, half], np.broadcast_to(found[:, :1, -1:], found[:, :, half].shape))
    assert clip.info.get("shutter", 1) == groups.get("shutter", 1)


def test_one_file_for_each_channel(tmp_path: Path) -> None:
    folder = tmp_path / "shots [v2] für «alle» *"
    frames = [{"color": image("R", "G", "B"), "alb": image("R", "G", "B"), "z": image("R")} for _ in range(3)]
    for i, frame in enumerate(frames, start=-1):
        for name, layers in frame.items():
            write_exr(folder / f"beauty_{name}[a].{i}.exr", layers)
        write_exr(folder / "depth" / f"{i:03d}.exr", image("Z"))
    about = {
        "channels": {
            "color": {"file": "beauty_color[a].####.exr"},
            "albedo": {"file": "*_alb*.#.exr"},
            "depth": {"file": "beauty_z[a].#.exr"},
        }
    }
    clip = imported(tmp_path, folder, about)
    assert len(clip) == 3
    for index, frame in enumerate(frames):
        found = clip.frame(index)
        np.testing.assert_allclose(found["color"][0], [frame["color"][c] for c in "RGB"], rtol=1e-3)
        np.testing.assert_allclose(found["albedo"][0], [frame["alb"][c] for c in "RGB"], atol=1e-3)
        np.testing.assert_array_equal(found["depth"][0, 0], frame["z"]["R"])


def test_files_of_channels_that_do_not_match_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "shots"
    write(folder, [image("R", "G", "B")] * 3, "color")
    write(folder, [image("R", "G", "B")] * 2, "albedo")
    about: dict[str, Any] = {"channels": {"color": {"file": "color.#.exr"}, "albedo": {"file": "albedo.#.exr"}}}
    said = refused(tmp_path, folder, about, capsys)
    assert "albedo.#.exr: 'albedo' has 2 frames (1 to 2), 'color' has 3 (1 to 3)" in said
    about["channels"]["albedo"]["file"] = "kd.#.exr"
    assert "shots: no file fits 'kd.#.exr', where 'channels.albedo.file'" in refused(tmp_path, folder, about, capsys)
    (folder / "color.2.exr").unlink()
    assert "frame 2 is missing: after color.1.exr comes color.3.exr" in refused(tmp_path, folder, about, capsys)
    (folder / "color.02.exr").write_bytes(b"")
    (folder / "color.2.exr").write_bytes(b"")
    assert "frame 2 is there twice (color.02.exr and color.2.exr)" in refused(tmp_path, folder, about, capsys)
    assert "expected a folder, as the channel map names" in refused(tmp_path, folder / "*.exr", about, capsys)


@pytest.fixture
def stereo(tmp_path: Path) -> Path:
    """Two frames whose left eye is 0.25 everywhere, in parts of the same channels as the right one's 0.75."""
    (tmp_path / "shots").mkdir()
    for i in (1, 2):
        parts = []
        for view, value in (("left", 0.25), ("right", 0.75)):
            layers = {f"beauty.{c}": np.full(SMALL, value, np.float32) for c in "RGB"}
            header = {"type": OpenEXR.scanlineimage, "view": view}
            parts.append(OpenEXR.Part(header, layers, f"rgb_{view}"))
        layers = {"Z": np.full(SMALL, 4, np.float32)}
        parts.append(OpenEXR.Part({"type": OpenEXR.scanlineimage}, layers, "depth"))
        with OpenEXR.File(parts) as file:
            file.write(str(tmp_path / "shots" / f"shot.{i}.exr"))
    return tmp_path / "shots"


@pytest.mark.parametrize("chosen", [{"part": "rgb_right"}, {"part": 1}, {"view": "right"}])
def test_parts_and_views_are_chosen_by_name(tmp_path: Path, stereo: Path, chosen: dict[str, Any]) -> None:
    about = {"channels": {"color": {"layer": "beauty", **chosen}, "depth": {"part": "depth"}}}
    found = imported(tmp_path, stereo, about).frame(0)
    assert (found["color"] == 0.75).all()
    assert (found["depth"] == 4).all()
    assert (
        imported(tmp_path, stereo, about | {"channels": {"color": "beauty"}}, "--force", "view=left").frame(1)["color"]
        == 0.25
    ).all()


def test_a_number_counts_the_parts_of_all_views(
    tmp_path: Path, stereo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Else the part of another channel would be taken, as soon as one eye is chosen."""
    about = {"channels": {"color": {"layer": "beauty", "part": 1}, "depth": {"part": 2}}, "view": "right"}
    found = imported(tmp_path, stereo, about).frame(0)
    assert (found["color"] == 0.75).all()
    assert (found["depth"] == 4).all()
    said = refused(tmp_path, stereo, about, capsys, "view=left", "--force")
    assert "shot.1.exr: no part '1' of view 'left'; the file has rgb_left, depth" in said


def test_a_number_is_the_same_part_in_each_frame(
    tmp_path: Path, stereo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Else one frame's colour would be another part's, and nothing would show it."""
    path = str(stereo / "shot.2.exr")
    with OpenEXR.File(path) as file:
        parts = [
            OpenEXR.Part(dict(p.header), {n: c.pixels for n, c in p.channels.items()}, p.name()) for p in file.parts
        ]
    with OpenEXR.File([parts[1], parts[0], parts[2]]) as file:
        file.write(path)
    about = {"channels": {"color": {"layer": "beauty", "part": 0}}}
    changed = "there is beauty of part rgb_right instead, where shot.1.exr has beauty of part rgb_left"
    assert f"shot.2.exr: 'color': {changed}" in refused(tmp_path, stereo, about, capsys)
    named = {"channels": {"color": {"layer": "beauty", "part": "rgb_left"}}}
    assert (imported(tmp_path, stereo, named).frame(1)["color"] == 0.25).all()


def test_the_eyes_of_a_stereo_image_are_not_mixed(
    tmp_path: Path, stereo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(tmp_path, stereo, {"channels": {"color": "beauty"}}, capsys)
    assert "shot.1.exr: the views 'left' and 'right' both have a channel 'beauty." in said
    assert "choose one of them in the channel map, or with view=NAME" in said
    for key, value, have in (("view", "centre", "left, right"), ("part", "alpha", "rgb_left, rgb_right, depth")):
        said = refused(tmp_path, stereo, {"channels": {"color": {"layer": "beauty", key: value}}}, capsys)
        assert f"shot.1.exr: no {key} '{value}'; the file has {have}" in said


def in_parts(path: Path, *parts: tuple[dict[str, Any], Layers]) -> None:
    """One file; each part has its own attributes, such as name and view."""
    path.parent.mkdir(exist_ok=True)
    with OpenEXR.File([OpenEXR.Part({"type": OpenEXR.scanlineimage, **about}, dict(p)) for about, p in parts]) as file:
        file.write(str(path))


@pytest.mark.parametrize("light", ["VL.Combined.", ""])
def test_a_part_of_its_own_need_not_have_the_prefix_of_the_image(tmp_path: Path, light: str) -> None:
    """It may have none, or another one; what it has must not be left out because the image is called otherwise."""
    layers = image(*(f"{light}{c}" for c in "RGB"), "depth.Z", "N.X", "N.Y", "N.Z")
    cut = {"rgb": layers.keys() - {"depth.Z", "N.X", "N.Y", "N.Z"}, "d": {"depth.Z"}, "n": {"N.X", "N.Y", "N.Z"}}
    parts = [({"name": name}, {key: layers[key] for key in keys}) for name, keys in cut.items()]
    in_parts(tmp_path / "shots" / "shot.1.exr", *parts)
    color = {"layer": "Combined" if light else ".", "part": "rgb"}
    channels = {"color": color, "depth": {"layer": "Z", "part": "d"}, "normal": {"layer": "N", "part": "n"}}
    found = imported(tmp_path, tmp_path / "shots", {"channels": channels, "prefix": "*", "optional": True}).frame(0)
    np.testing.assert_array_equal(found["depth"][0, 0], layers["depth.Z"])
    normal = np.stack([layers[f"N.{c}"] for c in "XYZ"])
    np.testing.assert_allclose(found["normal"][0], normal / np.linalg.norm(normal, axis=0), atol=1e-3)


@pytest.mark.parametrize("change", [("view=left",), ("channels.color.view=left",)])
def test_the_reference_of_an_eye_may_be_a_file_of_one_eye(
    tmp_path: Path, stereo: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, ...]
) -> None:
    clean = image(*(f"beauty.{c}" for c in "RGB"))
    reference = write(tmp_path / "clean", [clean] * 2)
    more = (*change, "--reference", str(reference))
    found = imported(tmp_path, stereo, {"channels": {"color": "beauty"}}, *more).frame(1)
    assert (found["color"] == 0.25).all()
    np.testing.assert_allclose(found["reference"][0], [clean[f"beauty.{c}"] for c in "RGB"], rtol=1e-3)
    about = {"channels": {"color": "beauty"}}  # the image itself must be that of the eye
    assert "shot.1.exr: no view 'left'; the file has no views" in refused(
        tmp_path / "clean", reference, about, capsys, *change
    )
    right = [({"name": "a", "view": "right"}, clean), ({"name": "b", "view": "centre"}, clean)]
    for i in (1, 2):
        in_parts(reference / f"shot.{i}.exr", *right)
    (tmp_path / "none").mkdir()
    assert "no view 'left'; the file has centre, right" in refused(tmp_path / "none", stereo, about, capsys, *more)


@pytest.mark.parametrize(
    ("ids", "kept"),
    [
        (np.array([0, 1, 5, 2**23 - 1], np.uint32), [0, 1, 5, 2**23 - 1]),
        (np.array([0, 2**24 + 1, 2**24 + 2, 2**32 - 1], np.uint32), [0, 2**23, 2**23 + 1, 2**23 + 2]),
        (np.array([3, 2**24, 7, 2**31], np.uint32), [3, 2**23, 7, 2**23 + 1]),
        (np.array([0, 1e-30, -4.5e20, 0.5], np.float32), [0, 2**23 + 1, 2**23, 2**23 + 2]),  # hashes
        (np.array([0, np.nan, np.inf, 2], np.float32), [0, 0, 0, 2]),
    ],
)
def test_ids_survive_float32(tmp_path: Path, ids: npt.NDArray[Any], kept: list[int]) -> None:
    plane = np.repeat(ids[None], SMALL[0], 0)
    layers = image("R", "G", "B", size=plane.shape) | {"ID": plane}
    later = {**layers, "ID": np.ascontiguousarray(plane[:, ::-1])}
    clip = imported(tmp_path, write(tmp_path / "shots", [layers, later]), {"channels": COLOR | {"instance": "ID"}})
    np.testing.assert_array_equal(clip.frame(0)["instance"][0, 0, 0], kept)
    np.testing.assert_array_equal(clip.frame(1)["instance"][0, 0, 0], kept[::-1])


def test_ids_that_were_averaged_are_told_and_hashes_are_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ids = np.repeat(np.arange(1, 5, dtype=np.float32), 4)[None].repeat(6, 0)
    averaged = (ids + np.roll(ids, 1, 1)) / 2
    hashed = np.float32([0, 0.3, 2.7e-9, 4.5e20])[ids.astype(int) - 1]
    for name, plane, told in (("averaged", averaged, True), ("hashed", hashed, False), ("whole", ids, False)):
        layers = image("R", "G", "B", size=plane.shape) | {"ID": np.ascontiguousarray(plane)}
        (tmp_path / name).mkdir()
        imported(tmp_path / name, write(tmp_path / name / "shots", [layers]), {"channels": COLOR | {"instance": "ID"}})
        assert ("averaged: 24 pixels of instance" in capsys.readouterr().out) is told


def test_ids_that_half_floats_round_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ids = np.repeat(np.array([1, 2047, 2049, 3000], np.float64)[None], 6, 0)
    for kind, told in ((np.float16, True), (np.float32, False)):
        (tmp_path / np.dtype(kind).name).mkdir()
        layers = image("R", "G", "B", size=ids.shape) | {"ID": ids.astype(kind)}
        source = write(tmp_path / np.dtype(kind).name / "shots", [layers])
        imported(source.parent, source, {"channels": COLOR | {"instance": "ID"}})
        assert ("rounded: 12 pixels of instance" in capsys.readouterr().out) is told


def test_depths_at_the_end_of_half_floats_are_the_sky(tmp_path: Path) -> None:
    depth = np.full(SMALL, 3.0)
    depth[0], depth[1] = 65504.0, 65472.0
    for kind, expected in ((np.float16, 0.0), (np.float32, 65504.0)):
        (tmp_path / np.dtype(kind).name).mkdir()
        source = write(tmp_path / np.dtype(kind).name / "shots", [image("R", "G", "B") | {"Z": depth.astype(kind)}])
        found = imported(source.parent, source, {"channels": COLOR | {"depth": "Z"}}).frame(0)["depth"][0, 0]
        np.testing.assert_array_equal(found[:3, 0], [expected, 65472, 3])


def test_new_ids_never_meet_those_that_are_kept() -> None:
    ids = Ids()
    given = np.array([[2**23 - 1, 2**23, 2**24 - 1, 2**24, 2**25, 1]], np.float64)
    found = np.concatenate([ids.keep(given), ids.keep(given + 2**26)])
    assert len(np.unique(found)) == found.size
    assert found.max() < UNNAMED


def moving(unknown: Callable[[Pixels, dict[str, Pixels]], Pixels]) -> list[Layers]:
    """The disc before a wall under a strip of sky, with vectors that `unknown` spoils."""
    return [
        dict(zip("RGB", f["color"], strict=True))
        | named("v", "xy", unknown(f["motion"].copy(), f))
        | {"z": f["depth"][0]}
        for f in scene(3)
    ]


def holes(value: float) -> Callable[[Pixels, dict[str, Pixels]], Pixels]:
    def spoil(motion: Pixels, frame: dict[str, Pixels]) -> Pixels:
        motion[:, 10:20, 15:18] = value  # across the disc's rim in some frames
        motion[:, 30, 40] = value
        return motion

    return spoil


@pytest.mark.parametrize(
    ("value", "unknown"), [(np.nan, []), (np.inf, []), (-1e10, "-1e10"), (1e10, [1e10, "sky"]), (-12345.0, -12345)]
)
def test_unknown_vectors_are_those_of_neighbours_at_their_depth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], value: float, unknown: object
) -> None:
    source = write(tmp_path / "shots", moving(holes(value)))
    channels = COLOR | {"motion": {"layer": "v", "unknown": unknown}, "depth": "z"}
    clip = imported(tmp_path, source, {"channels": channels})
    assert "unknown: " in capsys.readouterr().out
    for index, frame in enumerate(scene(3)):
        found = clip.frame(index)["motion"][0]
        np.testing.assert_allclose(found[:, SKY_ROWS:], frame["motion"][:, SKY_ROWS:], atol=1e-5)


def test_half_floats_hold_a_rounded_value_for_unknown(tmp_path: Path) -> None:
    frames = moving(holes(-12345.0))  # -12344 in half floats
    for layers in frames:
        layers |= {name: layers[name].astype(np.float16) for name in ("v.x", "v.y")}
    channels = COLOR | {"motion": {"layer": "v", "unknown": -12345}, "depth": "z"}
    clip = imported(tmp_path, write(tmp_path / "shots", frames), {"channels": channels})
    assert np.abs(clip.frame(1)["motion"]).max() < 10


@pytest.mark.parametrize(
    ("kind", "scale", "told"),
    [
        (np.float16, 2.0, "motion is stored in half floats, in steps of 0.62 px"),
        (np.float32, 2.0, ""),
        (np.float16, 1, ""),
    ],
)
def test_vectors_in_coarse_steps_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: type[np.floating[Any]], scale: float, told: str
) -> None:
    """Vectors around 0.5 that stand for the whole image: half floats above 0.5 are 1/2048 apart."""
    encoded = np.full((4, 640), 0.51, kind)
    vectors = encoded if scale == 2 else np.full((4, 640), 0.01, kind)
    layers = image("R", "G", "B", size=(4, 640)) | {"v.x": vectors, "v.y": vectors}
    channels = COLOR | {"motion": {"layer": "v", "scale": scale, "offset": 1 - scale}}
    imported(tmp_path, write(tmp_path / "shots", [layers] * 2), {"channels": channels, "motion": {"unit": "uv"}})
    said = capsys.readouterr().out
    assert told in said
    assert ("coarse: " in said) is bool(told)


@pytest.mark.filterwarnings("error")
def test_half_floats_of_which_none_is_known_have_no_steps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unknown = named("v", "xy", np.full((2, *SMALL), np.nan, np.float16))
    source = write(tmp_path / "shots", [image("R", "G", "B") | unknown] * 2)
    assert not imported(tmp_path, source, {"channels": COLOR | {"motion": "v"}}).frame(1)["motion"].any()
    said = capsys.readouterr()
    assert "unknown: 108 pixels of motion" in said.out
    assert "warning" not in said.err


def test_every_normal_of_a_surface_is_turned_to_the_world(tmp_path: Path) -> None:
    view = np.eye(4)
    view[:3, :3] = rotation(0.7)
    camera = {"view": view.tolist(), "projection": camera_of_fov(50, SMALL).projection.tolist()}
    (tmp_path / "cameras.json").write_text(json.dumps([camera]))
    world = np.array([0.48, 0.6, -0.64])
    planes = np.full((3, *SMALL), np.reshape(view[:3, :3] @ world, (3, 1, 1)), np.float32)
    depth = np.ones(SMALL, np.float32)
    depth[0] = 0
    source = write(tmp_path / "shots", [image("R", "G", "B") | named("N", "XYZ", planes) | {"Z": depth}])
    channels = COLOR | {"normal": "N", "geometric_normal": "N", "depth": "Z"}
    about = {"channels": channels, "normal": {"space": "camera"}, "cameras": "cameras.json"}
    found = imported(tmp_path, source, about).frame(0)
    for name in ("normal", "geometric_normal"):
        np.testing.assert_allclose(found[name][0, :, 1], np.repeat(world[:, None], SMALL[1], 1), atol=1e-3)
        assert not found[name][0, :, 0].any()  # the sky has none


def test_large_unknown_regions_move_like_what_is_around_them_and_do_not_take_long(tmp_path: Path) -> None:
    y, x = np.mgrid[:300, :400].astype(np.float32)
    motion = np.stack([3 + 0.01 * x, -2 + 0.01 * y])
    depth = np.where(y < 200, 1e10, 5).astype(np.float32)
    given = dict(zip("RGB", np.ones((3, 300, 400), np.float32), strict=True)) | {"z": depth}
    given |= named("v", "xy", np.where(depth < 9, motion, 0).astype(np.float32))
    channels = COLOR | {"motion": {"layer": "v", "unknown": "sky"}, "depth": "z"}
    started = time.process_time()
    found = imported(tmp_path, write(tmp_path / "shots", [given] * 2), {"channels": channels}).frame(1)["motion"][0]
    assert time.process_time() - started < 5
    np.testing.assert_array_equal(found[:, 200:], motion[:, 200:])
    for component, sky in zip(motion[:, 200:], found[:, :200], strict=True):
        assert component.min() - 1e-4 <= sky.min()
        assert sky.max() <= component.max() + 1e-4
    assert np.abs(found[1, :200] - motion[1, 200]).max() < 0.3  # nearer to the surfaces below than to their far end
    assert np.abs(found[0, 195] - motion[0, 195]).max() < 0.2


def cut(folder: Path, frames: Sequence[Layers], rows: slice, columns: slice, parts: bool = False) -> Path:
    """Files that store only a window of the picture; parts: each layer in a part of its own, color without a window."""
    folder.mkdir(parents=True)
    for i, layers in enumerate(frames, start=1):
        height, width = next(iter(layers.values())).shape
        whole = (np.array([0, 0], np.int32), np.array([width - 1, height - 1], np.int32))
        low = np.array([columns.start, rows.start], np.int32)
        window = (low, np.array([columns.stop - 1, rows.stop - 1], np.int32))
        header = {"type": OpenEXR.scanlineimage, "displayWindow": whole, "dataWindow": window}
        inside = {n: np.ascontiguousarray(plane[rows, columns], np.float32) for n, plane in layers.items()}
        written = [OpenEXR.Part(header, inside, "all")]
        if parts:
            light = {n: np.ascontiguousarray(layers[n], np.float32) for n in "RGB"}
            others = {n: plane for n, plane in inside.items() if n not in light}
            written = [OpenEXR.Part({**header, "dataWindow": whole}, light, "light")]
            written.append(OpenEXR.Part(header, others, "guides"))
        with OpenEXR.File(written) as file:
            file.write(str(folder / f"shot.{i}.exr"))
    return folder


@pytest.mark.parametrize("parts", [False, True])
def test_what_is_not_stored_is_not_decoded(tmp_path: Path, parts: bool) -> None:
    """Outside the data window there is no vector, no surface and no light, however values are encoded."""
    frames = []
    for f in scene(3):
        layers = dict(zip("RGB", f["color"], strict=True)) | named("v", "XY", f["motion"] / 128 + 0.5)
        layers |= named("n", "XYZ", f["normal"] / 2 + 0.5) | named("a", "RGB", 1 - f["albedo"])
        frames.append(layers | {"d.z": f["depth"][0] - 1, "i.id": f["instance"][0] - 1})
    rows, columns = slice(6, 40), slice(10, 60)
    source = cut(tmp_path / "shots", frames, rows, columns, parts)
    channels = {"color": {"layer": ["R", "G", "B"], "part": "light"} if parts else "."}
    channels |= {
        "motion": {"layer": "v", "scale": 128, "offset": -64},
        "normal": {"layer": "n", "scale": 2, "offset": -1},
        "albedo": {"layer": "a", "scale": -1, "offset": 1},
        "depth": {"layer": "d", "offset": 1},
        "instance": {"layer": "i", "offset": 1},
    }
    clip = imported(tmp_path, source, {"channels": channels})
    inside = np.zeros(SIZE, bool)
    inside[rows, columns] = True
    for index, frame in enumerate(scene(3)):
        found = clip.frame(index)
        for name in ("normal", "albedo", "depth", "instance"):
            hit = inside & ((frame["depth"][0] > 0) | (name in ("albedo", "depth")))
            np.testing.assert_allclose(found[name][0][:, hit], frame[name][:, hit], atol=2e-3, err_msg=name)
            assert not found[name][0][:, ~inside].any(), name
        np.testing.assert_allclose(found["motion"][0][:, inside], frame["motion"][:, inside], atol=1e-4)
        assert np.abs(found["motion"]).max() < 10  # the vectors of neighbours, not those that zeros decode to
        assert found["color"][0][:, ~inside].any() == parts


def test_a_part_without_a_layer_counts_where_parts_are_numbered() -> None:
    """Its channels may all be subsampled."""
    empty = np.eye(3, dtype=bool)
    parts = [Part("a", "", {}), Part("b", "", {"Z": np.zeros((3, 3), np.float32)}, outside=empty)]
    found = outside(Path("a.exr"), parts, Source(["Z"], part="1"), Found((("Z",),), 1))
    np.testing.assert_array_equal(found, empty)


def test_the_sky_has_no_shadows_vectors_and_what_is_meant_is_not_called_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """NaN says in these vectors that there is no shadow: nobody fills them, and they are no fault."""
    depth = np.ones(SMALL, np.float32)
    depth[0] = 0
    vectors = np.full((2, *SMALL), 3, np.float32)
    vectors[:, 2] = np.nan
    layers = image("R", "G", "B") | {"Z": depth} | named("s", "XY", vectors)
    channels = COLOR | {"depth": "Z", "shadow_motion": {"layer": "s", "unknown": "sky"}}
    found = imported(tmp_path, write(tmp_path / "shots", [layers]), {"channels": channels}).frame(0)["shadow_motion"]
    np.testing.assert_array_equal(found[0, 0, :, 0], [np.nan, 3, np.nan, 3, 3, 3])
    said = capsys.readouterr().out
    assert "unknown: " not in said
    assert "bad: " not in said


def test_a_value_that_is_not_said_to_be_unknown_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write(tmp_path / "shots", moving(holes(0.0)))
    clip = imported(tmp_path, source, {"channels": COLOR | {"motion": "v", "depth": "z"}})
    assert (clip.frame(0)["motion"][0, :, 12, 16] == 0).all()
    assert "unknown: " not in capsys.readouterr().out


def test_the_skys_vectors_come_from_the_cameras(tmp_path: Path) -> None:
    """A camera that turns to the left: the sky moves by the angle, whatever the file says of it."""

    def spoil(motion: Pixels, frame: dict[str, Pixels]) -> Pixels:
        motion[:, :SKY_ROWS] = 0
        return motion

    cameras = []
    for i in range(3):
        view = np.eye(4)
        view[:3, :3] = rotation(0.02 * i)
        cameras.append({"view": view.tolist(), "projection": camera_of_fov(50, SIZE).projection.tolist()})
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    channels = COLOR | {"motion": {"layer": "v", "unknown": "sky"}, "depth": "z"}
    about = {"channels": channels, "cameras": "cameras.json"}
    found = imported(tmp_path, write(tmp_path / "shots", moving(spoil)), about).frame(2)["motion"][0]
    focal = SIZE[0] / 2 / np.tan(np.radians(25))
    assert np.abs(np.abs(found[0, :SKY_ROWS].mean()) - 0.02 * focal) < 0.1 * 0.02 * focal
    np.testing.assert_array_equal(found[:, SKY_ROWS:], scene(3)[2]["motion"][:, SKY_ROWS:])


def test_grey_images_and_scalars_stored_as_grey(tmp_path: Path) -> None:
    grey, rough = image("Y", "A"), image("V")["V"]
    layers = grey | {f"r.{c}": rough for c in "RGB"}
    clip = imported(tmp_path, write(tmp_path / "shots", [layers] * 2), {"channels": {"color": ".", "roughness": "r"}})
    np.testing.assert_allclose(clip.frame(0)["color"][0], np.stack([grey["Y"]] * 3), rtol=1e-3)
    np.testing.assert_allclose(clip.frame(0)["roughness"][0, 0], rough, atol=1e-3)


def test_colour_in_x_y_and_z_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Spectral renderers write CIE XYZ under these names."""
    told = "not converted: color is stored as X, Y and Z"
    for components in ("XYZ", "RGB"):
        imported(tmp_path, write(tmp_path / components, [image(*components)]), {"channels": {"color": "."}}, "--force")
        assert (told in capsys.readouterr().out) == (components == "XYZ")


def test_of_two_sets_of_components_a_channel_takes_its_own(tmp_path: Path) -> None:
    layers = image("R", "G", "B", "X", "Y", "Z")
    about = {"channels": {"color": ".", "position": "."}}
    found = imported(tmp_path, write(tmp_path / "shots", [layers]), about).frame(0)
    np.testing.assert_allclose(found["color"][0], [layers[c] for c in "RGB"], rtol=1e-3)
    np.testing.assert_array_equal(found["position"][0], [layers[c] for c in "XYZ"])


@pytest.mark.parametrize("more", [{}, {"prefix": "*"}])
def test_a_layer_below_a_layer_is_not_its_only_component(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: dict[str, Any]
) -> None:
    """As of a depth of another kind, or under a prefix with a dot."""
    layers = image("VL.1.R", "VL.1.G", "VL.1.B", "VL.1.depth.mean.Z")
    source = write(tmp_path / "shots", [layers])
    about = {"channels": {"color": ".", "depth": "depth"}, "prefix": "VL.1", **more}
    assert "no depth with the prefix 'VL.1' for 'depth'" in refused(tmp_path, source, about, capsys)
    write(source, [layers | image("VL.1.depth.Z")])
    assert imported(tmp_path, source, about).frame(0)["depth"].any()


def test_a_channel_alone_in_its_file_is_found_under_a_prefix_with_a_dot(tmp_path: Path) -> None:
    depth = image("VL.1.Z")
    write(tmp_path / "shots", [image("VL.1.R", "VL.1.G", "VL.1.B")], "rgb")
    write(tmp_path / "shots", [depth], "z")
    channels = {"color": {"layer": ".", "file": "rgb.#.exr"}, "depth": {"layer": ".", "file": "z.#.exr"}}
    found = imported(tmp_path, tmp_path / "shots", {"channels": channels, "prefix": "*"}).frame(0)
    np.testing.assert_array_equal(found["depth"][0, 0], depth["VL.1.Z"])


def test_components_named_in_whole_words(tmp_path: Path) -> None:
    layers = image("R", "G", "B", "kd.red", "kd.green", "kd.blue", "mv.red", "mv.green")
    about = {"channels": {"color": ".", "albedo": "kd", "motion": "mv"}}
    found = imported(tmp_path, write(tmp_path / "shots", [layers]), about).frame(0)
    np.testing.assert_allclose(found["albedo"][0], [layers[f"kd.{c}"] for c in ("red", "green", "blue")], rtol=1e-3)
    np.testing.assert_array_equal(found["motion"][0], [layers[f"mv.{c}"] for c in ("red", "green")])


def test_a_component_in_both_cases_is_not_guessed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layers = image("C.R", "C.G", "C.B", "C.r", "C.g", "C.b", "Z", "z", "N.x", "N.y", "N.z")
    source = write(tmp_path / "shots", [layers])
    said = refused(tmp_path, source, {"channels": {"color": "C"}}, capsys)
    assert "no C for 'color' (3 components); the file has C.B, C.G, C.R, C.b, C.g, C.r, " in said
    found = imported(tmp_path, source, {"channels": {"color": ["C.r", "C.g", "C.b"], "depth": "z", "normal": "N"}})
    np.testing.assert_array_equal(found.frame(0)["depth"][0, 0], layers["z"])


@pytest.mark.parametrize("prefix", ["", "VL"])
def test_one_component_of_a_coloured_id_has_to_be_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], prefix: str
) -> None:
    """Ids that are stored as colours, as in a picture of them, under the second of two names."""
    layers = image("R", "G", "B", *(f"RenderID.{c}" for c in "RGB"))
    source = write(tmp_path / "shots", [{f"{prefix}.{c}" if prefix else c: plane for c, plane in layers.items()}])
    about = {"channels": {"color": ".", "instance": "renderId | RenderID"}, "optional": True, "prefix": prefix}
    said = refused(tmp_path, source, about, capsys)
    assert "RenderID.R, of which the map may name one by its full name" in said


def test_a_prefix_that_fits_nothing_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write(tmp_path / "shots", [image("VL.C.R", "VL.C.G", "VL.C.B")])
    said = refused(tmp_path, source, {"channels": {"color": "C"}, "prefix": "VL."}, capsys)
    assert "no C with the prefix 'VL.' for 'color'" in said


@pytest.mark.parametrize("change", [(), ("view=left",)])
def test_a_part_with_two_views_tells_how_to_choose_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, ...]
) -> None:
    """Blender 4's stereo files: every channel's name has its view."""
    layers = image(*(f"Combined.{view}.{c}" for view in ("left", "right") for c in "RGB"))
    (tmp_path / "shots").mkdir()
    with OpenEXR.File({"type": OpenEXR.scanlineimage, "multiView": ["left", "right"]}, dict(layers)) as file:
        file.write(str(tmp_path / "shots" / "shot.1.exr"))
    about = {"channels": {"color": "Combined"}}
    if change:
        assert imported(tmp_path, tmp_path / "shots", about, *change).channels == ("color",)
    else:
        said = refused(tmp_path, tmp_path / "shots", about, capsys)
        assert said.endswith("it has the views left, right: choose one with view=NAME")


def test_brackets_in_a_pattern_stand_for_themselves_if_they_are_no_set(tmp_path: Path) -> None:
    folder = write(tmp_path / "größe [a]", [image("R", "G", "B")] * 2, "shot [v2] ä")
    write(folder, [image("R", "G", "B")] * 3, "other")
    assert len(numbered_files(folder / "shot [v2] ä.*.exr", ".exr")) == 2
    assert len(numbered_files(folder / "shot [[]v2] ä.*.exr", ".exr")) == 2
    assert len(numbered_files(folder / "[op]ther.*.exr", ".exr")) == 3


def test_sums_of_layers(tmp_path: Path) -> None:
    layers = image("R", "G", "B") | named(
        "d", "RGB", np.float32([[[0.0, 0.5]], [[0.0, 0.0]], [[0.0, 0.25]]]).repeat(3, 1)
    )
    layers = {name: plane[:3, :2].copy() for name, plane in layers.items()}
    layers |= named("s", "RGB", np.full((3, 3, 2), 0.125, np.float32))
    about = {
        "channels": COLOR
        | {"albedo": {"layer": "none | d", "where_dark": ["s", "t"]}, "emission": {"layer": "d", "plus": "s"}}
    }
    found = imported(tmp_path, write(tmp_path / "shots", [layers]), about).frame(0)
    np.testing.assert_array_equal(found["albedo"][0, :, 0].T, [[0.125] * 3, [0.5, 0, 0.25]])
    np.testing.assert_array_equal(found["emission"][0, :, 0].T, [[0.125] * 3, [0.625, 0.125, 0.375]])


@pytest.mark.parametrize("channel", ["color", "emission"])
def test_what_is_added_does_not_stand_for_a_layer_that_is_not_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], channel: str
) -> None:
    """Half of the light would pass as the image."""
    source = write(tmp_path / "shots", [image("R", "G", "B", "indirect.R", "indirect.G", "indirect.B")])
    about: dict[str, Any] = {"channels": COLOR | {channel: {"layer": "dirct", "plus": "indirect"}}}
    assert f"no dirct for '{channel}'" in refused(tmp_path, source, about, capsys)
    if channel == "emission":
        assert "emission" in imported(tmp_path, source, about | {"optional": True}).channels


@pytest.mark.parametrize("frame", [0, 1, 3])
@pytest.mark.parametrize("optional", [True, False])
def test_a_pass_that_one_frame_lacks_is_named_with_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frame: int, optional: bool
) -> None:
    frames = [image("R", "G", "B") | named("n", "XYZ", RNG.random((3, *SMALL), np.float32)) for _ in range(4)]
    frames[frame] = {name: plane for name, plane in frames[frame].items() if not name.startswith("n.")}
    source = write(tmp_path / "shots", frames)
    about = {"channels": COLOR | {"normal": "n"}, "optional": optional}
    said = refused(tmp_path, source, about, capsys)
    assert f"{source}/shot.{frame + 1}.exr: " in said
    assert "'normal'" in said


def test_another_layer_in_a_later_frame_is_no_alternative(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = named("noisy", "RGB", np.ones((3, *SMALL), np.float32)) | named(
        "final", "RGB", np.zeros((3, *SMALL), np.float32)
    )
    only = {name: plane for name, plane in both.items() if name.startswith("final")}
    source = write(tmp_path / "shots", [both, both, only])
    said = refused(tmp_path, source, {"channels": {"color": "noisy | final"}}, capsys)
    assert "shot.3.exr: 'color': there is final instead, where shot.1.exr has noisy: expected the same passes" in said


def test_components_of_other_names_in_a_later_frame_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = write(tmp_path / "shots", [image("a.R", "a.G", "a.B"), image("a.r", "a.g", "a.b")])
    said = refused(tmp_path, source, {"channels": {"color": "a"}}, capsys)
    assert "'color': there is a.r a.g a.b instead, where shot.1.exr has a.R a.G a.B: expected the same" in said


def test_a_reference_is_needed_where_one_is_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write(tmp_path / "shots", [image("R", "G", "B")] * 2)
    about = {"channels": COLOR | {"reference": "clean"}, "optional": True}
    assert "reference" not in imported(tmp_path, source, about).channels
    said = refused(tmp_path / "shots", source, about, capsys, "--reference", str(source))
    assert "shot.1.exr: no clean for 'reference'" in said


def test_half_a_pass_is_no_missing_pass(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write(tmp_path / "shots", [image("R", "G", "B", "v.X")] * 2)
    about = {"channels": COLOR | {"motion": "v", "albedo": "kd"}, "optional": True}
    assert "shot.1.exr: no v for 'motion' (2 components); the file has B, G, R, v.X" in refused(
        tmp_path, source, about, capsys
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf, -20.0])
def test_bad_pixels_of_the_reference_are_counted_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bad: float
) -> None:
    frames = [image("R", "G", "B") | named("c", "RGB", RNG.random((3, *SMALL), np.float32)) for _ in range(3)]
    frames[1]["c.G"][2, 3:5] = bad
    frames[2]["c.R"][0, 0] = bad
    source = write(tmp_path / "shots", frames)
    imported(tmp_path, source, {"channels": COLOR | {"reference": "c"}})
    assert f"bad: 3 pixels of reference, first in {source}/shot.2.exr" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("about", "said"),
    [
        ({"channels": {"color": {"layr": "x"}}}, "'channels.color.layr'"),
        ({"channels": {"color": {"scale": "bright"}}}, "'channels.color.scale[0]'"),
        ({"channels": {"color": {"scale": [1, 2]}}}, "'scale' is [1.0, 2.0], expected a number, or 3"),
        ({"channels": {"color": {"scale": 0}}}, "'scale' is [0.0]"),
        ({"channels": {"color": {"offset": float("inf")}}}, "'offset' is [inf]"),
        ({"channels": {"color": {"unknown": 0}}}, "'unknown' is for motion vectors"),
        ({"channels": {"color": ".", "motion": {"unknown": "skye"}}}, "'unknown' has 'skye', expected stored values"),
        ({"channels": {"color": 7.5, "depth": None}}, "'channels.depth'"),
        ({"channels": {"color": "."}, "depth": {"scale": 0}}, "'depth.scale' is 0.0, expected a number that is not 0"),
        ({"channels": {"color": "."}, "shutter": 1.5}, "'shutter' is 1.5, expected the open share"),
        ({"channels": {"color": "."}, "shutter_motion": {"over": "second"}}, "'shutter_motion.over' is 'second'"),
        ({"channels": {"color": "."}, "normal": {"encoded": "octahedral"}}, "normal.encoded"),
        ({"channels": {"color": ".", "depth": {"layer": {"a": "b"}}}}, "'channels.depth'"),
        ({"channels": {"color": ["a", ["b"], "c"]}}, "'channels.color': ['a', ['b'], 'c']: expected a layer, or the"),
        ({"channels": {"color": {"scale": [1, [2], 3]}}}, "'channels.color': scale: "),
        ({"channels": {"color": ".", "motion": {"unknown": {"a": 1}}}}, "'channels.motion': unknown: "),
        ({"channels": {"color": " | "}}, "expected a layer"),
        ({"channels": {"color": ""}}, "expected a layer"),
        ({"channels": {"color": "."}, "depth": {"sky": float("nan")}}, "'depth.sky' is nan"),
        ({"channels": {"color": ".", "shutter_depth": "Z"}, "depth": {"along": "ray"}}, "'depth.along' is ray: give"),
        (
            {"channels": {"color": ".", "geometric_normal": "N"}, "normal": {"space": "camera"}},
            "'normal.space' is camera: 'cameras' must name",
        ),
        (
            {"channels": {"color": ".", "normal": {"scale": [1, -1, 1]}}, "normal": {"encoded": True}},
            "instead of both give scale: [2.0, -2.0, 2.0], offset: [-1, 1, -1]",
        ),
        ({"channels": "beauty"}, "channels"),
        ({"channels": ["beauty"]}, "list is not a subclass of Dict"),
    ],
)
def test_faulty_maps_are_refused_by_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], about: dict[str, Any], said: str
) -> None:
    source = write(tmp_path / "shots", [image("R", "G", "B")])
    error = refused(tmp_path, source, about, capsys)
    assert "map.yaml: " in error
    assert said in error


def test_the_page_names_every_key() -> None:
    page = (Path(__file__).parents[2] / "datasets" / "IMPORT.md").read_text(encoding="utf-8")
    groups = {"motion": Vectors, "shutter_motion": ShutterVectors, "normal": Normals, "depth": Depths}
    tables = page.split("## Any EXR files")[1].split("## Blender")[0]
    own = {f.name for f in fields(ChannelMap)} - {"forward_motion", "producer", "channels", *groups}
    for key in own | {f.name for f in fields(Source)}:
        assert f"`{key}`" in tables, key
    for group, schema in groups.items():
        for key in (f.name for f in fields(schema)):
            assert f"`{group}.{key}`" in tables or f"`.{key}` of the three" in tables, (group, key)
    for name in (path.stem for path in MAPS.glob("*.yaml")):
        assert f"| `{name}` |" in tables


def test_keys_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write(tmp_path / "shots", [image("R", "G", "B", "Z")] * 2)
    write(source / "more", [image("Z")] * 2, "z")
    (source / "b.7.exr").mkdir()  # no file, whatever it is called
    (source / ".shot.1.exr").write_bytes(b"")
    about = {"channels": COLOR}
    depth = ("channels.depth=Z", "channels.depth.scale=10", "depth.scale=0.5")
    clip = imported(tmp_path, source, about, *depth, "shutter=0.5", "channels.color.scale=3")
    assert 1 < clip.frame(0)["depth"].max() <= 5
    assert 1 < clip.frame(0)["color"].max() <= 3
    assert clip.info["shutter"] == 0.5
    files = ("channels.color.file=shot.#.exr", "channels.depth.file=more/z.#.exr", "--force")
    assert "depth" in imported(tmp_path, source, about, *files).channels
    for change, said in (
        ("depth.scales=10", "scales"),
        ("channels.depth.scales=10", "'channels.depth.scales'"),
        ("channels.deep=Z", "'channels.deep': no such channel"),
        ("channels.color=${oc.env:HOME}", "expected key=value, with the value itself"),
        ("channels.color=[R", "not readable as YAML"),
        ('channels.color="\\x24{oc.env:HOME}"', "'channels.color[0].layer[0]': '${oc.env:HOME}' calls a resolver"),
        ('channels.color.view="\\x24{oc.env:HOME}"', "'channels.color[0].view': '${oc.env:HOME}' calls a resolver"),
    ):
        assert said in refused(tmp_path / "shots", source, about, capsys, change)


def test_two_halves_of_a_resolver_do_not_become_one(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text("prefix: '$'\nfile: '{oc.env:HOME}'\nchannels: {color: '${prefix}${file}'}\n")
    with pytest.raises(NteError, match=r"'channels\.color.*' calls a resolver"):
        load_channel_map(path)


def test_a_pattern_leaves_hidden_folders_out(tmp_path: Path) -> None:
    frames = {"": 1.0, ".thumbnails/": 7.0}
    for below, value in frames.items():
        for i in range(2):
            layers = named("", "RGB", np.full((3, *SIZE), value, np.float32))
            (tmp_path / "shot" / "seq" / below).mkdir(parents=True, exist_ok=True)
            write_exr(tmp_path / f"shot/seq/{below}c.{i}.exr", {name[1:]: plane for name, plane in layers.items()})
    assert sorted(files_of_pattern(tmp_path / "shot", "*/c.#.exr")) == [0, 1]
    assert files_of_pattern(tmp_path / "shot", "seq/*/c.#.exr") == {}


@pytest.mark.parametrize("pattern", ["*#.exr", "s*#.exr", "*#*.exr"])
def test_a_star_takes_no_digit_and_no_sign_of_the_frame_number(tmp_path: Path, pattern: str) -> None:
    for number in range(-12, 13):
        (tmp_path / f"s.{number}.exr").touch()
    found = files_of_pattern(tmp_path, pattern)
    assert {number: path.name for number, path in found.items()} == {n: f"s.{n}.exr" for n in range(-12, 13)}


def test_one_frame_of_two_channels_has_one_number_but_stills_may_be_called_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, values in (("color.1", "RGB"), ("albedo.2", "RGB"), ("clean_4096spp", "RGB")):
        write_exr(tmp_path / "in" / f"{name}.exr", image(*values))
    about: dict[str, Any] = {"channels": {"color": {"file": "color.#.exr"}, "albedo": {"file": "albedo.#.exr"}}}
    assert "'albedo' has 1 frames (2 to 2), 'color' has 1 (1 to 1)" in refused(tmp_path, tmp_path / "in", about, capsys)
    about["channels"] |= {"albedo": {"file": "albedo.2.exr"}, "reference": {"file": "clean*.exr"}}
    assert {"albedo", "reference"} <= set(imported(tmp_path, tmp_path / "in", about).channels)


@pytest.mark.parametrize("numbers", [(1, 2), (3, 4)])
def test_a_pattern_that_fits_two_sequences_is_refused(tmp_path: Path, numbers: tuple[int, int]) -> None:
    """Also where the numbers of the second go on after those of the first."""
    for name in ("a.1.exr", "a.2.exr", *(f"b.{number}.exr" for number in numbers)):
        (tmp_path / name).touch()
    with pytest.raises(NteError, match=r"'\*\.#\.exr' fits 2 sequences, such as a\.2\.exr and b\.\d\.exr: name one"):
        files_of_pattern(tmp_path, "*.#.exr")
    assert len(files_of_pattern(tmp_path, "b.#.exr")) == 2


def test_a_star_may_be_another_in_each_file(tmp_path: Path) -> None:
    """A folder for each frame, with the number in both names."""
    for number in (1, 2, 3):
        (tmp_path / f"{number:04d}").mkdir()
        (tmp_path / f"{number:04d}" / f"beauty.{number}.exr").touch()
    assert list(files_of_pattern(tmp_path, "*/beauty.#.exr")) == [1, 2, 3]


def test_a_map_says_which_of_two_numbers_is_the_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names with the frame and its time."""
    for i in (1, 2):
        write_exr(tmp_path / "in" / f"shot_{i:04d}_{4 * i}ms.exr", image("R", "G", "B"))
    said = refused(tmp_path, tmp_path / "in", {"channels": COLOR}, capsys)
    assert "2 numbers differ in the names" in said
    assert said.endswith("or say in a channel map (--map) which is the frame, as # of a file")
    assert len(imported(tmp_path, tmp_path / "in", {"channels": COLOR, "file": "shot_#_*ms.exr"})) == 2


@pytest.mark.parametrize("how", ["folder", "pattern", "map"])
def test_a_frame_that_is_a_link_to_nothing_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], how: str
) -> None:
    source = write(tmp_path / "shots", [image("R", "G", "B")] * 2)
    (source / "shot.3.exr").symlink_to(tmp_path / "gone.exr")
    about = {"channels": {"color": {"layer": ".", "file": "shot.#.exr"}} if how == "map" else COLOR}
    given = source / "shot.*.exr" if how == "pattern" else source
    assert "shot.3.exr: cannot be read: No such file" in refused(tmp_path, given, about, capsys)


def test_a_grey_image_beside_depth(tmp_path: Path) -> None:
    """Y and Z of no layer are the standard names of a grey image with depth."""
    depth = np.full(SIZE, 3.0, np.float32)
    grey = np.random.default_rng(0).random(SIZE, np.float32)
    source = write_layers(tmp_path / "grey", [{"Y": grey, "A": grey, "Z": depth}])
    about = write_map(tmp_path / "map.yaml", {"channels": {"color": ".", "depth": "Z"}})
    frame = Clip(import_exr(source, about, tmp_path / "clip").folder).frame(0)
    np.testing.assert_allclose(frame["color"][0], np.stack([grey] * 3), rtol=1e-3)


@pytest.mark.parametrize("miss", [0.0, 0.5, 127 / 255, 128 / 255])
def test_a_pixel_without_a_normal_or_a_position_is_no_surface(tmp_path: Path, miss: float) -> None:
    """Without depth, infinite positions are misses, and among encoded normals 0 and the middle, which bytes round."""
    normal = np.full((3, *SIZE), miss, np.float32)
    normal[:, 5:] = np.reshape([0.5, 1.0, 0.5], (3, 1, 1))
    position = np.where(np.arange(SIZE[0])[:, None] < 5, np.inf, 2.0) * np.ones((3, *SIZE))
    layers = named("N", "XYZ", normal) | named("P", "XYZ", position) | named("C", "RGB", np.ones((3, *SIZE)))
    source = write_layers(tmp_path / "shot", [layers] * 2)
    about = {"channels": {"color": "C", "normal": "N", "position": "P"}, "normal": {"encoded": True}}
    frame = Clip(import_exr(source, write_map(tmp_path / "map.yaml", about), tmp_path / "clip").folder).frame(0)
    for name, value in (("normal", (0, 1, 0)), ("position", (2, 2, 2))):
        np.testing.assert_array_equal(frame[name][0, :, :5], 0)
        np.testing.assert_array_equal(frame[name][0, :, 5:], np.broadcast_to(np.reshape(value, (3, 1, 1)), (3, 43, 64)))


def test_a_surface_whose_position_is_no_number_is_told_and_passes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    position = np.ones((3, *SIZE), np.float32)
    position[1, 7, 8] = np.nan
    layers = named("C", "RGB", np.ones((3, *SIZE))) | named("P", "XYZ", position) | {"Z": np.ones(SIZE, np.float32)}
    source = write_layers(tmp_path / "shot", [layers])
    about = write_map(tmp_path / "map.yaml", {"channels": {"color": "C", "position": "P", "depth": "Z"}})
    assert main(["import", "exr", str(source), "--map", str(about), "--out", str(tmp_path / "clip")]) == 0
    assert "bad: 1 pixels of position, first in" in capsys.readouterr().out
    np.testing.assert_array_equal(Clip(tmp_path / "clip").frame(0)["position"][0, :, 7, 8], 0)


@pytest.mark.parametrize("use", ["motion: {layer: MV, unknown: sky}", "still"])
def test_orthographic_cameras_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], use: str) -> None:
    projection = [[0.1, 0, 0, 0.5], [0, -0.1, 0, 0.5], [0, 0, 0.01, 0], [0, 0, 0, 1]]
    (tmp_path / "cameras.json").write_text(json.dumps([{"view": np.eye(4).tolist(), "projection": projection}] * 2))
    layers = named("C", "RGB", np.ones((3, *SIZE))) | named("P", "XYZ", np.ones((3, *SIZE)))
    layers |= named("MV", "XY", np.zeros((2, *SIZE))) | {"Z": np.zeros(SIZE, np.float32)}
    source = write_layers(tmp_path / "shot", [layers] * 2)
    about: dict[str, Any] = {"channels": {"color": "C", "position": "P"}, "still": True}
    if use != "still":
        about = {"channels": {"color": "C", "depth": "Z", "motion": {"layer": "MV", "unknown": "sky"}}}
    path = write_map(tmp_path / "map.yaml", {**about, "cameras": "cameras.json"})
    assert main(["import", "exr", str(source), "--map", str(path), "--out", str(tmp_path / "clip")]) == 2
    assert "camera 0: 'projection' is orthographic" in capsys.readouterr().err
    assert not (tmp_path / "clip").exists()


UNREAL = {
    "channels": {
        "color": ".",
        "motion": {"layer": "Vec", "scale": 2.0, "offset": -1.0},
        "albedo": {"layer": "A", "plus": "S"},
    }
}


def stored_as(channels: dict[str, Source], name: str) -> tuple[list[str], list[str], list[float], list[float]]:
    source = channels[name]
    return source.layer, source.plus, source.scale, source.offset


@pytest.mark.parametrize("spelled", [{"motion": "other", "albedo": "B"}, {"motion": {"layer": "other"}, "albedo": "B"}])
def test_a_map_that_names_another_layer_keeps_how_it_is_stored(tmp_path: Path, spelled: dict[str, Any]) -> None:
    """In a map based on another one as on the command line; what was added to the other layer is not added to it."""
    below = write_map(tmp_path / "below.yaml", UNREAL)
    based = load_channel_map(write_map(tmp_path / "map.yaml", {"base": "below.yaml", "channels": spelled})).channels
    typed = load_channel_map(below, ["channels.motion=other", "channels.albedo=B"]).channels
    at_once = load_channel_map(below, ["channels={motion: other, albedo: B}"]).channels
    for found in (based, typed, at_once):
        assert stored_as(found, "motion") == (["other"], [], [2.0], [-1.0])
        assert stored_as(found, "albedo") == (["B"], [], [1.0], [0.0])
        assert stored_as(found, "color") == (["."], [], [1.0], [0.0])


def test_a_map_that_says_how_a_layer_is_stored_keeps_its_name(tmp_path: Path) -> None:
    below = write_map(tmp_path / "below.yaml", {"channels": {"color": ".", "motion": "vel"}})
    how = {"channels": {"motion": {"scale": 0.5}}}
    based = load_channel_map(write_map(tmp_path / "map.yaml", {"base": "below.yaml", **how})).channels
    for found in (based, load_channel_map(below, ["channels={motion: {scale: 0.5}}"]).channels):
        assert stored_as(found, "motion") == (["vel"], [], [0.5], [0.0])


def test_channels_at_once_are_keys_with_values(tmp_path: Path) -> None:
    with pytest.raises(NteError, match=r"'channels=Z': expected the layers of channels"):
        load_channel_map(write_map(tmp_path / "map.yaml", UNREAL), ["channels=Z"])


@pytest.mark.parametrize(
    ("typed", "key", "value"),
    [
        ("file=*.#.exr", "file", "*.#.exr"),
        ("file=#/a.exr", "file", "#/a.exr"),
        ("part=no", "part", "no"),
        ("view=", "view", ""),
        ("file='a #.exr'", "file", "a #.exr"),
    ],
)
def test_texts_of_a_channel_are_taken_as_they_are_typed(tmp_path: Path, typed: str, key: str, value: str) -> None:
    about = {"channels": {"color": {"layer": ".", "view": "left"}}, "view": "right"}
    found = load_channel_map(write_map(tmp_path / "map.yaml", about), [f"channels.color.{typed}"])
    assert getattr(found.channels["color"], key) == value


@pytest.mark.parametrize(
    ("typed", "value"),
    [
        ("prefix=*", "*"),
        ("prefix=Layer #1", "Layer #1"),
        ("prefix=größe 😀: 1", "größe 😀: 1"),
        ("prefix=007", "007"),
        ("view=", ""),
        ("part=no", "no"),
        ("file=#.exr", "#.exr"),
        ("result='A | B'", "A | B"),
        ('prefix="*"', "*"),
    ],
)
def test_texts_of_a_map_are_taken_as_they_are_typed(tmp_path: Path, typed: str, value: str) -> None:
    path = write_map(tmp_path / "map.yaml", {"channels": COLOR, "prefix": "VL", "view": "right"})
    assert getattr(load_channel_map(path, [typed]), typed.partition("=")[0]) == value
