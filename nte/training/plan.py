"""The plan of a run: its steps, processes and clips, kept in plan.json and compared on resuming.

The steps of an epoch follow from the number of clips and of sequences per step. A run resumed with other numbers would
silently end at another step, or learn from other data.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from hashlib import sha256
from pathlib import Path
from typing import Any

from nte.errors import NteError
from nte.files import write_whole
from nte.frames.clip import Clip

PLAN = "plan.json"
OTHER_RUN = "give the run another name (in nte compare: use another --runs)"
ANEW = "start the run anew with --force (in nte compare: delete its folder)"
_AGAIN = f"restore it, or {OTHER_RUN}"


@dataclass(frozen=True)
class Plan:
    """The numbers and clips that follow from a configuration."""

    processes: int  # number of processes that share a step, `data.batch` sequences each
    steps: list[int]  # number of steps of every phase
    clips: list[list[str]]  # [name, digest of clip.json, digest of frames] of each training clip, in order
    validation: list[list[str]]  # the same for validation clips
    init: str = ""  # digest of the weights of `init_from`; empty if the run begins with new ones

    def write(self, folder: Path) -> None:
        """Write plan.json into a run folder."""
        text = json.dumps(asdict(self)) + "\n"
        write_whole(folder / PLAN, lambda path: path.write_text(text, encoding="utf-8"))

    def require_same(self, folder: Path) -> "Plan":
        """Return the plan of the run in `folder`.

        Raises NteError, naming the first difference, unless this plan differs from it in the number of steps alone.
        """
        saved = _read(folder / PLAN)
        if saved.processes != self.processes:
            raise NteError(
                f"{folder}: trained by {saved.processes} processes, and here are {self.processes}, which changes what "
                f"a step is: start as many, or {OTHER_RUN}"
            )
        for key in ("clips", "validation"):
            if difference := _difference(getattr(saved, key), getattr(self, key)):
                raise NteError(f"{folder}: trained on other clips: {difference} in data.{key}: {_AGAIN}")
        if saved.init != self.init:
            raise NteError(f"{folder}: init_from has other weights now than those that the run began with: {_AGAIN}")
        return saved


def digests(clips: Sequence[Clip]) -> list[list[str]]:
    """List [name, digest of clip.json, digest of the sizes of all frames' files] of each clip."""
    return [[clip.name, digest_of(clip), _digest_of_frames(clip)] for clip in clips]


def _digest_of_frames(clip: Clip) -> str:
    """Digest of files' sizes, which other pixels change, as they are compressed.

    Not of their times: a copy of the data, as on another machine, has new ones, and whoever is refused there loses a
    training, whereas a cache with other times is only made again.
    """
    sizes = [size for _, size, _ in clip.stamps(range(clip.seeds))]
    return sha256(repr(sizes).encode()).hexdigest()[:16]


def digest_of(clip: Clip, *more: object) -> str:
    """Compute a digest, 16 hexadecimal digits, of a clip's clip.json and of any further objects (by their repr)."""
    return sha256(repr((json.dumps(clip.info, sort_keys=True), *more)).encode()).hexdigest()[:16]


def _difference(saved: list[list[str]], now: list[list[str]]) -> str:
    """The first difference in words; empty if there is none."""
    before, after = [{clip[0] for clip in clips} for clips in (saved, now)]
    if missing := sorted(before - after):
        return f"'{missing[0]}' is missing"
    if new := sorted(after - before):
        return f"'{new[0]}' is new"
    for was, is_ in zip(saved, now, strict=False):
        if was[0] != is_[0]:
            return f"'{is_[0]}' stands where '{was[0]}' stood"
        if was[1] != is_[1]:
            return f"'{is_[0]}' has another clip.json"
        if was[2:] and was[2:] != is_[2:]:  # older plans say nothing of frames
            return f"'{is_[0]}' has other frames"
    return "" if len(saved) == len(now) else f"there are {len(now)} for {len(saved)}"


def _read(path: Path) -> Plan:
    if not path.is_file():
        raise NteError(f"{path}: missing, so nobody knows what the run was trained on: {ANEW}")
    try:
        loaded: Any = json.loads(path.read_text(encoding="utf-8"))
        plan = Plan(**{field.name: loaded[field.name] for field in fields(Plan)})
        well_formed = type(plan.processes) is int and all(type(n) is int for n in plan.steps)
        well_formed = well_formed and type(plan.init) is str
        lists = [*plan.clips, *plan.validation]
        well_formed = well_formed and all(len(clip) in (2, 3) and all(type(s) is str for s in clip) for clip in lists)
        if not well_formed:
            raise ValueError("another type of value than expected")
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise NteError(f"{path}: not a plan of ours, or damaged: {error}: {ANEW}") from error
    return plan
