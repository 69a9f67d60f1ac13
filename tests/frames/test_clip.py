"""Clips on disk: what is stored comes back with everything that belongs to it, and what is wrong is named."""

import json
from pathlib import Path

import numpy as np
import pytest

from nte.errors import NteError
from nte.frames.clip import Clip, read_frame, write_frame
from nte.frames.clip_files import find_clips, frame_path
from nte.frames.clip_info import write_clip_info
from nte.frames.exr import read_layers, write_exr
from tests.synthetic import Pixels, disc_clip, disc_frame, write_clip

SIZE = 12, 16


def small_frames(count: int) -> list[dict[str, Pixels]]:
    return [disc_frame(i, SIZE, start=(6.0, 6.0), radius=3.0) for i in range(count)]


def test_channels_survive_in_the_storage_of_the_table(tmp_path: Path) -> None:
    (given,) = small_frames(1)
    write_frame(tmp_path / "a.exr", given)
    read = read_frame(tmp_path / "a.exr")
    assert read.keys() == given.keys()
    for name, values in given.items():
        half = name in ("color", "albedo", "normal")
        np.testing.assert_array_equal(read[name], values.astype(np.float16 if half else np.float32), err_msg=name)
        assert read[name].dtype == np.float32
    stored = read_layers(tmp_path / "a.exr")
    assert stored["color.R"].dtype == np.float16
    assert stored["motion.X"].dtype == np.float32


@pytest.mark.parametrize("bright", [65504.0, 65519.0, 65520.0, 1e6, 3e38])
def test_radiance_beyond_half_floats_survives(tmp_path: Path, bright: float) -> None:
    color = np.full((3, 4, 5), bright, np.float32)
    color[0, 0, 0] = 0.1
    write_frame(tmp_path / "a.exr", {"color": color})
    np.testing.assert_allclose(read_frame(tmp_path / "a.exr")["color"], color, rtol=1e-3)


@pytest.mark.parametrize("level", [1e-3, 1e-6, 1e-7, 1e-8, 1e-30])
def test_radiance_of_any_unit_survives(tmp_path: Path, level: float) -> None:
    color = (level * np.random.default_rng(0).exponential(size=(3, 9, 11))).astype(np.float32)
    color[0, 0, :3] = [1e3, 0, np.nan]  # a light in the dark, and what says nothing of it
    write_frame(tmp_path / "a.exr", {"color": color})
    np.testing.assert_allclose(read_frame(tmp_path / "a.exr")["color"], color, rtol=1e-3, atol=1e-6 * level)


def test_half_floats_stay_where_a_few_pixels_are_nearly_black(tmp_path: Path) -> None:
    color = np.random.default_rng(0).exponential(0.1, (3, 32, 32)).astype(np.float32)
    color[:, ::5, ::7] = 1e-9  # as at one sample per pixel
    write_frame(tmp_path / "a.exr", {"color": color, "albedo": color.clip(0, 1)})
    assert {plane.dtype for plane in read_layers(tmp_path / "a.exr").values()} == {np.dtype(np.float16)}


def test_bad_pixels_survive_for_the_denoiser_to_see(tmp_path: Path) -> None:
    color = np.array([np.nan, np.inf, -1], np.float32).reshape(3, 1, 1)
    write_frame(tmp_path / "a.exr", {"color": color})
    np.testing.assert_array_equal(read_frame(tmp_path / "a.exr")["color"], color)


def test_a_frame_has_its_channels_index_and_the_clip_s_scalars_and_cameras(tmp_path: Path) -> None:
    cameras = [{"view": np.diag([i + 1] * 4).tolist(), "projection": np.eye(4).tolist()} for i in range(3)]
    clip = Clip(write_clip(tmp_path / "c", small_frames(3), exposure=2.5, depth_scale=4, shutter=0.5, cameras=cameras))
    assert len(clip) == 3
    assert [frame.index for frame in clip] == [0, 1, 2]
    frame = clip.frame(2)
    assert frame.size == SIZE
    assert frame["color"].shape == (1, 3, *SIZE)
    assert (frame.exposure, frame.depth_scale, frame.shutter) == ([2.5], [4], [0.5])
    assert frame.view.shape == (1, 4, 4)
    np.testing.assert_array_equal(frame.view[0], np.diag([3] * 4))
    assert set(frame.channels) == set(clip.channels)
    bare = Clip(write_clip(tmp_path / "bare", small_frames(1))).frame(0)
    assert bare.exposure is bare.depth_scale is bare.shutter is bare.view is None


@pytest.mark.parametrize(
    ("info", "clean"),
    [
        ({}, None),
        ({"clean_guides": True}, True),
        ({"clean_guides": False}, False),
        ({"clean_guides": None, "origin": {"generator": "nte render"}}, None),
        ({"origin": {"generator": "nte render"}}, True),  # before the key was written
        ({"origin": {"generator": "Blender"}}, None),
        ({"origin": "nte render"}, None),
    ],
)
def test_guides_are_clean_where_the_clip_says_so(tmp_path: Path, info: dict[str, object], clean: bool | None) -> None:
    clip = Clip(write_clip(tmp_path / "c", small_frames(1), **info))
    assert clip.clean_guides is clean
    assert clip.frame(0).torch().numpy().with_channels().clean_guides is clean


def test_previous_forward_motion_is_the_forward_motion_of_the_frame_before(tmp_path: Path) -> None:
    frames = small_frames(3)
    for i, frame in enumerate(frames):
        frame["forward_motion"] += i
    clip = Clip(write_clip(tmp_path / "c", frames))
    assert np.isnan(clip.frame(0)["previous_forward_motion"]).all()
    for order in ((1, 2), (2, 1), (2, 2)):  # in order, backwards, again
        for i in order:
            np.testing.assert_array_equal(clip.frame(i)["previous_forward_motion"][0], frames[i - 1]["forward_motion"])
    without = [{"color": frame["color"]} for frame in frames]
    assert Clip(write_clip(tmp_path / "without", without)).channels == ("color",)


@pytest.mark.parametrize("moment", [1, 2])
def test_a_clip_that_two_threads_read_mixes_up_no_frames(tmp_path: Path, moment: int) -> None:
    # A training's thread decodes a clip while its held-out frames are validated.
    frames = small_frames(4)
    for i, frame in enumerate(frames):
        frame["forward_motion"] += i

    class Shared(Clip):
        """A clip of which another thread reads frame 3 after the first or second look at the last one that was read."""

        @property
        def _last_forward(self) -> object:
            kept, self.looks = self.kept, self.looks + 1
            if self.looks == moment:
                self.kept = 3, frames[3]["forward_motion"]
            return kept

        @_last_forward.setter
        def _last_forward(self, last: object) -> None:
            self.kept = last

    clip = Shared(write_clip(tmp_path / "c", frames))
    for i in range(1, 4):
        clip.kept, clip.looks = (i - 1, frames[i - 1]["forward_motion"]), 0
        np.testing.assert_array_equal(clip.frame(i)["previous_forward_motion"][0], frames[i - 1]["forward_motion"])


def test_the_reference_is_the_mean_of_its_halves(tmp_path: Path) -> None:
    halves = {"reference_a": np.full((3, 2, 2), 1, np.float32), "reference_b": np.full((3, 2, 2), 4, np.float32)}
    clip = Clip(write_clip(tmp_path / "c", [{"color": np.ones((3, 2, 2), np.float32)} | halves]))
    frame = clip.frame(0, ("reference", "reference_b"))
    assert set(frame.channels) == {"reference", "reference_b"}
    assert (frame["reference"] == 2.5).all()


def test_k_seeds_are_averaged_in_the_noisy_channels_alone(tmp_path: Path) -> None:
    folder = write_clip(tmp_path / "c", small_frames(1), seeds=3)
    color = small_frames(1)[0]["color"]
    for seed in (1, 2):
        write_frame(frame_path(folder, 0, seed), {"color": color + seed})
    clip = Clip(folder)
    assert clip.seeds == 3
    half = color.astype(np.float16).astype(np.float32)
    for seeds, more in (((0,), 0), ((2,), 2), ((0, 1, 2), 1), ((1, 2), 1.5)):
        frame = clip.frame(0, seeds=seeds)
        np.testing.assert_allclose(frame["color"][0], half + more, rtol=2e-3)
        np.testing.assert_array_equal(frame["albedo"], clip.frame(0)["albedo"])


def test_the_mean_of_seeds_is_over_those_that_have_a_value_and_a_direction_keeps_its_light(tmp_path: Path) -> None:
    """A penumbra is shadowed in some seeds, and each seed's gradient samples lie in other pixels."""
    nan = np.nan
    vectors = [[[3, nan, nan, 1]], [[5, 7, nan, 1]], [[1, nan, nan, nan]]]
    directions = [[[1, 0, 0, 0]], [[0, 1, 0, 0]], [[0, 0, 1, 0]]]

    def seed(i: int) -> dict[str, np.ndarray]:
        one = np.float32([directions[i]])
        return {
            "color": np.full((3, 1, 4), i, np.float32),
            "shadow_motion": np.float32(vectors[i]).repeat(2, 0)[:, None],
            "indirect_direction": one.repeat(3, 0),
            "indirect_radiance": 4 * one.repeat(3, 0),
        }

    folder = write_clip(tmp_path / "c", [seed(0)], seeds=3)
    for i in (1, 2):
        write_frame(frame_path(folder, 0, i), seed(i))
    frame = Clip(folder).frame(0, seeds=(0, 1, 2))
    assert (frame["color"] == 1).all()
    np.testing.assert_array_equal(frame["shadow_motion"][0], np.float32([[[3, 7, nan, 1]]] * 2))
    frame = Clip(folder).frame(0, seeds=(1, 2))
    np.testing.assert_array_equal(frame["shadow_motion"][0], np.float32([[[3, 7, nan, 1]]] * 2))
    np.testing.assert_array_equal(frame["indirect_direction"][0, 0, 0], [0, 1, 0, 0])
    np.testing.assert_array_equal(frame["indirect_radiance"][0, 0, 0], [0, 4, 0, 0])


def test_layers_of_others_are_ignored_and_half_a_channel_is_named(tmp_path: Path) -> None:
    plane = np.ones((2, 2), np.float32)
    write_exr(tmp_path / "a.exr", {"color.R": plane, "color.G": plane, "color.B": plane, "mist.V": plane})
    assert set(read_frame(tmp_path / "a.exr")) == {"color"}
    write_exr(tmp_path / "b.exr", {"motion.X": plane, "color.R": plane, "color.G": plane})
    with pytest.raises(NteError, match=r"b\.exr: channel 'color' has only color\.G, color\.R: expected R, G, B"):
        read_frame(tmp_path / "b.exr")


def test_a_missing_channel_is_named_with_its_file(tmp_path: Path) -> None:
    frames = small_frames(2)
    del frames[1]["albedo"]
    clip = Clip(write_clip(tmp_path / "c", frames))
    with pytest.raises(NteError, match=r"frame_0001\.exr: channel 'albedo' is missing; the file has color"):
        clip.frame(1)
    with pytest.raises(NteError, match=r"frame_0000\.exr: channel 'glossy' is missing"):
        clip.frame(0, ("glossy",))


def test_frames_of_another_size_and_gaps_are_named(tmp_path: Path) -> None:
    folder = write_clip(tmp_path / "c", small_frames(3))
    write_frame(frame_path(folder, 1), disc_frame(1, (12, 18)))
    with pytest.raises(NteError, match=r"frame_0001\.exr: is 18x12, clip\.json says 16x12: render or copy"):
        list(Clip(folder))
    frame_path(folder, 1).unlink()
    with pytest.raises(NteError, match=r"frame_0001\.exr: missing; clip\.json promises 3 frames: copy it"):
        Clip(folder)
    seeds = write_clip(tmp_path / "s", small_frames(1), seeds=2)
    with pytest.raises(NteError, match=r"seed_01/frame_0000\.exr: missing"):
        Clip(seeds)


GOOD = {"format": "nte-clip/1", "width": 16, "height": 12, "frames": 1}


@pytest.mark.parametrize(
    ("info", "message"),
    [
        (b"[" * 100_000, "not readable as JSON"),
        ({"format": "nte-clip/1", "width": 1, "height": 1, "frames": 10**308}, "'frames' is 1000"),
        ({"format": "nte-clip/1", "width": 1, "height": 1, "frames": 1, "exposure": 10**308}, "'exposure' is 1000"),
        (
            {
                "format": "nte-clip/1",
                "width": 1,
                "height": 1,
                "frames": 1,
                "cameras": [{"view": [[10**308] * 4] * 4, "projection": [[1] * 4] * 4}],
            },
            r"'cameras\[0\].view' is no 4x4 matrix of finite",
        ),
        (b"", "not readable as JSON"),
        (b"{", "not readable as JSON"),
        (b"\xff\xfe", "not readable as JSON"),
        ([], "format is 'list'"),
        ({}, "format is None, expected 'nte-clip/1'"),
        (GOOD | {"format": "nte-clip/2"}, "format is 'nte-clip/2'"),
        (GOOD | {"width": "16"}, "'width' is '16', expected a whole number"),
        (GOOD | {"frames": 0}, "'frames' is 0"),
        (GOOD | {"frames": True}, "'frames' is True"),
        (GOOD | {"seeds": "two"}, "'seeds' is 'two'"),
        (GOOD | {"exposure": "bright"}, "'exposure' is 'bright', expected a positive number"),
        (GOOD | {"exposure": 0}, "'exposure' is 0"),
        (GOOD | {"shutter": -0.5}, "'shutter' is -0.5, expected the open share of the frame"),
        (GOOD | {"shutter": 180}, "'shutter' is 180"),
        (GOOD | {"depth_scale": -1}, "'depth_scale' is -1"),
        (GOOD | {"clean_guides": "yes"}, "'clean_guides' is 'yes', expected true, false or null"),
        (GOOD | {"clean_guides": 1}, "'clean_guides' is 1"),
        (GOOD | {"clean_guides": "y" * 10_000}, "'clean_guides' is 'y{39}, expected"),
        (GOOD | {"format": "y" * 10_000}, "format is 'y{39}, expected"),
        (GOOD | {"spp": "1"}, "'spp' is '1', expected a positive number"),
        (GOOD | {"fps": float("nan")}, "'fps' is nan"),
        (GOOD | {"origin": {"recipe": "\ud800"}}, "not readable as JSON: .* surrogates not allowed"),
        (GOOD | {"cameras": 3}, "'cameras' has 3 for 1 frames"),
        (GOOD | {"cameras": []}, "'cameras' has 0 for 1 frames"),
        (GOOD | {"cameras": [{"view": [[1]]}]}, r"'cameras\[0\]\.view' is no 4x4 matrix"),
        (GOOD | {"cameras": [7]}, r"'cameras\[0\]\.view' is no 4x4 matrix"),
        (
            GOOD | {"cameras": [{"view": np.eye(4).tolist(), "projection": [[0] * 4] * 4}]},
            r"'cameras\[0\]\.projection' has no inverse: expected the matrix of a camera",
        ),
    ],
)
def test_a_wrong_clip_json_is_named_with_its_key(tmp_path: Path, info: object, message: str) -> None:
    folder = write_clip(tmp_path / "c", small_frames(1))
    (folder / "clip.json").write_bytes(info if isinstance(info, bytes) else json.dumps(info).encode())
    with pytest.raises(NteError, match=r"clip\.json: .*" + message) as error:
        Clip(folder)
    assert "\n" not in str(error.value)


def test_folders_that_are_no_clip(tmp_path: Path) -> None:
    folder = write_clip(tmp_path / "c", small_frames(1))
    (folder / "clip.json").unlink()
    for path, message in (
        (folder, "c: has frames but no clip.json: the clip is not finished"),
        (tmp_path, "is no clip; expected a folder with clip.json"),
        (tmp_path / "nowhere", "nowhere: does not exist"),
    ):
        with pytest.raises(NteError, match=message):
            Clip(path)


def test_clips_are_found_once_and_in_the_order_of_their_names(tmp_path: Path) -> None:
    for name in ("b", "a", "deeper/c", ".d.abc.tmp"):  # the last one is being imported
        disc_clip(tmp_path / name, frames=1)
    found = find_clips([tmp_path, tmp_path / "a"])
    assert [str(path.relative_to(tmp_path)) for path in found] == ["a", "b", "deeper/c"]
    (tmp_path / "empty").mkdir()
    for path, message in ((tmp_path / "empty", "no clip in it"), (tmp_path / "x", "does not exist")):
        with pytest.raises(NteError, match=message):
            find_clips([path])


def test_the_same_clip_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_clip_info(tmp_path / name, {"frames": 1, "width": 2, "height": 3})
    assert (tmp_path / "a" / "clip.json").read_bytes() == (tmp_path / "b" / "clip.json").read_bytes()


def test_a_thousand_million_promised_frames_are_not_looked_for(tmp_path: Path) -> None:
    folder = write_clip(tmp_path / "c", small_frames(1))
    info = json.loads((folder / "clip.json").read_text())
    (folder / "clip.json").write_text(json.dumps(info | {"frames": 10**9}))
    with pytest.raises(NteError, match=r"frame_0001\.exr: missing; clip\.json promises 1000000000 frames"):
        Clip(folder)
