"""Open Image Denoise as a denoiser of ours: it denoises, keeps our conventions and says what is wrong."""

import sys
from collections.abc import Callable

import numpy as np
import pytest
import torch

from nte import Denoiser, Frame, NteError
from nte.filters.oidn import QUALITIES, Oidn

pyoidn = pytest.importorskip("pyoidn")


def noisy_gradient(height: int = 45, width: int = 61, batch: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(noisy, clean), each (N, 3, H, W): a ramp of light, and the same with exponential noise."""
    ramp = np.linspace(0.2, 2, width, dtype=np.float32)
    clean = np.broadcast_to(ramp, (batch, 3, height, width)).copy()
    noise = np.random.default_rng(0).exponential(size=clean.shape).astype(np.float32)
    return clean * noise, clean


def denoise(denoiser: Denoiser, **channels: np.ndarray) -> np.ndarray:
    result, _ = denoiser.step(Frame(channels), None)
    assert isinstance(result.image, np.ndarray)
    return result.image


@pytest.mark.parametrize("quality", QUALITIES)
def test_it_removes_most_of_the_noise(quality: str) -> None:
    noisy, clean = noisy_gradient()
    image = denoise(Oidn(quality), color=noisy)
    assert image.shape == noisy.shape
    assert image.dtype == np.float32
    assert np.square(image - clean).mean() < 0.1 * np.square(noisy - clean).mean()


@pytest.mark.parametrize("size", [(7, 13), (33, 20), (65, 97)])
def test_a_constant_stays_constant_at_odd_sizes(size: tuple[int, int]) -> None:
    image = denoise(Oidn(), color=np.full((1, 3, *size), 3.0, np.float32))
    assert image.shape == (1, 3, *size)
    # OIDN itself errs by up to a fifth in the outermost pixels; the image as a whole keeps its light
    assert abs(image.mean() / 3 - 1) < 0.01
    assert np.median(np.abs(image / 3 - 1)) < 0.02


def test_albedo_and_normal_guide_it() -> None:
    rng = np.random.default_rng(1)
    texture = np.kron(rng.uniform(0.1, 0.9, (1, 3, 12, 16)), np.ones((4, 4))).astype(np.float32)
    noisy = texture * rng.exponential(size=texture.shape).astype(np.float32)
    up = np.zeros_like(texture)
    up[:, 2] = 1
    blind = np.square(denoise(Oidn(), color=noisy) - texture).mean()
    image = denoise(Oidn(), color=noisy, albedo=texture, normal=up)
    assert np.square(image - texture).mean() < 0.5 * blind
    as_images = [np.ascontiguousarray(a[0].transpose(1, 2, 0)) for a in (noisy, texture, up)]
    theirs = pyoidn.denoise(*as_images, hdr=True, clean_aux=True, quality="high")
    np.testing.assert_array_equal(image[0].transpose(1, 2, 0), theirs)
    assert not np.array_equal(theirs, pyoidn.denoise(*as_images, hdr=True, clean_aux=False, quality="high"))


def test_batch_elements_are_independent_and_sizes_may_change() -> None:
    oidn = Oidn("fast")
    noisy, _ = noisy_gradient(batch=2)
    both = denoise(oidn, color=noisy)
    assert denoise(oidn, color=noisy[:, :, :20, :30]).shape == (2, 3, 20, 30)
    np.testing.assert_array_equal(both[1:], denoise(oidn, color=noisy[1:]))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_bad_pixels_count_as_black_and_do_not_spread(bad: float) -> None:
    noisy, _ = noisy_gradient()
    black = noisy.copy()
    black[..., 20, 30] = 0
    given = black.copy()
    given[..., 20, 30] = bad
    image = denoise(Oidn("fast"), color=given)
    np.testing.assert_array_equal(image, denoise(Oidn("fast"), color=black))
    assert given[0, 0, 20, 30] == bad or np.isnan(bad)  # the input is left as it was


def test_torch_in_torch_out() -> None:
    noisy, _ = noisy_gradient()
    result, _ = Oidn("fast").step(Frame({"color": torch.from_numpy(noisy)}), None)
    assert isinstance(result.image, torch.Tensor)
    np.testing.assert_array_equal(result.image.numpy(), denoise(Oidn("fast"), color=noisy))


def raises(message: str, call: Callable[[], object]) -> None:
    with pytest.raises(NteError, match=message):
        call()


def test_an_unknown_quality_names_the_choices() -> None:
    raises("quality is 'best': expected one of high, balanced, fast", lambda: Oidn("best"))


def test_a_missing_pyoidn_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    raises(r"pip install 'nte\[compare\]'", Oidn)


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("bright", [65000.0, 1e10, 1e20])
def test_one_bright_pixel_stays_where_it_is(quality: str, bright: float) -> None:
    noisy, _ = noisy_gradient(64, 160)
    spoilt = noisy.copy()
    spoilt[..., 32, 20] = bright
    image, expected = denoise(Oidn(quality), color=spoilt), denoise(Oidn(quality), color=noisy)
    assert image[..., 110:].mean() == pytest.approx(expected[..., 110:].mean(), rel=0.02)
