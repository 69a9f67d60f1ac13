"""Bad pixels are counted, and told once."""

import warnings

import numpy as np
import pytest

from nte.frames.bad import BadPixelReport, BadPixelWarning, ForwardMotionWarning, count_bad
from nte.frames.frame import Frame
from tests.synthetic import random_channels


def good() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    far = {name: rng.normal(0, 3, (2, 2, 24, 36)).astype(np.float32) for name in ("shadow_motion", "reflection_motion")}
    return {**random_channels(rng, batch=2), **far}


def test_a_good_frame_has_none() -> None:
    assert count_bad(Frame(good())) == {}


@pytest.mark.parametrize(
    ("name", "value", "bad"),
    [
        ("color", np.nan, True), ("color", np.inf, True), ("color", -1, True), ("color", 0, False),
        ("color", 1e9, False),
        ("albedo", -0.1, True), ("normal", -1, False), ("normal", np.nan, True), ("depth", 0, False),
        ("depth", np.nan, True), ("motion", -30, False), ("motion", 144.5, True), ("motion", -1e6, True),
        ("motion", np.nan, True), ("previous_forward_motion", np.nan, False),
        ("previous_forward_motion", np.inf, True), ("previous_forward_motion", 1e6, True),
        ("shadow_motion", 1000, False),
        ("shadow_motion", 1e6, True), ("shadow_motion", np.inf, True),
        ("normal", 1e9, True), ("depth", 3e38, True), ("color", 1e30, True), ("albedo", 19.5, False),
        ("reflection_motion", np.nan, False),
    ],
)  # fmt: skip
def test_what_is_bad_depends_on_the_channel(name: str, value: float, bad: bool) -> None:
    channels = good()
    channels[name][1, 0, 3:5, 7] = value
    expected = {name: 2} if bad else {}
    assert count_bad(Frame(channels)) == expected
    assert count_bad(Frame(channels).torch()) == expected


def test_a_pixel_counts_once_however_many_components_are_bad_and_strangers_do_not_count() -> None:
    channels = good()
    channels["color"][0, :, 3, 4] = np.nan
    channels["my_own"] = channels["color"]
    assert count_bad(Frame(channels)) == {"color": 1}


def test_a_sequence_is_warned_of_once_with_frame_and_count() -> None:
    channels = good()
    report = BadPixelReport()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        report.look(Frame(good(), 0))
        assert not caught
        channels["color"][0, 0, 0, :3] = np.inf
        channels["motion"][1, 0, 0, 0] = np.nan
        report.look(Frame(channels, 1))
        report.look(Frame(channels, 2))
    assert [w.category for w in caught] == [BadPixelWarning]
    assert str(caught[0].message) == (
        "frame 1: bad pixels (non-finite, negative or absurd) are sanitised: 3 in color, 1 in motion"
    )
    assert report.total == {"color": 6, "motion": 2}


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_forward_motion_of_zeros_in_a_picture_that_moves_is_warned_of_once(kind: str) -> None:
    channels = good()

    def warned(*given: dict[str, np.ndarray]) -> list[str]:
        report = BadPixelReport()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for frame in (Frame(c, i) for i, c in enumerate(given)):
                report.look(frame.torch() if kind == "torch" else frame)
        assert all(w.category is ForwardMotionWarning for w in caught)
        return [str(w.message) for w in caught]

    zeros = np.zeros_like(channels["motion"])
    unknown = channels | {"previous_forward_motion": zeros}
    found = warned(channels, unknown, unknown)
    assert len(found) == 1
    assert found[0].startswith("frame 1: previous_forward_motion is 0 everywhere while motion is not")
    assert "NaN where it is unknown" in found[0]
    partly = zeros.copy()
    partly[:, :, 3, 4] = 2
    still = np.full_like(zeros, 0.1)
    for fine in (
        channels,
        channels | {"motion": still, "previous_forward_motion": zeros},
        channels | {"previous_forward_motion": partly},
        channels | {"previous_forward_motion": zeros + np.nan},
        {name: values for name, values in channels.items() if name != "previous_forward_motion"},
    ):
        assert not warned(fine)
