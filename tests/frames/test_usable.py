"""What is usable comes out bit for bit; everything else as the table of kinds says, from NumPy and PyTorch alike."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nte.denoiser import Denoiser, Noisy, sanitised
from nte.filters.taa import Taa, TaaOptions
from nte.frames.channels import CHANNELS, GUIDES
from nte.frames.frame import Frame
from nte.frames.usable import BRIGHTEST, known_cap, light_cap, mask_of, usable, usable_frame
from tests.everything import floor_frame

Pixels = npt.NDArray[np.float32]
nan, inf = np.nan, np.inf


def of(name: str, *pixel: float, brightest: float = 100.0) -> list[float]:
    """One pixel of a channel, in an image of 4×8."""
    values = np.zeros((1, len(CHANNELS[name].components), 4, 8), np.float32)
    values[0, :, 1, 2] = pixel
    found = usable(CHANNELS[name], values, brightest)
    theirs = usable(CHANNELS[name], torch.from_numpy(values), brightest)
    np.testing.assert_array_equal(found, theirs.numpy())
    assert found.dtype == np.float32
    return list(found[0, :, 1, 2].tolist())


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("color", (1, 2, 100), (1, 2, 100)), ("color", (1, -2, 101), (1, 0, 100)), ("color", (1, nan, 3), (0, 0, 0)),
        ("color", (1, inf, 3), (0, 0, 0)), ("color", (-inf, 1, 1), (0, 0, 0)), ("color", (1, 1e8, 3), (0, 0, 0)),
        ("albedo", (0.2, 1.5, -1), (0.2, 1, 0)), ("albedo", (0.2, nan, 0.3), (0, 0, 0)),
        ("albedo", (0.2, 0, 0.3), (0.2, 0, 0.3)),
        ("depth", (5,), (5,)), ("depth", (-5,), (0,)), ("depth", (nan,), (0,)), ("depth", (inf,), (0,)),
        ("depth", (3e38,), (0,)), ("depth", (1e-40,), (0,)),
        ("normal", (0, 0.6, -0.8), (0, 0.6, -0.8)), ("normal", (0, -6, 8), (0, -0.6, 0.8)),
        ("normal", (0, nan, 1), (0, 0, 0)), ("normal", (3e38, 0, 0), (0, 0, 0)), ("normal", (0.1, 0, 0), (0.1, 0, 0)),
        ("motion", (32, -16), (32, -16)), ("motion", (33, 0), (nan, nan)), ("motion", (0, 17), (nan, nan)),
        ("motion", (nan, 1), (nan, nan)), ("motion", (1, -3e38), (nan, nan)),
        ("shadow_motion", (512, 256), (512, 256)), ("shadow_motion", (1e6, 0), (nan, nan)),
        ("reflection_covariance", (9, 1, 4), (9, 1, 4)), ("reflection_covariance", (9, -3e38, 4), (nan, nan, nan)),
        ("gradient", (7, 5), (7, 5)), ("gradient", (7, nan), (nan, nan)), ("gradient", (-1, 2), (nan, nan)),
        ("gradient", (1e30, 2), (nan, nan)),
        ("roughness", (1.5,), (1,)), ("roughness", (nan,), (0,)), ("time", (nan,), (0.5,)), ("time", (1.5,), (1.5,)),
        ("position", (1e9, -5, 0), (1e9, -5, 0)), ("position", (1, inf, 0), (0, 0, 0)),
        ("instance", (16777215,), (16777215,)), ("instance", (nan,), (0,)),
    ],
)  # fmt: skip
def test_each_kind_has_its_range(name: str, given: tuple[float, ...], expected: tuple[float, ...]) -> None:
    np.testing.assert_allclose(of(name, *given), expected, rtol=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.floats(1e-6, 1e6))
def test_what_is_usable_stays_bit_for_bit(seed: int, scale: float) -> None:
    frame = floor_frame(seed, (9, 14), scale=scale)
    found = usable_frame(frame, frame.channels, known_cap(np.float32([np.nan])))
    for name, values in frame.channels.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)
    assert (found[mask_of("color")] == 1).all()


@pytest.mark.parametrize("name", GUIDES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e4])
def test_faults_of_guides_are_told_from_what_is_black(name: str, bad: float) -> None:
    values = np.zeros((2, 3, 4, 8), np.float32)
    values[1, 1, 2, 3] = bad
    for frame in (Frame({name: values}), Frame({name: torch.from_numpy(values)})):
        found = usable_frame(frame, (name,), np.ones(2, np.float32))
        mask = np.asarray(found[mask_of(name)])
        assert mask[1, 0, 2, 3] == 0
        assert mask.sum() == mask.size - 1
        again = usable_frame(found, (name,), np.ones(2, np.float32))
        np.testing.assert_array_equal(again[mask_of(name)], mask)
    assert mask_of(name) not in usable_frame(Frame({name: values[:1]}), (name,), np.ones(1, np.float32))


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(CHANNELS)), st.lists(st.floats(width=32), min_size=3, max_size=3))
def test_sanitising_twice_is_sanitising_once(name: str, pixel: list[float]) -> None:
    row = CHANNELS[name]
    values = np.zeros((1, len(row.components), 4, 8), np.float32)
    values[0, :, 2, 3] = pixel[: len(row.components)]
    once = usable(row, values, 100.0)
    np.testing.assert_allclose(usable(row, once, 100.0), once, rtol=1e-6)


def lit(light: float | Pixels, spike: float = 0.0, size: tuple[int, int] = (32, 32), **more: float) -> Frame:
    color = np.broadcast_to(np.float32(light), (1, 3, *size)).copy()
    if spike:
        color[0, :, 13, 17] = spike
    scalars = {name: np.float32([value]) for name, value in more.items()}
    return Frame({"color": color, "motion": np.zeros((1, 2, *size), np.float32)}, **scalars)  # type: ignore[arg-type]


@pytest.mark.parametrize("light", [1e-6, 0.3, 1e5])
@pytest.mark.parametrize("spike", [0.0, 1e19, 3e38, np.nan])
def test_the_cap_follows_the_exposure_and_no_spike(light: float, spike: float) -> None:
    expected = BRIGHTEST * light / 0.18
    assert light_cap(lit(light, spike), None) == pytest.approx(expected, rel=0.01)
    assert light_cap(lit(light, spike, exposure=2.0), None) == BRIGHTEST / 2


def test_the_cap_is_carried_does_not_pump_and_rises_out_of_the_dark() -> None:
    first = light_cap(lit(0.3), None)
    assert light_cap(lit(0.2), first) is first  # darker: as it was
    lamp = lit(0.31, 1e6)  # brighter than the cap itself, among light that is about as bright
    assert light_cap(lamp, first) == pytest.approx(first, rel=0.1)
    assert light_cap(lit(3e5), first) == pytest.approx(1e6 * first, rel=0.01)
    dark = light_cap(lit(0.0, 1e30), None)
    assert np.isnan(dark).all()  # a fault in the dark says nothing of the light to come
    assert light_cap(lit(0.3), dark) == pytest.approx(first)
    assert light_cap(lit(1e-4, reset=1.0), first) == pytest.approx(first / 3000, rel=0.01)


def test_a_fade_from_black_keeps_its_highlights() -> None:
    """The cap of the first, nearly black frame would turn everything else white."""
    denoiser, state = Taa(TaaOptions("none", alpha=1.0)), None
    for level in (0.0, 1e-9, 1e-4, 1.0):
        frame = lit(level, 100 * level)
        result, state = denoiser.step(frame, state)
        np.testing.assert_array_equal(result.image, frame["color"])


def test_the_state_of_another_batch_does_not_stand_in_the_way() -> None:
    class Mean(Denoiser):
        needs = ("color",)

        @sanitised
        def step(self, frame: Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[object, object]:
            self.seen = frame
            return _Same(), ()

    denoiser = Mean()
    _, state = denoiser.step(lit(1.0), None)
    channels = {"color": np.full((2, 3, 8, 8), 1e30, np.float32), "reference": np.full((2, 3, 8, 8), nan, np.float32)}
    denoiser.step(Frame(channels), state)
    assert denoiser.seen["color"].max() == 0
    assert np.isnan(denoiser.seen["reference"]).all()  # nothing that it does not read is touched


def test_every_sequence_of_a_batch_has_the_cap_that_it_has_alone() -> None:
    """One in other units, or with a fault, changes nothing for the other."""

    def both(*levels: float, spike: float = 0.0) -> Frame:
        return Frame({"color": np.concatenate([lit(level, spike * level)["color"] for level in levels])})

    together, alone = None, [None, None]
    for levels, spike in (((0.3, 3e9), 0.0), ((0.36, 3.6e9), 1e3), ((0.4, 3e17), 0.0), ((0.45, 3e9), 1e5)):
        together = light_cap(both(*levels, spike=spike), together)
        alone = [light_cap(both(level, spike=spike), cap) for level, cap in zip(levels, alone, strict=True)]
        np.testing.assert_array_equal(together, np.concatenate(alone))


def test_light_is_capped_whatever_type_the_frames_first_channel_has() -> None:
    color = np.full((1, 3, 16, 16), 1e-6, np.float32)
    numbers = torch.ones(1, 1, 16, 16, dtype=torch.int32)
    for channels in ({"instance": numbers, "color": torch.tensor(color)}, {"color": torch.tensor(color)}):
        np.testing.assert_array_equal(Noisy().step(Frame(channels), None)[0].image, color)


class _Same:
    like: Callable[[object, Frame], object] = lambda self, frame: self
