"""Shadow vectors: splatting, the non-planar heuristic, and a shadow that moves over a plane."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from nte.filters.bilateral import Edges, joint_bilateral
from nte.filters.trmv import Trmv
from nte.filters.trmv.inputs import RADIUS, GBuffer, prepare
from nte.filters.trmv.options import TrmvOptions
from nte.filters.trmv.samples import believable
from nte.filters.trmv.shadows import (
    FALLOFF,
    deviation_for,
    geometric_normal,
    planarity,
    shadow_reprojection,
    splat,
    squared_footprint,
)
from nte.frames.frame import Frame
from nte.motion.geometric import Reprojection, traditional_motion
from nte.session import Session
from tests.filters.trmv_frames import plane


def test_vectors_are_the_mean_of_shadowed_samples_and_visibility_of_all() -> None:
    frame = plane(size=(9, 9)).torch()
    edges = prepare(frame, None).edges
    visibility = torch.ones(1, 1, 9, 9)
    motion = torch.full((1, 2, 9, 9), float("nan"))
    visibility[..., 4, 4], visibility[..., 4, 5], visibility[..., 0, 0] = 0, 0, 0
    motion[..., 4, 4], motion[..., 4, 5] = 2.0, 4.0  # the third blocked sample has no valid vector
    found = splat(visibility, frame["direct"], motion, edges)
    expected = joint_bilateral(visibility, edges, RADIUS, deviation_for((9, 9)))
    torch.testing.assert_close(found.visibility, expected)
    assert found.shadowed.all()
    assert found.motion[0, 0, 4, 0] < 3 < found.motion[0, 0, 4, 8]
    assert torch.equal(found.motion[:, 0], found.motion[:, 1])
    torch.testing.assert_close(found.motion[0, 0, :, 4], found.motion[0, 0, 4, 4].expand(9))


def test_an_upright_image_is_filtered_as_one_that_lies() -> None:
    """A camera that is turned by 90° sees penumbrae of the same width."""
    assert deviation_for((360, 640)) == deviation_for((640, 360)) == pytest.approx(7.5 * 360 / 640)
    assert deviation_for((720, 1280)) == 7.5


def test_where_there_is_no_direct_light_nothing_is_said_and_nothing_is_heard() -> None:
    frame = plane(size=(1, 8)).torch()
    direct = frame["direct"].clone()
    direct[..., 4:] = 0
    visibility = torch.zeros(1, 1, 1, 8)
    visibility[..., 4:] = 1
    found = splat(visibility, direct, torch.zeros(1, 2, 1, 8), prepare(frame, None).edges)
    torch.testing.assert_close(found.visibility.flatten(), torch.tensor([0.0] * 4 + [1.0] * 4))


def test_fully_lit_surfaces_use_the_traditional_vector() -> None:
    frame = plane(size=(4, 6)).torch()
    traditional = traditional_motion(torch.ones(1, 2, 4, 6))
    no_shadow = torch.full((1, 2, 4, 6), float("nan"))
    splatted = splat(torch.ones(1, 1, 4, 6), frame["direct"], no_shadow, prepare(frame, None).edges)
    assert not splatted.shadowed.any()
    assert torch.equal(shadow_reprojection(splatted, traditional).motion, traditional.motion)


def vectors(x: float, size: tuple[int, int] = (1, 12)) -> Reprojection:
    return traditional_motion(torch.tensor([x, 0.0]).view(1, 2, 1, 1).expand(1, 2, *size))


def surface(height: Tensor) -> GBuffer:
    """The plane z = 0 in pixels of 0.1, with points lifted by `height` (12,)."""
    x = (torch.arange(12) + 0.5) * 0.1
    position = torch.stack([x, 0 * x, height]).view(1, 3, 1, 12)
    normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, 1, 12)
    return GBuffer(normal, torch.full((1, 1, 1, 12), 5.0), torch.ones(1, 1, 1, 12), position)


@pytest.mark.parametrize(
    ("angle", "trust"), [(0.0, 1.0), (FALLOFF, np.exp(-0.5)), (-FALLOFF, np.exp(-0.5)), (1.5, 0.0)]
)
def test_trust_falls_with_the_angle_to_the_receivers_plane(angle: float, trust: float) -> None:
    # The shadow of pixel 2 was at pixel 8, 0.6 away, lifted to `angle` above the plane.
    height = torch.zeros(12)
    height[8] = 0.6 * np.tan(angle)
    found = planarity(surface(torch.zeros(12)), surface(height), vectors(0), vectors(6))
    assert float(found[0, 0, 0, 2]) == pytest.approx(trust, abs=1e-4)


def test_trust_is_whole_within_a_pixels_footprint_and_nothing_before_the_sky() -> None:
    height = torch.zeros(12)
    height[2] = 0.05  # straight above the receiver, but nearer than the next pixel
    flat, bumpy = surface(torch.zeros(12)), surface(height)
    assert planarity(flat, bumpy._replace(position=bumpy.position), vectors(20), vectors(0))[0, 0, 0, 2] == 1
    assert planarity(flat, flat._replace(depth=torch.zeros(1, 1, 1, 12)), vectors(0), vectors(6)).max() == 0


def test_the_sky_is_no_neighbour_of_a_surface_at_the_worlds_origin() -> None:
    position = torch.zeros(1, 3, 1, 5)
    position[0, 0, 0, :3] = torch.tensor([-1.9, -0.9, 0.1])
    hit = torch.tensor([True, True, True, False, False]).view(1, 1, 1, 5)
    assert squared_footprint(position, hit).flatten().tolist() == pytest.approx([1, 1, 1, torch.inf, torch.inf])


def test_a_hidden_receiver_is_taken_where_it_is_now() -> None:
    # Before, something stood there, 3 above the plane: only the current receiver lies on the shadow's plane.
    height = torch.zeros(12)
    height[:4] = 3
    traditional = vectors(0)._replace(disoccluded=torch.arange(12).view(1, 1, 1, 12) < 4)
    flat, before = surface(torch.zeros(12)), surface(height)
    assert planarity(flat, before, traditional, vectors(6))[0, 0, 0, 2] == 1
    assert planarity(flat, before, vectors(0), vectors(6))[0, 0, 0, 2] < 0.1


SPEED = 5.0  # px a frame


def moving_shadow(index: int) -> Frame:
    """A plane at rest; the hard shadow of a bar, 14 px wide, moves to the right. No noise, exact vectors."""
    frame = plane(index, size=(24, 80))
    x = np.arange(80) + 0.5
    dark = np.broadcast_to((np.abs(x - 12 - SPEED * index) < 7)[None, None, None], (1, 1, 24, 80))
    motion = np.where(dark, np.array([-SPEED, 0], np.float32).reshape(1, 2, 1, 1), np.float32("nan"))
    return frame.with_channels(visibility=(~dark).astype(np.float32), shadow_motion=motion)


def error_of(**options: object) -> float:
    """RMSE against the spatially filtered shadow of the last of eight frames."""
    frames = [moving_shadow(i) for i in range(8)]
    image = Session(Trmv(TrmvOptions("visibility", **options))).step(frames[-1]).image  # type: ignore[arg-type]
    session = Session(Trmv(TrmvOptions("visibility", **options)))  # type: ignore[arg-type]
    truth = Session(Trmv(TrmvOptions("visibility", shadow="none"))).step(frames[-1]).image
    for frame in frames:
        image = session.step(frame).image
    return float(np.sqrt(np.mean((image - truth) ** 2)))


def test_shadow_vectors_keep_a_moving_shadow_where_traditional_ones_leave_ghosts() -> None:
    plain = {"clamp": float("inf"), "cleanup": False}
    reliable, traditional = error_of(**plain), error_of(shadow="traditional", **plain)
    assert traditional > 0.2
    assert reliable < 0.1 * traditional
    assert error_of() < 0.2 * error_of(shadow="traditional", clamp=float("inf"))


def test_a_shadow_that_moves_over_a_step_is_trusted_less() -> None:
    session = Session(Trmv(TrmvOptions("visibility")))
    for index in range(3):
        frame = moving_shadow(index)
        position = frame["position"].copy()
        position[..., 30:] += np.array([0, 0, 2], np.float32).reshape(1, 3, 1, 1)
        frame = replace(frame.with_channels(position=position), index=index)
        alpha = session.step(frame, ("visibility_alpha",)).extras["visibility_alpha"][0, 0, 12]
    # In frame 2 the shadow covers 15 to 29 and came from 10 to 24; what is now beyond the step came from before it.
    assert alpha[20] == pytest.approx(1 / 3, abs=1e-3)
    assert alpha[32] > 0.9


def test_one_vector_that_is_wrong_moves_nobody() -> None:
    # Like a ray that grazes its receiver. Long, or shorter than the image.
    frame = plane(size=(40, 60)).torch()
    edges = prepare(frame, None).edges
    dark = torch.zeros(1, 1, 40, 60)
    spread = torch.randn(1, 2, 40, 60, generator=torch.Generator().manual_seed(0))
    for length in (1e4, 40.0):
        motion = 2.0 + 0.3 * spread
        clean = splat(dark, frame["direct"], motion, edges)
        motion[0, :, 20, 30] = length
        spoilt = splat(dark, frame["direct"], motion, edges)
        assert spoilt.shadowed.all()
        assert (spoilt.motion - clean.motion).abs().max() < 0.1


def test_vectors_that_differ_are_all_believed() -> None:
    """Two lights, and samples too few to judge by."""
    motion = torch.full((1, 2, 20, 20), 3.0)
    motion[..., ::2] = -9.0
    assert believable(motion)[0].all()
    few = torch.full((1, 2, 20, 20), float("nan"))
    few[..., 5, 5], few[..., 5, 7] = 3.0, -9.0
    assert believable(few)[0].sum() == 2


def test_what_is_left_of_an_underflow_is_no_shadow() -> None:
    frame = plane(size=(40, 40)).torch()
    edges = prepare(frame, None).edges
    faint = Edges([w * 1e-18 for w in edges.along_x], [w * 1e-18 for w in edges.along_y])
    visibility, motion = torch.ones(1, 1, 40, 40), torch.full((1, 2, 40, 40), float("nan"))
    visibility[..., 20, 20], motion[..., 20, 20] = 0, 7.0
    for given in (edges, faint):
        found = splat(visibility, frame["direct"], motion, given)
        both = found.shadowed.expand(-1, 2, -1, -1)
        np.testing.assert_allclose(found.motion[both], 7.0, rtol=1e-3)
        assert (found.motion[~both] == 0).all()
    assert found.shadowed.sum() < 50  # 10⁻¹⁸ along one axis is a weight, 10⁻³⁶ along both is none


def tilted_wall(shading: Tensor) -> GBuffer:
    """A steep flat wall whose shading normals are those of a normal map."""
    y, x = torch.meshgrid(torch.arange(24) * 0.1, torch.arange(32) * 0.1, indexing="ij")
    position = torch.stack([x, y, 0.7 * x - 0.4 * y])[None]
    return GBuffer(shading, torch.full((1, 1, 24, 32), 5.0), torch.ones(1, 1, 24, 32), position)


@pytest.mark.parametrize("given", [True, False])
def test_a_normal_map_does_not_make_a_wall_look_bent(given: bool) -> None:
    flat = torch.nn.functional.normalize(torch.tensor([-0.7, 0.4, 1.0]), dim=0).view(1, 3, 1, 1).expand(1, 3, 24, 32)
    bumps = 0.36 * torch.randn(1, 3, 24, 32, generator=torch.Generator().manual_seed(1))  # some 20°
    wall = tilted_wall(torch.nn.functional.normalize(flat + bumps, dim=1))
    if given:
        wall = wall._replace(geometric=flat)
    still, shadow = (traditional_motion(torch.full((1, 2, 24, 32), m)) for m in (0.0, 3.0))
    trust = planarity(wall, wall, still, shadow)
    assert trust[..., :-3, :-3].min() > 0.999


def test_a_normal_across_points_is_the_surfaces_own_at_an_edge() -> None:
    wall = tilted_wall(torch.zeros(1, 3, 24, 32))
    assert wall.position is not None
    position, depth = wall.position.clone(), wall.depth.clone()
    position[..., 16:] = torch.tensor([3.0, 2.0, -9.0]).view(1, 3, 1, 1)  # one point: no normal to be had
    depth[..., :4, :] = 0
    found = geometric_normal(wall._replace(position=position, depth=depth, normal=torch.full((1, 3, 24, 32), 0.5)))
    flat = torch.nn.functional.normalize(torch.tensor([-0.7, 0.4, 1.0]), dim=0)
    cosine = (found * flat.view(1, 3, 1, 1)).sum(1).abs()
    torch.testing.assert_close(cosine[:, 4:, :16], torch.ones(1, 20, 16))
    assert (found[..., 16:] == 0.5).all()
