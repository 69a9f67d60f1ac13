"""Reader of noisebase's zip files: zarr arrays of one sequence, or of one frame each."""

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from nte.errors import NteError, needs_extra
from nte.importing.files import numbered_files

# array → its shape within a frame; the arrays of a sequence have a leading axis of frames
ARRAYS: dict[str, tuple[int | str, ...]] = {
    "color": (4, "H", "W", "S"), "exposure": (2,), "reference": (3, "H", "W"), "position": (3, "H", "W", "S"),
    "motion": (3, "H", "W", "S"), "normal": (3, "H", "W", "S"), "diffuse": (3, "H", "W", "S"),
    "camera_position": (3,), "camera_target": (3,), "camera_up": (3,), "view_proj_mat": (4, 4),
}  # fmt: skip

_Arrays: TypeAlias = Any  # a dictionary of zarr arrays, which need not be installed
_Store: TypeAlias = Any  # the zarr store that they are in


class NoisebaseSequence:
    """Random access to the frames of a sequence: one zip file with all frames, or a folder with one zip file a frame.

    Raises NteError for files that cannot be read, arrays that are missing and shapes that do not fit.
    """

    def __init__(self, source: Path) -> None:
        self._files = list(numbered_files(source, ".zip").values())
        self._open: tuple[Path, _Store, _Arrays] | None = None
        color = self._arrays(self._files[0])["color"]
        self.in_one_file = color.ndim == len(ARRAYS["color"]) + 1
        if self.in_one_file and len(self._files) > 1:
            raise NteError(f"{source}: holds {len(self._files)} sequences: import one of the files at a time")
        self.frames = int(color.shape[0]) if self.in_one_file else len(self._files)
        self.height, self.width, self.samples = map(int, color.shape[-3:])

    def path(self, frame: int) -> Path:
        """Return the file that holds a frame."""
        return self._files[0] if self.in_one_file else self._files[frame]

    def read(self, frame: int, name: str, samples: slice | None = None) -> npt.NDArray[Any]:
        """Read one frame of an array, without the frame axis; `samples` chooses along the last axis.

        Raises NteError for an array that is missing, has another shape or is damaged.
        """
        path = self.path(frame)
        arrays = self._arrays(path)
        sizes: dict[int | str, int] = {"H": self.height, "W": self.width, "S": self.samples}
        expected = tuple(sizes.get(n, n) for n in ARRAYS[name])
        lead = (self.frames,) if self.in_one_file else ()
        if name not in arrays:
            raise NteError(f"{path}: array '{name}' is missing; the file has {', '.join(sorted(arrays)) or 'none'}")
        array = arrays[name]
        if array.shape != (*lead, *expected):
            raise NteError(f"{path}: '{name}' has the shape {array.shape}, expected {(*lead, *expected)}")
        if array.dtype.kind not in "fiu":  # objects may be pickled: a codec of old numcodecs runs what is in them
            raise NteError(f"{path}: '{name}' has the type {array.dtype}, expected numbers")
        if name == "color" and array.dtype != np.uint8:
            raise NteError(f"{path}: 'color' has the type {array.dtype}, expected uint8: mantissas and an exponent")
        index = [*([frame] if lead else []), ..., *([samples] if samples else [])]
        try:
            return np.asarray(array[tuple(index)])
        except Exception as error:  # zarr and its codecs raise many kinds of errors for damaged chunks
            raise NteError(f"{path}: '{name}' is damaged in frame {frame}: copy the file again") from error

    def _arrays(self, path: Path) -> _Arrays:
        """The zarr arrays of a file, by name; the last file stays open."""
        if self._open and self._open[0] == path:
            return self._open[2]
        try:
            import zarr
        except ImportError as error:
            raise needs_extra("import", "noisebase data", error) from error
        if self._open:
            self._open[1].close()
            self._open = None
        try:
            store = zarr.storage.ZipStore(path, mode="r")
            arrays = dict(zarr.open_group(store, mode="r").arrays())
        except Exception as error:  # zarr raises many kinds of errors for damaged metadata
            raise NteError(f"{path}: not a readable zarr zip file: copy it again, or choose the right file") from error
        if "color" not in arrays or arrays["color"].ndim not in (4, 5):
            have = ", ".join(sorted(arrays)) or "none"
            raise NteError(f"{path}: no array 'color' of 4 or 5 axes: expected noisebase's layout; it has {have}")
        self._open = path, store, arrays
        return arrays
