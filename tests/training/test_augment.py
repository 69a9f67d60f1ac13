"""Augmented channels must still describe one image of one (mirrored) world."""

from itertools import permutations, product

import numpy as np
import pytest
import torch
from torch import Tensor

from nte.frames.channels import CHANNELS
from nte.motion.geometric import dual_motion
from nte.motion.warp import warp
from nte.training.augment import Augmentation

SYMMETRIES = [Augmentation(*bits) for bits in product((False, True), repeat=3)]
SIZE = 12, 16


def tensors(*names: str, size: tuple[int, int] = SIZE, seed: int = 0) -> dict[str, Tensor]:
    """Random channels (1, C, H, W); motions of whole and fractional pixels."""
    generator = torch.Generator().manual_seed(seed)
    return {n: torch.randn(1, len(CHANNELS[n].components), *size, generator=generator) * 2 for n in names}


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_augmenting_then_warping_is_warping_then_augmenting(symmetry: Augmentation) -> None:
    # Kept away from the border: a position on it is inside on one side and outside on the other.
    given = tensors("color", "motion")
    fetched = warp(given["color"], given["motion"])
    expected = symmetry({"color": fetched.image})["color"]
    mirrored = symmetry(given)
    found = warp(mirrored["color"], mirrored["motion"])
    torch.testing.assert_close(found.image, expected, atol=1e-4, rtol=1e-4)
    assert torch.equal(found.valid, symmetry({"depth": fetched.valid})["depth"])


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_dual_vectors_of_augmented_channels_are_the_augmented_dual_vectors(symmetry: Augmentation) -> None:
    # Off the whole pixels: a position between two of them belongs to the right one, mirrored to the left one.
    given = tensors("motion", "previous_forward_motion", "depth")
    given["motion"] = given["motion"].round() + 0.25
    given["depth"] = given["depth"].abs()
    ours = dual_motion(given["motion"], given["previous_forward_motion"], given["depth"], given["depth"])
    mirrored = symmetry(given)
    depth = mirrored["depth"]
    theirs = dual_motion(mirrored["motion"], mirrored["previous_forward_motion"], depth, depth)
    assert ours.disoccluded.any()
    torch.testing.assert_close(theirs.motion, symmetry({"motion": ours.motion})["motion"])
    assert torch.equal(theirs.disoccluded, symmetry({"depth": ours.disoccluded})["depth"])
    assert torch.equal(theirs.valid, symmetry({"depth": ours.valid})["depth"])


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_a_covariance_is_transformed_as_its_jacobian_says(symmetry: Augmentation) -> None:
    rng = np.random.default_rng(1)
    # J of the image's symmetry, read off what it does to two motion vectors.
    axes = torch.eye(2).view(2, 2, 1, 1)
    jacobian = symmetry({"motion": axes})["motion"].view(2, 2).T.numpy()
    root = rng.normal(size=(2, 2))
    covariance = root @ root.T
    stored = torch.tensor([covariance[0, 0], covariance[0, 1], covariance[1, 1]]).view(1, 3, 1, 1)
    expected = jacobian @ covariance @ jacobian.T
    found = symmetry({"reflection_covariance": stored})["reflection_covariance"].flatten().numpy()
    np.testing.assert_allclose(found, [expected[0, 0], expected[0, 1], expected[1, 1]])


def test_the_8_symmetries_are_distinct_and_each_is_undone_by_one_of_them() -> None:
    given = tensors("motion", "normal", "color", "reflection_covariance", size=(6, 6))
    results = [symmetry(given) for symmetry in SYMMETRIES]
    for a, b in product(range(8), repeat=2):
        assert torch.equal(results[a]["motion"], results[b]["motion"]) == (a == b)
    for result in results:
        undone = [all(torch.equal(back(result)[n], given[n]) for n in given) for back in SYMMETRIES]
        assert sum(undone) == 1


def test_two_symmetries_after_each_other_are_one_of_them() -> None:
    given = tensors("motion", "normal", "color", size=(6, 6))
    results = [symmetry(given) for symmetry in SYMMETRIES]
    for first, second in product(SYMMETRIES, repeat=2):
        both = second(first(given))
        assert any(all(torch.equal(both[n], one[n]) for n in given) for one in results)


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_the_world_is_mirrored_exactly_where_the_image_is(symmetry: Augmentation) -> None:
    axes = torch.eye(3).view(3, 3, 1, 1)
    world = symmetry({"normal": axes})["normal"].view(3, 3)
    image = symmetry({"motion": axes[:2, :2]})["motion"].view(2, 2)
    torch.testing.assert_close(world @ world.T, torch.eye(3))  # unit vectors stay unit
    assert torch.linalg.det(world) == torch.linalg.det(image)


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_colours_are_permuted_alike_and_nothing_else_is(order: tuple[int, int, int]) -> None:
    given = tensors("color", "reference", "albedo", "emission", "normal", "motion", "depth", "position")
    found = Augmentation(colours=order)(given)
    for name in ("color", "reference", "albedo", "emission"):
        assert torch.equal(found[name], given[name][:, list(order)])
    for name in ("normal", "motion", "depth", "position"):
        assert torch.equal(found[name], given[name])


def test_every_channel_of_the_table_can_be_augmented_and_unknown_nan_stays_nan() -> None:
    everything = tensors(*CHANNELS, size=(4, 6))
    everything["previous_forward_motion"][..., 0, 0] = float("nan")
    found = Augmentation(transpose=True, flip_x=True, colours=(2, 0, 1))(everything)
    assert {tuple(values.shape[2:]) for values in found.values()} == {(6, 4)}
    assert found["previous_forward_motion"].isnan().sum() == 2


def test_drawing_reaches_every_symmetry_and_every_order_of_colours() -> None:
    rng = np.random.default_rng(0)
    assert len({Augmentation.draw(rng) for _ in range(1000)}) == 8 * 6


def test_radiance_and_its_exposure_change_together_and_exposure_can_change_alone() -> None:
    given, scalars = tensors("color", "reference", "gradient", "albedo", "depth"), {"exposure": torch.tensor([0.5])}
    bright = Augmentation(light=4.0)
    found = bright(given)
    for name in ("color", "reference", "gradient"):
        assert torch.equal(found[name], 4 * given[name])
    for name in ("albedo", "depth"):
        assert torch.equal(found[name], given[name])
    assert bright.scalars(scalars)["exposure"].item() == 0.125  # what is exposed is the same
    darker = Augmentation(exposed=0.25)
    assert torch.equal(darker(given)["color"], given["color"])
    assert darker.scalars(scalars)["exposure"].item() == 0.125
    rng = np.random.default_rng(1)
    drawn = np.log2([(a.light, a.exposed) for a in (Augmentation().lit(rng, 2, 3) for _ in range(400))])
    for stops, factors in zip((2, 3), drawn.T, strict=True):
        assert 0.95 * stops < factors.max() <= stops
        assert abs(factors.mean()) < 0.15 * stops
    assert Augmentation().lit(rng, 0, 0) == Augmentation()


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_a_rotated_world_is_rotated_in_every_channel_and_mirrored_with_the_image(symmetry: Augmentation) -> None:
    rng = np.random.default_rng(2)
    turned = symmetry.turned(rng)
    assert turned.rotation is not None
    torch.testing.assert_close(torch.linalg.det(turned.rotation), torch.tensor(1.0))
    given = tensors("normal", "position", "indirect_direction", "motion", "color")
    given["position"] = given["normal"].clone()
    plain, found = symmetry(given), turned(given)
    for name in ("normal", "position", "indirect_direction"):
        # Angles and handedness stay those of the mirrored world.
        torch.testing.assert_close(found[name].norm(dim=1), plain[name].norm(dim=1))
        frame = [torch.stack([w[name][0, :, 1, 2], w[name][0, :, 2, 4], w[name][0, :, 3, 1]]) for w in (found, plain)]
        torch.testing.assert_close(frame[0] @ frame[0].T, frame[1] @ frame[1].T, atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(torch.linalg.det(frame[0]), torch.linalg.det(frame[1]), atol=1e-3, rtol=1e-3)
    assert not torch.allclose(found["normal"], plain["normal"], atol=0.1)
    assert torch.equal(found["normal"], found["position"])
    for name in ("motion", "color"):
        assert torch.equal(found[name], plain[name])


def test_every_direction_of_a_rotated_world_is_equally_likely() -> None:
    rng = np.random.default_rng(3)
    up = torch.tensor([0.0, 0.0, 1.0]).view(3, 1, 1)
    ends = torch.stack([Augmentation().turned(rng)({"normal": up})["normal"].flatten() for _ in range(3000)])
    assert ends.mean(0).abs().max() < 0.04
    torch.testing.assert_close(ends.T @ ends / 3000, torch.eye(3) / 3, atol=0.03, rtol=0)
