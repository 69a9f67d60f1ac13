"""The finest scale as a mixture: against a loop over pixels, and at its limits."""

import pytest
import torch
from torch import Tensor

from nte.models.filtering import Filtered, Mixing
from nte.models.prediction import TAPS, ScaleKernels

HEIGHT, WIDTH = 3, 5  # of half the resolution


def mixed(
    mixing: Tensor, light: Tensor, half: Tensor, history: Tensor, known: Tensor, *prior: Tensor
) -> tuple[Tensor, Tensor]:
    kernels = [ScaleKernels(None, None, None, mixing), ScaleKernels(torch.ones(1), None, None)]
    image, share = Mixing("mean", None)(Filtered([half], [light, *prior], history, known), kernels)
    assert share is not None
    return image, share


def everything(seed: int = 0, taps: int = TAPS) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    light, history = torch.rand(2, 2, 3, 2 * HEIGHT, 2 * WIDTH, generator=generator)
    return (
        torch.rand(2, taps * 4, HEIGHT, WIDTH, generator=generator) + 0.01,
        light,
        torch.rand(2, 3, HEIGHT, WIDTH, generator=generator),
        history,
        torch.rand(2, 1, 2 * HEIGHT, 2 * WIDTH, generator=generator) > 0.4,
    )


@pytest.mark.parametrize("priors", [0, 1])
def test_equals_a_loop_over_pixels(priors: int) -> None:
    mixing, light, half, history, known = everything(taps=TAPS + priors)
    prior = torch.rand(priors, *light.shape, generator=torch.Generator().manual_seed(5))
    image, share = mixed(mixing, light, half, history, known, *prior)
    for n in range(2):
        for y in range(2 * HEIGHT):
            for x in range(2 * WIDTH):
                place = 2 * (y % 2) + x % 2
                weights = mixing[n, place::4, y // 2, x // 2]
                rows = [min(max(y // 2 + dy, 0), HEIGHT - 1) for dy in (-1, 0, 1)]
                columns = [min(max(x // 2 + dx, 0), WIDTH - 1) for dx in (-1, 0, 1)]
                taps = [half[n, :, row, column] for row in rows for column in columns]
                taps += [own[n, :, y, x] for own in (light, *prior, history)]
                weights = weights * torch.tensor([1.0] * (TAPS + priors - 1) + [float(known[n, 0, y, x])])
                expected = (torch.stack(taps, 1) * weights).sum(1) / weights.sum()
                torch.testing.assert_close(image[n, :, y, x], expected)
                torch.testing.assert_close(share[n, 0, y, x], weights[:-1].sum() / weights.sum())


@pytest.mark.parametrize(("tap", "of"), [(TAPS - 2, "light"), (TAPS - 1, "history"), (4, "half")])
def test_a_single_weight_selects_its_tap(tap: int, of: str) -> None:
    _, light, half, history, _ = everything(1)
    mixing = torch.full((2, TAPS * 4, HEIGHT, WIDTH), 1e-12)
    mixing[:, 4 * tap : 4 * tap + 4] = 1
    image, _ = mixed(mixing, light, half, history, torch.ones_like(light[:, :1]) > 0)
    expected = {"light": light, "history": history, "half": half.repeat_interleave(2, 2).repeat_interleave(2, 3)}[of]
    torch.testing.assert_close(image, expected, rtol=1e-4, atol=1e-6)
