"""What a training needs before its first step: the clips that fit its network and its losses."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from nte.errors import NteError
from nte.filters.prior import complete
from nte.frames.channels import reference_of, way_to
from nte.frames.clip import Clip
from nte.models.trainable import TrainableDenoiser
from nte.training.clips import open_clips, open_weighted, require_clip, tell_missing
from nte.training.config import TrainConfig
from nte.training.data import TrainingBatches
from nte.training.losses import HIDDEN
from nte.training.target import Target
from nte.training.validation import ValidationSet, spread


class Material(NamedTuple):
    """What a run learns from, and what it is judged by."""

    data: TrainingBatches
    validation: ValidationSet


def open_material(
    config: TrainConfig, denoiser: TrainableDenoiser, cache: Path, rank: int = 0, world: int = 1
) -> Material:
    """Open the clips of a run, and check that they fit its network and its losses. No pixels are read.

    cache: folder for decoded clips that memory cannot hold. rank, world: the number of this process, and of all.
    Raises NteError if they do not fit.
    """
    shown = denoiser.target, reference_of(denoiser.target)  # beside the network's image
    whole = complete(denoiser)
    scored = tuple(dict.fromkeys((*whole.needs, *whole.wants, *shown)))
    needed = tuple(dict.fromkeys((*needed_channels(denoiser, config), *whole.needs)))
    chosen = open_weighted(config.data.clips, lambda clip: require_clip(clip, needed, config.data))
    optional = tuple(name for name in _seen(denoiser, denoiser.optional) if name not in needed)
    if rank == 0:
        tell_missing(chosen.clips, optional)
    data = TrainingBatches(
        chosen.clips, needed, config.data, config.seed, rank, world, cache, optional,
        chosen.probabilities, denoiser.prior,
    )  # fmt: skip
    own = config.data.validation
    judges = open_clips(own, lambda clip: _require_scored(clip, scored)) if own else chosen.clips
    for clip in judges:
        _require_scored(clip, scored)
    return Material(
        data, ValidationSet(spread(judges, config.validate_clips), 0 if own else max(1, config.data.holdout))
    )


def _require_scored(clip: Clip, channels: Sequence[str]) -> None:
    if missing := [name for name in channels if name not in clip.channels]:
        have = ", ".join(clip.channels)
        what = f"{clip.folder}: validation needs the channel '{missing[0]}'; the clip has {have}"
        raise NteError(what + way_to(missing[:1]))


def needed_channels(denoiser: TrainableDenoiser, config: TrainConfig) -> tuple[str, ...]:
    """List the channels that every clip must have. Raises NteError for a loss that this network cannot have."""
    for i, phase in enumerate(config.phases):
        if phase.occlusion * config.loss.occlusion > 0 and HIDDEN not in denoiser.extras:
            what = f"network '{config.network.kind}' gives no '{HIDDEN}'"
            raise NteError(f"'phases[{i}].occlusion' is {phase.occlusion}, but the {what}: set it to 0")
    if missing := [name for name, weight in config.loss.lights.items() if weight and name not in denoiser.components]:
        what = f"network '{config.network.kind}' does not give '{missing[0]}' apart"
        raise NteError(f"loss.lights has '{missing[0]}', but the {what}: leave it out")
    return tuple(dict.fromkeys([*_seen(denoiser, denoiser.needs), *config.loss.channels(Target(denoiser.target))]))


def _seen(denoiser: TrainableDenoiser, channels: Sequence[str]) -> list[str]:
    """The channels that `forward` takes: batches have the scalars that the others are there to measure."""
    return [name for name in channels if name in denoiser.inputs]
