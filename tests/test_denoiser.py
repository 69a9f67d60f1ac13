"""The protocol, and running a denoiser over a sequence."""

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

import nte
from nte import Denoiser, Frame, NteError, Result, Session, denoise
from nte.denoiser import Noisy, require_channels
from nte.frames.bad import BadPixelWarning
from tests.synthetic import random_channels


class Counting(Denoiser):
    """A denoiser whose image says how many frames its state has seen."""

    needs = ("color",)
    extras = ("history_length",)

    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        seen = (state or 0) + 1
        image = np.full_like(frame["color"], seen)
        return Result(image, dict.fromkeys(extras, image)), seen


def frames(count: int) -> list[Frame]:
    return [Frame({"color": np.ones((1, 3, 2, 2), np.float32)}, i) for i in range(count)]


def test_the_state_goes_from_frame_to_frame_and_two_sequences_have_two() -> None:
    counting = Counting()
    assert isinstance(counting, Denoiser)
    assert [result.image[0, 0, 0, 0] for result in denoise(counting, frames(3))] == [1, 2, 3]
    one, other = Session(counting), Session(counting)
    one.denoise(frames(1)[0])
    assert one.denoise(frames(1)[0]).max() == 2
    assert other.denoise(frames(1)[0]).max() == 1
    one.reset()
    assert one.denoise(frames(1)[0]).max() == 1


def test_denoising_is_lazy() -> None:
    taken: list[int] = []

    def endless() -> Iterator[Frame]:
        for i in range(1000):
            taken.append(i)
            yield frames(1)[0]

    results = denoise(Counting(), endless())
    next(results)
    next(results)
    assert taken == [0, 1]


def test_extras_are_handed_on() -> None:
    result = Session(Counting()).step(frames(1)[0], ("history_length",))
    assert result.extras["history_length"].max() == 1


def test_an_extra_that_a_denoiser_does_not_have_is_refused_also_where_its_own_step_looks_at_none() -> None:
    class Plain(Denoiser):
        needs = ("color",)
        extras = ("weight",)

        def step(self, frame: Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[Result, object]:
            return Result(frame["color"], {"weight": frame["color"]}), state

    assert [*Session(Plain()).step(frames(1)[0], ("weight",)).extras] == ["weight"]
    with pytest.raises(NteError, match=r"^Plain has no extra 'wait', did you mean weight[?] expected one of weight$"):
        next(denoise(Plain(), frames(1), ("wait",)))


def test_a_missing_channel_is_named_before_the_denoiser_runs() -> None:
    counting = Counting()
    counting.needs = ("color", "albedo", "motion")
    with pytest.raises(NteError, match="frame 4: Counting needs albedo, motion, which is missing; there is color"):
        Session(counting).denoise(Frame({"color": np.ones((1, 3, 2, 2), np.float32)}, 4))


def test_bad_pixels_are_reported_once_a_sequence() -> None:
    bad = frames(3)
    for frame in bad:
        frame["color"][0, 0, 0, 0] = np.nan
    session = Session(Noisy())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for frame in bad:
            session.denoise(frame)
        assert len(caught) == 1
        session.reset()
        session.denoise(bad[0])
    assert [w.category for w in caught] == [BadPixelWarning] * 2


class Told(Denoiser):
    """A denoiser that remembers the indices of the frames it was given."""

    needs = ("color",)

    def __init__(self) -> None:
        self.indices: list[int] = []

    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        self.indices.append(frame.index)
        return Result(frame["color"]), ()


@pytest.mark.parametrize(
    ("given", "seen"),
    [
        ([0, 0, 0, 0], [0, 1, 2, 3]),  # never numbered
        ([0, 1, 2, 3], [0, 1, 2, 3]),
        ([7, 8, 9], [7, 8, 9]),
        ([9, 8, 7], [9, 8, 7]),  # a clip played backwards
        ([5, 5, 6, 7], [5, 6, 7, 8]),  # a frame shown for longer
        ([5, 5, 5, 6, 3, 9], [5, 6, 7, 8, 3, 9]),
    ],
)
def test_a_session_counts_frames_that_nobody_numbered(given: list[int], seen: list[int]) -> None:
    told = Told()
    session = Session(told)
    channels = frames(1)[0].channels
    for index in given:
        session.denoise(Frame(channels, index))
    session.reset()
    session.denoise(Frame(channels))
    assert told.indices == [*seen, 0]


def test_vectors_that_are_drawn_average_in_a_session_of_frames_without_numbers() -> None:
    """McGuire's blur draws its taps from the frame's number: without one, every frame must still be another draw."""
    rng = np.random.default_rng(0)
    channels = random_channels(rng, (16, 20)) | {"shutter_motion": np.full((1, 2, 16, 20), 6, np.float32)}
    session = Session(nte.load_denoiser("mcguire"))
    images = [session.denoise(Frame(channels)) for _ in range(3)]
    assert not np.array_equal(images[0], images[1])
    assert not np.array_equal(images[1], images[2])


def test_noisy_is_the_input() -> None:
    (frame,) = frames(1)
    np.testing.assert_array_equal(Session(Noisy()).denoise(frame), frame["color"])


def test_results_take_the_kind_of_array_of_the_frame() -> None:
    (frame,) = frames(1)
    tensor = Result(torch.ones(1, 3, 2, 2, requires_grad=True), {"alpha": torch.ones(1)})
    as_numpy = tensor.like(frame)
    assert isinstance(as_numpy.image, np.ndarray)
    assert isinstance(as_numpy.extras["alpha"], np.ndarray)
    assert tensor.like(frame.torch()) is tensor
    assert isinstance(as_numpy.like(frame.torch()).image, torch.Tensor)


def test_results_come_back_to_the_device_of_the_frame() -> None:
    """As of a filter on a GPU within a composition whose frames are elsewhere."""
    frame = Frame({"color": torch.ones(1, 3, 4, 4, device="meta")})
    result = Result(torch.ones(1, 3, 4, 4), {"mask": torch.ones(1, 1, 4, 4)}).like(frame)
    assert result.image.device.type == result.extras["mask"].device.type == "meta"
    same = Result(torch.ones(1, 3, 4, 4))
    assert same.like(Frame({"color": torch.ones(1, 3, 4, 4)})) is same


def test_the_package_offers_its_names() -> None:
    assert set(nte.__all__) <= set(dir(nte))
    assert nte.__version__


@pytest.mark.parametrize(
    ("needs", "said"),
    [
        (("gradient",), "needs gradient, .*; nte render writes it in groups that set components$"),
        (("time", "motion"), "needs time, motion, .*; nte render writes it in groups that set shutter$"),
        (("motion",), "needs motion, which is missing; there is color$"),
    ],
)
def test_a_missing_channel_comes_with_the_recipe_that_renders_it(needs: tuple[str, ...], said: str) -> None:
    picky = Noisy()
    picky.needs = needs
    with pytest.raises(NteError, match=said):
        require_channels(picky, ["color"], "clip")
