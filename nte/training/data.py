"""Clips → training batches. What a step trains on depends on (seed, step) alone, so a run can be resumed."""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from nte.errors import NteError
from nte.frames.clip import Clip, find_clips
from nte.frames.scalars import sequence_scalars
from nte.training.augment import Augmentation
from nte.training.batch import Batch, collate
from nte.training.config import DataConfig


class ClipCache:
    """Decoded clips, (F, C, H, W) per channel and noise seed, as many as fit the memory given."""

    def __init__(self, clips: Sequence[Clip], channels: Sequence[str], gigabytes: float) -> None:
        self.clips, self.channels = clips, channels
        self.budget = gigabytes * 2**30
        self._kept: OrderedDict[tuple[int, int], dict[str, Tensor]] = OrderedDict()

    def get(self, index: int, seed: int) -> dict[str, Tensor]:
        """Every frame of clip `index` with noise seed `seed`."""
        key = index, seed
        if key not in self._kept:
            frames = [self.clips[index].frame(i, self.channels, (seed,)) for i in range(len(self.clips[index]))]
            exposure, depth_scale = sequence_scalars(frames[0])
            decoded = {name: torch.from_numpy(np.concatenate([f[name] for f in frames])) for name in self.channels}
            shutter = np.ones(1) if frames[0].shutter is None else frames[0].shutter
            scalars = {"exposure": exposure, "depth_scale": depth_scale, "shutter": shutter}
            self._kept[key] = decoded | {k: torch.as_tensor(v, dtype=torch.float32) for k, v in scalars.items()}
            while len(self._kept) > 1 and self._size() > self.budget:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def _size(self) -> int:
        return sum(t.nbytes for clip in self._kept.values() for t in clip.values())


class TrainingSteps(Dataset[Batch | NteError]):
    """Step number → batch: sequences cropped and augmented by a generator keyed by (seed, step).

    An epoch visits every clip once, in an order keyed by (seed, epoch). Of `world` processes, the one with
    this rank gets its share of every step.
    """

    def __init__(
        self, clips: Sequence[Clip], channels: Sequence[str], config: DataConfig, seed: int, rank: int, world: int
    ) -> None:
        self.clips, self.config, self.seed, self.rank, self.world = clips, config, seed, rank, world
        self.cache = ClipCache(clips, channels, config.cache_gb)
        for clip in clips:
            _check_clip(clip, channels, config)
        if config.crop == 0:
            _check_whole_frames(clips, config)

    @property
    def epoch(self) -> int:
        """Steps of an epoch."""
        return -(-len(self.clips) // (self.config.batch * self.world))

    def __getitem__(self, step: int) -> Batch | NteError:
        """The batch of a step; what is wrong with a file is returned, as a worker would raise it with its traceback."""
        try:
            return self._batch(step)
        except NteError as error:
            return error

    def _batch(self, step: int) -> Batch:
        rng = np.random.default_rng([self.seed, step, self.rank])
        epoch, place = divmod(step, self.epoch)
        order = np.random.default_rng([self.seed, epoch]).permutation(len(self.clips))
        # The last step of an epoch is filled up from the beginning of its order.
        begin = (place * self.world + self.rank) * self.config.batch
        chosen = np.take(order, range(begin, begin + self.config.batch), mode="wrap")
        return collate([self._sequence(int(index), rng) for index in chosen])

    def _sequence(self, index: int, rng: np.random.Generator) -> dict[str, Tensor]:
        """One clip's channels (F, C, crop, crop), and its scalars (1,)."""
        clip, config = self.clips[index], self.config
        decoded = self.cache.get(index, int(rng.integers(clip.seeds)))
        trained = len(clip) - config.holdout
        start = int(rng.integers(trained - config.frames + 1)) if config.any_start else 0
        frames = slice(start, start + config.frames)
        rows, columns = (_crop(size, config.crop, rng) for size in (clip.height, clip.width))
        images = {k: v[frames, :, rows, columns] for k, v in decoded.items() if v.ndim == 4}
        if config.augment:
            images = Augmentation.draw(rng)(images)
        return images | {k: v for k, v in decoded.items() if v.ndim == 1}


def training_loader(steps: TrainingSteps, first: int, last: int) -> Iterator[Batch]:
    """Batches of the steps [first, last), in order, from the configured number of worker processes."""
    workers = steps.config.workers
    loader = DataLoader(
        steps, batch_size=None, sampler=range(first, last), num_workers=workers,
        prefetch_factor=2 if workers else None, persistent_workers=False,
        generator=torch.Generator(),  # of its own: it would take a number from everybody's each time it starts
    )  # fmt: skip
    for batch in loader:
        if isinstance(batch, NteError):
            raise batch
        yield batch


def open_clips(folders: Sequence[str]) -> list[Clip]:
    """The clips in these folders, or in the folders below them, in order; raises NteError if there is none."""
    return [Clip(path) for path in find_clips([Path(folder) for folder in folders])]


def _crop(size: int, crop: int, rng: np.random.Generator) -> slice:
    start = int(rng.integers(size - crop + 1)) if crop else 0
    return slice(start, start + (crop or size))


def _check_clip(clip: Clip, channels: Sequence[str], config: DataConfig) -> None:
    missing = [name for name in channels if name not in clip.channels]
    if missing:
        have = ", ".join(clip.channels)
        raise NteError(f"{clip.folder}: training needs the channel '{missing[0]}'; the clip has {have}")
    if len(clip) < config.frames + config.holdout:
        wanted = f"data.frames {config.frames} + data.holdout {config.holdout}"
        raise NteError(f"{clip.folder}: {len(clip)} frames, but {wanted} are asked for")
    if config.crop > min(clip.height, clip.width):
        raise NteError(f"{clip.folder}: {clip.width}x{clip.height} is smaller than data.crop {config.crop}")


def _check_whole_frames(clips: Sequence[Clip], config: DataConfig) -> None:
    """Whole frames share a batch only if they have one size, and keep it when they are transposed."""
    if config.batch == 1:
        return
    for clip in clips:
        size, expected = (f"{c.width}x{c.height}" for c in (clip, clips[0]))
        if size != expected:
            raise NteError(f"{clip.folder}: {size}, but {clips[0].folder} has {expected}: set data.crop")
        if config.augment and clip.width != clip.height:
            raise NteError(f"{clip.folder}: {size} cannot be transposed by data.augment: set data.crop")
