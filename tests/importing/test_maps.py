"""The channel maps that ship, each on files built as its renderer's documentation says."""

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import yaml

from nte.cli import main
from nte.errors import NteError
from nte.frames.clip import Clip
from nte.frames.exr import read_layers, write_exr
from nte.importing.cameras import camera_of_fov
from nte.importing.channel_map import MAPS, find_map, load_channel_map
from nte.importing.ids import UNNAMED
from nte.importing.recognise import recognise
from tests.importing.producers import (
    FOV,
    SIZE,
    SKY_ROWS,
    looked_at_from_aside,
    named,
    rays,
    rotation,
    scene,
    write_layers,
)
from tests.synthetic import Pixels, smooth_texture

Frames = Sequence[dict[str, Pixels]]
PER_UV = np.reshape([SIZE[1], SIZE[0]], (2, 1, 1))


def run(source: Path, name: str, out: Path, *more: str) -> int:
    return main(["import", "exr", str(source), *more, "--map", name, "--out", str(out)])


def mitsuba(folder: Path, frames: Frames) -> tuple[Path, list[str]]:
    written = [
        named("image", "RGB", f["color"])
        | dict(zip("RGB", f["color"], strict=True))
        | named("albedo", "RGB", 1.02 * f["albedo"])  # a rough conductor's goes beyond 1
        | named("nn", "XYZ", f["normal"])
        | {"dd.T": (f["depth"] * np.linalg.norm(rays(SIZE), axis=0))[0], "idx.I": f["instance"][0]}
        for f in frames
    ]
    return write_layers(folder / "shots", written), [f"vertical_fov={FOV}"]


def vray(folder: Path, frames: Frames) -> tuple[Path, list[str]]:
    view = looked_at_from_aside(frames)
    cameras = [{"view": view.tolist(), "projection": camera_of_fov(FOV, SIZE).projection.tolist()}] * len(frames)
    (folder / "cameras.json").write_text(json.dumps(cameras))
    written = [
        dict(zip("RGB", f["color"], strict=True))
        | named("effectsResult", "RGB", f["reference"])  # the denoised image
        | named("VRayDiffuseFilter", "RGB", f["albedo"])
        | named("normals", "XYZ", np.einsum("ij,jhw->ihw", view[:3, :3], f["normal"]))
        | named("velocity", "XYZ", np.stack([f["forward_motion"][0], -f["forward_motion"][1], f["depth"][0]]))
        | {"Z": np.where(f["depth"] > 0, f["depth"], 1e30)[0]}
        for f in frames
    ]
    return write_layers(folder / "shots", written), [f"cameras={folder / 'cameras.json'}"]


def arnold(folder: Path, frames: Frames) -> tuple[Path, list[str]]:
    folder = folder / "shots"
    for i, f in enumerate(frames):
        metal = f["instance"] == 2
        layers = (
            dict(zip("RGBA", [*f["color"], np.ones(SIZE, np.float32)], strict=True))
            | named("diffuse_albedo", "RGB", np.where(metal, 0, f["albedo"]))
            | named("specular_albedo", "RGB", np.where(metal, f["albedo"], 0.03 * (f["depth"] > 0)))
            | named("N", "XYZ", f["normal"])
            | named("motionvector", "RGB", np.stack([-f["motion"][0], f["motion"][1], 0 * f["depth"][0]]))
            | {"Z": np.where(f["depth"] > 0, f["depth"], 1e30)[0]}
        )
        ids = np.where(f["instance"] > 0, 3e9 + f["instance"].astype(float), 0)[0].astype(np.uint32)
        write_exr(folder / f"shot.{i:04d}.exr", {n: np.float32(v) for n, v in layers.items()} | {"ID": ids})
    return folder, []


def karma(folder: Path, frames: Frames) -> tuple[Path, list[str]]:
    written = [
        named("C", "rgba", np.concatenate([f["color"], np.ones_like(f["depth"])]))
        | named("albedo", "rgb", f["albedo"])
        | named("N", "xyz", f["normal"])
        | named("motionvectors", "xyz", np.stack([-f["motion"][0], f["motion"][1], 0 * f["depth"][0]]))
        | {"Pz": f["depth"][0], "objectid": f["instance"][0]}
        for f in frames
    ]
    return write_layers(folder / "shots", written, first=1001), []


def unreal(folder: Path, frames: Frames) -> tuple[Path, list[str]]:
    written = []
    for f in frames:
        uv = -f["motion"] / PER_UV * np.reshape([1, -1], (2, 1, 1))  # current − previous, y upwards
        depth = np.where(f["depth"] > 0, 100 * f["depth"], np.inf)
        written.append(
            dict(zip("RGBA", [*f["color"], np.ones(SIZE)], strict=True))
            | named("FinalImageMovieRenderQueue_WorldDepth", "RGB", np.concatenate([depth, f["depth"], depth / 3]))
            | named("FinalImageMovieRenderQueue_MotionVectors", "RG", uv / 2 + 0.5)
            | named("FinalImageWorldNormal", "RGB", f["normal"] / 2 + 0.5)
            | named("FinalImageBaseColor", "RGB", f["albedo"])
            | named("ActorHitProxyMask00", "RGBA", np.concatenate([f["color"], f["depth"]]))
        )
    return write_layers(folder / "shots", written), []


def falcor(folder: Path, frames: Frames) -> tuple[Path, list[str]]:
    folder = folder / "captured [v2] größer"
    for i, f in enumerate(frames):
        miss = f["depth"] == 0
        outputs = {
            "PathTracer.color": dict(zip("RGB", f["color"], strict=True)),
            "GBufferRT.mvec": dict(zip("RGB", [*(f["motion"] / PER_UV), np.zeros(SIZE)], strict=True)),
            "GBufferRT.normW": dict(zip("RGBA", [*f["normal"], np.zeros(SIZE)], strict=True)),
            "GBufferRT.linearZ": dict(zip("RG", [np.where(miss, 1e8, f["depth"])[0], np.full(SIZE, 0.3)], strict=True)),
            "GBufferRT.diffuseOpacity": dict(zip("RGBA", [*f["albedo"], np.ones(SIZE)], strict=True)),
            "GBufferRT.texC": {"R": np.zeros(SIZE), "G": np.zeros(SIZE)},
        }
        for output, layers in outputs.items():
            write_exr(folder / f"Mogwai.{output}.{98 + i}.exr", {n: np.float32(v) for n, v in layers.items()})
    return folder, []


EVERY = ("color", "albedo", "normal", "depth", "motion")
RENDERERS: dict[str, tuple[Callable[[Path, Frames], tuple[Path, list[str]]], tuple[str, ...]]] = {
    "mitsuba": (mitsuba, ("color", "normal", "depth", "instance")),
    "vray": (vray, ("color", "albedo", "normal", "depth", "forward_motion")),
    "arnold": (arnold, EVERY),
    "karma": (karma, (*EVERY, "instance")),
    "unreal": (unreal, EVERY),
    "falcor": (falcor, EVERY),
}


@pytest.mark.parametrize("name", RENDERERS)
def test_a_renderers_files_become_our_channels(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = scene()
    build, channels = RENDERERS[name]
    source, overrides = build(tmp_path, frames)
    assert run(source, name, tmp_path / "clip", *overrides) == 0
    if "motion" in channels:
        assert "clip: plausible" in capsys.readouterr().out
    for index, frame in enumerate(frames):
        found = Clip(tmp_path / "clip").frame(index)
        depth = {"depth": np.where(frame["depth"] > 0, frame["depth"], 0)}
        for channel in channels:
            known = frame["depth"] > 0 if "motion" in channel else np.ones_like(frame["depth"], bool)
            values, expected = (np.where(known, a, 0) for a in (found[channel][0], (frame | depth)[channel]))
            np.testing.assert_allclose(values, expected, rtol=1e-3, atol=1e-3, err_msg=channel)
            assert np.isfinite(found[channel]).all()
            if "motion" in channel:  # the sky's are unknown, so they are those of what is nearest to it
                assert np.abs(found[channel][0, :, :SKY_ROWS]).max() < 10


def test_ids_of_32_bits_stay_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = scene(2)
    source, _ = arnold(tmp_path, frames)
    assert run(source, "arnold", tmp_path / "clip") == 0
    assert "renumbered: 2 ids of instance" in capsys.readouterr().out
    for index, frame in enumerate(frames):
        found = Clip(tmp_path / "clip").frame(index)["instance"][0]
        assert len(np.unique(found)) == 3  # the sky, the wall, the disc
        assert (np.unique(found[frame["instance"] == 2]) == 2**23 + 1).all()
        assert not found[frame["instance"] == 0].any()


def test_the_polygons_of_karma_are_no_objects(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, _ = karma(tmp_path, scene(2))
    for path in source.iterdir():
        write_exr(path, {"primid" if name == "objectid" else name: v for name, v in read_layers(path).items()})
    assert run(source, "karma", tmp_path / "clip") == 0
    assert "instance" not in Clip(tmp_path / "clip").channels
    assert "instance from" not in capsys.readouterr().out


def test_the_image_that_is_not_denoised_is_taken_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = scene(2)
    source, overrides = vray(tmp_path, frames)
    assert run(source, "vray", tmp_path / "clip", *overrides) == 0
    assert "read color from R G B, " in capsys.readouterr().out
    np.testing.assert_array_equal(Clip(tmp_path / "clip").frame(0)["color"][0], frames[0]["color"])


def test_a_channel_without_its_camera_is_left_out_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, _ = vray(tmp_path, scene(2))
    assert run(source, "vray", tmp_path / "clip") == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if "without normal" in line or "left out" in line]
    lacks = "'normal.space' is camera: 'cameras' must name the JSON file of the cameras"
    assert lines == [f"  without normal (left out: {lacks}): only denoisers that need none, such as taa"]
    assert "normal" not in Clip(tmp_path / "clip").channels


def corner(index: int) -> tuple[dict[str, Pixels], Pixels, Pixels]:
    """What BMFR stores of frame `index` of two walls that meet, its depth and its motion."""

    def to_pixels(i: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        basis = rotation(0.3 + 0.03 * i)
        intrinsic = np.array([[70, 0, SIZE[1] / 2], [0, 70, SIZE[0] / 2], [0, 0, 1.0]])
        return np.asarray(intrinsic @ np.concatenate([basis, -basis @ [[0.2 * i], [0.1], [-4]]], 1))

    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    now, before = to_pixels(index), to_pixels(index - 1)
    rays = np.linalg.solve(now[:, :3], np.stack([x, y, np.ones(SIZE)]).reshape(3, -1))  # by depth
    eye = np.linalg.solve(now[:, :3], -now[:, 3])
    walls = np.array([[0.5, 0.1, 1.0], [-0.7, 0.2, 1.0]])  # those of points with n·p = 2
    depths = (2 - walls @ eye)[:, None] / (walls @ rays)
    depth = np.where(depths > 0, depths, np.inf).min(0)
    points = eye[:, None] + depth * rays
    u, v, w = before[:, :3] @ points + before[:, 3:]
    motion = np.stack([u / w, v / w]).reshape(2, *SIZE) - np.stack([x, y])
    position = points.reshape(3, *SIZE)
    albedo = smooth_texture(9 * position[0], 9 * position[1])
    normal = -walls[depths.argmin(0)].T.reshape(3, *SIZE)  # to the eye
    channels = {"color": 2 * albedo, "albedo": albedo, "shading_normal": normal, "world_position": position}
    return channels, depth.reshape(SIZE), motion


def test_bmfrs_data_get_motion_and_depth_from_positions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sky = np.zeros(SIZE, bool)
    sky[:6, :30] = True
    for i in range(8, 12):  # padding that changes: color8, color10
        for name, values in corner(i)[0].items():
            seen = values if name == "color" else np.where(sky, 0, values)
            layers = {c: np.ascontiguousarray(v, np.float32) for c, v in zip("RGB", seen, strict=True)}
            write_exr(tmp_path / "inputs" / f"{name}{i}.exr", layers)
    (tmp_path / "inputs" / "camera_matrices.h").write_text("float a[4];")
    assert run(tmp_path / "inputs", "bmfr", tmp_path / "clip") == 0
    said = capsys.readouterr().out
    assert "made from position, as if only the camera moves: depth and motion" in said
    assert "clip: plausible" in said
    clip = Clip(tmp_path / "clip")
    assert len(clip) == 4
    for index in (1, 2, 3):
        _, depth, motion = corner(index + 8)
        found = clip.frame(index)
        np.testing.assert_allclose(found["depth"][0, 0][~sky], depth[~sky], rtol=1e-3)
        np.testing.assert_allclose(found["motion"][0][:, ~sky], motion[:, ~sky], atol=0.01)
        assert not found["depth"][0, 0][sky].any()
        assert np.isfinite(found["motion"]).all()


def test_what_depth_made_of_positions_calls_a_surface_is_one(tmp_path: Path) -> None:
    """Mitsuba counts shapes from 0, which is a miss in nte; normals and vectors of a sky are those of no surface."""
    sky = np.zeros(SIZE, bool)
    sky[:6] = True
    for i in range(2):
        seen = corner(i)[0]
        layers = dict(zip("RGB", seen["color"], strict=True)) | named("nn", "XYZ", seen["shading_normal"])
        layers |= named("pos", "XYZ", np.where(sky, 0, seen["world_position"])) | {"idx.I": np.zeros(SIZE)}
        layers |= named("next", "XY", np.where(sky, 0, np.full((2, *SIZE), 3.0)))
        write_exr(tmp_path / f"shot.{i}.exr", {n: np.ascontiguousarray(v, np.float32) for n, v in layers.items()})
    run(tmp_path, "mitsuba", tmp_path / "clip", "still=true", "channels.forward_motion={layer: next, unknown: sky}")
    found = Clip(tmp_path / "clip").frame(0)
    np.testing.assert_array_equal(found["instance"][0, 0], np.where(sky, 0, UNNAMED))
    assert not found["normal"][0][:, sky].any()
    assert found["normal"][0][:, ~sky].any()
    np.testing.assert_array_equal(found["forward_motion"][0][:, ~sky], 3)
    assert np.abs(found["forward_motion"][0][:, sky]).max() > 1  # the camera's rotation, as the stored 0 is unknown


def test_positions_that_do_not_tell_the_camera_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for i in range(3):
        for name, values in corner(i)[0].items():
            flat = np.zeros_like(values) if (name, i) == ("world_position", 1) else values
            layers = {c: np.ascontiguousarray(v, np.float32) for c, v in zip("RGB", flat, strict=True)}
            write_exr(tmp_path / "inputs" / f"{name}{i}.exr", layers)
    assert run(tmp_path / "inputs", "bmfr", tmp_path / "clip") == 2
    assert "world_position1.exr: 'position' does not say where the camera is" in capsys.readouterr().err
    assert not (tmp_path / "clip").exists()


def blender_parts(path: Path, frame: dict[str, Pixels], views: Sequence[str], denoised: Pixels) -> None:
    """A frame as Blender 5.0 writes it (seen with bpy 5.0.1): one part for each pass and view."""
    parts = []
    for view in views:
        other = 0.5 if view == "right" else 1.0
        passes = {
            "Combined": ("RGBA", np.concatenate([other * denoised, np.ones_like(frame["depth"])])),
            "Noisy Image": ("RGBA", np.concatenate([other * frame["color"], np.ones_like(frame["depth"])])),
            "Diffuse Color": ("RGB", other * frame["albedo"]),
            "Depth": ("Z", frame["depth"]),
            "CryptoObject00": ("rgba", np.concatenate([frame["color"], frame["depth"]])),
        }
        for name, (components, planes) in passes.items():
            layers = {f"ViewLayer.{name}.{c}": np.float32(p) for c, p in zip(components, planes, strict=True)}
            header = {"type": OpenEXR.scanlineimage} | ({"view": view} if view else {})
            parts.append(OpenEXR.Part(header, layers, f"ViewLayer.{name}{'-' if view else ''}{view}"))
    path.parent.mkdir(exist_ok=True)
    with OpenEXR.File(parts) as file:
        file.write(str(path))


def test_blenders_image_before_denoising_is_the_noisy_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = scene(2)
    for i, frame in enumerate(frames):
        blender_parts(tmp_path / "shots" / f"v2.{i:04d}.exr", frame, [""], frame["reference"])
    assert main(["import", "blender", str(tmp_path / "shots"), "--out", str(tmp_path / "clip")]) == 0
    assert "color from ViewLayer.Noisy Image, albedo from ViewLayer.Diffuse Color" in capsys.readouterr().out
    np.testing.assert_array_equal(Clip(tmp_path / "clip").frame(1)["color"][0], frames[1]["color"])


def test_one_eye_of_a_stereo_image_is_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (frame,) = scene(1)
    blender_parts(tmp_path / "shots" / "shot.0001.exr", frame, ["left", "right"], frame["reference"])
    command = ["import", "blender", str(tmp_path / "shots"), "--out", str(tmp_path / "clip")]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert "the views 'left' and 'right' both have a channel 'ViewLayer.Combined." in error
    assert "with view=NAME" in error
    for view, factor in (("left", 1), ("right", 0.5)):
        assert main([*command, "--force", f"view={view}"]) == 0
        found = Clip(tmp_path / "clip").frame(0)
        for name in ("color", "albedo"):
            np.testing.assert_allclose(found[name][0], factor * frame[name], rtol=1e-3, atol=1e-4)
    assert main([*command, "--force", "view=middle"]) == 2
    assert "no view 'middle'; the file has left, right" in capsys.readouterr().err


def test_a_part_for_each_layer_is_read_like_one_part(tmp_path: Path) -> None:
    frames = scene(2)
    source, _ = arnold(tmp_path, frames)
    for path in source.iterdir():
        layers: dict[str, dict[str, Pixels]] = {}
        for name, plane in read_layers(path).items():
            layer, _, component = name.rpartition(".")
            layers.setdefault(layer or {"Z": "Z", "ID": "ID"}.get(name, "RGBA"), {})[component] = plane
        parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, planes, name) for name, planes in layers.items()]
        with OpenEXR.File(parts) as file:
            file.write(str(path))
    assert run(source, "arnold", tmp_path / "clip") == 0
    found = Clip(tmp_path / "clip").frame(1)
    for name in EVERY:
        known = frames[1]["depth"] > 0
        np.testing.assert_allclose(np.where(known, found[name][0], 0), np.where(known, frames[1][name], 0), atol=2e-3)
    assert len(np.unique(found["instance"])) == 3


def test_every_map_that_ships_can_be_loaded_and_names_its_source() -> None:
    maps = sorted(MAPS.glob("*.yaml"))
    assert {path.stem for path in maps} == {*RENDERERS, "blender", "bmfr"}
    for path in maps:
        text = path.read_text(encoding="utf-8")
        assert "https://" in text
        assert "ocumented" in text
        assert load_channel_map(path).optional
        assert set(yaml.safe_load(text)["channels"]) >= {"color", "albedo", "normal"}


def test_maps_are_parsed_once_however_many_files_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, _ = arnold(tmp_path, scene(2))
    paths = sorted(source.iterdir())
    assert recognise(paths[0]) == "arnold"

    def parse(path: Path) -> None:
        raise AssertionError(f"{path} is parsed again")

    monkeypatch.setattr("nte.importing.recognise.load_channel_map", parse)
    assert recognise(paths[1]) == "arnold"


def test_thousands_of_channels_are_looked_at_one_by_one(tmp_path: Path) -> None:
    """Each layer is a prefix that might be meant: looking for each in all channels took ten seconds and more."""
    path = tmp_path / "many.exr"
    write_exr(path, {f"layer{i}.{'RGB'[i % 3]}": np.zeros((2, 2), np.float16) for i in range(5000)})
    start = time.process_time()
    with pytest.raises(NteError, match=r"many\.exr: has no channel of ours"):
        recognise(path)
    assert time.process_time() - start < 5


def test_an_unknown_map_lists_what_there_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "blendr", tmp_path / "clip") == 2
    assert "did you mean blender? expected one of arnold, blender, bmfr, falcor, karma" in capsys.readouterr().err
    assert run(tmp_path, "maps/none.yaml", tmp_path / "clip") == 2
    assert "maps/none.yaml: cannot be read" in capsys.readouterr().err
    assert find_map("vray") == MAPS / "vray.yaml"


@pytest.mark.slow
def test_mitsubas_own_files_have_the_layers_of_its_map(tmp_path: Path) -> None:
    from nte.render.engine.backend import load_mitsuba

    mi = load_mitsuba()
    box = mi.cornell_box()
    box["sensor"]["film"] |= {"width": 24, "height": 16, "rfilter": {"type": "box"}}
    aovs = "albedo:albedo,nn:sh_normal,dd:depth,pos:position,idx:shape_index"
    box["integrator"] = {"type": "aov", "aovs": aovs, "any name": {"type": "path"}}
    loaded = mi.load_dict(box)
    for i in range(2):
        mi.render(loaded, spp=1, seed=i)
        (tmp_path / "shots").mkdir(exist_ok=True)
        loaded.sensors()[0].film().bitmap().write(str(tmp_path / "shots" / f"box.{i}.exr"))
    assert run(tmp_path / "shots", "mitsuba", tmp_path / "clip", "vertical_fov=39.3", "still=true") == 0
    found = Clip(tmp_path / "clip").frame(1)
    assert {"color", "albedo", "normal", "depth", "position", "instance", "motion"} <= set(found.channels)
    assert np.abs(found["motion"]).mean() < 0.1  # the camera rests; it is recovered from jittered samples
