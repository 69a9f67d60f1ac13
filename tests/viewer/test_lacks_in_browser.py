"""What is there is shown, and what is not is said: lost files, failed denoisers, long clips, browsers without WebGL."""

from pathlib import Path

import numpy as np
import pytest

from nte.denoiser import Denoiser, Noisy, Result, State
from nte.errors import NteError
from nte.evaluation.view import view
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.viewer.page import write_page
from nte.viewer.recorder import Layer, Recorder, Recording
from tests.synthetic import disc_clip
from tests.viewer.browser import Browser, needs_chromium
from tests.viewer.steering import choose, frame_of, numbers, point, slide

pytestmark = [pytest.mark.slow, needs_chromium]


class Fragile(Denoiser):
    """Returns the noisy image, but fails on images of another width than 56."""

    needs = ("color",)

    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        if frame.size[1] != 56:
            raise NteError("only 56 wide")
        return Result(frame["color"] * 1.0), ()


def test_a_file_that_is_lost_is_said_and_the_rest_goes_on(browser: Browser, noisy_clip: Path, tmp_path: Path) -> None:
    page = view([noisy_clip], {"taa": load_denoiser("taa")}, tmp_path / "out")
    (lost,) = (tmp_path / "out").glob("layers/disc/image_taa_color/0002.js")
    lost.unlink()
    browser.open(page)
    choose(browser, "#right", "taa")
    for _ in range(5):
        browser.press("ArrowRight")
        browser.settle()
        said = browser.run("[...document.querySelectorAll('.name')].some(n => n.textContent.includes('not there'))")
        assert said == (frame_of(browser) == 2)


def test_a_denoiser_that_failed_on_a_clip_is_said_there_and_shown_elsewhere(
    browser: Browser, noisy_clip: Path, tmp_path: Path
) -> None:
    other = disc_clip(tmp_path / "other", frames=2, size=(24, 30), seed=2, start=(10.0, 12.0))
    page = view([noisy_clip, other], {"fragile": Fragile(), "plain": Noisy()}, tmp_path / "out")
    browser.open(page)
    choose(browser, "#right", "fragile")
    choose(browser, "#clip", "other")
    assert "fragile failed: only 56 wide" in browser.run("document.querySelector('.notes').textContent")
    assert browser.run("[...document.querySelectorAll('.name')].map(n => n.textContent)") == ["noisy input", "plain"]
    assert "fragile" not in browser.run("[...document.querySelector('#right').options].map(o => o.text)")
    choose(browser, "#clip", "disc")
    assert browser.run("document.querySelector('.notes')") is None
    choose(browser, "#right", "fragile")
    assert browser.errors == []


def test_two_thousand_frames(browser: Browser, tmp_path: Path) -> None:
    recorder = Recorder(Recording(tmp_path / "layers"), "long", (6, 8), 2000, 1.0)
    for i in range(2000):
        recorder.add(i, Layer("image", "noisy input", "color"), np.full((3, 6, 8), i / 1000, np.float32))
    data = {"title": "long", "summary": "", "note": "", "notes": [], "clips": [recorder.entry()], "rows": []}
    browser.open(write_page(tmp_path, data | {"metrics": [], "tables": [], "about": []}))
    count = (
        "window.loaded = []; const take = nteLayer; nteLayer = (...given) => (loaded.push(given[0]), take(...given))"
    )
    browser.run(count)
    for key, index in (("End", 1999), ("ArrowLeft", 1998), ("Home", 0)):
        browser.press(key)
        browser.settle()
        assert frame_of(browser) == index
    slide(browser, "#frame", 1234)
    point(browser, (6, 8), 4, 3)
    assert numbers(browser)["noisy input"] == pytest.approx([float(np.float16(1.234))] * 3)
    assert browser.errors == []
    assert len(browser.run("loaded")) <= 6  # frames are loaded as they are needed, and those next to them


def test_a_browser_without_webgl_shows_the_same_and_says_so(noisy_clip: Path, tmp_path: Path) -> None:
    page = view([noisy_clip], {"taa": load_denoiser("taa")}, tmp_path / "out")
    browser = Browser(tmp_path / "profile", "--disable-3d-apis")
    try:
        browser.size(700, 900)
        browser.open(page)
        assert browser.run("document.createElement('canvas').getContext('webgl2')") is None
        assert "This browser has no WebGL 2" in browser.run("document.querySelector('#no-webgl').textContent")
        colours = "new Set(new Uint32Array(document.querySelector('#canvas').getContext('2d')"
        assert browser.run(f"{colours}.getImageData(0, 0, 600, 400).data.buffer)).size") > 500
    finally:
        browser.close()
