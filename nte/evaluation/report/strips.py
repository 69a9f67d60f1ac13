"""Picture strips as papers print them: reference and methods side by side, with a crop of each below."""

from pathlib import Path

import numpy as np

from nte.evaluation.score_clip import Shown
from nte.evaluation.targets import BRIGHTENED
from nte.files import make_folder
from nte.frames.show import RGB, Picture, grid, write_png

_CROP = 4  # a crop's side is this part of the picture's


def write_strips(shown: list[Shown], folder: Path) -> list[Path]:
    """Write a PNG for each clip and light: <clip>_<light>.png, the report's frame."""
    make_folder(folder)
    written = []
    for one in shown:
        path = folder / f"{one.clip.replace('/', '_')}_{one.target}.png"
        write_png(path, strip(one))
        written.append(path)
    return written


def strip(shown: Shown) -> RGB:
    """Reference, noisy input and each output, (H, W, 3) in all; below each its part where outputs differ most.

    The crop is chosen by the outputs alone, so that nobody picks the place that flatters a method.
    """
    images = {name: shown.images[name] for name in ("reference", *shown.images)}  # the reference comes first
    corner, size = most_different([shown.images[spec] for spec in shown.flip])
    rows, columns = (slice(start, start + length) for start, length in zip(corner, size, strict=True))
    place = f"x {corner[1]}, y {corner[0]}, frame {shown.frame}"
    brightened = BRIGHTENED.get(shown.target)
    note = f"{shown.target}, {brightened:g} times as bright" if brightened else shown.target
    whole = [Picture(name, pixels, note) for name, pixels in images.items()]
    # As large as the pictures, so that the sheet shows both rows at the same width.
    crops = [Picture("", pixels[rows, columns].repeat(_CROP, 0).repeat(_CROP, 1), place) for pixels in images.values()]
    return grid([*whole, *crops], columns=len(images))


def most_different(images: list[RGB]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Corner (row, column) and size (rows, columns) of the window in which the images vary most among each other."""
    stack = np.stack(images).astype(np.float32)
    spread = stack.std(0).sum(-1)
    height, width = spread.shape
    rows, columns = max(1, height // _CROP), max(1, width // _CROP)
    # Sums over every window from a summed-area table.
    table = np.pad(spread, ((1, 0), (1, 0))).cumsum(0, dtype=np.float64).cumsum(1)
    sums = table[rows:, columns:] - table[:-rows, columns:] - table[rows:, :-columns] + table[:-rows, :-columns]
    row, column = np.unravel_index(int(sums.argmax()), sums.shape)
    return (int(row), int(column)), (rows, columns)
