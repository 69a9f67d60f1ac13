"""The viewer in a real browser, from disk: what is seen is what the files hold, and every control does what it says."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from nte.evaluation.evaluate import evaluate
from nte.evaluation.view import view
from nte.frames.clip import Clip
from nte.frames.show import heat, show
from nte.registry import load_denoiser
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import disc_clip, write_clip
from tests.viewer.browser import Browser, needs_chromium
from tests.viewer.reading import data_of, layer_of, pixels_of
from tests.viewer.steering import (
    SIZE,
    WINDOW,
    choose,
    colour_at,
    displayed,
    drawn,
    frame_of,
    numbers,
    pixels_seen,
    place_of,
    point,
    seen,
    slide,
    window_at,
)  # fmt: skip

pytestmark = [pytest.mark.slow, needs_chromium]

NASTY = "<b>x&y"
SOME = (21, 17)  # a pixel, x and y
LABEL = (slice(0, 5), slice(0, 30))  # rows and columns that the image's name covers


@pytest.fixture(scope="module")
def page(noisy_clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clips of different sizes with two denoisers; the second has no reference."""
    other = disc_clip(tmp_path_factory.mktemp("other") / NASTY, frames=2, size=(24, 30), seed=2, start=(10.0, 12.0))
    denoisers = {spec: load_denoiser(spec) for spec in ("taa", "svgf")}
    return view([noisy_clip, other], denoisers, tmp_path_factory.mktemp("view") / "out")


RESET = """
  for (const box of document.querySelectorAll("input[type=checkbox]:checked")) box.click();
  const choose = (menu, text) => {
    menu.value = [...menu.options].find(option => option.text === text).value;
    menu.dispatchEvent(new Event("change", {bubbles: true}));
  };
  choose(document.querySelector("#clip"), "disc");
  choose(document.querySelector("#left"), "noisy input");
  choose(document.querySelector("#right"), "taa");
  for (const key of ["s", "v", "\\\\", "0", "Home"]) {
    document.body.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true}));
  }
"""


@pytest.fixture(scope="module")
def loaded(browser: Browser, page: Path) -> Browser:
    browser.open(page)
    return browser


@pytest.fixture
def opened(loaded: Browser, page: Path) -> Iterator[Browser]:
    """The page with what is chosen at first; afterwards, nothing was complained about."""
    if loaded.run("location.href") != page.as_uri():
        loaded.open(page)
    loaded.run(f"(() => {{ {RESET} }})()")
    loaded.settle()
    yield loaded
    assert loaded.errors == []
    loaded.size(*WINDOW)


def test_the_number_under_the_pointer_is_the_files(opened: Browser, noisy_clip: Path) -> None:
    x, y = SOME
    opened.run("document.querySelector('.numbers input').click()")  # every channel
    for index in (0, 3):
        opened.press("Home")
        for _ in range(index):
            opened.press("ArrowRight")
        point(opened, SIZE, x, y)
        opened.settle()
        assert opened.run("document.querySelector('#pixel').textContent") == f"x {x}, y {y}"
        frame, found = Clip(noisy_clip).frame(index), numbers(opened)
        for name, title in (("color", "noisy input"), ("reference", "reference"), ("albedo", "albedo")):
            expected = frame[name][0, :, y, x].astype(np.float16).astype(float)
            assert found[title] == pytest.approx(expected.tolist(), rel=1e-5), name
        for name in ("depth", "motion", "forward_motion", "instance"):
            assert found[name] == pytest.approx(frame[name][0, :, y, x].tolist(), rel=1e-5), name


def test_the_pixel_is_where_the_pointer_is_and_has_its_colour(opened: Browser, noisy_clip: Path) -> None:
    """Numbers and picture are of one place: the colours of many pixels are those of the file, displayed."""
    opened.press("f")  # the left image alone
    opened.settle()
    picture = pixels_seen(opened, SIZE)
    index = frame_of(opened)
    expected = displayed(noisy_clip, Clip(noisy_clip).frame(index)["color"][0].astype(np.float16))
    for part in (picture, expected):
        part[:, *LABEL] = 0
    np.testing.assert_allclose(picture, expected, atol=1.1 / 255)


def test_the_split_moves(opened: Browser, noisy_clip: Path, page: Path) -> None:
    box = opened.box("#canvas")
    size = SIZE
    choose(opened, "#right", "reference")
    index = frame_of(opened)
    left = displayed(noisy_clip, pixels_of(page, index, "image", "noisy input"))
    right = displayed(noisy_clip, pixels_of(page, index, "image", "reference"))
    middle = box["x"] + box["width"] / 2
    height = box["y"] + 40
    for target, expected in ((0.9, left), (0.1, right)):
        opened.mouse("press", middle, height)
        opened.settle()  # drawn anew meanwhile, as whoever drags sees it
        for share in (0.5, target):
            opened.mouse("move", box["x"] + share * box["width"], height, held=True)
            opened.settle()
        opened.mouse("release", box["x"] + target * box["width"], height)
        opened.settle()
        middle = box["x"] + target * box["width"]
        np.testing.assert_allclose(colour_at(opened, size, 25, 17), expected[:, 17, 25], atol=1.1 / 255)
    opened.press(".")
    assert opened.box(".divider")["x"] == pytest.approx(box["x"] + 0.15 * box["width"], abs=8)


def test_the_exposure_slider_changes_pixels(opened: Browser, noisy_clip: Path) -> None:
    opened.press("f")
    index = frame_of(opened)
    color = Clip(noisy_clip).frame(index)["color"][0].astype(np.float16)
    x, y = SOME
    before = colour_at(opened, SIZE, x, y)
    for stops in (2.0, -3.0):
        slide(opened, "#exposure", stops)
        np.testing.assert_allclose(
            colour_at(opened, SIZE, x, y), displayed(noisy_clip, color, stops)[:, y, x], atol=1.1 / 255
        )
    opened.press("\\")
    opened.settle()
    np.testing.assert_array_equal(colour_at(opened, SIZE, x, y), before)
    opened.press("]")
    opened.settle()
    expected = displayed(noisy_clip, color, 0.5)[:, y, x]
    np.testing.assert_allclose(colour_at(opened, SIZE, x, y), expected, atol=1.1 / 255)


def test_keys_choose_frames_and_images(opened: Browser) -> None:
    opened.press("Home")
    opened.settle()
    assert frame_of(opened) == 0
    opened.press("ArrowLeft")
    opened.settle()
    assert frame_of(opened) == 4  # around the end
    opened.press("ArrowRight")
    opened.press("ArrowRight")
    opened.settle()
    assert frame_of(opened) == 1
    names = "[...document.querySelectorAll('.name')].map(name => name.textContent)"
    opened.press("1", "Digit1")
    opened.press("@", "Digit2", shift=True)
    opened.settle()
    assert opened.run(names) == ["svgf", "taa"]
    opened.press("b")
    opened.settle()
    assert opened.run(names) == ["svgf", "taa"]
    opened.press("a")
    opened.settle()
    assert opened.run(names) == ["taa", "svgf", "noisy input", "reference"]
    opened.press("m")
    opened.settle()
    assert opened.run(names) == ["FLIP of taa", "FLIP of svgf"]
    opened.press("e")
    opened.settle()
    assert opened.run(names) == ["taa − reference", "svgf − reference", "noisy input − reference"]
    opened.press("d")
    opened.settle()
    assert opened.run(names) == ["svgf − taa"]
    # A key that is meant for a menu does nothing to the page.
    opened.run("document.querySelector('#left').focus()")
    opened.press("ArrowRight")
    opened.settle()
    assert frame_of(opened) == 1


def test_playing_advances_with_all_images_in_step(opened: Browser, page: Path, noisy_clip: Path) -> None:
    opened.press("a")
    opened.press("Home")
    opened.settle()
    opened.run("window.seen = []")
    opened.run(
        "new MutationObserver(() => seen.push(+document.querySelector('#canvas').dataset.frame))"
        ".observe(document.querySelector('#canvas'), {attributeFilter: ['data-frame']})"
    )
    opened.press(" ", "Space")
    opened.wait("new Set(seen).size === 5 && seen.at(-1) < 4")  # all frames, and again from the first
    assert opened.run("document.querySelector('#play').textContent") == "Stop"
    opened.press(" ", "Space")
    opened.settle()
    steps = np.diff(opened.run("seen"))
    assert set(steps.tolist()) <= {0, 1, -4}  # none is left out
    stopped = frame_of(opened)
    opened.run("new Promise(done => setTimeout(done, 400))")
    assert frame_of(opened) == stopped
    # The panes show the frame that the page says.
    picture = seen(opened)
    height, width = ((length - 4) // 2 for length in picture.shape[1:])
    row, column = place_of((height, width), SIZE, *SOME)
    x, y = SOME
    for corner, name in (((0, 0), "taa"), ((0, width + 4), "svgf"), ((height + 4, 0), "noisy input")):
        expected = displayed(noisy_clip, pixels_of(page, stopped, "image", name))[:, y, x]
        found = picture[:, corner[0] + row, corner[1] + column]
        np.testing.assert_allclose(found, expected, atol=1.1 / 255)


def test_zoom_keeps_the_pixel_under_the_pointer(opened: Browser) -> None:
    x, y = SOME
    point(opened, SIZE, x, y)
    column, row = window_at(opened, SIZE, x, y)
    for delta in (-240, -240, 240):
        opened.mouse("wheel", column, row, deltaX=0, deltaY=delta)
        opened.settle()
        opened.mouse("move", column + 1, row)
        opened.settle()
        assert opened.run("document.querySelector('#pixel').textContent") == f"x {x}, y {y}"
    opened.press("0")
    opened.settle()
    point(opened, SIZE, 0, 0)
    assert opened.run("document.querySelector('#pixel').textContent") == "x 0, y 0"


def test_two_sides_show_the_same_place_at_any_zoom(opened: Browser) -> None:
    opened.press("b")
    choose(opened, "#right", "noisy input")
    opened.settle()
    box = opened.box("#canvas")
    width = (drawn(opened).shape[2] - 4) // 2
    assert opened.run("document.querySelector('#canvas').width") == box["width"]  # so that nothing is blurred
    for delta in (-480, -300, 120):
        opened.mouse("wheel", box["x"] + 0.7 * width, box["y"] + 0.3 * box["height"], deltaX=0, deltaY=delta)
        opened.settle()
        picture = drawn(opened)
        np.testing.assert_array_equal(picture[:, :, :width], picture[:, :, width + 4 : 2 * width + 4])
        assert picture.std() > 0.05
    x, y = box["x"] + 0.7 * width, box["y"] + 0.3 * box["height"]
    opened.mouse("move", x, y)
    opened.settle()
    spot = opened.run("document.querySelector('#pixel').textContent")
    opened.mouse("move", x + width + 4, y)
    opened.settle()
    assert opened.run("document.querySelector('#pixel').textContent") == spot


def test_flip_changes_between_the_two(opened: Browser, noisy_clip: Path, page: Path) -> None:
    index = frame_of(opened)
    x, y = SOME
    opened.press("f")
    for name in ("noisy input", "taa", "noisy input"):
        opened.settle()
        expected = displayed(noisy_clip, pixels_of(page, index, "image", name))[:, y, x]
        np.testing.assert_allclose(colour_at(opened, SIZE, x, y), expected, atol=1.1 / 255)
        opened.press("f")


@pytest.mark.parametrize(
    "name",
    [
        "albedo", "normal", "depth", "instance", "motion", "history_length of svgf", "alpha of svgf", "disoccluded",
        "FLIP of taa", "reference",
    ],
)  # fmt: skip
def test_every_kind_of_layer_looks_the_same_without_webgl_and_as_in_python(
    browser: Browser, page: Path, noisy_clip: Path, name: str
) -> None:
    pictures = []
    for fragment in ("", "#2d"):
        browser.open(page, fragment)
        browser.press("f")
        choose(browser, "#left", name)
        pictures.append(pixels_seen(browser, SIZE))
        assert browser.run("document.querySelector('#no-webgl') !== null") == (fragment == "#2d")
        index = frame_of(browser)
        assert browser.errors == []
    if name in ("albedo", "normal", "depth", "motion"):
        data = data_of(page.read_text("utf-8"))
        scale = layer_of(data, "channel", name, name)["scale"]
        pictures.append(show(name, Clip(noisy_clip).frame(index)[name][0], scale=scale).pixels.transpose(2, 0, 1) / 255)
    elif name.startswith("FLIP"):
        pictures.append(heat(pixels_of(page, index, "flip", "taa")[0] / np.float32(255), "magma"))
    for picture in pictures:
        picture[:, *LABEL] = 0
    for other in pictures[1:]:
        np.testing.assert_allclose(other, pictures[0], atol=1.6 / 255)


def test_differences_and_signed_errors_are_those_of_what_is_displayed(
    opened: Browser, page: Path, noisy_clip: Path
) -> None:
    index = frame_of(opened)
    x, y = SOME
    choose(opened, "#left", "noisy input")
    choose(opened, "#right", "taa")
    opened.press("d")
    opened.settle()
    ours, theirs, truth = (
        displayed(noisy_clip, pixels_of(page, index, "image", name))[:, y, x]
        for name in ("noisy input", "taa", "reference")
    )
    expected = np.clip(np.abs(ours - theirs) * 4, 0, 1)
    np.testing.assert_allclose(colour_at(opened, SIZE, x, y), expected, atol=4 / 255)
    opened.press("f")
    opened.press("e")
    opened.settle()
    error = float((ours - truth).mean()) * 4
    far = np.array([0.86, 0.16, 0.11] if error > 0 else [0.1, 0.38, 0.9])
    expected = 0.07 + (far - 0.07) * min(abs(error), 1)
    np.testing.assert_allclose(colour_at(opened, SIZE, x, y), expected, atol=4 / 255)


def test_arrows_point_where_the_vectors_do(opened: Browser) -> None:
    """The disc moves 3.5 px to the right, so its vectors point to the left: white lines lie to the left of the dots."""
    opened.press("End")
    opened.press("f")
    opened.settle()
    before = seen(opened)
    opened.press("w")
    opened.settle()
    changed = np.abs(seen(opened) - before).max(0) > 0.02
    assert changed.any()
    opened.press("w")
    opened.settle()
    assert not (np.abs(seen(opened) - before).max(0) > 0.02).any()
    row, column = place_of(changed.shape, SIZE, 16 + 14, 20)  # the disc's centre in frame 4
    window = changed[row - 60 : row + 60, column - 60 : column + 60]
    rows, columns = window.sum(1).max(), window.sum(0).max()
    assert rows > 2 * columns  # horizontal strokes


def test_a_clip_of_another_size_is_shown_and_its_lack_is_said(opened: Browser) -> None:
    choose(opened, "#clip", NASTY)
    assert opened.run("document.querySelector('h1').textContent").endswith(NASTY)
    point(opened, (24, 30), 29, 23)
    assert opened.run("document.querySelector('#pixel').textContent") == "x 29, y 23"
    assert frame_of(opened) < 2
    assert opened.run("document.querySelectorAll('#app b').length") == 1  # that of the pixel, none from a name


def test_tables_sort(opened: Browser) -> None:
    names = "[...document.querySelectorAll('#means tbody th')].map(cell => cell.textContent)"
    values = "[...document.querySelectorAll('#means tbody tr')].map(row => parseFloat(row.children[1].textContent))"
    typed = opened.run(names)
    assert typed == ["taa", "svgf"]
    click = "[...document.querySelectorAll('#means thead button')].find(b => b.textContent.startsWith('PSNR')).click()"
    opened.run(click)
    opened.settle()
    assert opened.run(values) == sorted(opened.run(values), reverse=True)
    opened.run(click)
    opened.settle()
    assert opened.run(values) == sorted(opened.run(values))
    assert opened.run("document.querySelector('#means [aria-sort=ascending]').textContent").startswith("PSNR")


def test_curves_mark_frames_and_lead_to_them(opened: Browser) -> None:
    opened.run("document.querySelector('[data-metric=psnr]').scrollIntoView({block: 'center'})")
    box = opened.box("[data-metric=psnr] .u-over")
    opened.mouse("move", box["x"] + box["width"] - 2, box["y"] + 40)
    opened.settle()
    read = "document.querySelector('[data-metric={}] .read').textContent"
    last = opened.run(read.format("psnr"))
    opened.mouse("press", box["x"] + box["width"] - 2, box["y"] + 40)
    opened.mouse("release", box["x"] + box["width"] - 2, box["y"] + 40)
    opened.settle()
    assert frame_of(opened) == 4
    opened.mouse("move", box["x"] + 2, box["y"] + 40)
    opened.settle()
    assert opened.run(read.format("psnr")) != last
    assert opened.run("document.querySelectorAll('.scatter circle').length") == 2


@pytest.mark.parametrize("dark", [False, True])
def test_the_page_fits_800_pixels_in_light_and_dark(opened: Browser, dark: bool) -> None:
    opened.size(800, 900)
    opened.dark(dark)
    opened.settle()
    assert opened.run("document.documentElement.scrollWidth") <= 800
    background = opened.run("getComputedStyle(document.body).backgroundColor")
    level = sum(int(part) for part in background.strip("rgb()").split(",")) / 3
    assert (level < 60) == dark
    opened.dark(False)


def test_the_report_of_an_evaluation_opens_and_says_its_numbers(
    browser: Browser, noisy_clip: Path, tmp_path: Path
) -> None:
    other = write_clip(tmp_path / "clips" / "two", noisy_frames(3, seed=5, size=(30, 44)))
    found = evaluate(
        [noisy_clip, other], {NASTY: load_denoiser("taa"), "noisy": load_denoiser("noisy")}, tmp_path / "out"
    )
    browser.open(tmp_path / "out" / "index.html")
    browser.settle()
    cells = browser.run("[...document.querySelectorAll('#means tbody td:nth-child(2)')].map(c => c.textContent)")
    means = found.metrics["means"]
    assert [float(cell[:5]) for cell in cells] == [pytest.approx(mean["psnr"], abs=0.006) for mean in means.values()]
    assert all("…" in cell for cell in cells)
    assert browser.run("document.querySelector('#means tbody th').textContent") == NASTY
    assert browser.run("[...document.querySelectorAll('.name')].map(n => n.textContent)")[1] in (NASTY, "noisy")
    browser.press("ArrowRight")
    browser.settle()
    assert browser.errors == []


def test_the_values_of_many_denoisers_fit_800_pixels(browser: Browser, noisy_clip: Path, tmp_path: Path) -> None:
    many = {f"denoiser {number}": load_denoiser("noisy") for number in range(12)}
    browser.open(view([noisy_clip], many, tmp_path / "out"))
    browser.size(800, 900)
    browser.settle()
    assert browser.run("document.querySelector('[data-metric=psnr] .read').children.length") == 12
    assert browser.run("document.documentElement.scrollWidth") <= 800
    browser.size(*WINDOW)
