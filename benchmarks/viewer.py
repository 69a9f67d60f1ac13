"""How a long clip of large frames feels in the viewer: python -m benchmarks.viewer [options]

A page of a disc that moves before a wall, noisy and as denoisers give it, is opened in a headless Chromium that draws
without a GPU. Printed are the size of the page, the time until its first picture, that of a jump to a frame that is not
loaded and of a step to one that is, frames per second while playing two images, the longest time for which the page
answered nothing meanwhile, and the memory of the page's script. Returns 1 if playing leaves frames out.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.command import count, make_parser, run
from nte.cli.parsing import parse_size
from nte.evaluation.view import view
from nte.registry import load_denoiser
from nte.viewer.page import size_of
from tests.synthetic import disc_frame, write_clip
from tests.viewer.browser import Browser

PLAYED = 10.0  # seconds
# The browser's own clock tells when frames are drawn, and how long a timer of 20 ms had to wait.
WATCH = """
window.seen = [], window.waits = [];
new MutationObserver(() => seen.push(+document.querySelector('#canvas').dataset.frame))
    .observe(document.querySelector('#canvas'), {attributeFilter: ['data-frame']});
let before = performance.now();
setInterval(() => { const now = performance.now(); waits.push(now - before - 20); before = now; }, 20);
"""


def _milliseconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - start)


def _key(browser: Browser, key: str) -> None:
    browser.press(key)
    browser.settle()


def main(arguments: Sequence[str]) -> int:
    """Print what was measured."""
    parser = make_parser(__doc__)
    parser.add_argument("--size", type=parse_size, default=(720, 1280), metavar="WIDTHxHEIGHT")
    parser.add_argument("--frames", type=count, default=60)
    parser.add_argument("--denoisers", nargs="+", default=["taa"])
    options = parser.parse_args(arguments)
    rng, (height, width) = np.random.default_rng(0), options.size
    with TemporaryDirectory() as name:
        folder = Path(name)
        disc = {"start": (width / 4, height / 2), "radius": height / 4}
        frames = [disc_frame(index, (height, width), rng=rng, **disc) for index in range(options.frames)]
        clip = write_clip(folder / "disc", frames)
        channels = ("albedo", "motion", "depth")
        page = view([clip], {spec: load_denoiser(spec) for spec in options.denoisers}, folder / "page", None, channels)
        print(f"page of {options.frames} frames of {width}x{height}: {size_of(page.parent) / 1e6:.0f} MB")
        browser = Browser(folder / "profile", "--enable-precise-memory-info")
        try:
            print(f"first picture {_milliseconds(lambda: browser.open(page)):.0f} ms")
            print(f"jump to the last frame {_milliseconds(lambda: _key(browser, 'End')):.0f} ms")
            _key(browser, "Home")
            _key(browser, "ArrowRight")
            print(f"step back to a frame that is loaded {_milliseconds(lambda: _key(browser, 'ArrowLeft')):.0f} ms")
            browser.run(f"(() => {{{WATCH}}})()")
            browser.press(" ", "Space")
            browser.run(f"new Promise(done => setTimeout(done, {1e3 * PLAYED}))")
            browser.press(" ", "Space")
            seen, waits = browser.run("seen"), browser.run("waits")
            browser.settle()
            memory = browser.run("performance.memory.usedJSHeapSize") / 1e6
        finally:
            browser.close()
    steps = np.diff(seen)
    left_out = int(((steps > 1) | ((steps < 0) & (steps != 1 - options.frames))).sum())
    print(
        f"playing: {len(seen) / PLAYED:.1f} frames per second, {left_out} left out; the page answered within "
        f"{max(waits):.0f} ms, in the mean {np.mean(waits):.0f}; script's memory {memory:.0f} MB"
    )
    print(f"errors: {browser.errors or 'none'}")
    return int(left_out > 0 or bool(browser.errors))


if __name__ == "__main__":
    run(main)
