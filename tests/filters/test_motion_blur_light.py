"""Light is neither made nor lost: bright bars on black, whose blurred frame has the light that the truth has."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.session import Session
from tests.filters.bars import Bar

BARS = {
    "slow": Bar((8, 14), (2.5, 0), image=(44, 40)),
    "fast": Bar((10, 14), (20, 0), image=(44, 60)),
    "thin and fast": Bar((2, 14), (26, 0), image=(44, 60)),
    "slanted": Bar((8, 16), (7.3, 3.6), 0.6, image=(52, 52)),
    "striped, up": Bar((24, 16), (3, -14), 1.2, stripes=9.0, image=(72, 56)),
    "half a shutter": Bar((8, 16), (18, 5), -0.4, image=(52, 56), shutter=0.5),
    "an eighth of a shutter": Bar((8, 16), (18, 5), -0.4, image=(52, 48), shutter=0.125),
    "converging": Bar((20, 20), (4, 0), 0.3, growth=-0.2, image=(56, 60)),
    "diverging": Bar((12, 12), (4, 0), 0.3, growth=0.2, image=(48, 52)),
}  # in images so large that windows of 15×15 around what is seen end inside
COLOR = (8.0, 2.0, 0.5)
FRAMES, BATCH = 2, 16


def light_of(spec: str, bar: Bar) -> tuple[float, float, float]:
    """Light of the last frame, in which the bar is in the middle of the image, of its input and of the truth."""
    session, frames = Session(load_denoiser(spec)), [bar.frame(i + 1 - FRAMES, batch=BATCH) for i in range(FRAMES)]
    images = [session.denoise(frame) for frame in frames]
    means = (images[-1].mean(0), frames[-1]["color"].mean(0), bar.truth(0))
    ours, given, truth = (mean.sum((1, 2)) for mean in means)
    assert np.ptp(ours / truth) < 1e-4  # no colour is kept better than another
    return float(ours.sum()), float(given.sum()), float(truth.sum())


SPECS = {"ours": "motion_blur", "plain share": "motion_blur:factor=share", "as the paper": "motion_blur:preset=paper"}


@pytest.mark.parametrize(
    ("spec", "name"),
    [*(("ours", name) for name in BARS), *((spec, name) for spec in ("plain share", "as the paper")
                                           for name in ("slow", "thin and fast", "half a shutter", "converging"))],
)  # fmt: skip
def test_light_is_kept_within_a_percent(spec: str, name: str) -> None:
    bar = Bar(**{**BARS[name].__dict__, "color": COLOR})
    ours, given, truth = light_of(SPECS[spec], bar)
    assert given == pytest.approx(truth, rel=0.02)  # the samples are few, and themselves not all of the truth
    assert ours == pytest.approx(given, rel=0.01)


@pytest.mark.parametrize(("before", "now"), [(0.25, 1.0), (1.0, 0.5)])
def test_light_is_kept_where_the_shutter_changes(before: float, now: float) -> None:
    bar, session = Bar((8, 16), (18, 5), -0.4, image=(56, 60), color=COLOR), Session(load_denoiser("motion_blur"))
    session.denoise(replace(bar, shutter=before).frame(-1, batch=BATCH))
    frame = replace(bar, shutter=now).frame(0, batch=BATCH)
    assert session.denoise(frame).sum() == pytest.approx(frame["color"].sum(), rel=0.01)


def crossing(index: int, front: Bar, back: Bar, batch: int) -> Frame:
    """Two bars in one frame: what is behind is seen where the one in front is not. Their times are the same."""
    near, far = front.frame(index, batch=batch), back.frame(index, batch=batch)
    covers = near["shutter_depth"] < 4
    behind = {name: values + (name == "shutter_depth") * np.float32(0.5) for name, values in far.channels.items()}
    channels = {name: np.where(covers, near[name], behind[name]) for name in near.channels}
    return Frame(channels, index, shutter=near.shutter)


@pytest.mark.parametrize(("velocity", "shutter"), [((0, 11), 1.0), ((0, 11), 0.5), ((-12, 0), 0.5), ((8, -7), 1.0)])
def test_light_is_kept_where_things_cross_that_move_in_two_directions(
    velocity: tuple[float, float], shutter: float
) -> None:
    front = Bar((10, 10), (11, 2), 0.2, image=(48, 50), color=COLOR, shutter=shutter)
    back = Bar((11, 9), velocity, -0.3, image=(48, 50), color=(1.0, 6.0, 3.0), shutter=shutter)
    session = Session(load_denoiser("motion_blur"))
    for index in (-1, 0):
        frame = crossing(index, front, back, batch=8)
        image = session.denoise(frame)
    assert image.sum() == pytest.approx(frame["color"].sum(), rel=0.01)


def test_the_factor_stays_a_share_where_motion_converges() -> None:
    """Each frame's history arrives on fewer pixels than it came from."""
    bar, session = Bar((40, 40), (0, 0), growth=-0.15, image=(56, 56)), Session(load_denoiser("motion_blur"))
    for index in range(5):
        extras = session.step(bar.frame(index - 2), ("factor",)).extras
        assert extras["factor"].min() >= 0
        assert extras["factor"].max() <= 1 + 1e-6


def test_a_gap_in_front_of_what_moves_shows_it_at_full_light() -> None:
    """A fence stands before a bright ground that slides: between its bars nothing of the ground is lost."""
    time = np.random.default_rng(0).random((1, 1, 32, 64))
    bars = np.indices((32, 64))[1] % 12 < 5
    channels = {
        "color": np.where(bars, 0.1, 6.0) * np.ones((1, 3, 1, 1)),
        "time": time,
        "shutter_motion": np.where(bars, 0, np.reshape([9.0, 4.0], (2, 1, 1)))[None],
        "shutter_depth": np.where(bars, 2.0, 7.0)[None, None],
    }
    frame = Frame({name: values.astype(np.float32) for name, values in channels.items()})
    session = Session(load_denoiser("motion_blur"))
    for _ in range(2):
        image = session.denoise(frame)
    torch.testing.assert_close(torch.from_numpy(image), torch.from_numpy(frame["color"]), atol=1e-4, rtol=0)
