"""Every channel is judged by what it can be."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport, check, describe
from nte.frames.clip import Clip
from nte.importing.convert import unit
from tests.synthetic import Pixels, disc_frame, write_clip

MOVING = {"velocity": (5.0, -2.0), "wall_velocity": (-3.0, 1.5), "size": (64, 96)}


def ball_normals(size: tuple[int, int], index: int = 0) -> Pixels:
    """(3, H, W): a hemisphere that fills the image, all directions that face the viewer; it moves with the wall."""
    left, down = np.multiply(MOVING["wall_velocity"], index)
    y, x = (np.linspace(-0.6, 0.6, n) - 1.2 * moved / n for n, moved in zip(size, (down, left), strict=True))
    x, y = np.meshgrid(x, y)
    return np.stack([x, -y, np.sqrt(1 - x**2 - y**2)]).astype(np.float32)


def checked(folder: Path, change: Callable[[dict[str, Pixels], int], dict[str, Pixels]]) -> CheckReport:
    frames = [disc_frame(i, **MOVING) for i in range(3)]  # type: ignore[arg-type]
    for i, frame in enumerate(frames):
        frame["normal"] = ball_normals((64, 96), i)
        frame["color"] = frame["color"] * np.random.default_rng(i).uniform(0.9, 1.1, (1, 64, 96)).astype(np.float32)
        frame |= {name: np.asarray(values, np.float32) for name, values in change(frame, i).items()}
    return check(Clip(write_clip(folder / "clip", frames)))


def test_nothing_is_said_of_right_values(tmp_path: Path) -> None:
    report = checked(tmp_path, lambda f, i: {})
    assert [f for f in report.findings if not f.found.startswith("aliased")] == []  # the disc really is aliased
    assert report.verdict == "plausible"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda f, i: {"normal": f["normal"] / 2 + 0.5}, "normal: no component is negative: stored as n/2 + 1/2"),
        (lambda f, i: {"normal": unit(f["normal"] / 2 + 0.5)}, "stored as n/2 + 1/2, or another channel"),
        (lambda f, i: {"normal": 3 * f["normal"]}, "normal: vectors of length 3"),
        (lambda f, i: {"depth": -f["depth"]}, "depth: negative in 100.00% of the pixels"),
        (lambda f, i: {"depth": 0 * f["depth"]}, "depth: 0 everywhere, though normal and instance and albedo"),
        (lambda f, i: {"albedo": 255 * f["albedo"]}, "albedo: 25.5 to 229.5, outside in 100.00% of the pixels"),
        (lambda f, i: {"roughness": 2 + f["depth"]}, "roughness: 5 to 7"),
        (lambda f, i: {"visibility": -f["depth"]}, "visibility: -5 to -3"),
        (lambda f, i: {"instance": f["instance"] / 3}, "instance: fractions, or negative, in"),
        (lambda f, i: {"motion": f["motion"] * 1e6}, "longer than four images in 18432 pixels of motion, the first in"),
        (lambda f, i: {"reference": 4 * f["reference"]}, "reference: color is 0.25 times as bright"),
        (lambda f, i: {"reference": f["reference"][:, ::-1]}, "reference: shows the picture of color upside down"),
        (
            lambda f, i: {"reference": 3 * f["reference"][:, :, ::-1]},
            "shows the picture of color mirrored left to right",
        ),
        (lambda f, i: {"reference": f["reference"] * np.nan}, "negative in 18432 pixels of reference, the first in"),
    ],
)
def test_what_a_channel_cannot_be_fails(tmp_path: Path, change: Callable[..., dict[str, Pixels]], told: str) -> None:
    report = checked(tmp_path, change)
    assert report.verdict == "implausible"
    assert told in report.reason


def test_a_few_bad_pixels_of_the_reference_are_counted_and_named(tmp_path: Path) -> None:
    def harm(frame: dict[str, Pixels], index: int) -> dict[str, Pixels]:
        reference = frame["reference"].copy()
        if index == 2:
            reference[0, 3, 4], reference[1, 5, 6], reference[2, 7, 8] = np.nan, np.inf, -20
        return {"reference": reference}

    report = checked(tmp_path, harm)
    assert report.verdict == "plausible"
    told = describe(report)
    assert "note: reference: not finite, or negative in 3 pixels of reference, the first in frame 2" in told
    assert told.startswith("clip: plausible")


def test_a_reference_that_is_the_noisy_image_is_noted(tmp_path: Path) -> None:
    """The reference is read from the same files as the colour: up to the rounding of half floats they are one image."""
    told = "note: reference: is the same image as color; expected the same frames without noise"
    assert told in describe(checked(tmp_path / "a", lambda f, i: {"reference": f["color"]}))
    dim = np.where(np.arange(96) > 0, 1, 1e-6)  # of which half floats keep few digits
    given = checked(tmp_path / "dim", lambda f, i: dict.fromkeys(("color", "reference"), dim * f["color"]))
    assert told in describe(given)
    once = describe(checked(tmp_path / "b", lambda f, i: {"reference": f["color"]} if i else {}))
    assert told not in once


def test_one_direction_is_not_taken_for_an_encoding(tmp_path: Path) -> None:
    slanted = np.full((3, 64, 96), 3**-0.5)  # a wall seen at an angle: every component is positive, and right
    assert checked(tmp_path, lambda f, i: {"normal": slanted}).verdict == "plausible"


@pytest.mark.parametrize(
    ("gains", "fault"),
    [((1.5, 0.5), True), ((0.5, 0.7, 1.0, 1.0, 1.3, 1.6), True), ((1, 1, 1, 1, 1, 3), False), ((1.1, 0.9), None)],
)
def test_a_reference_with_an_exposure_of_its_own_in_every_frame(
    tmp_path: Path, gains: tuple[float, ...], fault: bool | None
) -> None:
    """On average over the clip it has the exposure of the colour."""
    rng = np.random.default_rng(0)
    frames = [disc_frame(i, **MOVING, rng=rng) for i in range(6)]  # type: ignore[arg-type]
    for i, frame in enumerate(frames):
        frame["reference"] *= np.float32(gains[i % len(gains)])
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    found = [finding for finding in report.findings if "as frames differ" in finding.found]
    assert [finding.fault for finding in found] == ([] if fault is None else [fault])
    assert report.verdict == ("implausible" if fault else "plausible")


@pytest.mark.parametrize(("usual", "other", "fault"), [(1.0, 4.0, False), (5.0, 1.0, True)])
def test_a_frame_with_an_exposure_of_its_own_says_nothing_of_the_others(
    tmp_path: Path, usual: float, other: float, fault: bool
) -> None:
    report = checked(tmp_path, lambda f, i: {"color": f["color"] * (other if i == 1 else usual)})
    assert [f.fault for f in report.findings if "as frames differ (1 of 3 do)" in f.found] == [False]
    whole = [f for f in report.findings if "median of blocks" in f.found]
    assert [f.fault for f in whole] == [True] * fault
    assert all(f.found.startswith("color is 5 times as bright") for f in whole)
    assert report.verdict == ("implausible" if fault else "plausible")


@pytest.mark.parametrize(
    "change",
    [
        lambda f: {"reference": f["reference"] ** (1 / 2.2)},
        lambda f: {"color": f["color"] ** (1 / 2.2)},
        lambda f: {"reference": f["reference"] / (1 + f["reference"])},
    ],
)
def test_light_that_is_encoded_for_display_fails(tmp_path: Path, change: Callable[..., dict[str, Pixels]]) -> None:
    report = checked(tmp_path, lambda f, i: change(f))
    assert report.verdict == "implausible"
    assert "reference: is no multiple of color" in report.reason


@pytest.mark.parametrize("name", ["albedo", "normal", "depth", "instance", "color", "reference"])
def test_a_channel_that_is_lost_in_one_frame_is_named(tmp_path: Path, name: str) -> None:
    report = checked(tmp_path, lambda f, i: {name: f[name] * (i != 1)})
    [told] = [f for f in report.findings if f.channel == name or f.channel == "reference"]
    assert told.found.startswith("0 everywhere in 1 of 3 frames, the first is 1, though other channels show ")
    assert (told.channel, told.fault) == (name, False)


def test_positions_that_are_all_zero_are_noted(tmp_path: Path) -> None:
    report = checked(tmp_path, lambda f, i: {"position": 0 * f["normal"]})
    assert [f.fault for f in report.findings if f.found.startswith("0 everywhere in 3 of 3 frames")] == [False]
    assert [f.channel for f in report.findings if "0 everywhere" in f.found] == ["position"]


def test_a_frame_without_surfaces_or_light_has_lost_none(tmp_path: Path) -> None:
    """The camera looks into the dark sky for a frame."""
    shown = ("color", "reference", "albedo", "normal", "depth", "instance")
    report = checked(tmp_path, lambda f, i: {name: f[name] * (i != 1) for name in shown})
    assert not [f for f in report.findings if "0 everywhere" in f.found]


def test_a_small_reference_that_is_upside_down_is_blamed_itself(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frames = [disc_frame(i, size=(40, 40), start=(10, 12), rng=rng) for i in range(3)]
    for frame in frames:
        frame["reference"] = frame["reference"][:, ::-1]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert [f.channel for f in report.findings if "upside down" in f.found] == ["reference"]


@pytest.mark.parametrize("size", [(1, 1), (4, 4), (16, 16), (24, 32)])
def test_noise_of_a_tiny_picture_is_no_other_exposure(tmp_path: Path, size: tuple[int, int]) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        frame = disc_frame(0, size=size, start=(8, 8), radius=4)
        frame["color"] = (frame["reference"] * rng.lognormal(-2, 2, (1, *size))).astype(np.float32)
        report = check(Clip(write_clip(tmp_path / str(seed), [frame])))
        assert not [finding for finding in report.findings if finding.channel == "reference" and finding.fault]


def test_noise_is_no_other_exposure(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    # One pixel in 40 carries all the light: what a path tracer gives with a small lamp.
    report = checked(tmp_path, lambda f, i: {"color": f["reference"] * 40 * (rng.random((1, 64, 96)) < 1 / 40)})
    assert [finding for finding in report.findings if finding.channel == "reference"] == []


@pytest.mark.parametrize(("pixels", "fault"), [(5, False), (500, True)])
def test_light_that_hardly_any_sample_finds_is_not_lost(tmp_path: Path, pixels: int, fault: bool) -> None:
    """The lamps are off: in the reference a few of thousands of samples meet one all the same."""
    stray = np.arange(64 * 96).reshape(1, 64, 96) < pixels
    report = checked(tmp_path, lambda f, i: {"color": 0 * f["color"], "reference": 0.01 * stray * f["reference"]})
    assert any(f.fault for f in report.findings if f.channel in ("color", "reference")) == fault


def test_light_that_never_meets_says_nothing_of_exposure(tmp_path: Path) -> None:
    """Colour on the left half only, reference on the right half only: no block has both, so there is no ratio."""
    left = np.arange(96) < 48
    report = checked(tmp_path, lambda f, i: {"color": f["color"] * left, "reference": f["reference"] * ~left})
    assert [finding for finding in report.findings if finding.channel == "reference"] == []


def test_what_passed_close_to_the_camera_may_have_been_far_outside(tmp_path: Path) -> None:
    """A point near the camera's plane is projected to anywhere: with a fast camera that is right for whole regions."""

    def near(frame: dict[str, Pixels], index: int) -> dict[str, Pixels]:
        motion = frame["motion"].copy()
        motion[:, 50:, :40] = np.geomspace(500, 1e7, 40)
        return {"motion": motion}

    report = checked(tmp_path, near)
    assert report.verdict == "plausible"
    assert "note: motion: longer than four images in 1680 pixels of motion, the first in frame 0" in describe(report)


def test_what_will_pass_close_to_the_camera_may_go_far_outside(tmp_path: Path) -> None:
    """Forward vectors are read twice: of a frame, and of the frame before, where NaN has a meaning."""

    def near(frame: dict[str, Pixels], index: int) -> dict[str, Pixels]:
        forward = frame["forward_motion"].copy()
        forward[:, 50:, :40] = np.geomspace(500, 1e7, 40)
        return {"forward_motion": forward}

    report = checked(tmp_path, near)
    assert report.verdict == "plausible"
    assert "note: forward_motion: longer than four images in 1680 pixels" in describe(report)
    report = checked(tmp_path / "infinite", lambda f, i: {"forward_motion": np.full_like(f["motion"], np.inf)})
    assert report.verdict == "implausible"


def test_an_albedo_of_the_sky_shows_no_surface(tmp_path: Path) -> None:
    sky = {"albedo": np.ones((3, 64, 96)), "depth": np.zeros((1, 64, 96))}
    report = checked(tmp_path, lambda f, i: {**sky, "normal": 0 * f["normal"], "instance": sky["depth"]})
    assert [finding for finding in report.findings if finding.channel == "depth"] == []


def test_an_albedo_that_is_black_is_told(tmp_path: Path) -> None:
    report = checked(tmp_path, lambda f, i: {"albedo": 0 * f["albedo"], "emission": 0 * f["albedo"]})
    assert "note: albedo: 0 everywhere; expected values above 0" in describe(report)
    assert [finding for finding in report.findings if finding.channel == "emission"] == []


@pytest.mark.parametrize(("grey", "sky"), [(1.0, True), (0.5, True), (0.5, False)])
def test_one_albedo_for_all_is_noted(tmp_path: Path, grey: float, sky: bool) -> None:
    """Also where the sky, as it should, has none."""
    shown = (lambda f: f["depth"] > 0) if sky else (lambda f: f["depth"] >= 0)
    report = checked(tmp_path, lambda f, i: {"albedo": grey * np.repeat(shown(f), 3, 0)})
    assert [f.fault for f in report.findings if f.found.startswith(f"{grey:.4g} everywhere")] == [False]


@pytest.mark.parametrize(("by", "fault"), [(3e-5, False), (0.5, True)])
def test_light_that_is_hardly_negative_is_only_noted(tmp_path: Path, by: float, fault: bool) -> None:
    """Lossy compression, and pixel filters with negative lobes, leave some in the dark."""

    def dark(frame: dict[str, Pixels], index: int) -> dict[str, Pixels]:
        rows = np.arange(64)[:, None] < 20
        return {name: np.where(rows, -by, frame[name]) for name in ("color", "reference")}

    found = [f for f in checked(tmp_path, dark).findings if "negative in" in f.found]
    assert [(f.channel, f.fault) for f in found] == [("color", fault), ("reference", fault)]


def test_albedo_darker_than_soot_is_noted(tmp_path: Path) -> None:
    report = checked(tmp_path, lambda f, i: {"albedo": f["albedo"] / 255})
    assert [f.fault for f in report.findings if "darker than soot" in f.found] == [False]
