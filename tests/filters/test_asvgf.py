"""A-SVGF: temporal gradients say where history is stale."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from nte.filters.asvgf import Asvgf, AsvgfOptions, stratify
from nte.filters.reproject import geometry_of
from nte.filters.svgf import Svgf, SvgfOptions
from nte.frames.channels import COMPONENTS, width_of
from nte.frames.frame import Frame
from nte.session import Session
from tests.filters.sequences import noisy_frames, run, still_channels


def gradient_of(
    shape: tuple[int, int, int], now: np.ndarray | float, before: np.ndarray | float, seed: int = 0
) -> np.ndarray:
    """One pair in a random pixel of each stratum, elsewhere NaN: (N, 2, H, W)."""
    batch, height, width = shape
    rng = np.random.default_rng(seed)
    pairs = np.stack(np.broadcast_arrays(now, before, np.zeros(shape))[:2], 1).astype(np.float32)
    chosen = np.zeros(shape, bool)
    for n in range(batch):
        for top in range(0, height, 3):
            for left in range(0, width, 3):
                y = top + rng.integers(min(3, height - top))
                chosen[n, y, left + rng.integers(min(3, width - left))] = True
    return np.where(chosen[:, None], pairs, np.float32(np.nan))


def test_strata_hold_the_pair_wherever_it_lies_and_moments_of_the_pixels_that_exist() -> None:
    shape = (2, 7, 8)
    rng = np.random.default_rng(0)
    now, before = rng.random(shape), rng.random(shape)
    gradient = gradient_of(shape, now, before)
    gradient[1, :, 3:6, 3:6] = np.nan
    light = torch.rand(2, 1, 7, 8)
    depth = 2 + torch.rand(2, 1, 7, 8)
    strata = stratify(torch.from_numpy(gradient), light, geometry_of(depth, torch.rand(2, 3, 7, 8)))
    assert strata.change.shape == (2, 1, 3, 3)
    assert strata.brightest.flatten().tolist().count(0) == 1
    for n, i, j in ((0, 0, 0), (1, 2, 1), (0, 2, 2), (1, 1, 1)):
        rows, columns = slice(3 * i, 3 * i + 3), slice(3 * j, 3 * j + 3)
        pixels = gradient[n, :, rows, columns]
        valid = np.isfinite(pixels).all(0)
        pair = pixels[:, valid][:, 0] if valid.any() else np.zeros(2)
        assert float(strata.change[n, 0, i, j]) == pytest.approx(pair[0] - pair[1], abs=1e-6)
        assert float(strata.brightest[n, 0, i, j]) == pytest.approx(pair.max(), abs=1e-6)
        expected = depth[n, 0, rows, columns][torch.from_numpy(valid)][0] if valid.any() else depth[n, 0, 4, 4]
        assert float(strata.geometry.depth[n, 0, i, j]) == pytest.approx(float(expected))
        assert float(strata.moments[n, 0, i, j]) == pytest.approx(float(light[n, 0, rows, columns].mean()), rel=1e-5)


def alphas(gradients: list[np.ndarray], **options: float) -> list[np.ndarray]:
    """α of each frame of a still scene."""
    session = Session(Asvgf(AsvgfOptions(**options)))  # type: ignore[arg-type]
    frames = noisy_frames(len(gradients), still_channels(size=gradients[0].shape[2:]))  # type: ignore[arg-type]
    return [
        session.step(f.with_channels(gradient=g), ("alpha",)).extras["alpha"]
        for f, g in zip(frames, gradients, strict=True)
    ]


def test_light_that_does_not_change_leaves_alpha_alone_and_a_light_switched_off_forgets_everything() -> None:
    shape = (1, 20, 25)
    same, off = gradient_of(shape, 0.7, 0.7), gradient_of(shape, 0.0, 0.7)
    nothing = np.full_like(same, np.nan)
    found = alphas([nothing, same, same, off, nothing], alpha=0.1)
    for alpha, expected in zip(found, (1, 1 / 2, 1 / 3, 1, 1 / 2), strict=True):
        np.testing.assert_allclose(alpha, expected, rtol=1e-5)


@pytest.mark.parametrize("make", [Svgf, Asvgf])
@pytest.mark.parametrize("unit", [1e-7, 1e5])
def test_the_unit_of_light_does_not_matter(make: type[Svgf], unit: float) -> None:
    """Scenes in other units have other numbers, and edges of light stop the filter in all of them."""
    frames = noisy_frames(5, still_channels(size=(20, 25)))
    rng = np.random.default_rng(2)
    pairs = [gradient_of((1, 20, 25), *rng.uniform(0.1, 1, (2, 1, 20, 25)), seed=i) for i in range(5)]
    frames = [frame.with_channels(gradient=pair) for frame, pair in zip(frames, pairs, strict=True)]
    units = [f.with_channels(color=f["color"] * unit, gradient=f["gradient"] * unit) for f in frames]
    for image, other in zip(run(make(), frames), run(make(), units), strict=True):
        np.testing.assert_allclose(other / unit, image, rtol=1e-3, atol=1e-5)


def error(image: np.ndarray, frame: Frame) -> float:
    return float(np.sqrt(np.square(image - frame["reference"]).mean()))


@pytest.mark.parametrize("target", COMPONENTS)
def test_so_does_each_component_where_its_own_light_changed(target: str) -> None:
    channels, shape = still_channels((37, 50)), (1, 37, 50)
    channels |= {"gradient": gradient_of(shape, 1.0, 1.0), f"gradient_{target}": gradient_of(shape, 0.0, 1.0)}
    frames = [
        frame.with_channels(**{target: frame["color"][:, : width_of(target)].clip(max=1)})
        for frame in noisy_frames(4, channels)
    ]
    changed = run(Asvgf(AsvgfOptions(target)), frames)  # type: ignore[arg-type]
    for image, frame in zip(changed[1:], frames[1:], strict=True):
        (alone,) = run(Svgf(SvgfOptions(target)), [frame])  # type: ignore[arg-type]
        np.testing.assert_allclose(image, alone, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("batch", [1, 2])
def test_where_everything_changed_it_filters_as_a_first_frame_does(batch: int) -> None:
    """λ = 1: no history, but the spatial filter as wide as the noise of one frame asks for."""
    frames = noisy_frames(6, still_channels((37, 50), batch))
    off = gradient_of((batch, 37, 50), 0.0, 1.0)
    changed = run(Asvgf(), [frame.with_channels(gradient=off) for frame in frames])
    for image, frame in zip(changed[1:], frames[1:], strict=True):
        (alone,) = run(Svgf(), [frame])
        np.testing.assert_allclose(image, alone, rtol=1e-4, atol=1e-5)
        assert error(image, frame) < 0.3 * error(frame["color"], frame)


def test_where_half_of_the_picture_changed_that_half_is_young_and_the_other_keeps_its_history() -> None:
    shape = (1, 30, 96)
    left = np.broadcast_to(np.arange(96) < 48, shape)
    half = gradient_of(shape, np.where(left, 0.0, 1.0), 1.0)
    frames = noisy_frames(9, still_channels(shape[1:]))
    session = Session(Asvgf(AsvgfOptions(gradient_iterations=0)))
    for frame in frames[:-1]:
        session.step(frame.with_channels(gradient=np.full_like(half, np.nan)))
    result = session.step(frames[-1].with_channels(gradient=half), ("history_length", "alpha"))
    length = result.extras["history_length"]
    np.testing.assert_allclose(length[..., :48], 1, rtol=1e-5)
    np.testing.assert_allclose(length[..., 54:], 9, rtol=1e-5)
    (alone,) = run(Svgf(), [frames[-1]])
    young = (..., slice(0, 30))
    reference = frames[-1]["reference"]
    assert np.abs(result.image - reference)[young].mean() < 1.1 * np.abs(alone - reference)[young].mean()


@pytest.mark.parametrize("change", [0.1, 0.25, 0.5, 0.8])
def test_light_that_keeps_changing_is_filtered_no_worse_than_one_frame_alone(change: float) -> None:
    """Between 0 and 1, too, the variance is that of the noise that is left: nothing stays as it came."""
    frames = noisy_frames(10, still_channels((48, 64)))
    pairs = gradient_of((1, 48, 64), 1 - change, 1.0)
    images = run(Asvgf(), [frame.with_channels(gradient=pairs) for frame in frames])
    alone = np.mean([error(run(Svgf(), [frame])[0], frame) for frame in frames[5:]])
    assert np.mean([error(*pair) for pair in zip(images[5:], frames[5:], strict=True)]) < 1.02 * alone


def test_alpha_is_between_its_floor_and_one_in_proportion_to_the_relative_change() -> None:
    shape = (1, 12, 12)
    quarter = gradient_of(shape, 0.75, 1.0)
    found = alphas([np.full_like(quarter, np.nan)] * 4 + [quarter], alpha=0.2)[-1]
    np.testing.assert_allclose(found, 0.2 + 0.8 * 0.25, rtol=1e-4)


def test_noise_in_the_pairs_cancels_where_only_its_sign_is_random() -> None:
    shape = (1, 96, 96)
    sign = np.random.default_rng(0).choice([-1, 1], size=shape)
    noisy = gradient_of(shape, 1 + 0.2 * sign, 1 - 0.2 * sign)
    nothing = np.full_like(noisy, np.nan)
    raw, filtered = (alphas([nothing, noisy], gradient_iterations=n)[-1].mean() for n in (0, 5))
    assert raw == pytest.approx(0.5 + 0.5 * 0.4 / 1.2, rel=0.01)
    assert filtered < 0.5 + 0.25 * (raw - 0.5)


def heavy_tailed(shape: tuple[int, int, int], seed: int, share: float = 0.15) -> np.ndarray:
    """Pairs of light that is rarely bright, of which some paths met something else: on average nothing has changed."""
    rng = np.random.default_rng(seed)
    now, before = (rng.lognormal(-1, 1.2, shape) for _ in range(2))
    return gradient_of(shape, np.where(rng.random(shape) < share, now, before), before, seed)


def test_noise_of_the_gradients_themselves_can_be_kept_from_shortening_history() -> None:
    """Steady indirect light with noisy pairs keeps its history, and a light switched off is still noticed."""
    shape, frames = (1, 96, 96), 8
    channels = still_channels(shape[1:])
    given = [
        Frame({**channels, "indirect": channels["color"], "gradient": g, "gradient_indirect": g}, index)
        for index, g in enumerate(heavy_tailed(shape, seed) for seed in range(frames))
    ]
    means = {}
    for noise in (0.0, 1.0):
        # Two iterations, as on narrow surfaces.
        session = Session(Asvgf(AsvgfOptions("indirect", gradient_noise=noise, gradient_iterations=2)))
        means[noise] = [session.step(frame, ("history_length",)).extras["history_length"].mean() for frame in given][-1]
    assert means[0.0] < 0.6 * frames
    assert means[1.0] > 0.75 * frames
    off = gradient_of(shape, 0.0, 1.0)
    assert session.step(given[0].with_channels(gradient_indirect=off), ("alpha",)).extras["alpha"].mean() > 0.8


def test_a_component_follows_its_own_gradient_and_without_one_that_of_all_light() -> None:
    """A shadow moves: the pairs of all light and of visibility differ, those of indirect light do not."""
    shape, frames = (1, 20, 25), 6
    channels = still_channels(shape[1:])
    channels |= {"indirect": channels["color"], "glossy": channels["color"], "visibility": channels["depth"] * 0 + 0.5}
    moved, still = gradient_of(shape, 0.1, 1.0), gradient_of(shape, 0.3, 0.3)
    pairs = {"gradient": moved, "gradient_visibility": moved, "gradient_indirect": still, "gradient_glossy": still}

    def length(target: str, *without: str) -> float:
        session = Session(Asvgf(AsvgfOptions(target)))
        seen = {name: values for name, values in (channels | pairs).items() if name not in without}
        found = [session.step(Frame(seen, i), ("history_length",)).extras["history_length"] for i in range(frames)]
        return float(found[-1].mean())

    for target in ("indirect", "glossy"):
        assert length(target) == pytest.approx(frames, rel=1e-4)
        assert length(target, f"gradient_{target}") < 1.5
    assert length("visibility") < 1.5
    assert length("color") < 1.5
    assert "gradient" in Asvgf(AsvgfOptions("indirect")).needs
    assert "gradient_indirect" in Asvgf(AsvgfOptions("indirect")).optional


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("spoilt", [0, 1])
def test_a_gradient_whose_square_overflows_is_a_change_and_no_more(spoilt: int, noise: float) -> None:
    """Where the exposure is so small that the sanitiser cannot tell it from light."""
    shape = (1, 24, 32)
    pairs = gradient_of(shape, 1.0, 1.0)
    one = pairs.copy()
    one[0, spoilt][np.isfinite(one[0, 0])] = np.where(np.arange(88) == 40, 5e19, 1)
    session = Session(Asvgf(AsvgfOptions(gradient_noise=noise)))
    for frame, gradient in zip(noisy_frames(4, still_channels()), [pairs, pairs, one, pairs], strict=True):
        given = replace(frame.with_channels(gradient=gradient), exposure=np.array([1e-11], np.float32))
        result = session.step(given, ("history_length",))
        assert np.isfinite(result.image).all()
        assert np.isfinite(result.extras["history_length"]).all()


def test_a_change_stays_near_where_it_is() -> None:
    shape = (1, 30, 96)
    left = np.broadcast_to(np.arange(96) < 12, shape)
    found = alphas(
        [np.full((1, 2, 30, 96), np.nan, np.float32), gradient_of(shape, 1.0, np.where(left, 0.2, 1.0))],
        gradient_iterations=1,
    )[-1][0, 0]
    assert found[:, :9].min() > 0.7
    np.testing.assert_allclose(found[:, 30:], 0.5, atol=1e-5)


def test_it_follows_a_light_that_is_switched_off_where_svgf_lags() -> None:
    channels = still_channels()
    dark = {**channels, "reference": channels["reference"] * np.float32(0.05)}
    frames = noisy_frames(10, channels) + noisy_frames(2, dark, seed=9)
    nothing = np.full_like(channels["motion"], np.nan)
    pairs = [nothing] * 10 + [gradient_of((1, 24, 32), 0.1, 2.0), nothing]
    given = [Frame({**f.channels, "gradient": g}, i) for i, (f, g) in enumerate(zip(frames, pairs, strict=True))]
    lag, follow = (
        np.abs(run(d, given)[11] - dark["reference"]).mean()
        for d in (Svgf(SvgfOptions(alpha=0.1)), Asvgf(AsvgfOptions(alpha=0.1)))
    )
    assert follow < 0.1 * lag
