"""Decoded clips in tiles, so that a crop reads little more than itself, from memory or from mapped files.

A folder of the cache holds one clip with one noise seed, or with the mean of several. Its name has a digest of all that
it was made from, and it is whole or absent, so several processes and several runs can share a cache.

tiles.npy    float32 (rows of tiles, columns of tiles, frames, components, TILE, TILE)
scalars.npy  float32 (3, 1): SCALARS of the sequence
"""

import os
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from nte.errors import NteError
from nte.files import make_folder, sweep, temporary_name
from nte.filters.named import load_filter
from nte.frames.channels import PRIOR, REFERENCES, width_of
from nte.frames.clip import Clip, Pixels
from nte.frames.frame import Frame
from nte.frames.reference import BadReferenceWarning, count_bad_pixels, describe_bad_pixels
from nte.frames.scalars import sequence_scalars
from nte.motion.geometric import scatter_forward_motion
from nte.recurrence import FORWARD
from nte.training.plan import digest_of
from nte.version import DENOISING, __version__, versions_of

TILE = 64  # pixels; a crop of 256 reads 1.6 times its size
FORMAT = "nte-tiles/1"
SCATTERED = "scattered_forward_motion"
Key = tuple[int, tuple[int, ...]]  # of a clip, by its index, with noise seeds whose mean is taken
SCALARS = ("exposure", "depth_scale", "shutter")  # scalars of a frame that belong to its sequence


class BrokenClipError(NteError):
    """An error in a clip's files, whereas other errors concern the cache."""


class TiledClip(NamedTuple):
    """One clip with one noise seed, or the mean of several, decoded."""

    channels: tuple[str, ...]
    tiles: Pixels  # (rows of tiles, columns of tiles, frames, components, TILE, TILE)
    scalars: Pixels  # (3, 1)

    def crop(self, frames: slice, rows: slice, columns: slice) -> dict[str, Tensor]:
        """Copy the channels (F, C, H, W) of some frames, rows and columns. Slices need a start and a stop, no step."""
        size = frames.stop - frames.start, rows.stop - rows.start, columns.stop - columns.start
        images, first = {}, 0
        for name in self.channels:
            image = np.empty((size[0], _width(name), *size[1:]), np.float32)
            for (row, y, inside_y), (column, x, inside_x) in product(_pieces(rows), _pieces(columns)):
                components = slice(first, first + _width(name))
                image[:, :, y, x] = self.tiles[row, column, frames, components, inside_y, inside_x]
            images[name] = torch.from_numpy(image)
            first += _width(name)
        return images

    def sequence_scalars(self) -> dict[str, Tensor]:
        """Return exposure, depth_scale and shutter by name, each (1,)."""
        return {name: torch.tensor(value) for name, value in zip(SCALARS, self.scalars, strict=True)}


class ClipStore:
    """A store of clips that are decoded once and kept in memory, or in files below `folder` if it is given.

    channels: names to keep, where a clip has them; a previous_forward_motion that a clip lacks is made by scattering
    its motion. scattered: keep SCATTERED as well, the previous_forward_motion that scattering makes for every clip.
    prior: the denoiser whose image is the channel `prior`, if that is to be kept.
    """

    def __init__(
        self, clips: Sequence[Clip], channels: Sequence[str], folder: Path | None = None, scattered: bool = False,
        prior: str = "",
    ) -> None:  # fmt: skip
        self.clips, self.folder, self.prior = clips, folder, prior
        self._versions = (__version__, versions_of(*DENOISING)) if prior else ()
        self.channels = (*channels, SCATTERED) if scattered else tuple(channels)
        self._open: dict[Key, TiledClip] = {}
        self._told: set[int] = set()

    def get(self, index: int, *seeds: int) -> TiledClip:
        """Return clip `index` with a noise seed, or the mean of several, decoding it at the first call.

        Raises BrokenClipError for a clip that cannot be read, and NteError for a file of the cache that is damaged or
        cannot be written.
        """
        key = index, tuple(sorted(seeds))
        if key not in self._open:
            self._open[key] = self._decode(key, np.empty) if self.folder is None else self._mapped(self.folder, key)
        return self._open[key]

    def gigabytes(self, most: int) -> float:
        """Return the size of all decoded clips with all means of up to `most` of their seeds, in GiB."""
        total = 0.0
        for clip in self.clips:
            asked = {seeds for first in range(clip.seeds) for seeds in means(clip.seeds, first, most)}
            total += 4.0 * np.prod(self._shape(clip)) * len(asked)
        return total / 2**30

    def _kept(self, clip: Clip) -> tuple[str, ...]:
        """The channels that are kept of a clip."""
        made = FORWARD, SCATTERED, PRIOR
        return tuple(name for name in self.channels if name in clip.channels or name in made)

    def _shape(self, clip: Clip) -> tuple[int, ...]:
        components = sum(map(_width, self._kept(clip)))
        return -(-clip.height // TILE), -(-clip.width // TILE), len(clip), components, TILE, TILE

    def _mapped(self, folder: Path, key: Key) -> TiledClip:
        clip = self.clips[key[0]]
        path = folder / f"{clip.name}_{self._digest(clip, key[1])}"
        if not path.is_dir():
            make_folder(folder)
            sweep(folder, path.name)
            temporary = temporary_name(path)
            try:
                temporary.mkdir()
                made = self._decode(key, lambda shape, dtype: _allocate(temporary / "tiles.npy", shape))
                np.save(temporary / "scalars.npy", made.scalars)
                _reach_the_disk(temporary)
                with suppress(FileExistsError, NotADirectoryError):
                    _rename(temporary, path)
            except OSError as error:
                reason = f"cannot be written: {error.strerror}: name another folder by data.cache_dir"
                raise NteError(f"{path}: {reason}") from error
            finally:
                shutil.rmtree(temporary, ignore_errors=True)
        try:
            tiles = np.load(path / "tiles.npy", mmap_mode="r", allow_pickle=False)
            scalars = np.load(path / "scalars.npy", allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise NteError(f"{path}: damaged ({error}): delete it, it will be made again") from error
        found, expected = (tiles.shape, scalars.shape), (self._shape(clip), (len(SCALARS), 1))
        if found != expected:
            raise NteError(f"{path}: damaged: it holds {found}, expected {expected}: delete it, it will be made again")
        return TiledClip(self._kept(clip), tiles, scalars)

    def _decode(self, key: Key, allocate: Callable[[tuple[int, ...], type[np.float32]], Pixels]) -> TiledClip:
        """Read frame after frame into the array that `allocate` makes; only one more frame is in memory at a time."""
        index, seeds = key
        clip = self.clips[index]
        kept = self._kept(clip)
        tiles = allocate(self._shape(clip), np.float32)
        # Besides the channels that are kept, those that give exposure, depth scale and scattered motion.
        # Made for each clip, so that a store can be sent to a worker process: a denoiser may hold locks and devices.
        below = load_filter(self.prior) if self.prior else None
        read = () if below is None else (*below.needs, *below.optional)
        wanted = dict.fromkeys((*self.channels, "color", "depth", "motion", *read))
        stored = [name for name in wanted if name in clip.channels]
        scalars = np.ones((len(SCALARS), 1), np.float32)
        state = None
        for i in range(len(clip)):
            try:
                frame = clip.frame(i, stored, seeds)
                self._look(frame, index)
                if below is not None:
                    result, state = below.step(frame, state)
                    frame = frame.with_channels(prior=result.image)
                if i == 0:
                    scalars[:2] = np.stack(sequence_scalars(frame))
                    scalars[2] = 1 if frame.shutter is None else frame.shutter
            except NteError as error:
                raise BrokenClipError(str(error)) from error
            planes = np.concatenate([self._channel(frame, name)[0] for name in kept])
            tiles[:, :, i] = _tiled(planes)
        return TiledClip(kept, tiles, scalars)

    def _channel(self, frame: Frame, name: str) -> Pixels:
        if name == SCATTERED or (name == FORWARD and name not in frame):
            motion, depth = (torch.from_numpy(frame[n]) for n in ("motion", "depth"))
            return np.asarray(scatter_forward_motion(motion, depth))
        return np.asarray(frame[name])

    def _look(self, frame: Frame, index: int) -> None:
        folder = self.clips[index].folder
        for name in REFERENCES:
            bad = count_bad_pixels(frame, name, folder) if name in frame else 0
            if bad and index not in self._told:
                self._told.add(index)
                warnings.warn(describe_bad_pixels(bad, name, folder, frame.index), BadReferenceWarning, stacklevel=2)

    def _digest(self, clip: Clip, seeds: tuple[int, ...]) -> str:
        """Digest of all that the tiles are made from, so that a clip that is rendered again has other tiles."""
        try:
            stamps = clip.stamps(sorted({0, *seeds}))
        except NteError as error:
            raise BrokenClipError(str(error)) from error
        where, made_by = str(clip.folder.resolve()), (self.prior, *self._versions)
        return digest_of(clip, FORMAT, TILE, self._kept(clip), *made_by, seeds, where, stamps)


def means(count: int, first: int, most: int) -> list[tuple[int, ...]]:
    """List the seeds, out of `count`, whose mean a sequence can be: `first` alone, with the next one, up to `most`."""
    return [tuple(sorted((first + i) % count for i in range(size))) for size in range(1, min(most, count) + 1)]


def _width(channel: str) -> int:
    """How many components a channel has; also knows SCATTERED."""
    return width_of(FORWARD if channel == SCATTERED else channel)


def _pieces(pixels: slice) -> Iterator[tuple[int, slice, slice]]:
    """Cut rows or columns at the borders of tiles: yield a tile's number, and its pixels in the crop and in itself."""
    for tile in range(pixels.start // TILE, -(-pixels.stop // TILE)):
        start, stop = max(pixels.start, tile * TILE), min(pixels.stop, (tile + 1) * TILE)
        yield tile, slice(start - pixels.start, stop - pixels.start), slice(start - tile * TILE, stop - tile * TILE)


def _tiled(planes: Pixels) -> Pixels:
    """Cut planes (C, H, W) into tiles (rows of tiles, columns of tiles, C, TILE, TILE), padded with zeros."""
    count, height, width = planes.shape
    padded = np.pad(planes, [(0, 0), (0, -height % TILE), (0, -width % TILE)])
    split = padded.reshape(count, padded.shape[1] // TILE, TILE, padded.shape[2] // TILE, TILE)
    return split.transpose(1, 3, 0, 2, 4)


def _allocate(path: Path, shape: tuple[int, ...]) -> Pixels:
    """Make a mapped file with its space reserved: writing to a map on a full disk would kill the process."""
    tiles = np.lib.format.open_memmap(path, mode="w+", dtype=np.float32, shape=shape)
    if hasattr(os, "posix_fallocate"):
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    return tiles


def _reach_the_disk(folder: Path) -> None:
    """Wait until a folder's files are on the disk: after a power cut, missing content would read as zeros."""
    for path in folder.iterdir():
        with path.open("r+b") as file:
            os.fsync(file.fileno())


def _rename(temporary: Path, path: Path) -> None:
    """Rename a folder; raises FileExistsError if another process was faster."""
    try:
        temporary.rename(path)
    except OSError as error:
        raise (FileExistsError if path.is_dir() else type(error))(*error.args) from error
