"""Metrics of one frame: analytic answers, slow obvious twins, and what must hold for any image."""

from collections.abc import Callable

import flip_evaluator
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nte import Frame, NteError
from nte.color import PSNR_MAX
from nte.evaluation.metrics import (
    flip_map,
    psnr,
    region_mean,
    regions_of,
    score,
    ssim_map,
    temporal_l1,
    temporal_l1_floor,
)
from tests.synthetic import DISC, Pixels, disc_frame

HEIGHT, WIDTH = 14, 19
ALL = {"all": torch.ones(1, 1, HEIGHT, WIDTH, dtype=torch.bool)}
seeds = st.integers(0, 2**31)


def image(seed: int) -> Tensor:
    return torch.rand(1, 3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(seed))


def mask(seed: int) -> Tensor:
    return torch.rand(1, 1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(seed)) < 0.3


def flat(value: float) -> Tensor:
    return torch.full((1, 3, HEIGHT, WIDTH), value)


def test_a_constant_offset_has_the_scores_of_the_formulas() -> None:
    scores, _ = score(flat(0.6), flat(0.5), ALL)
    found = scores["all"]
    assert found["l1"] == pytest.approx(0.1)
    assert found["mse"] == pytest.approx(0.01)
    assert found["rmse"] == pytest.approx(0.1)
    assert found["psnr"] == pytest.approx(20.0, abs=1e-4)
    # without structure SSIM is its luminance term: (2·μ·μ' + c₁)/(μ² + μ'² + c₁) with c₁ = 0.01²
    assert found["ssim"] == pytest.approx((2 * 0.3 + 1e-4) / (0.61 + 1e-4), abs=1e-4)


@given(seeds)
@settings(max_examples=10)
def test_identical_images_are_perfect_in_every_region(seed: int) -> None:
    scores, maps = score(image(seed), image(seed), {**ALL, "some": mask(seed)})
    for region in scores.values():
        assert region["psnr"] == PSNR_MAX
        assert region["ssim"] == pytest.approx(1, abs=1e-6)
        assert [region[name] for name in ("flip", "l1", "mse", "rmse")] == [0, 0, 0, 0]
    assert maps["flip"].shape == maps["ssim"].shape == (1, 1, HEIGHT, WIDTH)


@given(seeds)
@settings(max_examples=10)
def test_scores_of_a_region_agree_with_a_loop_over_its_pixels(seed: int) -> None:
    ours, theirs, region = image(seed), image(seed + 1), mask(seed + 2)
    scores, maps = score(ours, theirs, {"some": region})
    squared, absolute, flips = [], [], []
    for y in range(HEIGHT):
        for x in range(WIDTH):
            if region[0, 0, y, x]:
                difference = [float(ours[0, c, y, x]) - float(theirs[0, c, y, x]) for c in range(3)]
                squared += [d * d for d in difference]
                absolute += [abs(d) for d in difference]
                flips.append(float(maps["flip"][0, 0, y, x]))
    found = scores["some"]
    assert found["mse"] == pytest.approx(np.mean(squared), rel=1e-5)
    assert found["l1"] == pytest.approx(np.mean(absolute), rel=1e-5)
    assert found["rmse"] == pytest.approx(np.sqrt(np.mean(squared)), rel=1e-5)
    assert found["psnr"] == pytest.approx(-10 * np.log10(np.mean(squared)), rel=1e-4)
    assert found["flip"] == pytest.approx(np.mean(flips), rel=1e-5)


def test_ssim_map_agrees_with_the_formula_at_one_pixel() -> None:
    ours, theirs = image(1).double(), image(2).double()
    y, x = 7, 9  # the 11×11 window fits around it
    offsets = np.arange(-5, 6)
    window = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    window /= window.sum()
    expected = []
    for c in range(3):
        a, b = (t[0, c, y - 5 : y + 6, x - 5 : x + 6].numpy() for t in (ours, theirs))
        ma, mb = (window * a).sum(), (window * b).sum()
        va, vb = (window * a * a).sum() - ma**2, (window * b * b).sum() - mb**2
        cov = (window * a * b).sum() - ma * mb
        expected.append((2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4)))
    assert float(ssim_map(ours, theirs)[0, 0, y, x]) == pytest.approx(np.mean(expected), abs=1e-5)


def test_flip_is_nvidias_with_its_own_mean_and_direction() -> None:
    ours, theirs = image(3), image(4)
    arrays = [np.ascontiguousarray(t[0].permute(1, 2, 0).numpy()) for t in (theirs, ours)]
    _, mean, parameters = flip_evaluator.evaluate(*arrays, "LDR", parameters={"ppd": 67.0})
    assert parameters["ppd"] == 67
    assert region_mean(flip_map(ours, theirs)) == pytest.approx(mean, rel=1e-5)


def test_flip_of_a_batch_is_that_of_its_images() -> None:
    both = flip_map(torch.cat([image(1), image(2)]), torch.cat([image(3), image(4)]))
    torch.testing.assert_close(both[1:], flip_map(image(2), image(4)))


def test_more_noise_is_worse_by_every_metric() -> None:
    clean, noise = 0.25 + 0.5 * image(5), image(6) - 0.5
    little, much = (score(clean + k * noise, clean, ALL)[0]["all"] for k in (0.05, 0.3))
    for name in ("psnr", "ssim"):
        assert little[name] > much[name]  # type: ignore[operator]
    for name in ("flip", "l1", "mse", "rmse"):
        assert little[name] < much[name]  # type: ignore[operator]


@given(seeds, st.floats(-0.5, 0.5))
@settings(max_examples=20)
def test_temporal_l1_ignores_a_constant_offset_and_sees_flicker(seed: int, offset: float) -> None:
    now, before = image(seed), image(seed + 1)
    steady = temporal_l1(now + offset, before + offset, now, before)
    assert float(steady.max()) < 1e-6
    flicker = temporal_l1(now + offset, before - offset, now, before)
    torch.testing.assert_close(flicker, torch.full_like(flicker, 2 * abs(offset)), atol=1e-5, rtol=0)


def test_the_floor_is_what_a_perfect_denoiser_gets() -> None:
    """Truth against the mean of two noisy halves, by simulation: the estimate from the halves alone agrees."""
    draw = torch.Generator().manual_seed(0)
    truth = [torch.rand(1, 3, 200, 200, generator=draw) for _ in range(2)]
    a, b = ([t + 0.03 * torch.randn(t.shape, generator=draw) for t in truth] for _ in range(2))
    reference = [(x + y) / 2 for x, y in zip(a, b, strict=True)]
    perfect = temporal_l1(truth[1], truth[0], reference[1], reference[0]).mean()
    assert float(temporal_l1_floor(a[1], a[0], b[1], b[0]).mean()) == pytest.approx(float(perfect), rel=0.02)


def test_a_region_without_pixels_has_no_score() -> None:
    nothing = torch.zeros(1, 1, HEIGHT, WIDTH, dtype=torch.bool)
    scores, _ = score(image(0), image(1), {"none": nothing})
    assert set(scores["none"].values()) == {None}
    assert psnr(image(0), image(1), nothing) is None


def test_ssim_of_a_tiny_image_is_refused_in_our_words() -> None:
    tiny = torch.rand(1, 3, 5, 9)
    with pytest.raises(NteError, match="9x5 image: expected at least 6x6"):
        ssim_map(tiny, tiny)
    assert ssim_map(torch.rand(1, 3, 6, 6), torch.rand(1, 3, 6, 6)).shape == (1, 1, 6, 6)


def disc(index: int) -> dict[str, Pixels]:
    """Whole pixels per frame, so that every pixel is seen or hidden entirely."""
    return disc_frame(index, velocity=(3.0, 1.0))


def frame_of(index: int, *left_out: str) -> Frame:
    channels = {name: torch.from_numpy(values)[None] for name, values in disc(index).items()}
    channels["previous_forward_motion"] = torch.from_numpy(disc(index - 1)["forward_motion"])[None]
    return Frame({name: values for name, values in channels.items() if name not in left_out}, index=index)


def test_regions_are_where_the_disc_is_and_where_it_was() -> None:
    frame = frame_of(2)
    regions = regions_of(frame)
    is_disc = frame["instance"] == DISC
    was_disc = torch.from_numpy(disc(1)["instance"])[None] == DISC
    assert torch.equal(regions["moving"], is_disc)
    assert torch.equal(regions["disoccluded"], was_disc & ~is_disc)
    assert regions["disoccluded"].any()


@given(seeds)
@settings(max_examples=20)
def test_static_and_moving_partition_the_image(seed: int) -> None:
    motion = torch.randn(1, 2, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(seed)) * 0.1
    motion[0, :, 3, 4] = float("nan")
    regions = regions_of(Frame({"motion": motion}, index=1))
    assert torch.equal(regions["static"] ^ regions["moving"], regions["all"])
    assert regions["all"].all()
    assert torch.equal(regions["moving"], torch.nan_to_num(motion).norm(dim=1, keepdim=True) > 0.1)


def test_missing_forward_motion_is_scattered() -> None:
    given_, scattered = (regions_of(frame_of(2, *out)) for out in ((), ("previous_forward_motion",)))
    # scattering leaves holes, which count as not disoccluded, but finds the most of it
    assert not (scattered["disoccluded"] & ~given_["disoccluded"]).any()
    assert scattered["disoccluded"].sum() > 0.5 * given_["disoccluded"].sum()


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (lambda: Frame({"color": torch.zeros(1, 3, 8, 9)}), {"all"}),
        (lambda: Frame({"motion": torch.zeros(1, 2, 8, 9)}, index=1), {"all", "static", "moving"}),
    ],
)
def test_regions_need_what_they_are_made_of(frame: Callable[[], Frame], expected: set[str]) -> None:
    assert set(regions_of(frame())) == expected


def test_shadowed_and_glossy_pixels_are_told_by_the_references() -> None:
    visibility = torch.tensor([1.0, 0.995, 0.9, 0.0]).view(1, 1, 1, 4)
    light = torch.tensor([1.0, 1.0, 1.0, 0.0]).view(1, 1, 1, 4).expand(1, 3, 1, 4)
    glossy = torch.tensor([0.5, 0.11, 0.09, 0.0]).view(1, 1, 1, 4).expand(1, 3, 1, 4)
    channels = {"reference_visibility": visibility, "reference": light, "reference_glossy": glossy}
    regions = regions_of(Frame(channels))
    assert regions["shadowed"].flatten().tolist() == [False, False, True, True]
    assert regions["glossy"].flatten().tolist() == [True, True, False, False]  # black is no highlight


def test_nothing_is_disoccluded_in_the_first_frame() -> None:
    frame = frame_of(2, "previous_forward_motion")
    first = Frame(frame.channels, index=0)
    assert not regions_of(first)["disoccluded"].any()
