import numpy as np
import pytest
import torch

from nte.motion.geometric import (
    Reprojection,
    complete_forward_motion,
    dual_motion,
    scatter_forward_motion,
    traditional_motion,
)
from nte.motion.warp import warp
from tests.synthetic import DISC, disc_frame


def frames(**options: object) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    previous, current = disc_frame(0, **options), disc_frame(1, **options)  # type: ignore[arg-type]
    as_batch = lambda f: {k: torch.as_tensor(v)[None] for k, v in f.items()}  # noqa: E731
    return as_batch(previous), as_batch(current)


def dual(previous: dict[str, torch.Tensor], current: dict[str, torch.Tensor]) -> Reprojection:
    return dual_motion(current["motion"], previous["forward_motion"], current["depth"], previous["depth"])


def hidden_before(previous: dict[str, torch.Tensor], current: dict[str, torch.Tensor]) -> torch.Tensor:
    """The truth: pixels of the wall that the disc covered, in a scene where only the disc moves."""
    return (previous["instance"] == DISC) & (current["instance"] != DISC)


@pytest.mark.parametrize("velocity", [(4.0, 0.0), (3.5, 0.0), (-2.25, 5.75), (0.0, -9.0)])
def test_the_mask_is_what_the_disc_uncovers(velocity: tuple[float, float]) -> None:
    previous, current = frames(velocity=velocity, start=(32.0, 24.0))
    found = dual(previous, current)
    assert torch.equal(found.disoccluded, hidden_before(previous, current))
    assert found.valid[current["instance"] != DISC].all()


@pytest.mark.parametrize("velocity", [(4.0, 0.0), (3.5, 0.0), (-2.25, 5.75)])
def test_dual_vectors_repeat_the_occluders_motion(velocity: tuple[float, float]) -> None:
    # Wall at rest: y = x and z = x + v, so x^O = x − v: the wall beside the disc, on the side it moves away from.
    previous, current = frames(velocity=velocity, start=(32.0, 24.0))
    found = dual(previous, current)
    expected = -torch.tensor(velocity).view(1, 2, 1, 1)
    hidden = found.disoccluded.expand_as(found.motion)
    torch.testing.assert_close(found.motion[hidden], expected.expand_as(found.motion)[hidden])
    assert torch.equal(found.motion[~hidden], current["motion"][~hidden])


def test_dual_vectors_fetch_the_wall_where_traditional_ones_fetch_the_disc() -> None:
    previous, current = frames(velocity=(6.0, 0.0), start=(32.0, 24.0))
    found = dual(previous, current)
    hidden = found.disoccluded.squeeze()
    traditional_depth = warp(previous["depth"], current["motion"]).image.squeeze()[hidden]
    dual_depth = warp(previous["depth"], found.motion).image.squeeze()[hidden]
    assert (dual_depth == 5).float().mean() > (traditional_depth == 5).float().mean() + 0.5


def test_without_depth_only_silhouettes_are_taken_for_disocclusions() -> None:
    previous, current = frames(velocity=(3.5, 0.0), start=(32.0, 24.0))
    found = dual_motion(current["motion"], previous["forward_motion"])
    hidden = hidden_before(previous, current)
    assert found.disoccluded[hidden].all()
    wrong = found.disoccluded & ~hidden
    assert 0 < wrong.sum() < 0.2 * hidden.sum()


def test_nothing_moves_nothing_is_disoccluded() -> None:
    previous, current = frames(velocity=(0.0, 0.0))
    found = dual(previous, current)
    assert not found.disoccluded.any()
    assert (found.motion == 0).all()
    assert found.valid.all()


def test_a_moving_camera_alone_disoccludes_nothing() -> None:
    previous, current = frames(velocity=(2.5, -1.5), wall_velocity=(2.5, -1.5))
    found = dual(previous, current)
    assert not found.disoccluded.any()


def test_an_occluder_leaving_the_image() -> None:
    # The disc leaves at the left; the dual vectors of what it uncovers point right into its old place … and
    # those of pixels closer to the border than its speed stay traditional but are known to be disoccluded.
    previous, current = frames(velocity=(-12.0, 0.0), start=(8.0, 24.0))
    found = dual(previous, current)
    hidden = hidden_before(previous, current)
    assert torch.equal(found.disoccluded, hidden)
    assert found.valid[hidden].all()
    entering = frames(velocity=(12.0, 0.0), start=(-2.0, 24.0))
    found = dual(*entering)
    outside = found.disoccluded & (found.motion[:, :1] == 0)
    assert outside.any()  # x − v lies left of the image: the traditional vector, which is 0, stays
    assert torch.equal(found.disoccluded, hidden_before(*entering))


def test_what_comes_from_outside_is_invalid_not_disoccluded() -> None:
    motion = torch.full((1, 2, 8, 8), 0.0)
    motion[:, 0] = 3.0
    found = dual_motion(motion, -motion)
    assert torch.equal(found.valid[..., :5].all(), torch.tensor(True))
    assert not found.valid[..., 5:].any()
    assert not found.disoccluded.any()


def test_unknown_forward_motion_means_not_disoccluded() -> None:
    previous, current = frames()
    found = dual_motion(current["motion"], torch.full_like(previous["forward_motion"], float("nan")))
    assert not found.disoccluded.any()
    assert torch.equal(found.motion, current["motion"])


def test_bad_motion_is_zero_and_invalid() -> None:
    motion = torch.zeros(1, 2, 4, 4)
    motion[0, 1, 2, 1] = float("nan")
    motion[0, 0, 0, 0] = float("inf")
    result = traditional_motion(motion)
    assert (result.motion == 0).all()
    assert (~result.valid).sum() == 2


@pytest.mark.parametrize("velocity", [(4.0, 0.0), (-3.0, 5.0)])
def test_scattering_finds_the_disc_and_leaves_holes(velocity: tuple[float, float]) -> None:
    previous, current = frames(velocity=velocity, start=(32.0, 24.0))
    scattered = scatter_forward_motion(current["motion"], current["depth"])
    known = scattered.isfinite().all(1)
    assert known.float().mean() > 0.9
    both = known[:, None].expand_as(scattered)
    torch.testing.assert_close(scattered[both], previous["forward_motion"][both])
    found = dual_motion(current["motion"], scattered, current["depth"], previous["depth"])
    assert torch.equal(found.disoccluded, hidden_before(previous, current))


def test_scattering_lets_the_nearest_win_and_agrees_with_a_loop() -> None:
    rng = torch.Generator().manual_seed(3)
    motion = torch.randn(2, 2, 9, 11, generator=rng) * 3
    depth = torch.randint(0, 4, (2, 1, 9, 11), generator=rng).float()
    result = scatter_forward_motion(motion, depth)
    for n in range(2):
        expected = np.full((2, 9, 11), np.nan, np.float32)
        nearest = np.full((9, 11), np.inf)
        for y in range(9):
            for x in range(11):
                mx, my = motion[n, :, y, x].tolist()
                px, py = x + 0.5 + mx, y + 0.5 + my
                if not (0 <= px <= 11 and 0 <= py <= 9):
                    continue
                tx, ty = min(int(px), 10), min(int(py), 8)
                d = depth[n, 0, y, x].item() or np.inf
                if d <= nearest[ty, tx]:
                    nearest[ty, tx] = d
                    expected[:, ty, tx] = [-mx, -my]
        np.testing.assert_array_equal(result[n].numpy(), expected)


def test_only_sequences_that_know_nothing_are_scattered() -> None:
    _, current = frames(velocity=(4.0, 0.0))
    motion, depth = current["motion"].repeat(3, 1, 1, 1), current["depth"].repeat(3, 1, 1, 1)
    given = torch.rand(motion.shape)
    given[1] = float("nan")
    given[2, :, 3:] = float("nan")
    found = complete_forward_motion(given, motion, depth)
    torch.testing.assert_close(found[[0, 2]], given[[0, 2]], rtol=0, atol=0, equal_nan=True)
    expected = scatter_forward_motion(motion, depth)
    torch.testing.assert_close(found[1], expected[1], rtol=0, atol=0, equal_nan=True)
    torch.testing.assert_close(complete_forward_motion(None, motion, depth), expected, rtol=0, atol=0, equal_nan=True)
    assert complete_forward_motion(given[:1], motion[:1], depth[:1]).data_ptr() == given.data_ptr()


def test_a_device_need_not_finish_its_work_for_the_missing_vectors() -> None:
    """Tensors on `meta` have no values, so a step that looked at one would fail, as it would make a GPU wait."""
    motion, depth = torch.empty(2, 2, 9, 13, device="meta"), torch.empty(2, 1, 9, 13, device="meta")
    assert complete_forward_motion(motion, motion, depth).shape == motion.shape
