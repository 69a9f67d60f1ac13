from pathlib import Path

import numpy as np
import pytest

from nte.checking import check
from nte.frames.clip import Clip
from tests.synthetic import Pixels, disc_clip, disc_frame, write_clip

MOVING = {"velocity": (5.0, -2.0), "wall_velocity": (-3.0, 1.5), "size": (64, 96)}


def wrong(folder: Path, change: object) -> Clip:
    frames = [disc_frame(i, **MOVING) for i in range(4)]  # type: ignore[arg-type]
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


def test_forward_vectors_are_told_from_a_wrong_sign(tmp_path: Path) -> None:
    # An accelerating wall: the forward motion of a frame is not minus its backward motion.
    places = [0.0, 4.0, 9.5, 17.0, 26.5, 38.0]
    frames = []
    for i in range(5):
        frame = disc_frame(0, size=(64, 96), radius=0, wall_velocity=(0, 0))
        shift = disc_frame(1, size=(64, 96), radius=0, wall_velocity=(places[i], 0))
        frame["albedo"] = shift["albedo"]
        frame["motion"][0] = places[i + 1] - places[i]
        frames.append(frame)
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "implausible"
    assert "direction" in report.reason


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
    assert report.verdict == "plausible"


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


def test_one_bad_frame_does_not_condemn_the_clip(tmp_path: Path) -> None:
    frames = [disc_frame(i, **MOVING) for i in range(8)]  # type: ignore[arg-type]
    frames[4]["motion"] *= -1
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.votes.against
    assert report.verdict == "plausible"


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
    assert radiance.tallies["color"].bad == 8
    geometry = check(wrong(tmp_path / "geometry", nan("depth")))
    assert geometry.verdict == "implausible"
    assert "8 pixels of depth" in geometry.reason


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
