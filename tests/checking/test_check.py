from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.checking import check
from nte.frames.clip import Clip
from tests.synthetic import Pixels, disc_clip, disc_frame, write_clip

Change = Callable[[Pixels], Pixels]
MOVING = {"velocity": (5.0, -2.0), "wall_velocity": (-3.0, 1.5), "size": (64, 96)}


def wrong(folder: Path, change: object) -> Clip:
    frames = [disc_frame(i, **MOVING) for i in range(3)]  # type: ignore[arg-type]
    for frame in frames:
        frame.update(change(frame))  # type: ignore[operator]
    return Clip(write_clip(folder / "clip", frames))


def test_good_vectors_explain_the_albedo(tmp_path: Path) -> None:
    report = check(Clip(disc_clip(tmp_path / "clip", **MOVING)))
    assert report.verdict == "plausible"
    assert report.ratio > 10
    assert report.errors["albedo", "dual", "visible"].value < report.errors["albedo", "none", "visible"].value / 10
    assert 0.001 < report.disoccluded < 0.1
    assert 0.01 < report.invalid < 0.2


def motion_times(x: float, y: float) -> object:
    return lambda f: {"motion": f["motion"] * np.array([x, y], np.float32).reshape(2, 1, 1)}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (motion_times(-1, -1), "sign ("),
        (motion_times(1, -1), "sign of y"),
        (motion_times(-1, 1), "sign of x"),
        (lambda f: {"motion": f["motion"][::-1]}, "axis order"),
        (motion_times(1 / 96, 1 / 64), "unit (uv"),
        (motion_times(2 / 96, -2 / 64), "unit (NDC"),
    ],
)
def test_another_convention_is_named(tmp_path: Path, change: object, named: str) -> None:
    report = check(wrong(tmp_path, change))
    assert report.verdict == "implausible"
    assert named in report.reason


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda motion: motion, []),
        (lambda motion: motion * np.reshape([1 / 96, -1 / 64], (2, 1, 1)), ["sign of y", "unit (uv"]),
        (lambda motion: motion[::-1] * np.float32(-1), ["sign (they are negated)", "axis order"]),
    ],
)
def test_forward_vectors_are_told_from_a_wrong_sign(tmp_path: Path, change: Change, named: list[str]) -> None:
    # An accelerating wall: the forward motion of a frame is not minus its backward motion.
    places = [0.0, 2.0, 8.0, 18.0, 32.0, 50.0]
    frames = []
    for i in range(5):
        frame = disc_frame(0, size=(64, 96), radius=0, wall_velocity=(0, 0))
        shift = disc_frame(1, size=(64, 96), radius=0, wall_velocity=(places[i], -0.4 * places[i]))
        frame["albedo"] = shift["albedo"]
        forward = np.full_like(frame["motion"], places[i + 1] - places[i]) * np.reshape([1, -0.4], (2, 1, 1))
        frame["motion"] = change(forward).astype(np.float32)
        frames.append(frame)
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "implausible"
    assert all(words in report.reason for words in ["direction (they are stored on the previous frame's", *named])


def test_noise_in_the_vectors_is_implausible(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    report = check(wrong(tmp_path, lambda f: {"motion": rng.normal(0, 8, f["motion"].shape).astype("f")}))
    assert report.verdict == "implausible"
    assert "does not explain" in report.reason


def test_a_few_pixels_do_not_outvote_the_clip(tmp_path: Path) -> None:
    # A strip of wall that hardly moves, and whose albedo happens to be explained by motion in NDC.
    frames = [disc_frame(i, **MOVING) for i in range(4)]  # type: ignore[arg-type]
    chance = disc_frame(0, size=(64, 96), radius=0)["albedo"]
    for i, frame in enumerate(frames):
        frame["albedo"][:, :8] = np.roll(chance, 4 * i, 2)[:, :8]
        frame["motion"][:, :8] = np.array([-4 / 48, 0], np.float32).reshape(2, 1, 1)
        frame["instance"][:, :8] = 3
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert len(report.votes.against) >= 6  # enough to be misled by
    assert report.verdict != "implausible"


@pytest.mark.parametrize("factor", [0.0, 1 / 64, 1 / 8])
def test_a_picture_that_moves_without_its_vectors(tmp_path: Path, factor: float) -> None:
    report = check(wrong(tmp_path, motion_times(factor, factor)))
    assert report.verdict == "implausible"
    assert "the picture changes and the vectors do not" in report.reason or "unit" in report.reason


def test_vectors_of_a_wrong_length_are_measured(tmp_path: Path) -> None:
    report = check(wrong(tmp_path, motion_times(0.4, 0.4)))
    assert report.verdict == "implausible"
    factor = float(report.reason.split("the vectors are ")[1].split(" times too short")[0])
    assert factor == pytest.approx(2.5, rel=0.15)


@pytest.mark.parametrize("radius", [16.0, 20.0])
def test_an_object_whose_own_motion_is_left_out_is_never_plausible(tmp_path: Path, radius: float) -> None:
    """The vectors are those of the camera alone: most of the picture confirms them, and the disc never does."""
    options = {"size": (64, 96), "wall_velocity": (-3.0, 2.0), "start": (40.0, 32.0), "radius": radius}
    frames = [disc_frame(i, **options) for i in range(4)]  # type: ignore[arg-type]
    for frame in frames:
        frame["motion"] = np.broadcast_to(np.float32([3, -2]).reshape(2, 1, 1), (2, 64, 96))
        del frame["forward_motion"]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.votes.good > report.votes.weight_against
    assert report.verdict == "undecidable"
    assert "in some places" in report.reason


def test_one_bad_frame_does_not_condemn_the_clip(tmp_path: Path) -> None:
    frames = [disc_frame(i, **MOVING) for i in range(8)]  # type: ignore[arg-type]
    frames[4]["motion"] *= -1
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.votes.against
    assert report.verdict == "plausible"
    told = [finding.found for finding in report.findings if finding.channel == "motion"]
    assert told == ["contradicts the picture in 1 of 7 frames that were judged, the first is 4"]


def test_without_instances_and_depth(tmp_path: Path) -> None:
    bare = [{n: disc_frame(i, **MOVING)[n] for n in ("color", "albedo", "motion")} for i in range(4)]  # type: ignore[arg-type]
    assert check(Clip(write_clip(tmp_path / "right", bare))).verdict == "plausible"
    for frame in bare:
        frame["motion"] = frame["motion"] * np.float32([1, -1]).reshape(2, 1, 1)
    report = check(Clip(write_clip(tmp_path / "wrong", bare)))
    assert "sign of y" in report.reason


def test_a_still_clip_is_undecidable(tmp_path: Path) -> None:
    report = check(Clip(disc_clip(tmp_path / "clip", velocity=(0.0, 0.0))))
    assert report.verdict == "undecidable"


def test_bad_geometry_fails_and_bad_radiance_is_counted(tmp_path: Path) -> None:
    def nan(name: str) -> object:
        def change(frame: dict[str, Pixels]) -> dict[str, Pixels]:
            values = frame[name].copy()
            values[0, 3, 4:6] = np.nan
            return {name: values}

        return change

    radiance = check(wrong(tmp_path / "radiance", nan("color")))
    assert radiance.verdict == "plausible"
    assert radiance.tallies["color"].bad == 6
    geometry = check(wrong(tmp_path / "geometry", nan("depth")))
    assert geometry.verdict == "implausible"
    assert "6 pixels of depth" in geometry.reason


def test_dual_vectors_serve_disoccluded_pixels_better(tmp_path: Path) -> None:
    report = check(Clip(disc_clip(tmp_path / "clip", velocity=(6.0, 0.0), start=(14.0, 24.0))))
    # The wall beside is a better guess than the disc's normal.
    error = {vectors: report.errors["normal", vectors, "disoccluded"].value for vectors in ("dual", "traditional")}
    assert error["dual"] < error["traditional"] / 2


def test_a_clip_without_vectors_is_checked_for_its_values(tmp_path: Path) -> None:
    frames = [{"color": np.ones((3, 8, 8), np.float32), "roughness": np.full((1, 8, 8), 7, np.float32)}] * 2
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert "roughness: 7 to 7" in report.reason
    bare = write_clip(tmp_path / "bare", [{"color": frame["color"]} for frame in frames])
    assert check(Clip(bare)).verdict == "undecidable"


def ground_frame(index: int, size: tuple[int, int] = (60, 200), speed: float = 2.0) -> dict[str, Pixels]:
    """A textured plane that a camera at height 1.5 flies over backwards, `speed` a frame; above it is the sky."""
    height, width = size
    y, x = np.mgrid[:height, :width] + 0.5
    right, down = (x - width / 2) / height, (y - height / 3) / height  # a ray's slopes; the horizon is a third down
    hit = down > 0.02
    far = np.where(hit, 1.5 / np.where(hit, down, 1), 0)  # depth
    u, v = right * far, far - speed * index  # on the plane
    waves = [np.sin(3 * u + 1) + np.sin(11 * v) / 2, np.sin(4 * v) + np.sin(13 * u) / 2, np.sin(2 * u + 5 * v)]
    before = far - speed  # depth of the same point in the previous frame, negative where it was behind the camera
    ratio = far / np.where(before > 0, before, np.nan) - 1
    motion = np.stack([right, down]) * height * np.nan_to_num(ratio, nan=3 * width)
    channels = {
        "albedo": (0.5 + 0.3 * np.stack(waves)) * hit,
        "color": np.ones((3, *size)),
        "depth": far[None],
        "instance": hit[None],
        "motion": np.where(hit, motion, 0),
    }
    return {name: values.astype(np.float32) for name, values in channels.items()}


def test_a_fast_camera_is_no_other_unit(tmp_path: Path) -> None:
    """Most of the picture was not there in the frame before: nothing can be fetched, so nothing contradicts."""
    clip = Clip(write_clip(tmp_path / "clip", [ground_frame(i) for i in range(4)]))
    assert check(clip).verdict != "implausible"


@pytest.mark.parametrize("share", [0.05, 0.1, 0.9])
def test_thin_parts_at_rest_that_each_frame_samples_anew(tmp_path: Path, share: float) -> None:
    """Foliage that covers a share of every pixel, seen by one jittered sample: single pixels change, nothing moves."""

    def sampled(frame: dict[str, Pixels]) -> dict[str, Pixels]:
        leaf = rng.random((1, 64, 96)) < share
        return {
            "motion": 0 * frame["motion"],
            "depth": np.where(leaf, 3, 8),
            "instance": 1 + leaf,
            "albedo": np.where(leaf, 0.2, 0.6) * np.ones((3, 64, 96)),
        }

    rng = np.random.default_rng(0)
    assert check(wrong(tmp_path, sampled)).verdict == "undecidable"


@pytest.mark.parametrize("sigma", [0.05, 0.2, 0.5])
def test_noise_of_an_albedo_at_rest_is_no_motion(tmp_path: Path, sigma: float) -> None:
    """Neither depth nor instances say that nothing moves, and single pixels change everywhere."""

    def noisy(frame: dict[str, Pixels]) -> dict[str, Pixels]:
        return {"albedo": np.clip(still + sigma * rng.normal(size=still.shape), 0, 1), "motion": 0 * frame["motion"]}

    rng, still = np.random.default_rng(1), disc_frame(0, **MOVING)["albedo"]  # type: ignore[arg-type]
    frames = [disc_frame(i, **MOVING) for i in range(4)]  # type: ignore[arg-type]
    kept = [{n: v for n, v in (f | noisy(f)).items() if n in ("color", "albedo", "motion")} for f in frames]
    assert check(Clip(write_clip(tmp_path / "clip", kept))).verdict == "undecidable"


@pytest.mark.parametrize("without", [(), ("depth",), ("depth", "instance")])
def test_flat_surfaces_that_move_without_their_vectors(tmp_path: Path, without: tuple[str, ...]) -> None:
    frames = [disc_frame(i, velocity=(5.0, -2.0), size=(64, 96)) for i in range(4)]
    for frame in frames:
        frame["albedo"] = np.where(frame["instance"] == 2, np.float32(0.2), np.float32(0.6)) * np.ones_like(
            frame["normal"]
        )
        frame["motion"] = 0 * frame["motion"]
    kept = [{n: v for n, v in frame.items() if n not in (*without, "forward_motion")} for frame in frames]
    report = check(Clip(write_clip(tmp_path / "clip", kept)))
    assert report.verdict == "implausible"
    assert "the picture changes and the vectors do not" in report.reason


def test_a_texture_too_fine_for_its_pixels(tmp_path: Path) -> None:
    """Aliased, a texture turns into another one in each frame: some displacement always fits, but never the same."""

    def aliased(index: int) -> dict[str, Pixels]:
        frame = ground_frame(index, size=(64, 96), speed=-0.05)
        x = np.arange(96) + 0.5
        far = np.where(frame["depth"][0] > 0, frame["depth"][0], 1)
        u, v = 90 * (x - 48) / 64 * far, 90 * (far + 0.05 * index)
        albedo = np.stack([np.sin(u), np.sin(0.93 * v), np.sin(1.02 * (u + v))]) * (frame["depth"] > 0)
        return {**frame, "albedo": (0.5 + 0.4 * albedo).astype(np.float32)}

    clip = Clip(write_clip(tmp_path / "clip", [aliased(i) for i in range(4)]))
    assert check(clip).verdict != "implausible"
