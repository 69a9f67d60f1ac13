"""The user's cache: what a provider makes of a model once, and finds again at the next start."""

import os
from hashlib import sha256
from pathlib import Path


def cache_folder(provider: str) -> Path:
    """Return the folder of a provider: below XDG_CACHE_HOME, or ~/.cache. It need not be there."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "nte" / provider


def engine_options(path: Path) -> dict[str, str]:
    """Return the options by which TensorRT keeps its engines of the model at `path`, which take minutes to build.

    {} where the cache cannot be written to. TensorRT tells engines of other GPUs, versions and sizes apart, but not
    those of other weights: so each model has a folder of its own, which is named after its checksum.
    """
    folder = cache_folder("tensorrt") / sha256(path.read_bytes()).hexdigest()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # a home that cannot be written to, a full disk
        return {}
    return {"trt_engine_cache_enable": "1", "trt_engine_cache_path": str(folder)}
