import torch

from nte.filters.blocks import (
    Moments,
    accumulate,
    clamp_history,
    clip_history,
    fetch_finite,
    fetch_history,
    neighbourhood_moments,
)
from nte.motion.catmull_rom import warp_catmull_rom
from nte.motion.geometric import traditional_motion
from nte.motion.warp import warp


def test_moments_are_those_of_the_pixels_that_exist() -> None:
    image = torch.rand(2, 3, 6, 7)
    moments = neighbourhood_moments(image)
    for y, x in ((3, 4), (0, 0), (5, 6), (0, 3)):
        around = image[1, 2, max(0, y - 1) : y + 2, max(0, x - 1) : x + 2]
        torch.testing.assert_close(moments.mean[1, 2, y, x], around.mean())
        torch.testing.assert_close(moments.deviation[1, 2, y, x], around.std(correction=0))


def test_moments_are_those_of_the_pixels_that_are_known_and_few_of_these_bound_nothing() -> None:
    image, known = torch.rand(2, 3, 6, 7), torch.rand(2, 1, 6, 7) < 0.4
    moments = neighbourhood_moments(torch.where(known, image, 1e3), 5, 1, known)
    for y, x in ((3, 4), (0, 0), (5, 6), (0, 3)):
        at = 1, slice(None), slice(max(0, y - 2), y + 3), slice(max(0, x - 2), x + 3)
        around = image[at][2][known[at][0]]
        if len(around) < 4:
            assert (moments.deviation[1, :, y, x] == float("inf")).all()
        else:
            torch.testing.assert_close(moments.mean[1, 2, y, x], around.mean(), rtol=1e-4, atol=1e-4)
            torch.testing.assert_close(moments.deviation[1, 2, y, x], around.std(correction=0), rtol=1e-3, atol=1e-3)
    nothing = neighbourhood_moments(image, known=known & False)
    torch.testing.assert_close(clamp_history(image, nothing), image)
    everything, whole = (neighbourhood_moments(image, 5, 2, mask) for mask in (known | True, None))
    torch.testing.assert_close(everything, whole)
    alone = torch.rand(1, 1, 1, 1)  # all that exist are known, so they are enough
    assert clamp_history(alone + 1, neighbourhood_moments(alone, known=alone > 0)) == alone


def test_moments_of_bright_light_do_not_cancel() -> None:
    image = 10_000 + torch.rand(1, 1, 8, 8)
    exact = neighbourhood_moments(image.double()).deviation
    torch.testing.assert_close(neighbourhood_moments(image).deviation.double(), exact, rtol=0.05, atol=1e-3)


def constant(*rgb: float) -> torch.Tensor:
    return torch.tensor(rgb, dtype=torch.float32).view(1, 3, 1, 1)


def test_clamping_works_per_channel_and_clipping_along_the_line_to_the_mean() -> None:
    moments = Moments(constant(1, 1, 1), constant(1, 1, 2))
    history = constant(5, 0.5, 3)
    torch.testing.assert_close(clamp_history(history, moments), constant(2, 0.5, 3))
    # The red is four deviations away: everything is moved to a quarter of its distance.
    torch.testing.assert_close(clip_history(history, moments), constant(2, 0.875, 1.5))
    torch.testing.assert_close(clamp_history(history, moments, width=2), constant(3, 0.5, 3))


def test_history_within_the_box_is_left_alone_and_a_box_without_size_is_the_mean() -> None:
    inside = constant(1.5, 0.5, 1)
    for limit in (clamp_history, clip_history):
        torch.testing.assert_close(limit(inside, Moments(constant(1, 1, 1), constant(1, 1, 1))), inside)
        mean = constant(1, 2, 3)
        torch.testing.assert_close(limit(constant(9, 0, 3), Moments(mean, 0 * mean)), mean, atol=1e-5, rtol=0)


def test_alpha_weighs_the_current_frame_and_invalid_pixels_take_it() -> None:
    current, history = torch.full((1, 3, 1, 2), 1.0), torch.full((1, 3, 1, 2), 5.0)
    valid = torch.tensor([True, False]).view(1, 1, 1, 2)
    torch.testing.assert_close(accumulate(current, history, valid, 0.25)[0, 0, 0], torch.tensor([4.0, 1.0]))


def test_history_is_fetched_where_it_was_and_valid_inside_and_without_reset() -> None:
    history = torch.arange(4.0).expand(2, 1, 4, 4)
    motion = torch.zeros(2, 2, 4, 4)
    motion[:, 0] = 1
    warped, valid = fetch_history(history, traditional_motion(motion), torch.tensor([0.0, 1.0]))
    torch.testing.assert_close(warped[0, 0, 0, :3], torch.tensor([1.0, 2.0, 3.0]))
    assert valid[0, 0, 0].tolist() == [True, True, True, False]
    assert not valid[1].any()
    assert fetch_history(history, traditional_motion(motion), None)[1].sum() == 2 * 4 * 3


def test_history_that_is_not_finite_has_no_part_in_what_is_fetched_and_no_more_place_than_its_own() -> None:
    history = torch.full((1, 3, 6, 8), 2.0)
    history[0, 1, 2, 3] = float("nan")
    for fetch in (warp, warp_catmull_rom):
        for x, lost in ((0.0, [3]), (0.25, [3]), (0.5, []), (-0.75, [4])):
            motion = torch.tensor([x, 0.0]).view(1, 2, 1, 1).expand(1, 2, 6, 8)
            image, valid = fetch_finite(fetch, history, motion)
            inside = fetch(torch.ones_like(history), motion).valid
            gone = (inside & ~valid)[0, 0].nonzero().tolist()
            # Halfway, which of two pixels has most of the weight is a matter of rounding.
            assert x == 0.5 or gone == [[2, column] for column in lost]
            torch.testing.assert_close(image[:, :, valid[0, 0]], torch.full_like(image[:, :, valid[0, 0]], 2.0))


def test_the_mean_of_known_light_is_never_negative() -> None:
    """Light of exactly 0 beside bright light: a mean below 0 by rounding would make a ratio of lights infinite."""
    generator = torch.Generator().manual_seed(3)
    light = torch.rand(2, 3, 40, 60, generator=generator) * 7
    light[..., 20:] = 0
    known = torch.rand(2, 1, 40, 60, generator=generator) > 0.2
    for size, step in ((3, 1), (5, 4)):
        assert neighbourhood_moments(light, size, step, known).mean.min() >= 0
