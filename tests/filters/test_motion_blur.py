"""The whole filter for motion blur: what must hold of its output, whatever its switches."""

import time
from dataclasses import replace

import numpy as np
import pytest

from nte.denoiser import require_channels
from nte.errors import NteError
from nte.filters.motion_blur import MotionBlur
from nte.filters.motion_blur.options import MotionBlurOptions
from nte.frames.bad import BadPixelWarning
from nte.frames.frame import Frame
from nte.session import Session
from tests.filters.bars import Bar
from tests.filters.blurred import DISC, blurred_disc, coverage
from tests.filters.sequences import run

SWITCHES = [
    {}, {"prefilter": True}, {"history": False}, {"steps": "fixed"}, {"iterations": 1}, {"angle": "naive"},
    {"factor": "share"}, {"static": "reprojected"}, {"fetch": "kernel"}, {"beta_a": 1.0, "beta_l": 10.0},
]  # fmt: skip


def sequence(count=3, **options):
    return [blurred_disc(index, **options) for index in range(count)]


def still(frame):
    return Frame({**frame.channels, "shutter_motion": np.zeros_like(frame["shutter_motion"])}, frame.index)


@pytest.mark.parametrize("options", SWITCHES, ids=str)
def test_constant_stays_constant(options):
    frames = [blurred_disc(i, velocity=(5.0, 2.0)) for i in range(3)]
    frames = [f.with_channels(color=np.full_like(f["color"], 0.7)) for f in frames]
    for image in run(MotionBlur(MotionBlurOptions(**options)), frames):
        np.testing.assert_allclose(image, 0.7, rtol=1e-5)


@pytest.mark.parametrize("options", SWITCHES[1:], ids=str)
def test_switches_change_the_result(options):
    frames = sequence(velocity=(7.0, 4.0))
    if options.keys() & {"iterations", "angle", "beta_a"}:  # what turns, and goes right: angles about 0°
        y, x = np.indices(frames[0].size) - 20.0
        turning = np.stack([8 - 0.15 * y, 0.15 * x])[None].astype(np.float32)
        frames = [f.with_channels(shutter_motion=turning) for f in frames]
    ours, theirs = (run(MotionBlur(MotionBlurOptions(**chosen)), frames)[-1] for chosen in ({}, options))
    assert np.abs(ours - theirs).max() > 1e-3


def test_disc_of_twenty_pixels_is_blurred_as_computed():
    """One frame, without a mean over noise: a third of the noise is left, and none beside the way."""
    truth = coverage((20.0, 0.0))
    expected = truth * DISC[:, None, None] + (1 - truth)
    beside = np.abs(np.indices(truth.shape)[0] + 0.5 - truth.shape[0] / 2) > 9.0
    for seed in range(4):
        frame = blurred_disc(seed=seed, flat=True)
        image = run(MotionBlur(), [frame])[0][0]
        ours, raw = (np.sqrt(np.square(one - expected).mean()) for one in (image, frame["color"][0]))
        assert ours < 0.33 * raw
        np.testing.assert_array_equal(image[:, beside], 1)
    # The profile along the way, a mean over the rows of the middle: that of the truth to its ends.
    middle = slice(21, 27)
    assert np.abs(image[0, middle].mean(0) - expected[0, middle].mean(0)).max() < 0.3


def test_history_lowers_the_noise_of_a_pattern_that_slides():
    bar, errors = Bar((24, 24), (9, 2), stripes=8.0, image=(40, 64)), {}
    for history in (True, False):
        image = run(MotionBlur(MotionBlurOptions(history=history)), [bar.frame(i - 2, batch=4) for i in range(3)])[-1]
        errors[history] = np.sqrt(np.square(image - bar.truth(0)).mean())
    assert errors[True] < 0.9 * errors[False]


def test_a_static_pixel_keeps_its_colour_where_nothing_passes():
    frames = sequence(velocity=(6.0, 0.0))
    for frame, image in zip(frames, run(MotionBlur(), frames), strict=True):
        moving = frame["shutter_motion"][0, 0] != 0
        ys, xs = np.nonzero(moving)
        y, x = np.indices(moving.shape)
        far = np.ones_like(moving)
        for row, column in zip(ys, xs, strict=True):
            far &= (abs(y - row) > 7) | (abs(x - column) > 7)
        assert far.any()
        assert moving.any()
        np.testing.assert_array_equal(image[0][:, far], frame["color"][0][:, far])


def test_an_edge_along_the_motion_stays_sharp():
    """A half plane that slides along its edge covers what it covers: nothing is blurred."""
    frame = blurred_disc(flat=True)
    below = np.indices(frame.size)[0] >= 24
    color = np.where(below, 3.0, 1.0) * np.ones((1, 3, 1, 1))
    motion = np.where(below, np.reshape([9.0, 0.0], (2, 1, 1)), 0.0)[None]
    depth = np.where(below, 3.0, 5.0)[None, None]
    channels = {"color": color, "time": frame["time"], "shutter_motion": motion, "shutter_depth": depth}
    frame = Frame({name: values.astype(np.float32) for name, values in channels.items()})
    image = run(MotionBlur(), [frame])[0]
    np.testing.assert_allclose(image, frame["color"], atol=1e-4)


def test_static_geometry_in_front_stays_as_it_is():
    frame = blurred_disc(velocity=(9.0, 0.0))
    bars = np.indices(frame.size)[1] % 16 < 8
    channels = {
        "color": np.where(bars, 0.25, frame["color"]),
        "shutter_motion": np.where(bars, 0, frame["shutter_motion"]),
        "shutter_depth": np.where(bars, 1, frame["shutter_depth"]),
        "time": frame["time"],
    }
    image = run(MotionBlur(), [Frame({k: v.astype(np.float32) for k, v in channels.items()})])[0]
    np.testing.assert_allclose(image[0][:, bars], 0.25, atol=1e-6)


def test_nothing_moves_nothing_changes_and_it_is_cheap():
    frame = blurred_disc(size=(192, 256), velocity=(7.0, 3.0), radius=80.0)
    rest = still(frame)
    denoiser = MotionBlur()
    np.testing.assert_allclose(run(denoiser, [rest])[0], rest["color"], atol=1e-6)

    def fastest(frame):
        times = []
        for _ in range(3):
            start = time.perf_counter()
            denoiser.step(frame, None)
            times.append(time.perf_counter() - start)
        return min(times)

    assert fastest(frame) > 3 * fastest(rest)


def test_reset_is_a_new_start_bit_for_bit():
    frames = sequence(4, batch=2)
    reset = Frame(frames[2].channels, 2, reset=np.array([1.0, 0.0], np.float32))
    denoiser = MotionBlur(MotionBlurOptions(prefilter=True))
    through = run(denoiser, [*frames[:2], reset, frames[3]])
    fresh = run(denoiser, frames[2:])
    kept = run(denoiser, frames)
    for ours, started, went in zip(through[2:], fresh, kept[2:], strict=True):
        np.testing.assert_array_equal(ours[0], started[0])
        np.testing.assert_array_equal(ours[1], went[1])
    assert np.abs(through[2][0] - kept[2][0]).max() > 0


def test_a_batch_is_its_sequences_one_by_one():
    frames = sequence(3, batch=2, velocity=(6.0, 3.0))
    both = run(MotionBlur(MotionBlurOptions(prefilter=True)), frames)
    for number in (0, 1):
        single = [Frame({k: v[number : number + 1] for k, v in f.channels.items()}, f.index) for f in frames]
        for ours, alone in zip(both, run(MotionBlur(MotionBlurOptions(prefilter=True)), single), strict=True):
            np.testing.assert_allclose(ours[number], alone[0], atol=2e-5)


def test_the_same_input_gives_the_same_output():
    first, second = (run(MotionBlur(MotionBlurOptions(prefilter=True)), sequence()) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_extras_say_what_was_done():
    session = Session(MotionBlur())
    for frame in sequence(2, velocity=(4.0, 0.0)):
        extras = session.step(frame, ("factor", "reprojected", "length")).extras
    assert extras["factor"].min() >= 0
    assert 0.9 < extras["factor"].max() <= 1
    assert 0 < extras["reprojected"].mean() < 1
    assert extras["length"].max() == pytest.approx(4, rel=1e-5)
    with pytest.raises(NteError, match="no extra 'nothing'"):
        session.step(frame, ("nothing",))


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (5, 4)])
def test_images_smaller_than_the_kernels(size):
    for image in run(
        MotionBlur(MotionBlurOptions(prefilter=True)), sequence(size=size, velocity=(9.0, 4.0), radius=3.0)
    ):
        assert image.shape[-2:] == size
        assert np.isfinite(image).all()


def test_bad_pixels_are_sanitised_and_reported():
    frame = blurred_disc()
    for name, value in (("color", np.nan), ("time", np.nan), ("shutter_motion", np.inf), ("shutter_depth", np.nan)):
        frame[name][:, :, 20:22, 30] = value
    with pytest.warns(BadPixelWarning):
        assert np.isfinite(run(MotionBlur(MotionBlurOptions(prefilter=True)), [frame, blurred_disc(1)])).all()


def test_vectors_longer_than_the_image():
    frame = blurred_disc(velocity=(1e4, 0.0), flat=True)
    frame["shutter_motion"][:, 0, 10:20] = 1e6
    image = run(MotionBlur(MotionBlurOptions(prefilter=True)), [frame, frame])[1]
    assert np.isfinite(image).all()
    assert image.min() >= 0.99
    assert image.max() <= 3.01


def test_times_outside_the_shutter_are_refused():
    frame = blurred_disc()
    frame["time"][0, 0, 0, :3] = 16.6
    with pytest.raises(NteError, match=r"frame 0: time is 16.6 to 16.6 in 3 pixels, expected .* in \[0, 1\]"):
        run(MotionBlur(), [frame])


def test_missing_channels_name_the_recipe_that_has_them():
    with pytest.raises(NteError, match=r"needs time, shutter_motion, shutter_depth.*groups that set shutter"):
        require_channels(MotionBlur(), ("color",), "clip")


@pytest.mark.parametrize(
    "options", [{"factor": "x"}, {"steps": "x"}, {"iterations": 0}, {"accept": 9.0}, {"shutter": 1.5},
                {"shutter": -0.5}, {"beta_l": float("nan")}, {"near": -1.0}],
)  # fmt: skip
def test_options_out_of_range_are_refused(options):
    with pytest.raises(NteError, match=f"motion_blur: .*{next(iter(options))}"):
        MotionBlur(MotionBlurOptions(**options))


@pytest.mark.parametrize("share", [0.5, 0.2])
def test_the_shutter_is_that_of_the_frame(share):
    """Bit for bit as when the number is given by hand, and history is found by it and not by another."""
    frames = [Bar((12, 20), (15, 4), 0.3, image=(48, 80), shutter=share).frame(i - 1) for i in range(3)]
    mute = [replace(frame, shutter=None) for frame in frames]
    told, by_hand = run(MotionBlur(), frames), run(MotionBlur(MotionBlurOptions(shutter=share)), mute)
    np.testing.assert_array_equal(told, by_hand)
    assert np.abs(told[-1] - run(MotionBlur(), mute)[-1]).max() > 0
    found = {}
    for name, given in (("told", frames), ("mute", mute)):
        session = Session(MotionBlur())
        found[name] = [session.step(frame, ("reprojected",)).extras["reprojected"].sum() for frame in given][-1]
    assert found["told"] > 1.5 * found["mute"]


def test_each_sequence_of_a_batch_has_a_shutter_of_its_own():
    shares = (1.0, 0.25)
    bars = [Bar((12, 20), (15, 4), image=(40, 72), shutter=share) for share in shares]
    single = [[bar.frame(i - 1) for i in range(2)] for bar in bars]
    both = [
        Frame({k: np.concatenate([a[k], b[k]]) for k in a.channels}, a.index, shutter=np.float32(shares))
        for a, b in zip(*single, strict=True)
    ]
    image = run(MotionBlur(), both)[-1]
    for number, frames in enumerate(single):
        np.testing.assert_allclose(image[number], run(MotionBlur(), frames)[-1][0], atol=2e-5)


@pytest.mark.parametrize("share", [-0.5, 0.0, 1.5, float("nan")])
def test_a_shutter_that_cannot_be_is_refused(share):
    frame = replace(blurred_disc(), shutter=np.float32([share]))
    with pytest.raises(NteError, match=r"frame 0: shutter is .*, expected the open share of the frame, in \(0, 1\]"):
        run(MotionBlur(), [frame])


def test_vectors_that_point_backward_are_refused_where_motion_tells():
    frame = blurred_disc(velocity=(9.0, 3.0), radius=12.0)
    motion = np.where(frame["shutter_motion"] != 0, np.reshape([-9.0, -3.0], (1, 2, 1, 1)), 0).astype(np.float32)
    run(MotionBlur(), [frame.with_channels(motion=motion)])
    backward = frame.with_channels(motion=motion, shutter_motion=-frame["shutter_motion"])
    with pytest.raises(NteError, match="frame 0: shutter_motion points to the previous frame, as motion does"):
        run(MotionBlur(), [backward])


@pytest.mark.parametrize(("before", "now"), [(0.5, 0.6), (0.5, 1.0), (1.0, 0.7)])
def test_history_is_followed_by_its_own_shutter(before, now):
    """The vectors of history span the shutter of the previous frame, not of this one."""
    bar, errors = Bar((20, 20), (15, 4), 0.3, stripes=8.0, image=(48, 80)), {}
    frames = [replace(bar, shutter=before).frame(-1, batch=4), replace(bar, shutter=now).frame(0, batch=4)]
    truth = replace(bar, shutter=now).truth(0)
    for history in (True, False):
        image = run(MotionBlur(MotionBlurOptions(history=history)), frames)[-1]
        errors[history] = np.sqrt(np.square(image - truth).mean())
    assert errors[True] < 0.93 * errors[False]
