"""What a reader does to the viewer's page, and what they see of it."""

import base64
import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from nte.frames.clip import Clip
from nte.frames.show import display
from nte.viewer.recorder import exposure_of
from tests.viewer.browser import Browser

WINDOW = (500, 700)  # small: the graphics card is a program here
SIZE = (40, 56)  # height and width of the fixture noisy_clip


def choose(browser: Browser, selector: str, text: str) -> None:
    """Choose an option of a menu by its text."""
    browser.run(
        f"""(() => {{
          const menu = document.querySelector({selector!r});
          menu.value = [...menu.options].find(option => option.text === {text!r}).value;
          menu.dispatchEvent(new Event("change", {{bubbles: true}}));
        }})()"""
    )
    browser.settle()


def slide(browser: Browser, selector: str, value: float) -> None:
    browser.run(
        f"""(() => {{
          const slider = document.querySelector({selector!r});
          slider.value = {value};
          slider.dispatchEvent(new Event("input", {{bubbles: true}}));
        }})()"""
    )
    browser.settle()


def seen(browser: Browser) -> npt.NDArray[np.float32]:
    """What the canvas shows, (3, H, W) in [0, 1]."""
    browser.mouse("move", 2, 2)
    image = Image.open(io.BytesIO(browser.picture("#canvas"))).convert("RGB")
    return (np.asarray(image, np.float32) / 255).transpose(2, 0, 1)


def drawn(browser: Browser) -> npt.NDArray[np.float32]:
    """What was drawn on the canvas, without what lies above it, (3, H, W) in [0, 1]."""
    url: str = browser.run("document.querySelector('#canvas').toDataURL()")
    image = Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB")
    return (np.asarray(image, np.float32) / 255).transpose(2, 0, 1)


def place_of(
    room: tuple[float, float], size: tuple[int, int], x: npt.ArrayLike, y: npt.ArrayLike
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Row and column of the middle of an image pixel, while the whole image (height, width) is seen in a pane."""
    zoom = int(min(room[1] / size[1], room[0] / size[0]))
    top, left = ((r - zoom * s) / 2 for r, s in zip(room, size, strict=True))
    at = [np.floor(start + (np.asarray(i) + 0.5) * zoom).astype(int) for start, i in ((top, y), (left, x))]
    return at[0], at[1]


def pixels_seen(browser: Browser, size: tuple[int, int]) -> npt.NDArray[np.float32]:
    """The colours (3, H, W) that the canvas shows of every pixel of an image (height, width)."""
    picture = seen(browser)
    y, x = np.mgrid[: size[0], : size[1]]
    rows, columns = place_of(picture.shape[1:], size, x, y)
    return picture[:, rows, columns]


def colour_at(browser: Browser, size: tuple[int, int], x: int, y: int) -> npt.NDArray[np.float32]:
    return pixels_seen(browser, size)[:, y, x]


def window_at(browser: Browser, size: tuple[int, int], x: int, y: int) -> tuple[float, float]:
    """Where the middle of an image pixel lies in the window."""
    box = browser.box("#canvas")
    row, column = place_of((box["height"], box["width"]), size, x, y)
    return box["x"] + float(column), box["y"] + float(row)


def point(browser: Browser, size: tuple[int, int], x: int, y: int) -> None:
    browser.mouse("move", *window_at(browser, size, x, y))
    browser.settle()


def numbers(browser: Browser) -> dict[str, list[float]]:
    """The table of numbers, as soon as all of them have come: layer → values."""
    browser.wait("!document.querySelector('.numbers').textContent.includes('…')")
    rows: dict[str, list[str]] = browser.run(
        """Object.fromEntries([...document.querySelectorAll(".numbers tr")].map(row =>
          [row.dataset.layer, [...row.querySelectorAll("td:not(.unit)")].map(cell => cell.lastChild.textContent)]))"""
    )
    known = {name: texts for name, texts in rows.items() if "–" not in texts}  # those of this frame
    return {name: [float(text.replace("−", "-")) for text in texts] for name, texts in known.items()}


def frame_of(browser: Browser) -> int:
    return int(browser.run("document.querySelector('#canvas').dataset.frame"))


def displayed(clip: Path, values: npt.NDArray[Any], stops: float = 0.0) -> npt.NDArray[np.float32]:
    return display(np.asarray(values, np.float32), exposure_of(Clip(clip)) * 2**stops).astype(np.float32)
