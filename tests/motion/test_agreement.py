"""Variational refinement: what it must keep, what it must mend, and that it solves the equations it states."""

import pytest
import torch
from torch import Tensor

from nte.motion import agreement
from nte.motion.agreement import agree
from nte.motion.warp import pixel_centres

STRENGTH, GAIN = 8.0, 30.0


def texture(position: Tensor) -> Tensor:
    """A smooth pattern in [0, 1] at positions (N, 2, H, W), px."""
    x, y = position[:, :1], position[:, 1:]
    return 0.5 + 0.25 * torch.sin(x / 2.3) * torch.cos(y / 3.1) + 0.25 * torch.sin((x - 2 * y) / 5.7)


def images(motion: Tensor) -> tuple[Tensor, Tensor]:
    """(current, previous) such that current(p) = previous(p + motion)."""
    here = pixel_centres(motion)
    return texture(here + motion), texture(here)


def test_what_stands_still_stays() -> None:
    image = torch.rand(1, 2, 20, 30, generator=torch.Generator().manual_seed(1))
    zero = torch.zeros(1, 2, 20, 30)
    assert agree(image, image, zero, STRENGTH, GAIN).abs().max() < 1e-5  # the warp rounds


def test_a_motion_that_is_off_is_mended() -> None:
    true = torch.tensor([1.5, -0.75]).view(1, 2, 1, 1).expand(1, 2, 48, 64)
    generator = torch.Generator().manual_seed(2)
    current, previous = (image + 0.02 * torch.randn(image.shape, generator=generator) for image in images(true))
    off = torch.sin(pixel_centres(true) / 7) * 0.5
    refined = agree(current, previous, true + off, STRENGTH, GAIN)
    assert (refined - true).abs().mean() < off.abs().mean() / 3


def test_an_edge_of_motion_stands() -> None:
    motion = torch.zeros(1, 2, 40, 64)
    motion[..., 32:] = 2.0
    current, previous = images(motion)
    refined = agree(current, previous, motion, STRENGTH, GAIN)
    assert (refined - motion).abs().mean() < 0.05
    assert (refined[0, 0, :, 38] - refined[0, 0, :, 26]).mean() > 1.8


def test_the_steps_end_at_the_solution_of_the_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a dense matrix of all pixels' equations, written one by one."""
    monkeypatch.setattr(agreement, "STEPS", 2000)
    generator = torch.Generator().manual_seed(3)
    height, width = 5, 8
    now, before = torch.rand(2, 1, 1, height, width, dtype=torch.float64, generator=generator)
    motion = 0.2 * torch.rand(1, 2, height, width, dtype=torch.float64, generator=generator)
    found = agreement._solved(now, before, motion, STRENGTH, GAIN)

    xx, xy, yy, bx, by = (plane[0, 0] for plane in agreement._data(now, before, GAIN))
    count = height * width
    matrix, right = torch.zeros(2 * count, 2 * count, dtype=torch.float64), torch.zeros(2 * count, dtype=torch.float64)
    for y in range(height):
        for x in range(width):
            u, v = 2 * (y * width + x), 2 * (y * width + x) + 1
            own = torch.stack([torch.stack([xx[y, x], xy[y, x]]), torch.stack([xy[y, x], yy[y, x]])])
            matrix[u : v + 1, u : v + 1] += own
            right[u : v + 1] = own @ motion[0, :, y, x] - torch.stack([bx[y, x], by[y, x]])
            for k in agreement.REACH:
                for dy, dx in ((0, k), (0, -k), (k, 0), (-k, 0)):
                    if 0 <= y + dy < height and 0 <= x + dx < width:
                        apart = (motion[0, :, y, x] - motion[0, :, y + dy, x + dx]).square().sum()
                        pull = STRENGTH / (4 * len(agreement.REACH)) / (1 + apart / agreement.EDGE**2).sqrt()
                        for i in (0, 1):
                            matrix[u + i, u + i] += pull
                            matrix[u + i, 2 * ((y + dy) * width + x + dx) + i] -= pull
    expected = torch.linalg.solve(matrix, right).view(height, width, 2).permute(2, 0, 1)[None]
    assert (expected - motion).abs().max() < agreement._FARTHEST  # no limit was met
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)
