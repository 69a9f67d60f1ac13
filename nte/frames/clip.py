"""A clip on disk: a folder with clip.json and one layered OpenEXR file per frame."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.channels import CHANNELS
from nte.frames.clip_files import frame_path
from nte.frames.clip_info import read_clip_info
from nte.frames.exr import HALF_MAX, HALF_TINY, read_exr, write_exr
from nte.frames.frame import About, Frame

Pixels = npt.NDArray[np.float32]
_OF_ONE_SAMPLE = ("indirect_radiance", "indirect_direction", "time", "shutter_motion", "shutter_depth")


def write_frame(path: Path, channels: Mapping[str, Pixels]) -> None:
    """Write channels, each (C, H, W), as one layered OpenEXR file that is whole or absent.

    Raises NteError if the file cannot be written.
    """
    write_exr(path, as_layers(channels))


def as_layers(channels: Mapping[str, Pixels]) -> dict[str, npt.NDArray[np.floating]]:
    """Convert channels, each (C, H, W), to the layers that are stored: full layered name → (H, W).

    A layer has half floats if the table of channels says so and `half_keeps` holds for its values; else float32.
    """
    layers: dict[str, npt.NDArray[np.floating]] = {}
    for name, values in channels.items():
        row = CHANNELS[name]
        half = row.storage == "half" and half_keeps(values, dark_counts=row.kind == "radiance")
        for component, plane in zip(row.components, values, strict=True):
            layers[f"{name}.{component}"] = plane.astype(np.float16 if half else np.float32)
    return layers


def half_keeps(values: Pixels, dark_counts: bool) -> bool:
    """Tell whether half floats can hold the values: none is beyond 65504 and, if dark_counts, no dark one is lost.

    Half floats keep a value above 6e-5 with a relative error of 5e-4, a smaller one with an absolute error of 3e-8,
    and none below 3e-8. A dark value counts as lost if its error is more than 1e-3 of itself and more than 1e-6 m,
    where m is the geometric mean of the image: a path-traced frame always has a few pixels of a millionth of the
    mean, which nobody sees.
    """
    sizes = np.abs(values)
    finite = np.isfinite(sizes)
    if (sizes[finite] > HALF_MAX).any():
        return False
    dark = sizes[(sizes > 0) & (sizes < HALF_TINY)]
    if not dark_counts or not dark.size:
        return True
    mean = np.exp(np.log(sizes[finite & (sizes > 0)], dtype=np.float64).mean())
    lost = np.abs(dark.astype(np.float16) - dark)
    return bool((lost <= 1e-3 * np.maximum(dark, 1e-3 * mean)).all())


def read_frame(path: Path, size: tuple[int, int] | None = None) -> dict[str, Pixels]:
    """Read a frame's channels, each (C, H, W) float32: all that the table of channels has; other layers are ignored.

    size: the (height, width) that the file must have; a file of another size raises NteError before its pixels are
    read. Also raises NteError for a file that cannot be read, and for a channel that lacks some of its components.
    """
    return assemble(path, read_exr(path, size))


def assemble(path: Path, layers: Mapping[str, Pixels]) -> dict[str, Pixels]:
    """Collect layers (full layered name → (H, W)) into the table's channels, each (C, H, W).

    A missing `reference` becomes the mean of reference_a and reference_b. Raises NteError, naming `path`, for a
    channel that lacks some of its components.
    """
    found: dict[str, Pixels] = {}
    for name, row in CHANNELS.items():
        planes = [layers[key] for c in row.components if (key := f"{name}.{c}") in layers]
        if len(planes) == len(row.components):
            found[name] = np.stack(planes)
        elif planes:
            have = ", ".join(sorted(key for key in layers if key.startswith(f"{name}.")))
            raise NteError(f"{path}: channel '{name}' has only {have}: expected {', '.join(row.components)}")
    if "reference" not in found and "reference_a" in found and "reference_b" in found:
        found["reference"] = (found["reference_a"] + found["reference_b"]) * np.float32(0.5)
    return found


class Clip:
    """A sequence of frames on disk, read lazily.

    Raises NteError if the folder has no clip.json, if clip.json is not a valid one of nte, or if a frame is missing.

    >>> clip = nte.Clip("data/clips/disc_000")
    >>> len(clip), clip.height, clip.width
    (4, 40, 56)
    >>> clip.frame(1, ["color", "motion"])["motion"].shape
    (1, 2, 40, 56)
    >>> len([frame for frame in clip])
    4
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self.info = read_clip_info(self.folder)
        self.height, self.width = int(self.info["height"]), int(self.info["width"])
        self.frames = int(self.info["frames"])
        self._last_forward: tuple[int, Pixels] | None = None  # so that reading in order opens each file once
        for seed in range(self.seeds):
            paths = (frame_path(self.folder, i, seed) for i in range(self.frames))
            if path := next((path for path in paths if not path.is_file()), None):  # the first is enough
                raise NteError(
                    f"{path}: missing; clip.json promises {self.frames} frames: copy it there, or render or import the "
                    "clip again"
                )

    def __len__(self) -> int:
        return self.frames

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(i) for i in range(self.frames))

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.resolve().name

    @property
    def seeds(self) -> int:
        """How many independent noise seeds are stored."""
        return int(self.info.get("seeds", 1))

    @property
    def clean_guides(self) -> bool | None:
        """Whether albedo and normal are free of noise, as clip.json says; those of `nte render` are. None: unknown."""
        origin = self.info.get("origin")
        ours = isinstance(origin, dict) and origin.get("generator") == "nte render"
        said: bool | None = self.info.get("clean_guides", True if ours else None)
        return said

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """The channels that frames have, read from the first file; derived channels are included."""
        found = tuple(self._read(frame_path(self.folder, 0)))
        return (*found, "previous_forward_motion") if "forward_motion" in found else found

    def frame(self, index: int, channels: Iterable[str] | None = None, seeds: Sequence[int] = (0,)) -> Frame:
        """Read frame `index` with the named channels (None: all it has) as arrays (1, C, H, W) float32.

        Noisy channels are the mean over `seeds`, so k seeds give k times the samples per pixel. Where a NaN says that a
        seed has no value, as that of a shadow's vector in an unshadowed pixel, the mean is over the other seeds.
        Channels that describe one sample together (a direction and the light from there; a time, with motion and depth
        then) have no mean, and are those of the first of the seeds.
        previous_forward_motion comes from the file of the previous frame; it is NaN (unknown) on frame 0.
        Raises NteError, naming the file, for a channel that is missing or a size that differs from clip.json.
        """
        path = frame_path(self.folder, index)
        wanted = self.channels if channels is None else tuple(channels)
        stored = self._read(path)
        previous_forward = self._previous_forward_motion(index) if "previous_forward_motion" in wanted else None
        if "forward_motion" in stored:
            self._last_forward = index, stored["forward_motion"]
        noisy = [name for name in wanted if name in CHANNELS and CHANNELS[name].noisy]
        paths = [frame_path(self.folder, index, seed) for seed in seeds if seed]
        others = [(other, self._read(other)) for other in paths]
        arrays: dict[str, Pixels] = {}
        for name in wanted:
            if previous_forward is not None and name == "previous_forward_motion":
                arrays[name] = previous_forward
            elif name in noisy and others:
                sources = [*([(path, stored)] if 0 in seeds else []), *others]
                arrays[name] = _mean_of_seeds(name, [self._pick(read, name, file) for file, read in sources])
            else:
                arrays[name] = self._pick(stored, name, path)
        return Frame({name: a[None] for name, a in arrays.items()}, index=index, **self._about(index))

    def stamps(self, seeds: Iterable[int] = (0,)) -> list[tuple[str, int, int]]:
        """Return name, size in bytes and time of modification in ns of each frame's file, for each of some noise seeds.

        They tell whether pixels may have changed, and read none. Raises NteError for a file that cannot be read.
        """
        paths = [frame_path(self.folder, index, seed) for seed in seeds for index in range(len(self))]
        try:
            return [(path.name, (stat := path.stat()).st_size, stat.st_mtime_ns) for path in paths]
        except OSError as error:
            raise NteError(f"{error.filename}: cannot be read: {error.strerror}") from error

    def _read(self, path: Path) -> dict[str, Pixels]:
        return read_frame(path, (self.height, self.width))

    def _pick(self, stored: Mapping[str, Pixels], name: str, path: Path) -> Pixels:
        if name not in stored:
            raise NteError(f"{path}: channel '{name}' is missing; the file has {', '.join(stored) or 'none'}")
        return stored[name]

    def _previous_forward_motion(self, index: int) -> Pixels:
        if index == 0:
            return np.full((2, self.height, self.width), np.nan, np.float32)
        last = self._last_forward  # once: another thread may read frames of the same clip
        if last and last[0] == index - 1:
            return last[1]
        path = frame_path(self.folder, index - 1)
        return self._pick(self._read(path), "forward_motion", path)

    def _about(self, index: int) -> About:
        """The scalars and the camera that clip.json has for a frame, with a batch axis."""
        about: About = {"clean_guides": self.clean_guides}
        for key in ("exposure", "depth_scale", "shutter"):
            if key in self.info:
                about[key] = np.array([self.info[key]], np.float32)
        if "cameras" in self.info:
            camera = self.info["cameras"][index]
            about |= {k: np.array([camera[k]], np.float32) for k in ("view", "projection")}
        return about


def _mean_of_seeds(name: str, seeds: Sequence[Pixels]) -> Pixels:
    """The mean (C, H, W) of a noisy channel over its seeds; see `Clip.frame`."""
    if name in _OF_ONE_SAMPLE:
        return seeds[0]
    if not CHANNELS[name].nan_means:
        return np.asarray(np.mean(seeds, 0, dtype=np.float32))
    known = ~np.isnan(seeds)
    count = known.sum(0, dtype=np.float32)
    total = np.where(known, seeds, 0).sum(0, dtype=np.float32)
    return np.where(count > 0, total / count.clip(min=1), np.float32(np.nan))
