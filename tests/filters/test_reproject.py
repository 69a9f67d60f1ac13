"""Reprojection: against a loop over pixels, and a camera, a disc and a sky whose history is known."""

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from nte.filters import reproject as module
from nte.filters.reproject import Geometry, fwidth, geometry_of, previous_depth, reproject
from nte.motion.camera import points_from_depth
from tests.synthetic import disc_frame


def random_surface(random: torch.Generator, shape: tuple[int, int, int]) -> Geometry:
    """Two depths, two orientations and some sky, mixed pixel by pixel, so that tests pass and fail."""
    n, h, w = shape
    kind = torch.randint(0, 4, (n, 1, h, w), generator=random)
    depth = torch.where(kind == 3, 0.0, 2.0 + kind % 2)
    tilt = torch.where(kind == 2, 0.8, 0.0)
    normal = torch.cat([tilt, 0 * tilt, (1 - tilt**2).sqrt()], 1) * (kind != 3)
    surface = geometry_of(depth, normal)
    return surface._replace(depth_width=0 * depth, normal_width=0 * depth)


def slow(values: Tensor, motion: Tensor, allowed: Tensor, now: Geometry, before: Geometry) -> tuple[Tensor, Tensor]:
    """The definition, pixel by pixel and tap by tap."""
    fetched, valid = torch.zeros_like(values), torch.zeros_like(allowed)
    batch, _, height, width = values.shape

    def passes(n: int, y: int, x: int, v: int, u: int) -> bool:
        if not (0 <= v < height and 0 <= u < width):
            return False
        zs = [float(s.depth[n, 0, j, i]) for s, j, i in ((now, y, x), (before, v, u))]
        apart = 0 if zs[0] == zs[1] else abs(zs[0] - zs[1])
        turned = float((now.normal[n, :, y, x] - before.normal[n, :, v, u]).norm())
        floor = 0.002 * zs[0] if zs[0] < math.inf else 0
        return apart <= 10 * floor and turned <= 16 * 0.01

    for n in range(batch):
        for y in range(height):
            for x in range(width):
                px, py = x + float(motion[n, 0, y, x]), y + float(motion[n, 1, y, x])
                left, top = math.floor(px), math.floor(py)
                taps = {
                    (top + j, left + i): abs(1 - j - (py - top)) * abs(1 - i - (px - left))
                    for j in (0, 1)
                    for i in (0, 1)
                }
                taps = {t: weight for t, weight in taps.items() if passes(n, y, x, *t)}
                if sum(taps.values()) < 0.01:
                    around = [(round(py) + j, round(px) + i) for j in (-1, 0, 1) for i in (-1, 0, 1)]
                    taps = {t: 1.0 for t in around if passes(n, y, x, *t)}
                if taps and bool(allowed[n, 0, y, x]):
                    valid[n, 0, y, x] = True
                    mean = sum(weight * values[n, :, v, u] for (v, u), weight in taps.items())
                    fetched[n, :, y, x] = mean / sum(taps.values())
    return fetched, valid


@pytest.mark.parametrize("strip", [7, 1 << 16])
@pytest.mark.parametrize("shape", [(2, 9, 11), (1, 1, 1), (1, 2, 5)])
def test_it_is_the_definition_tap_by_tap(
    shape: tuple[int, int, int], strip: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "STRIP_PIXELS", strip)
    random = torch.Generator().manual_seed(1)
    n, h, w = shape
    now, before = random_surface(random, shape), random_surface(random, shape)
    values = torch.rand(n, 2, h, w, generator=random)
    motion = 2 * torch.randn(n, 2, h, w, generator=random)
    motion[:, :, 0, 0] = 0
    allowed = torch.rand(n, 1, h, w, generator=random) < 0.9
    history = reproject(values, motion, allowed, now, before)
    fetched, valid = slow(values, motion, allowed, now, before)
    torch.testing.assert_close(history.valid, valid)
    torch.testing.assert_close(history.values, fetched)


def still(surface: Geometry) -> tuple[Tensor, Tensor]:
    shape = surface.depth.shape
    return torch.zeros(shape[0], 2, *shape[2:]), torch.ones(shape, dtype=torch.bool)


def test_zero_motion_moves_no_pixel() -> None:
    surface = random_surface(torch.Generator().manual_seed(0), (1, 13, 8))
    values = torch.rand(1, 3, 13, 8)
    history = reproject(values, *still(surface), surface, surface)
    assert history.valid.all()
    assert torch.equal(history.values, values)


@pytest.mark.parametrize("far", [-1e9, -40.0, 40.0, 1e9])
def test_what_comes_from_outside_the_image_is_invalid(far: float) -> None:
    surface = geometry_of(torch.ones(1, 1, 6, 5), torch.ones(1, 3, 6, 5))
    motion, allowed = still(surface)
    assert not reproject(motion, motion + far, allowed, surface, surface).valid.any()


def test_a_disc_that_moves_by_half_pixels_keeps_its_history_and_uncovers_a_wall_without() -> None:
    before, now = (disc_frame(i, velocity=(3.5, 0.0), radius=9.0) for i in range(2))
    surfaces = [geometry_of(*(torch.from_numpy(f[k][None]) for k in ("depth", "normal"))) for f in (before, now)]
    motion = torch.from_numpy(now["motion"][None])
    values = torch.from_numpy(before["albedo"][None])
    history = reproject(values, motion, torch.ones(1, 1, 48, 64, dtype=torch.bool), surfaces[1], surfaces[0])
    disc = torch.from_numpy(now["instance"][None]) == 2
    uncovered = (torch.from_numpy(before["instance"][None]) == 2) & ~disc
    assert history.valid[disc].all()
    error = (history.values - torch.from_numpy(now["albedo"][None])).abs().amax(1, keepdim=True)
    assert error[disc].max() < 0.35  # of the search at the rim: a pixel or so beside
    assert error[disc].median() < 0.01
    # The search looks one pixel around; where there was disc alone, there is none.
    wall = (torch.from_numpy(before["instance"][None]) == 1).float()
    nothing = uncovered & (F.max_pool2d(wall, 3, stride=1, padding=1) == 0)
    assert nothing.sum() > 10
    assert not history.valid[nothing].any()


def camera(forward: float) -> tuple[Tensor, Tensor]:
    """(view, projection) of a camera that looks along −z, moved by `forward` and turned."""
    turn = torch.eye(4)
    c, s = math.cos(0.2 * forward), math.sin(0.2 * forward)
    turn[0, 0], turn[0, 2], turn[2, 0], turn[2, 2] = c, s, -s, c
    view = torch.eye(4)
    view[2, 3] = forward
    far, near, cot = 100.0, 0.1, 1.5
    ndc = torch.tensor(
        [[cot, 0, 0, 0], [0, cot, 0, 0], [0, 0, -far / (far - near), -far * near / (far - near)], [0, 0, -1, 0]]
    )
    to_image = torch.tensor([[0.5, 0, 0, 0.5], [0, -0.5, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]])
    return (turn @ view)[None], (to_image @ ndc)[None]


def test_the_previous_depth_is_that_of_the_points_before_the_previous_camera() -> None:
    (view, projection), (before, _) = camera(0.5), camera(0.1)
    depth = 2 + torch.rand(1, 1, 5, 7)
    depth[..., 2, 3] = 0
    points = points_from_depth(depth, view, projection)
    exact = -(torch.einsum("nij,njhw->nihw", before[:, :3, :3], points)[:, 2:] + before[:, 2, 3].view(-1, 1, 1, 1))
    for given in (depth, torch.where(depth > 0, depth, float("inf"))):
        found = previous_depth(given, view, projection, before)
        assert found[0, 0, 2, 3] == float("inf")
        torch.testing.assert_close(found[depth > 0], exact[depth > 0])


@pytest.mark.parametrize(("distance", "tolerance"), [(1e4, 2e-4), (1e6, 0.015)])
def test_the_previous_depth_keeps_its_digits_far_from_the_origin(distance: float, tolerance: float) -> None:
    """Matrices in single precision have lost some already; what is left must not cost history, at a limit of 2 %."""
    (view, projection), (before, _) = camera(0.5), camera(0.1)
    depth = 2 + torch.rand(1, 1, 5, 7)
    exact = previous_depth(depth, view, projection, before)
    away = torch.eye(4, dtype=torch.float64)
    away[:3, 3] = torch.tensor([-1, 0.7, -0.5]) * distance
    found = previous_depth(depth, (view.double() @ away).float(), projection, (before.double() @ away).float())
    torch.testing.assert_close(found, exact, rtol=tolerance, atol=0)


def test_a_camera_that_moves_forward_keeps_the_history_of_what_it_looks_at() -> None:
    (view, projection), (before_view, _) = camera(1.0), camera(0.5)
    depth = torch.full((1, 1, 24, 32), 4.0)
    facing = torch.tensor([0.0, 0, 1]).view(1, 3, 1, 1).expand(1, 3, 24, 32)
    expected = previous_depth(depth, view, projection, before_view)
    now, before = geometry_of(depth, facing), geometry_of(depth, facing)._replace(depth=expected)
    motion, allowed = still(now)
    assert not reproject(depth, motion, allowed, now, before).valid.any()
    assert reproject(depth, motion, allowed, now, before, expected).valid.all()
    # What moves along with the camera keeps its depth, whatever the camera alone would say.
    assert reproject(depth, motion, allowed, now, now, expected).valid.all()


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_the_unit_of_length_does_not_matter(unit: float) -> None:
    """A wall, a parallel plate before it, and sky; the plate has moved by two pixels and by 1 % of its depth."""
    plate = torch.zeros(1, 1, 9, 16, dtype=torch.bool)
    plate[..., 2:7, 5:10] = True
    depth = torch.where(plate, 4.0, 5.0)
    depth[..., 14:] = 0
    normal = (depth > 0) * torch.tensor([0.0, 0, 1]).view(1, 3, 1, 1)
    now = geometry_of(depth * unit, normal)
    before = geometry_of(torch.where(plate.roll(2, 3), 4.04, torch.where(depth > 0, 5.0, 0.0)) * unit, normal)
    motion = torch.where(plate, 2.0, 0.0) * torch.tensor([1.0, 0]).view(1, 2, 1, 1)
    values = torch.where(plate.roll(2, 3), 1.0, 0.0)
    found = reproject(values, motion, torch.ones_like(plate), now, before)
    assert torch.equal(found.values > 0, plate)
    hidden = plate.roll(2, 3) & ~plate
    beside = F.max_pool2d(1 - values, 3, stride=1, padding=1) > 0  # there the search finds the wall
    assert torch.equal(found.valid, ~hidden | beside)


def test_widths_are_slopes_and_a_silhouette_is_none() -> None:
    x, y = torch.arange(8.0).expand(1, 1, 6, 8), torch.arange(6.0).view(-1, 1).expand(1, 1, 6, 8)
    torch.testing.assert_close(fwidth(3 * x + 2 * y), torch.full((1, 1, 6, 8), 5.0))
    step = torch.where(x >= 4, 9.0, 1.0)
    assert not fwidth(step).any()
    assert not geometry_of(0 * x, torch.zeros(1, 3, 6, 8)).depth_width.any()
    alone = torch.zeros(1, 1, 5, 5)
    alone[..., 2, 2] = 3
    assert not geometry_of(alone, torch.zeros(1, 3, 5, 5)).depth_width.any()


def test_bad_numbers_are_misses() -> None:
    depth = torch.tensor([float("nan"), float("inf"), -1, 2]).view(1, 1, 2, 2)
    normal = torch.tensor([float("nan"), float("inf"), 1, 3**-0.5]).view(1, 1, 2, 2).expand(1, 3, 2, 2)
    surface = geometry_of(depth, normal)
    assert surface.depth.flatten().tolist() == [float("inf")] * 3 + [2]
    assert surface.normal[0, 0].flatten().tolist() == pytest.approx([0, 0, 3**-0.5, 3**-0.5])
    assert torch.isfinite(surface.depth_width).all()
    assert torch.isfinite(surface.normal_width).all()


def test_pixels_are_counted_beyond_the_whole_numbers_of_float32() -> None:
    height, width = 5, 2**22 + 1
    image = torch.zeros(5, height * width, dtype=torch.int8)
    row, column = torch.tensor([4.0]), torch.tensor([3.0])
    image[4, 4 * width + 3] = 7
    taps = module._Taps(image, torch.zeros(7, 1), torch.zeros(2, 1), torch.zeros(1, dtype=torch.int64), (height, width))
    assert taps.at(column, row)[0].item() == 7
