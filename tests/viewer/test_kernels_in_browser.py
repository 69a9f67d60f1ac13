"""The kernels under the pointer in a real browser: the network's own, every weight in the place where it was read."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from nte.evaluation.view import view
from nte.frames.clip import Clip
from nte.models.prediction import ScaleKernels
from nte.models.temporal import TemporalDenoiser
from nte.registry import load_denoiser
from nte.session import Session
from tests.networks import small_network
from tests.viewer.browser import Browser, needs_chromium
from tests.viewer.reading import data_of
from tests.viewer.steering import SIZE, choose, frame_of, numbers, point

pytestmark = [pytest.mark.slow, needs_chromium]


def kernels_drawn(browser: Browser) -> dict[str, tuple[npt.NDArray[np.float64], dict[str, float]]]:
    """The squares of weights as they stand on the screen, and the numbers below each of them."""
    browser.wait("document.querySelectorAll('.kernel').length && !document.querySelector('.kernel[aria-busy=true]')")
    found: dict[str, list[Any]] = browser.run(
        """Object.fromEntries([...document.querySelectorAll(".kernel")].map(one => {
          const cells = [...one.querySelectorAll("td")].map(cell => {
            const {x, y} = cell.getBoundingClientRect();
            return {x, y, exact: Number(cell.title), short: Number(cell.textContent)};
          });
          const further = [...one.querySelectorAll("[data-name]")];
          const read = further.map(cell => [cell.dataset.name, Number(cell.lastChild.textContent)]);
          return [one.dataset.kernel, [cells, Object.fromEntries(read)]];
        }))"""
    )
    drawn = {}
    for name, (cells, further) in found.items():
        cells = sorted(cells, key=lambda cell: (cell["y"], cell["x"]))  # by where they are, not by their order
        np.testing.assert_allclose([cell["short"] for cell in cells], [cell["exact"] for cell in cells], atol=6e-4)
        side = round(len(cells) ** 0.5)
        assert len({round(cell["y"]) for cell in cells}) == len({round(cell["x"]) for cell in cells}) == side
        drawn[name] = (np.array([cell["exact"] for cell in cells]).reshape(side, side), further)
    return drawn


def slanted_network(**choices: object) -> TemporalDenoiser:
    """A network whose kernels have no symmetry, and differ from pixel to pixel."""
    network = small_network(**choices)
    generator = torch.Generator().manual_seed(1)
    for head in network.prediction.heads.heads:
        head.bias.copy_(1.5 * torch.randn(head.bias.shape, generator=generator))
    return network


def test_the_kernel_under_the_pointer_makes_the_pixel_of_its_neighbours(
    browser: Browser, noisy_clip: Path, tmp_path: Path
) -> None:
    """A network of one scale without a history: the sum over the kernel as it is drawn is the number of its image."""
    network = slanted_network(channels=[4, 6], scales=1, temporal=False, feed_warped=False, demodulate=False)
    page = view([noisy_clip], {"net": network}, tmp_path / "out")
    browser.open(page)
    choose(browser, "#right", "net")
    browser.run("document.querySelector('#with-kernels').click()")
    for x, y in ((21, 17), (30, 8), (12, 33)):
        point(browser, SIZE, x, y)
        ((kernel, _),) = kernels_drawn(browser).values()
        color = Clip(noisy_clip).frame(frame_of(browser))["color"][0].astype(np.float64)
        around = color[:, y - 2 : y + 3, x - 2 : x + 3]
        image = numbers(browser)["net"]
        assert (kernel * around).sum((1, 2)) == pytest.approx(image, rel=2e-3)
        for wrong in (kernel.T, kernel[::-1], kernel[:, ::-1], kernel[::-1, ::-1]):  # the test would see them
            assert (wrong * around).sum((1, 2)) != pytest.approx(image, rel=2e-2)
    assert browser.errors == []


def test_the_kernels_of_every_scale_and_of_the_history_are_the_networks_own(
    browser: Browser, noisy_clip: Path, tmp_path: Path
) -> None:
    network = slanted_network()
    page = view([noisy_clip], {"net": network, "taa": load_denoiser("taa")}, tmp_path / "out")
    predicted: list[list[ScaleKernels]] = []
    handle = network.prediction.register_forward_hook(lambda module, given, made: predicted.append(made[0]))
    session = Session(network)
    for frame in Clip(noisy_clip):
        session.step(frame)
    handle.remove()
    browser.open(page)
    choose(browser, "#right", "net")
    browser.run("document.querySelector('#with-kernels').click()")
    browser.press("End")
    x, y = 37, 22  # the wall, which does not move: all of the history may be read
    point(browser, SIZE, x, y)
    drawn = kernels_drawn(browser)
    scales = predicted[frame_of(browser)]
    expected = {f"kernel{place} of net": scales[k].spatial for k, place in enumerate(("", " at 1/2", " at 1/4"))}
    expected["kernel of the history of net"] = scales[0].temporal
    assert drawn.keys() == expected.keys()
    for name, weights in expected.items():
        every = 2 ** {"kernel at 1/2 of net": 1, "kernel at 1/4 of net": 2}.get(name, 0)
        taps = np.asarray(weights)[0, :, y // every, x // every].astype(np.float64)
        square = (taps / taps.sum()).reshape(5, 5)
        assert abs(square - square.T).max() > 0.01
        np.testing.assert_allclose(drawn[name][0], square, rtol=1e-3, atol=1e-6)
    for k in (1, 2):
        alpha = float(np.asarray(scales[k].alpha)[0, 0, y >> k, x >> k])
        assert drawn[f"kernel at 1/{1 << k} of net"][1]["α"] == pytest.approx(alpha, rel=6e-3)
    browser.press("Home")
    browser.settle()
    chosen = data_of(page.read_text("utf-8"))["clips"][0]["chosen"]
    assert 0 < chosen < 4
    assert f"kept of frames {chosen} to 4 only" in browser.run("document.querySelector('.numbers').textContent")
    browser.run("[...document.querySelectorAll('.numbers button')].find(one => one.textContent === 'Go there').click()")
    browser.settle()
    assert frame_of(browser) == chosen
    choose(browser, "#right", "taa")
    assert "No image in sight is of a network" in browser.run("document.querySelector('.numbers').textContent")
    assert browser.errors == []
