"""The clips of a run: which there are, which are broken, and how often each is seen.

One fault among many clips is an accident, such as a file that a full disk cut off: the clip is named and left out, and
the rest trains. Many faults are a mistake in the configuration or in the data: then the run would learn from something
else than was asked for, so it is refused.
"""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from nte.errors import NteError
from nte.frames.channels import PRIOR, way_to
from nte.frames.clip import Clip
from nte.frames.clip_files import find_clips, frame_path
from nte.frames.exr_header import missing_end
from nte.recurrence import FORWARD
from nte.training.config import DataConfig, folder_and_share

MOST_BROKEN = 0.1  # largest share of the clips that may be left out; a single one always may, unless it is the only one


class BrokenClipWarning(UserWarning):
    """Warning that a clip is left out of training, or that it lacks a channel that others have."""


class ClipSet(NamedTuple):
    """Clips, and the probability of each in a sequence; no probabilities: every clip is seen once in an epoch."""

    clips: list[Clip]
    probabilities: list[float] | None = None


def too_many(broken: int, clips: int) -> bool:
    """Tell whether so many broken ones among the clips of a run are a mistake rather than an accident."""
    return broken >= clips or broken > max(1, MOST_BROKEN * clips)


def open_clips(folders: Sequence[str], require: Callable[[Clip], None]) -> list[Clip]:
    """Open the clips in these folders, or in the folders below them, in order, and leave out the broken ones.

    require: raises NteError for a clip that cannot be used. Warns of each broken clip (BrokenClipWarning). Raises
    NteError if there is no clip, and if more than MOST_BROKEN of them are broken, but at least two, or all.
    """
    paths = find_clips([Path(folder) for folder in folders])
    found, faults = [], []
    for path in paths:
        try:
            clip = Clip(path)
            require(clip)
            require_frames(clip)
        except NteError as error:
            faults.append(error)
        else:
            found.append(clip)
    if faults and too_many(len(faults), len(paths)):
        others = f" ({len(faults)} of {len(paths)} clips cannot be used)" if len(faults) > 1 else ""
        raise NteError(f"{faults[0]}{others}") from faults[0]
    for fault in faults:
        warnings.warn(f"left out of training: {fault}", BrokenClipWarning, stacklevel=2)
    return found


def open_weighted(entries: Sequence[object], require: Callable[[Clip], None]) -> ClipSet:
    """Open the clips of `data.clips`, whose entries are folders, or mappings with a folder and its share of sequences.

    Entries without a share divide what the others leave, by their numbers of clips. A clip in two entries belongs to
    the first. Raises NteError as `open_clips` does, and for an entry with a share whose clips all belong to others.
    """
    parts = [folder_and_share(entry) for entry in entries]
    clips = open_clips([folder for folder, _ in parts], require)
    if all(share is None for _, share in parts):
        return ClipSet(clips)
    owners: dict[Path, int] = {}
    for number, (folder, _) in enumerate(parts):
        for path in find_clips([Path(folder)]):
            owners.setdefault(path.resolve(), number)
    owner = [owners[clip.folder.resolve()] for clip in clips]
    counts = [owner.count(number) for number in range(len(parts))]
    for (folder, share), count in zip(parts, counts, strict=True):
        if share is not None and not count:
            raise NteError(f"data.clips: {folder} has the share {share}, but no clip of its own that can be used")
    left = 1 - sum(share or 0 for _, share in parts)
    rest = sum(count for (_, share), count in zip(parts, counts, strict=True) if share is None)
    weights = [
        left / max(1, rest) if share is None else share / count for (_, share), count in zip(parts, counts, strict=True)
    ]
    chosen = [weights[number] for number in owner]
    return ClipSet(clips, [weight / sum(chosen) for weight in chosen])


def require_clip(clip: Clip, channels: Sequence[str], config: DataConfig) -> None:
    """Raise NteError for a clip that lacks a channel, or that is too short or too small for the configuration.

    `previous_forward_motion` may be missing, as it can be made of motion and depth; so may `prior`, which is made.
    """
    missing = [name for name in channels if name not in clip.channels and name not in (FORWARD, PRIOR)]
    if missing:
        have = ", ".join(clip.channels)
        what = f"{clip.folder}: training needs the channel '{missing[0]}'; the clip has {have}"
        raise NteError(what + way_to(missing[:1]))
    if "color" not in clip.channels and "exposure" not in clip.info:
        raise NteError(f"{clip.folder}: no channel 'color' to measure the exposure of: set 'exposure' in its clip.json")
    if len(clip) < config.frames + config.holdout:
        wanted = f"data.frames {config.frames} + data.holdout {config.holdout}, those kept for validation"
        raise NteError(f"{clip.folder}: {len(clip)} frames: expected at least {wanted}: lower one, or render more")
    if config.crop > min(clip.height, clip.width):
        raise NteError(f"{clip.folder}: {clip.width}x{clip.height} is smaller than data.crop {config.crop}")


def require_frames(clip: Clip) -> None:
    """Raise NteError for the first frame file that is cut off or has a damaged header; pixels are not read."""
    for path in (frame_path(clip.folder, index, seed) for seed in range(clip.seeds) for index in range(len(clip))):
        try:
            fault = missing_end(path)
        except OSError as error:
            raise NteError(f"{path}: cannot be read: {error.strerror}") from error
        if fault:
            raise NteError(f"{path}: the OpenEXR file is truncated or damaged: {fault}: render or copy it again")


def require_whole_frames(clips: Sequence[Clip], config: DataConfig) -> None:
    """Raise NteError for whole frames that cannot share a batch: of other sizes, or not square but transposed."""
    if config.batch == 1:
        return
    for clip in clips:
        size, expected = (f"{c.width}x{c.height}" for c in (clip, clips[0]))
        if size != expected:
            raise NteError(f"{clip.folder}: {size}, but {clips[0].folder} has {expected}: set data.crop")
        if config.augment and clip.width != clip.height:
            raise NteError(f"{clip.folder}: {size} cannot be transposed by data.augment: set data.crop")


def tell_missing(clips: Sequence[Clip], optional: Sequence[str]) -> None:
    """Warn of the optional channels that some of the clips lack: their batches do without them."""
    for name in optional:
        lacking = [clip for clip in clips if name not in clip.channels and name != FORWARD]
        if lacking:
            what = f"{len(lacking)} of {len(clips)} clips have no '{name}', for example {lacking[0].folder}"
            warnings.warn(f"{what}: a batch with one of them does without it", BrokenClipWarning, stacklevel=2)
