"""The scores of a clip on disk, so that a comparison which is stopped goes on with the clips that are left.

A file is whole or absent: rows, failures and pictures of one clip in a NumPy archive, without pickling. It has a digest
of all that the scores depend on; scores with another digest are not read.
"""

import json
from dataclasses import asdict
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from nte.evaluation.metric_table import Row
from nte.evaluation.score_clip import Shown
from nte.evaluation.units import EVALUATION, ClipScores, ClipUnit, Stamp, stamps_of
from nte.files import make_folder, write_whole
from nte.frames.clip import Clip
from nte.version import __version__

_KINDS = ("images", "flip")


def unit_digest(unit: ClipUnit) -> str:
    """Compute a digest of all that a unit's scores depend on.

    That is the clip (clip.json; names, sizes and times of its frames), the denoisers with the bytes of their files, how
    they are scored, and the versions of nte and of the packages that compute it.
    """
    clip = Clip(unit.clip)
    info = json.dumps([clip.info, clip.stamps()], sort_keys=True)
    how = json.dumps({**asdict(unit), "clip": ""}, sort_keys=True)
    versions = json.dumps(EVALUATION.versions())
    files = [_digest_of(stamp) for spec in unit.denoisers for stamp in stamps_of(spec)]
    return sha256("\n".join([__version__, versions, info, how, *files]).encode()).hexdigest()


@cache  # every clip has the same denoisers
def _digest_of(stamp: Stamp) -> str:
    return sha256(stamp[0].read_bytes()).hexdigest()


def keep(path: Path, digest: str, scores: ClipScores) -> None:
    """Write the scores of a clip. Raises NteError if that fails."""
    pictures: Row = {}
    shown = []
    for number, one in enumerate(scores.shown):
        names = {kind: list(getattr(one, kind)) for kind in _KINDS}
        shown.append(
            {"clip": one.clip, "target": one.target, "frame": one.frame, "disoccluded": one.disoccluded} | names
        )
        for kind in _KINDS:
            pictures |= {f"{number}_{kind}_{i}": image for i, image in enumerate(getattr(one, kind).values())}
    about = {"digest": digest, "rows": scores.rows, "failed": scores.failed, "shown": shown}
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, about=text, **pictures)

    make_folder(path.parent)
    write_whole(path, write)


def read_kept(path: Path, digest: str) -> ClipScores | None:
    """Read the scores of a clip; None if there are none, or if they are of other denoisers or another clip.

    Also None where a denoiser failed: its reason may be gone.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            about: Row = json.loads(file["about"].tobytes())
            if about["digest"] != digest or about["failed"]:
                return None
            shown = []
            for number, one in enumerate(about["shown"]):
                images, flip = (
                    {name: file[f"{number}_{kind}_{i}"] for i, name in enumerate(one[kind])} for kind in _KINDS
                )
                shown.append(Shown(one["clip"], one["target"], one["frame"], one["disoccluded"], images, flip))
            return ClipScores(about["rows"], shown, about["failed"])
    except Exception:  # what zip, zlib, NumPy and JSON make of damaged bytes is more than a list of types
        return None
