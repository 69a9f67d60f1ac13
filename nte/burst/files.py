"""The merge of a burst's files into one picture, for `nte merge-burst`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from nte.burst.defects import find_defects
from nte.burst.merge import RADII, Merged, merge_burst
from nte.burst.noise import NoiseModel, fit_noise
from nte.burst.pictures import SUFFIXES, read_picture, write_picture
from nte.burst.raw import Raw, develop, read_raw
from nte.errors import NteError
from nte.files import already_there

_SMALLEST = 64  # px along each axis; the search needs patches to compare


@dataclass(frozen=True)
class Summary:
    """The result of a merge: the noise model, the picture, and how each file was used."""

    noise: NoiseModel
    merged: Merged
    others: list[Path]  # files other than the reference, in the order of merged.frames
    defects: int  # number of hot or dead pixels that were found on the sensor


def merge_files(
    files: Sequence[Path],
    out: Path,
    reference: int = 1,
    noise: NoiseModel | None = None,
    radii: tuple[int, ...] = RADII,
    force: bool = False,
    reach: Callable[[int], object] = lambda done: None,
    brightness: float = 0.0,
    bits: int = 16,
    keep_defects: bool = False,
) -> Summary:
    """Merge raw photographs, or pictures (.exr, .png, .tif), and write one picture: .exr (linear), .png or .tif.

    reference: number of the file to which the others are aligned, counted from 1. noise: None fits the model to the
    reference and a neighbour. radii: patch radii of the search, finest level first. reach: called after each frame
    with the number of frames done. brightness: stops, added to those that the file asks for. bits: 8 or 16, for a .png
    or .tif. keep_defects: treat hot and dead pixels of the sensor as part of the scene. Only one frame besides the
    reference is in memory at a time. Raises NteError for files that do not go together, and for an `out` that exists
    without `force`.
    """
    pictures = _check(files, out, reference, force)
    first = files[reference - 1]
    others = [path for number, path in enumerate(files, 1) if number != reference]
    raw = None if pictures else read_raw(first)
    mosaic = raw.mosaic if raw else None
    base = _tensor(read_picture(first)) if raw is None else _tensor(raw.values[None])
    if min(base.shape[-2:]) < _SMALLEST:
        raise NteError(f"{first}: is {_size(base)}: expected at least {_SMALLEST} pixels along each side")
    clips = first.suffix.lower() != ".exr"
    unit = 1.0 if clips else _unit(base)
    base = base / unit
    neighbour = others[min(reference - 1, len(others) - 1)]

    def read(path: Path) -> Tensor:
        return _read(path, base, first, raw) / unit

    second = read(neighbour) if noise is None or (raw and not keep_defects) else base
    fitted = fit_noise(base, second, mosaic, clips) if noise is None else noise.scaled(1 / unit)
    defects = find_defects(base, second, fitted, mosaic) if raw and not keep_defects else None
    merged = merge_burst(base, map(read, others), fitted, mosaic, radii, reach, clips, defects)
    merged = merged._replace(image=merged.image * unit)
    pixels = merged.image[0].numpy()
    stops = brightness + (raw.brightness if raw else 0.0)
    picture = pixels if pictures else develop(first, pixels[0])
    write_picture(out, picture * np.float32(2.0**stops), bits)
    return Summary(fitted.scaled(unit), merged, others, 0 if defects is None else int(defects.sum()))


def _check(files: Sequence[Path], out: Path, reference: int, force: bool) -> bool:
    """Check all that can be checked without reading; true if the files are pictures, false if they are raw."""
    if len(files) < 2:
        raise NteError(f"a burst of {len(files)} file: expected at least two photographs of one scene")
    seen: dict[Path, Path] = {}
    for path in files:
        if path.resolve() in seen:
            raise NteError(f"{path}: is given twice: its noise would be averaged with itself; leave one out")
        seen[path.resolve()] = path
    if not 1 <= reference <= len(files):
        raise NteError(f"--reference {reference}: expected the number of a file, from 1 to {len(files)}")
    if out.suffix.lower() not in SUFFIXES:
        raise NteError(f"{out}: expected a name that ends in .exr (linear), .png or .tif (as displayed)")
    if out.resolve() in seen:
        raise NteError(f"{out}: is a file of the burst: choose another name")
    if out.exists() and not force:
        raise already_there(out)
    kinds = [path.suffix.lower() if path.suffix.lower() in SUFFIXES else "raw" for path in files]
    for path, kind in zip(files, kinds, strict=True):
        if kind != kinds[0]:
            raise NteError(f"{path}: is {kind}, {files[0]} is {kinds[0]}: expected files of one kind")
    return kinds[0] != "raw"


def _read(path: Path, base: Tensor, first: Path, camera: Raw | None) -> Tensor:
    """Read another frame of the burst (1, C, H, W); raises NteError if it does not match the reference."""
    if camera is None:
        frame = _tensor(read_picture(path))
    else:
        raw = read_raw(path)
        frame = _tensor(raw.values[None])
        if raw.mosaic != camera.mosaic or not np.allclose(raw.camera, camera.camera, rtol=1e-4):
            raise NteError(f"{path}: of another camera than {first}: expected one burst")
        if raw.exposure != camera.exposure:
            found, given = ("ISO {:g}, {:g} s, f/{:g}".format(*one.exposure) for one in (raw, camera))
            raise NteError(f"{path}: taken with {found}; {first} with {given}: expected one exposure")
    if frame.shape != base.shape:
        raise NteError(f"{path}: is {_size(frame)}, {first} is {_size(base)}: expected one size")
    return frame


def _unit(picture: Tensor) -> float:
    """The median light of a linear picture, which has no white level: least variances are shares of this.

    A mean would be that of a single bright pixel, beside which all else would count as noise.
    """
    light = picture[picture > 0]
    return float(light.median()) if light.numel() else 1.0


def _tensor(pixels: np.ndarray) -> Tensor:
    return torch.from_numpy(pixels)[None]


def _size(image: Tensor) -> str:
    return f"{image.shape[-1]}x{image.shape[-2]}"
