"""Picture strips as papers print them: reference and methods side by side, with a crop of each below."""

from pathlib import Path

import numpy as np

from nte.evaluation.score_clip import Shown
from nte.files import make_folder
from nte.frames.show import RGB, Picture, grid, write_png
from nte.viewer.recorder import BRIGHTENED

_CROP = 4  # a crop's side is one part in so many of the picture's


def write_strips(shown: list[Shown], folder: Path) -> list[Path]:
    """Write a strip as PNG for each clip and light, <clip>_<light>.png in `folder`; return the files.

    A missing folder is made. Raises NteError if a file cannot be written.
    """
    make_folder(folder)
    written = []
    for one in shown:
        path = folder / f"{one.clip.replace('/', '_')}_{one.target}.png"
        write_png(path, strip(one))
        written.append(path)
    return written


def strip(shown: Shown) -> RGB:
    """Draw reference, noisy input and each output side by side, with a crop below each, as one (H, W, 3) uint8.

    The crop shows the place where the outputs differ most, so that nobody picks a place that flatters a method.
    """
    images = {name: shown.images[name] for name in ("reference", *shown.images)}  # the reference comes first
    corner, size = most_different([shown.images[spec] for spec in shown.flip])
    rows, columns = (slice(start, start + length) for start, length in zip(corner, size, strict=True))
    place = f"x {corner[1]}, y {corner[0]}, frame {shown.frame}"
    brightened = BRIGHTENED.get(shown.target)
    note = f"{shown.target}, {brightened:g} times as bright" if brightened else shown.target
    whole = [Picture(name, pixels, note) for name, pixels in images.items()]
    # Crops are enlarged to the pictures' size, so that the sheet shows both rows at the same width.
    crops = [Picture("", pixels[rows, columns].repeat(_CROP, 0).repeat(_CROP, 1), place) for pixels in images.values()]
    return grid([*whole, *crops], columns=len(images))


def most_different(images: list[RGB]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Find the window in which the images (H, W, 3) differ most from each other; its side is a quarter of theirs.

    Returns its corner (row, column) and its size (rows, columns).
    """
    stack = np.stack(images).astype(np.float32)
    spread = stack.std(0).sum(-1)
    height, width = spread.shape
    rows, columns = max(1, height // _CROP), max(1, width // _CROP)
    # Sums over every window from a summed-area table.
    table = np.pad(spread, ((1, 0), (1, 0))).cumsum(0, dtype=np.float64).cumsum(1)
    sums = table[rows:, columns:] - table[:-rows, columns:] - table[rows:, :-columns] + table[:-rows, :-columns]
    row, column = np.unravel_index(int(sums.argmax()), sums.shape)
    return (int(row), int(column)), (rows, columns)
