"""Motion blur: what each sample's time, motion and depth say, against motion whose answer is known."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from nte.errors import NteError
from nte.frames import Clip
from nte.frames.clip_files import find_clips
from nte.frames.exr import read_exr
from nte.render.engine import backend
from nte.render.engine.mesh_stage import MeshStage
from nte.render.passes.gbuffer import geometry
from nte.render.passes.hits import points_at
from nte.render.passes.radiance import radiance
from nte.render.passes.shutter import SUBFRAMES, _hits, _strata, _times, _trace, blurred, centre_motion
from nte.render.passes.unshadowed import unshadowed_integrator
from nte.render.recipes.clips import render_recipe
from nte.render.scenes.families import FAMILIES
from nte.render.world.seeds import derive_generator
from nte.render.world.transforms import look_at, moving, rotation, still, translation
from tests.render.shots import radiance_at
from tests.render.test_clips import contents
from tests.render.test_gbuffer import FOCAL, HEIGHT, WIDTH, board, staged

SHUTTER = 0.5
SPEED = np.array([-1.2, 0.0, 0.4])  # scene units a frame, at depth 4: to the right, and away
FAST = moving(lambda time: np.array([0, 0, 4]) + SPEED * time, (0, 1, 0), 0.0)
CHECKS = np.kron(np.indices((4, 4)).sum(0) % 2, np.ones((2, 2)))[..., None].repeat(3, 2).astype(np.float32)


def unshadowed(stage: MeshStage) -> MeshStage:
    return MeshStage(stage.scene, WIDTH, HEIGHT, 2, unshadowed_integrator())


def image_of(points: np.ndarray) -> np.ndarray:
    """Pixel positions (..., 2) of world points as the camera of `staged` sees them."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([WIDTH / 2 - FOCAL * x / z, HEIGHT / 2 - FOCAL * y / z], -1)


@pytest.fixture(scope="module")
def flying() -> tuple[list[dict[str, np.ndarray]], list[np.ndarray]]:
    """A small board in front of a still wall with a pattern: seeds, and the reference's halves."""
    wall = board(6, 8, color=CHECKS)
    return blurred(unshadowed(staged(board(0, 1, FAST), wall)), 0.0, SHUTTER, 512, list(range(3)), [100, 101])


def test_times_are_uniform_and_differ_among_neighbours():
    strata = _strata(40, 48, derive_generator("order"))
    tiles = strata.reshape(5, 8, 6, 8).transpose(0, 2, 1, 3)
    assert (np.sort(tiles.reshape(30, 64)) == np.arange(64)).all()
    for side in (2, 4):  # of blocks with one pixel in each part of the shutter
        blocks = strata.reshape(40 // side, side, 48 // side, side).transpose(0, 2, 1, 3).reshape(-1, side**2)
        assert (np.sort(blocks * side**2 // SUBFRAMES) == np.arange(side**2)).all()
    cropped = _strata(5, 3, derive_generator("order"))
    assert cropped.shape == (5, 3)
    assert len(np.unique(cropped)) == 15
    times = np.stack([_times(derive_generator("times", i)) for i in range(200)])
    assert (np.floor(times * SUBFRAMES) - np.arange(SUBFRAMES) <= 1).all()
    assert times.min() >= 0
    assert times.max() <= 1
    within = times * SUBFRAMES - np.arange(SUBFRAMES)
    assert within.mean() == pytest.approx(0.5, abs=0.01)
    assert within.std() == pytest.approx(np.sqrt(1 / 12), abs=0.01)


def test_the_stored_time_is_the_traced_one(flying):
    for seed in flying[0]:
        assert np.array_equal(seed["time"].astype(np.float16).astype(np.float32), seed["time"])
        hit = seed["shutter_motion"][0] != 0  # only the board moves
        then = 4 + SPEED[2] * SHUTTER * (seed["time"][0] - 0.5)
        np.testing.assert_allclose(seed["shutter_depth"][0], np.where(hit, then, 6), atol=1e-5)


def test_a_sample_shows_what_its_pixel_holds_at_its_time(flying):
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    for seed in flying[0]:
        centre = np.array([0, 0, 4]) + SPEED * (SHUTTER * (seed["time"][0, ..., None] - 0.5))
        off = np.abs(np.stack([x, y], -1) - image_of(centre)).max(-1) - FOCAL / centre[..., 2]  # from the outline
        seen = seed["shutter_motion"][0] != 0
        assert seen[off < -0.51].all()
        assert not seen[off > 0.51].any()


def test_shutter_motion_of_a_moving_object(flying):
    """From the plane's point in the pixel at its time, along the board's straight way."""
    ends = SHUTTER * np.array([-0.5, 0.5])
    for seed in flying[0]:
        hit = seed["shutter_motion"][0] != 0
        depth, time = seed["shutter_depth"][0, ..., None], SHUTTER * (seed["time"][0, ..., None] - 0.5)
        y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        ray = np.stack([(WIDTH / 2 - x) / FOCAL, (HEIGHT / 2 - y) / FOCAL, np.ones_like(x)], -1)
        opening, closing = (image_of(ray * depth + SPEED * (end - time)) for end in ends)
        error = np.abs(np.moveaxis(closing - opening, -1, 0) - seed["shutter_motion"])[:, hit]
        assert hit.any()
        assert error.max() < 0.05  # at the pixel's centre, and the sample is up to half a pixel off it
        assert (closing - opening)[hit][:, 0].mean() == pytest.approx(1.2 * SHUTTER / 4 * FOCAL, rel=0.01)


@pytest.mark.parametrize("shutter", [0.25, 1.0])
def test_shutter_motion_of_a_moving_camera_at_pixel_centres(shutter: float):
    def pan(time: float) -> np.ndarray:
        return translation((0.8 * time, 0, 0)) @ rotation((0, 1, 0), 0.1 * time)

    stage = staged(board(0, 1, still(translation((0, 0, 4)))), camera=pan)
    with stage.at(0) as moment:
        motion = centre_motion(moment, shutter)
    x = np.arange(WIDTH) + 0.5
    angle, half = np.arctan((x - WIDTH / 2) / FOCAL), 0.05 * shutter  # to the right, and the turn since mid-shutter
    sky = FOCAL * (np.tan(angle + half) - np.tan(angle - half))  # the camera turns to its left
    np.testing.assert_allclose(motion[0, 0], sky, atol=0.05)
    y, middle = HEIGHT // 2, WIDTH // 2
    assert np.abs(motion[1, 0, middle]) < 0.05
    right = (middle + 0.5 - WIDTH / 2) / FOCAL * 4 + np.array([-0.4, 0.4]) * shutter  # the camera steps to its left
    seen = FOCAL * np.tan(np.arctan(right / 4) + np.array([-half, half]))
    assert motion[0, y, middle] == pytest.approx(seen[1] - seen[0], abs=0.05)


def test_samples_have_the_references_mean(flying):
    """Column by column, across the blurred edges of the board: no bias between `color` and `reference`."""
    seeds, halves = flying
    reference = np.mean(halves, axis=0)
    difference = np.stack([seed["color"] for seed in seeds]) - reference
    profile = difference.mean((0, 2))
    error = difference.std((0, 2)) / np.sqrt(len(seeds) * HEIGHT)
    assert (np.abs(profile) < 5 * error + 2e-3 * reference.mean()).all()
    assert abs(difference.mean()) < 0.01 * reference.mean()


def test_a_reference_is_the_mean_of_sharp_frames(flying):
    stage = unshadowed(staged(board(0, 1, FAST), board(6, 8, color=CHECKS)))
    sharp = []
    for number in range(40):
        sharp.append(radiance_at(stage, SHUTTER * ((number + 0.5) / 40 - 0.5), 16, number))
    expected, reference = np.mean(sharp, axis=0), np.mean(flying[1], axis=0)
    assert reference.mean() == pytest.approx(expected.mean(), rel=2e-3)
    assert np.abs(reference - expected).mean() < 0.01 * expected.mean()
    assert np.abs(sharp[20] - expected).mean() > 0.03 * expected.mean()  # it is blurred


def test_nothing_moves_nothing_changes():
    stage = unshadowed(staged(board(3, 1, color=CHECKS), board(6, 8)))
    (seed,), (half,) = blurred(stage, 3.0, 1.0, 512, [1], [2])
    assert (seed["shutter_motion"] == 0).all()
    with stage.at(3) as moment:
        assert (centre_motion(moment, 1.0) == 0).all()
        sharp = radiance(moment, 256, 5)
    assert np.abs(half - sharp).mean() < 0.02 * sharp.mean()
    assert half.mean() == pytest.approx(sharp.mean(), rel=2e-3)


def test_hits_lie_in_their_pixels_at_their_time():
    def turning(time: float) -> np.ndarray:
        return look_at((0.5 * time, 0, 0), (0, 0, 4)) @ rotation((0, 0, 1), 0.2 * time)

    stage = staged(board(0, 1, FAST), board(6, 8), camera=turning)
    camera, time = stage.camera, 0.3
    pixels = np.arange(0, WIDTH * HEIGHT, 3)
    with stage.at(time) as moment:
        rows = _trace(moment, pixels, 1)
    points = points_at(stage, _hits(rows), time)
    clip = np.c_[points, np.ones(len(points))] @ (camera.projection(WIDTH, HEIGHT) @ camera.view(time)).T
    place = clip[:, :2] / clip[:, 3:] * (WIDTH, HEIGHT)
    assert np.abs(place - (np.stack([pixels % WIDTH, pixels // WIDTH], 1) + 0.5)).max() < 0.505
    np.testing.assert_allclose(rows[:, 3], clip[:, 3], rtol=1e-5)


def test_a_medium_is_seen_through():
    """The sample's hit is the surface behind a cloud, as for the channels without noise."""
    stage = MeshStage(FAMILIES["cloud"](derive_generator("seen through")), 16, 16, 2)
    with stage.at(0) as moment:
        depth = geometry(moment)["depth"].ravel()
        found = _trace(moment, np.arange(256), 1)[:, 3]
    assert np.median(np.abs(found - depth) / np.maximum(depth, 1)) < 0.02


def test_unshadowed_is_albedo_times_irradiance():
    """A small light far behind the camera: radiance · area / distance² at normal incidence; a miss is black."""
    stage = unshadowed(staged(board(3, 1)))
    image = radiance_at(stage, 0, 1, 0)
    middle = image[:, HEIGHT // 2, WIDTH // 2]
    expected = np.array([0.2, 0.4, 0.6]) / np.pi * 1.0 / 4**2  # the lamp: 1 × 1, at z = −1
    np.testing.assert_allclose(middle, expected, rtol=0.03)
    assert (image[:, 0, 0] == 0).all()
    assert np.array_equal(image, radiance_at(stage, 0, 1, 0))


RECIPE = """\
name: blur
seed: 7
train:
  - {scene: motion_blur, clips: 1, width: 24, height: 20, frames: 2, seeds: 2, reference_spp: 128, shutter: 0.75,
     unshadowed: true, parameters: {case: crossing}}
"""
NAME = "train/motion_blur_000"


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("blur") / "blur.yaml"
    path.write_text(RECIPE)
    return path


@pytest.fixture(scope="module")
def clips(recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("blurred")
    assert render_recipe(recipe, out, progress=False) == [out / NAME, out / "sharp" / NAME]
    return out


@pytest.mark.slow
def test_clips_and_their_sharp_twins(clips: Path):
    assert find_clips([clips / "train"]) == [clips / NAME]
    blurry, sharp = Clip(clips / NAME), Clip(clips / "sharp" / NAME)
    assert {"color", "reference", "time", "shutter_motion", "shutter_depth", "depth", "motion"} <= set(blurry.channels)
    assert set(sharp.channels) == set(blurry.channels) - {"time", "shutter_depth"}
    assert blurry.info["shutter"] == sharp.info["shutter"] == 0.75
    seed = read_exr(clips / NAME / "seed_01" / "frame_0000.exr")
    shutter = {"time.T", "shutter_motion.X", "shutter_motion.Y", "shutter_depth.Z"}
    assert set(seed) == {"color.R", "color.G", "color.B"} | shutter
    for name in ("depth", "albedo", "motion"):  # the noise-free channels of both are those of mid-shutter
        assert np.array_equal(blurry.frame(1)[name], sharp.frame(1)[name])
    first, second = (blurry.frame(1, seeds=(number,))["time"] for number in (0, 1))
    assert not np.array_equal(first, second)
    assert Clip(clips / "sharp" / NAME).frame(0, seeds=(0, 1))["shutter_motion"].any()


@pytest.mark.slow
def test_the_sharp_twin_is_the_clip_without_a_shutter(clips: Path, tmp_path: Path):
    path = tmp_path / "sharp.yaml"
    path.write_text(RECIPE.replace("shutter: 0.75,", ""))
    render_recipe(path, tmp_path / "out", progress=False)
    alone, twin = Clip(tmp_path / "out" / NAME), Clip(clips / "sharp" / NAME)
    for index in range(2):
        for name in set(alone.channels) - {"previous_forward_motion"}:
            assert np.array_equal(alone.frame(index)[name], twin.frame(index)[name])
    assert set(twin.info) - set(alone.info) == {"shutter"}
    assert not (tmp_path / "out" / "sharp").exists()


@pytest.mark.slow
def test_the_same_bytes_after_an_interruption(clips: Path, recipe: Path, tmp_path: Path):
    out = tmp_path / "out"
    shutil.copytree(clips, out)
    (out / NAME / "seed_01" / "frame_0001.exr").unlink()
    shutil.rmtree(out / "sharp")
    render_recipe(recipe, out, progress=False)
    assert contents(out) == contents(clips)
    other = tmp_path / "other.yaml"
    other.write_text("name: other\ntest: [{clips: 0}]")
    render_recipe(other, out, force=True, progress=False)
    assert [path.name for path in out.rglob("*") if path.is_file()] == ["recipe.yaml"]


@pytest.mark.parametrize("key", ["shutter", "unshadowed", "components"])
def test_arrays_of_rays_need_llvm(key: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(backend, "is_scalar", lambda: True)
    with pytest.raises(NteError, match=f"'{key}' needs.*karellen-llvm-core"):
        backend.require_arrays(key)
