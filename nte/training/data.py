"""Training batches from clips. The batch of a step depends on (seed, step) alone, so a run can be resumed."""

from collections.abc import Generator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from nte.errors import NteError
from nte.frames.channels import way_to
from nte.frames.clip import Clip, find_clips
from nte.recurrence import FORWARD
from nte.training.augment import Augmentation
from nte.training.batch import Batch, collate
from nte.training.config import DataConfig
from nte.training.tiles import SCATTERED, ClipStore


class Sample(NamedTuple):
    """One sequence of a batch: a part of a clip, by its index and noise seed, and how it is augmented."""

    clip: int
    seed: int
    frames: slice
    rows: slice
    columns: slice
    augmentation: Augmentation
    scattered: bool


class TrainingSteps(Dataset[Batch | NteError]):
    """The batches of a run by step number: sequences cropped and augmented by a generator keyed by (seed, step, rank).

    An epoch visits every clip once, in an order keyed by (seed, epoch). rank, world: the number of this process, and of
    all processes; each gets its share of every step. channels: names that a clip must have. Raises NteError for clips
    that do not fit the configuration.
    """

    def __init__(
        self, clips: Sequence[Clip], channels: Sequence[str], config: DataConfig, seed: int, rank: int, world: int,
        cache: Path | None = None,
    ) -> None:  # fmt: skip
        """Check the clips. cache: folder for decoded clips if memory cannot hold them and config names no folder."""
        self.clips, self.config, self.seed, self.rank, self.world = clips, config, seed, rank, world
        for clip in clips:
            _require_clip(clip, channels, config)
        if config.crop == 0:
            _require_whole_frames(clips, config)
        self.scatter = config.scatter if FORWARD in channels else 0.0
        self.store = ClipStore(clips, channels, scattered=self.scatter > 0)
        fits = self.store.gigabytes() * max(1, config.workers) <= config.cache_gb  # every worker has its own
        if config.cache_dir or not fits:
            self.store.folder = Path(config.cache_dir) if config.cache_dir else cache

    @property
    def epoch(self) -> int:
        """Number of steps of an epoch."""
        return -(-len(self.clips) // (self.config.batch * self.world))

    def __getitem__(self, step: int) -> Batch | NteError:
        """Return the batch of a step, or the NteError of a faulty file: a worker would raise it with its traceback."""
        try:
            return self._batch(step)
        except NteError as error:
            return error

    def samples(self, step: int) -> list[Sample]:
        """List the samples of the batch of a step."""
        rng = np.random.default_rng([self.seed, step, self.rank])
        epoch, place = divmod(step, self.epoch)
        order = np.random.default_rng([self.seed, epoch]).permutation(len(self.clips))
        # The last step of an epoch is filled up from the beginning of its order.
        begin = (place * self.world + self.rank) * self.config.batch
        chosen = np.take(order, range(begin, begin + self.config.batch), mode="wrap")
        return [self._draw(int(index), rng) for index in chosen]

    def describe(self, step: int) -> str:
        """Name the clips and frames of a step, for an error message."""
        return ", ".join(
            f"{self.clips[s.clip].folder} frames {s.frames.start} to {s.frames.stop - 1}" for s in self.samples(step)
        )

    def _batch(self, step: int) -> Batch:
        return collate([self._sequence(sample) for sample in self.samples(step)])

    def _draw(self, index: int, rng: np.random.Generator) -> Sample:
        clip, config = self.clips[index], self.config
        seed = int(rng.integers(clip.seeds))
        trained = len(clip) - config.holdout
        start = int(rng.integers(trained - config.frames + 1)) if config.any_start else 0
        rows, columns = (_crop(size, config.crop, rng) for size in (clip.height, clip.width))
        augmentation = Augmentation.draw(rng) if config.augment else Augmentation()
        scattered = self.scatter > 0 and bool(rng.random() < self.scatter)
        return Sample(index, seed, slice(start, start + config.frames), rows, columns, augmentation, scattered)

    def _sequence(self, sample: Sample) -> dict[str, Tensor]:
        """One sample's channels (F, C, H, W), cropped and augmented, and its scalars (1,)."""
        clip = self.store.get(sample.clip, sample.seed)
        images = clip.crop(sample.frames, sample.rows, sample.columns)
        if (scattered := images.pop(SCATTERED, None)) is not None and sample.scattered:
            images[FORWARD] = scattered
        return sample.augmentation(images) | clip.sequence_scalars()


def training_loader(steps: TrainingSteps, first: int, last: int) -> Generator[Batch]:
    """Yield the batches of the steps [first, last), in order, from the configured number of worker processes.

    Closing the generator ends the processes. Raises NteError for a faulty file.
    """
    workers = steps.config.workers
    loader = DataLoader(
        steps, batch_size=None, sampler=range(first, last), num_workers=workers,
        prefetch_factor=2 if workers else None, persistent_workers=False,
        generator=torch.Generator(),  # its own, or each start would draw a number from the global generator
    )  # fmt: skip
    for batch in loader:  # a generator that is closed ends its worker processes
        if isinstance(batch, NteError):
            raise batch
        yield batch


def open_clips(folders: Sequence[str]) -> list[Clip]:
    """Open the clips in these folders, or in the folders below them, in order. Raises NteError if there is none."""
    return [Clip(path) for path in find_clips([Path(folder) for folder in folders])]


def _crop(size: int, crop: int, rng: np.random.Generator) -> slice:
    start = int(rng.integers(size - crop + 1)) if crop else 0
    return slice(start, start + (crop or size))


def _require_clip(clip: Clip, channels: Sequence[str], config: DataConfig) -> None:
    missing = [name for name in channels if name not in clip.channels and name != FORWARD]  # FORWARD can be scattered
    if missing:
        have = ", ".join(clip.channels)
        what = f"{clip.folder}: training needs the channel '{missing[0]}'; the clip has {have}"
        raise NteError(what + way_to(missing[:1]))
    if "color" not in clip.channels and "exposure" not in clip.info:
        raise NteError(f"{clip.folder}: no channel 'color' to measure the exposure of: set 'exposure' in its clip.json")
    if len(clip) < config.frames + config.holdout:
        wanted = f"data.frames {config.frames} + data.holdout {config.holdout}"
        raise NteError(f"{clip.folder}: {len(clip)} frames, but {wanted} are asked for")
    if config.crop > min(clip.height, clip.width):
        raise NteError(f"{clip.folder}: {clip.width}x{clip.height} is smaller than data.crop {config.crop}")


def _require_whole_frames(clips: Sequence[Clip], config: DataConfig) -> None:
    """Raise NteError for whole frames that cannot share a batch: of other sizes, or not square but transposed."""
    if config.batch == 1:
        return
    for clip in clips:
        size, expected = (f"{c.width}x{c.height}" for c in (clip, clips[0]))
        if size != expected:
            raise NteError(f"{clip.folder}: {size}, but {clips[0].folder} has {expected}: set data.crop")
        if config.augment and clip.width != clip.height:
            raise NteError(f"{clip.folder}: {size} cannot be transposed by data.augment: set data.crop")
