"""The facts of a clip: clip.json, which makes a folder a clip."""

import json
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from nte.errors import NteError
from nte.files import make_folder, write_whole

FORMAT = "nte-clip/1"
Info: TypeAlias = dict[str, Any]  # what clip.json says, by its keys


def write_clip_info(folder: Path, info: Info) -> None:
    """Write clip.json, the last file of a clip: a folder without it is not finished.

    Raises NteError if it cannot be written.
    """
    text = json.dumps({"format": FORMAT, **info}, indent=1, sort_keys=True) + "\n"
    make_folder(folder)
    write_whole(folder / "clip.json", lambda temporary: temporary.write_text(text, encoding="utf-8"))


def read_clip_info(folder: Path) -> Info:
    """Read and check clip.json. Raises NteError, naming the key, for what is missing or cannot be."""
    path = folder / "clip.json"
    if not path.is_file():
        state = "has frames but no clip.json: the clip is not finished" if any(folder.glob("*.exr")) else "is no clip"
        raise NteError(f"{folder}: {state if folder.exists() else 'does not exist'}; expected a folder with clip.json")
    try:
        info = json.loads(path.read_text(encoding="utf-8"))
        json.dumps(info, ensure_ascii=False).encode()  # half of a surrogate pair could neither be printed nor written
    except (ValueError, OSError, RecursionError) as error:
        raise NteError(f"{path}: not readable as JSON: {error}") from error
    if not isinstance(info, dict) or info.get("format") != FORMAT:
        found = info.get("format") if isinstance(info, dict) else type(info).__name__
        raise NteError(f"{path}: format is {found!r:.40}, expected '{FORMAT}'")
    for key in ("width", "height", "frames", "seeds"):
        found = info.get(key, 1 if key == "seeds" else None)
        if type(found) is not int or not 1 <= found < 2**31:
            raise NteError(f"{path}: '{key}' is {found!r:.40}, expected a whole number of at least 1")
    for key in ("exposure", "depth_scale", "fps", "spp", "reference_spp"):
        found = info.get(key, 1)
        if type(found) not in (int, float) or not 0 < found < 1e38:
            raise NteError(f"{path}: '{key}' is {found!r:.40}, expected a positive number")
    if type(info.get("clean_guides")) not in (bool, type(None)):
        found = f"{info['clean_guides']!r:.40}"
        raise NteError(f"{path}: 'clean_guides' is {found}, expected true, false or null for unknown")
    shutter = info.get("shutter", 1)
    if type(shutter) not in (int, float) or not 0 < shutter <= 1:
        raise NteError(f"{path}: 'shutter' is {shutter!r:.40}, expected the open share of the frame, in (0, 1]")
    if "cameras" in info:
        _require_cameras(path, info["cameras"], info["frames"])
    return info


def _require_cameras(path: Path, cameras: object, frames: int) -> None:
    if not isinstance(cameras, list) or len(cameras) != frames:
        found = len(cameras) if isinstance(cameras, list) else f"{cameras!r:.40}"
        raise NteError(f"{path}: 'cameras' has {found} for {frames} frames")
    for index, camera in enumerate(cameras):
        for key in ("view", "projection"):
            try:
                with np.errstate(over="ignore"):
                    matrix = np.array(camera[key], np.float32)
            except (TypeError, ValueError, KeyError, IndexError, OverflowError, RecursionError):
                matrix = np.empty(0, np.float32)
            if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
                raise NteError(f"{path}: 'cameras[{index}].{key}' is no 4x4 matrix of finite numbers")
            if np.linalg.det(matrix.astype(np.float64)) == 0:
                raise NteError(f"{path}: 'cameras[{index}].{key}' has no inverse: expected the matrix of a camera")
