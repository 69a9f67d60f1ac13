"""The kernels that are overheard are those that were applied: the image is made of them, tap by tap."""

import numpy as np
import pytest
import torch

from nte.frames.frame import Frame
from nte.models.applied import Application, Kernel, overheard
from nte.models.filtering import Filtered, Mixing
from nte.models.prediction import TAPS, ScaleKernels
from nte.session import Session
from tests.networks import small_network
from tests.synthetic import random_frames

SIZE = (21, 18)  # padded to 24 × 24


def applied(frames: list[Frame], **choices: object) -> tuple[list[Kernel], list[np.ndarray]]:
    """The kernels of the last frame, and all images (C, H, W)."""
    network = small_network(channels=[4, 6], demodulate=False, **choices)
    session = Session(network)
    images = []
    for frame in frames:
        with overheard() as found:
            images.append(np.asarray(session.step(frame).image[0]))
    (application,) = found
    return application.applied(*SIZE), images


def read(image: np.ndarray, y: int, x: int) -> np.ndarray:
    """A pixel (C,), or the nearest of the border."""
    return image[:, min(max(y, 0), image.shape[1] - 1), min(max(x, 0), image.shape[2] - 1)]


def filtered(image: np.ndarray, weights: np.ndarray, y: int, x: int) -> np.ndarray:
    """The sum over the taps: row 0, column 0 is two pixels up and to the left of the pixel."""
    square = weights[:25, y, x].reshape(5, 5)
    return sum(square[v, u] * read(image, y + v - 2, x + u - 2) for v in range(5) for u in range(5))


INSIDE = [(2, 2), (9, 5), (10, 12), (3, 14)]  # far enough from the padding


def test_the_image_is_the_sum_over_a_kernel() -> None:
    frames = random_frames(1, SIZE)
    (kernel,), images = applied(frames, scales=1, temporal=False, feed_warped=False)
    weights = kernel.weights.numpy()
    assert (kernel.name, kernel.every, weights.shape) == ("kernel", 1, (25, *SIZE))
    np.testing.assert_allclose(weights.sum(0), 1, rtol=1e-5)
    for y, x in INSIDE:
        expected = filtered(frames[0]["color"][0], weights, y, x)
        np.testing.assert_allclose(images[0][:, y, x], expected, rtol=1e-4)


def test_kernels_of_every_scale_are_there_and_start_where_their_pixels_do() -> None:
    kernels, _ = applied(random_frames(2, SIZE), scales=3, front=2)
    sizes = {kernel.name: (kernel.every, tuple(kernel.weights.shape), kernel.further) for kernel in kernels}
    assert sizes == {
        "kernel": (1, (25, 21, 18), ()),
        "kernel of the history": (1, (25, 21, 18), ()),
        "kernel at 1/2": (2, (26, 11, 9), ("α",)),
        "kernel at 1/4": (4, (26, 6, 5), ("α",)),
    }
    for kernel in kernels:
        total = kernel.weights[:25].sum(0)
        np.testing.assert_allclose(total[total > 0], 1, rtol=1e-5)


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
def test_the_kernel_of_the_history_leaves_out_what_may_not_be_read() -> None:
    """The left half comes from outside the image: there is nothing to read there, and half of it at the edge."""
    frames = random_frames(2, SIZE)
    motion = np.zeros_like(frames[1]["motion"])
    motion[:, 0, :, :9] = -100  # px
    kernels, _ = applied([frames[0], frames[1].with_channels(motion=motion)], scales=1, motion="traditional")
    history = next(kernel.weights.numpy() for kernel in kernels if kernel.name == "kernel of the history")
    squares = history.reshape(5, 5, *SIZE)
    assert not squares[:, :, :, :7].any()
    assert not squares[:, :2, :, 9].any()  # the two columns on the left
    assert (squares[:, 2:, :, 9] > 0).all()
    np.testing.assert_allclose(history.sum(0)[:, 7:], 1, rtol=1e-5)


@pytest.mark.parametrize("priors", [0, 1])
def test_a_mixture_is_the_sum_over_its_weights(priors: int) -> None:
    """Of 3×3 pixels of half the resolution, and of images of the whole."""
    generator = torch.Generator().manual_seed(0)
    light, history, prior = torch.rand(3, 1, 3, 6, 10, generator=generator)
    half, known = torch.rand(1, 3, 3, 5, generator=generator), torch.rand(1, 1, 6, 10, generator=generator) > 0.4
    mixing = torch.rand(1, (TAPS + priors) * 4, 3, 5, generator=generator)
    scales = [ScaleKernels(None, None, None, mixing), ScaleKernels(torch.ones(1, 25, 3, 5), None, None)]
    own = [light, prior][: 1 + priors]
    image, _ = Mixing("mean", None)(Filtered([half], own, history, known), scales)
    (kernel, _) = Application(light, scales, history, known.float(), prior if priors else None).applied(6, 10)
    assert (kernel.every, kernel.further) == (1, ("pixel", *["prior"] * priors, "history"))
    weights = kernel.weights.numpy()
    np.testing.assert_allclose(weights.sum(0), 1, rtol=1e-5)
    for y, x in [(0, 0), (3, 4), (5, 9)]:
        taps = [read(half[0].numpy(), y // 2 + v, x // 2 + u) for v in (-1, 0, 1) for u in (-1, 0, 1)]
        taps += [one[0, :, y, x].numpy() for one in (*own, history)]
        expected = np.einsum("tc,t->c", np.stack(taps), weights[:, y, x])
        np.testing.assert_allclose(image[0, :, y, x], expected, rtol=1e-5)


def test_nothing_is_overheard_afterwards() -> None:
    network = small_network()
    with overheard() as found:
        pass
    Session(network).denoise(random_frames(1)[0])
    assert found == []
    with overheard() as found:
        Session(network).denoise(random_frames(1)[0])
    assert len(found) == 1
    assert found[0].number == sum(t.numel() for scale in found[0].kernels for t in scale if isinstance(t, torch.Tensor))
