"""Training batches from clips. A batch depends on (seed, its number) alone, so a run can be resumed."""

import warnings
from collections.abc import Generator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from nte.errors import NteError
from nte.frames.clip import Clip
from nte.overlap import ahead
from nte.recurrence import FORWARD
from nte.training.augment import Augmentation
from nte.training.batch import Batch, collate
from nte.training.clips import BrokenClipWarning, require_clip, require_whole_frames, too_many
from nte.training.config import DataConfig
from nte.training.tiles import SCATTERED, BrokenClipError, ClipStore, means

AHEAD = 2  # batches that each worker process, or the thread, loads before they are asked for


class Sample(NamedTuple):
    """One sequence of a batch: a part of a clip, by its index and noise seeds, and how it is augmented."""

    clip: int
    seeds: tuple[int, ...]  # their noisy channels are averaged
    frames: slice
    rows: slice
    columns: slice
    augmentation: Augmentation
    scattered: bool


class TrainingBatches(Dataset[Batch | NteError]):
    """The batches of a run by number: sequences cropped and augmented by a generator keyed by (seed, number, rank).

    An epoch visits every clip once, in an order keyed by (seed, epoch), unless clips have probabilities: then each
    sequence draws its clip. rank, world: the number of this process, and of all processes; each gets its share of every
    batch. channels: names that a clip must have. optional: names that are kept where all clips of a batch have them.
    A clip that turns out to be broken is replaced by the next one. Raises NteError for clips that do not fit the
    configuration.
    """

    def __init__(
        self, clips: Sequence[Clip], channels: Sequence[str], config: DataConfig, seed: int, rank: int, world: int,
        cache: Path | None = None, optional: Sequence[str] = (), probabilities: Sequence[float] | None = None,
        prior: str = "",
    ) -> None:  # fmt: skip
        """Check the clips.

        cache: folder for decoded clips if memory cannot hold them and config names no folder. prior: see ClipStore.
        """
        self.clips, self.config, self.seed, self.rank, self.world = clips, config, seed, rank, world
        self.probabilities = probabilities
        for clip in clips:
            require_clip(clip, channels, config)
        if config.crop == 0:
            require_whole_frames(clips, config)
        kept = tuple(dict.fromkeys((*channels, *optional)))
        self.scatter = config.scatter if FORWARD in kept else 0.0
        self.store = ClipStore(clips, kept, scattered=self.scatter > 0, prior=prior)
        every_worker = self.store.gigabytes(config.average) * max(1, config.workers)  # has its own
        fits = every_worker <= config.cache_gb
        if config.cache_dir or not fits:
            self.store.folder = Path(config.cache_dir) if config.cache_dir else cache
        self._broken: set[int] = set()

    @property
    def epoch(self) -> int:
        """Number of batches of an epoch."""
        return -(-len(self.clips) // (self.config.batch * self.world))

    def __getitem__(self, number: int) -> Batch | NteError:
        """Return a batch, or the NteError of a faulty file: a worker would raise it with its traceback."""
        try:
            return collate([self._whole(sample, number) for sample in self.samples(number)])
        except NteError as error:
            return error

    def samples(self, number: int) -> list[Sample]:
        """List the samples of a batch."""
        rng = np.random.default_rng([self.seed, number, self.rank])
        if self.probabilities is not None:
            chosen = rng.choice(len(self.clips), self.config.batch, p=self.probabilities)
        else:
            epoch, place = divmod(number, self.epoch)
            order = np.random.default_rng([self.seed, epoch]).permutation(len(self.clips))
            # The last batch of an epoch is filled up from the beginning of its order.
            begin = (place * self.world + self.rank) * self.config.batch
            chosen = np.take(order, range(begin, begin + self.config.batch), mode="wrap")
        return [self._draw(int(index), rng) for index in chosen]

    def describe(self, numbers: Sequence[int]) -> str:
        """Name the clips and frames of some batches, for an error message."""
        return ", ".join(
            f"{self.clips[s.clip].folder} frames {s.frames.start} to {s.frames.stop - 1}"
            for number in numbers
            for s in self.samples(number)
        )

    def _draw(self, index: int, rng: np.random.Generator) -> Sample:
        clip, config = self.clips[index], self.config
        most = min(config.average, clip.seeds)
        count = int(rng.integers(most)) if most > 1 else 0
        seeds = means(clip.seeds, int(rng.integers(clip.seeds)), most)[count]
        trained = len(clip) - config.holdout
        start = int(rng.integers(trained - config.frames + 1)) if config.any_start else 0
        rows, columns = (_crop(size, config.crop, rng) for size in (clip.height, clip.width))
        augmentation = Augmentation.draw(rng) if config.augment else Augmentation()
        scattered = self.scatter > 0 and bool(rng.random() < self.scatter)
        augmentation = augmentation.lit(rng, config.radiance, config.exposure)
        augmentation = augmentation.turned(rng) if config.rotate else augmentation
        return Sample(index, seeds, slice(start, start + config.frames), rows, columns, augmentation, scattered)

    def _whole(self, sample: Sample, number: int) -> dict[str, Tensor]:
        """One sample's sequence; if its clip is broken, one of the next clip, drawn by a generator of its own.

        Raises NteError if so many clips are broken that they cannot be an accident.
        """
        rng = np.random.default_rng([self.seed, number, self.rank, sample.clip])
        while True:
            if sample.clip not in self._broken:
                try:
                    return self._sequence(sample)
                except BrokenClipError as error:
                    self._broken.add(sample.clip)
                    if too_many(len(self._broken), len(self.clips)):
                        raise
                    text = f"left out of training, the next clip takes its place: {error}"
                    warnings.warn(text, BrokenClipWarning, stacklevel=2)
            sample = self._draw((sample.clip + 1) % len(self.clips), rng)

    def _sequence(self, sample: Sample) -> dict[str, Tensor]:
        """One sample's channels (F, C, H, W), cropped and augmented, and its scalars (1,)."""
        clip = self.store.get(sample.clip, *sample.seeds)
        images = clip.crop(sample.frames, sample.rows, sample.columns)
        if (scattered := images.pop(SCATTERED, None)) is not None and sample.scattered:
            images[FORWARD] = scattered
        return sample.augmentation(images) | sample.augmentation.scalars(clip.sequence_scalars())


def training_loader(batches: TrainingBatches, first: int, last: int, ahead: bool = True) -> Generator[Batch]:
    """Yield the batches [first, last), in order, which the configured worker processes, or else a thread, load ahead.

    ahead: false loads each batch when it is due, if there are no worker processes. Where the steps themselves compute
    on the CPU, a thread takes more time from them than it saves. A batch that is loaded and never yielded leaves no
    trace: a run continues from the number of batches that it has trained on. Closing the generator ends the processes
    or the thread, after the batch that it is loading. Raises NteError for a faulty file, when its batch is due.
    """
    processes = batches.config.workers > 0
    load = _from_processes if processes else _from_thread if ahead else _when_due
    with closing(load(batches, range(first, last))) as loaded:
        for batch in loaded:
            if isinstance(batch, NteError):
                raise batch
            yield batch


def _from_processes(batches: TrainingBatches, numbers: range) -> Generator[Batch | NteError]:
    """Load in processes: forked ones, except where they make a prior.

    Open Image Denoise hangs in a fork of a process that has used it, as a validation does. A new process costs 1.3 s of
    a core, a fork nothing.
    """
    prior = bool(batches.store.prior)
    yield from DataLoader(
        batches, batch_size=None, sampler=numbers, num_workers=batches.config.workers, prefetch_factor=AHEAD,
        multiprocessing_context="spawn" if prior else None,
        generator=torch.Generator(),  # its own, or each start would draw a number from the global generator
    )  # fmt: skip


def _when_due(batches: TrainingBatches, numbers: range) -> Generator[Batch | NteError]:
    yield from map(batches.__getitem__, numbers)


def _from_thread(batches: TrainingBatches, numbers: range) -> Generator[Batch | NteError]:
    """Load in one thread: decoding releases Python's lock, and a clip that two threads want would be decoded twice.

    PyTorch computes on one core there: threads of a second pool would make every operation of a step wait.
    """
    return ahead(map(batches.__getitem__, numbers), AHEAD, partial(torch.set_num_threads, 1))


def _crop(size: int, crop: int, rng: np.random.Generator) -> slice:
    start = int(rng.integers(size - crop + 1)) if crop else 0
    return slice(start, start + (crop or size))
