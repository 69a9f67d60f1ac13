"""The pixels of a clip on their way to the viewer: what each image shows, and which frames are kept."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from nte.files import remove
from nte.frames.channels import CHANNELS
from nte.frames.clip import Clip
from nte.frames.scalars import sequence_scalars
from nte.frames.show import scale_of
from nte.viewer.layer_file import Values, type_of, write_layer

FOLDER = "layers"  # beside the page
REFERENCE, INPUT = "reference", "noisy input"
BRIGHTENED = {"indirect": 10.0}  # indirect light is a small part of a picture; papers print it ten times as bright

Entry: TypeAlias = dict[str, Any]  # what the page knows of a clip or a layer, as JSON
Group = Literal["image", "flip", "extra", "channel", "kernel"]

KERNEL_BYTES = 256_000_000  # for a denoiser's kernels on a clip, as half floats: two frames of 1280×720, or 33 of 256²


@dataclass(frozen=True)
class Layer:
    """What an image shows.

    group: an image that is compared, its FLIP map, another output of a denoiser, a channel, or kernels, which are no
    image: the numbers of a pixel are a square of weights, row by row, and others with names.
    """

    group: Group
    of: str  # the denoiser's specification, "reference", "noisy input", or the channel
    channel: str  # what it shows: a target, a channel, or the name of an extra or a kernel
    every: int = 1  # of kernels: so many pixels of the image share one, along each axis
    further: tuple[str, ...] = ()  # of kernels: the names of the numbers after the square

    @property
    def shown(self) -> str:
        """How the values become a picture; see `nte.frames.channels.Channel.shown`."""
        row = CHANNELS.get(self.channel)
        return "" if row is None else row.shown


@dataclass(frozen=True)
class Recording:
    """What of a clip is recorded. span: so many frames around the chosen one, None for all from `first` to `last`."""

    folder: Path  # FOLDER beside the page
    span: int | None = None
    channels: tuple[str, ...] | None = None  # None: all
    extras: bool = False  # the further outputs of denoisers as well, and kernels
    first: int = 0
    last: int | None = None


@dataclass
class Recorder:
    """Writes the layers of one clip as its frames come, and keeps a list of them: `entry`."""

    recording: Recording
    label: str  # the clip's name
    size: tuple[int, int]  # (height, width)
    frames: int  # in the clip
    exposure: float
    notes: list[str] = field(default_factory=list)  # what the page says about the clip: what failed, what is not there
    failed: dict[str, str] = field(default_factory=dict)  # denoisers that were dropped, and why
    _there: dict[Layer, "_Kept"] = field(default_factory=dict)
    _centre: int | None = None

    def wants(self, index: int) -> bool:
        """Tell whether the frame is in the range that is recorded."""
        return self.recording.first <= index <= (self.frames if self.recording.last is None else self.recording.last)

    def add(self, index: int, layer: Layer, values: Values) -> None:
        """Write an image (C, H, W), float or uint8, of frame `index`; frames come in order."""
        size = tuple(-(-length // layer.every) for length in self.size)
        if not self.wants(index) or values.shape[1:] != size:
            return
        kept = self._there.setdefault(layer, _Kept(slug(layer.group, layer.of, layer.channel)))
        if values.dtype == np.uint8:
            kept.picture = len(values) == 3
        else:
            values = np.asarray(values, np.float32)
            if layer.group != "kernel" and layer.shown not in ("radiance", "reflectance", "labels"):
                kept.scale = max(kept.scale, scale_of(layer.channel, values))
        kept.components, kept.frames = len(values), [*kept.frames, index]
        name = f"{self.folder.name}/{kept.key}/{index:04d}"
        write_layer(self._path(kept, index), name, values, type_of(layer.channel, values))

    def keeps_kernels(self, index: int, spec: str, size: int) -> bool:
        """Tell whether a denoiser's kernels of frame `index` are kept, which take `size` bytes.

        They are many times as large as an image. So they are kept of the chosen frame and those that follow, as many as
        KERNEL_BYTES has room for; those of frames before it are deleted.
        """
        if self._centre is None or not self.recording.extras:
            return False
        start, room = max(self._centre, self.recording.first), KERNEL_BYTES // size
        if not room:
            much, most = (f"{number / 1e6:.0f} MB" for number in (size, KERNEL_BYTES))
            note = f"The kernels of {spec} are not kept: those of one frame take {much}, more than {most}."
            self.notes += [] if note in self.notes else [note]
        layers = [layer for layer in self._there if (layer.group, layer.of) == ("kernel", spec)]
        self._keep(lambda frame: frame >= start, layers)
        return start <= index < start + room

    def centre(self, index: int) -> None:
        """Choose the frame that is in the middle of the span."""
        self._centre = index

    def end_frame(self, index: int) -> None:
        """Delete the frames that are too far from the chosen one, and too far back to be near a later one."""
        span = self.recording.span
        if span is not None:
            centre = index if self._centre is None else self._centre
            self._keep(lambda f: centre - span < f < centre + span or f > index - span)

    def end(self) -> None:
        """Delete all but the span: the chosen frame is in its middle, or nearer to where the clip begins or ends."""
        span = self.recording.span
        if span is not None and self._centre is not None:
            start = max(0, min(self._centre - span // 2, self.frames - span))
            self._keep(lambda f: start <= f < start + span)

    def _keep(self, wanted: Callable[[int], bool], layers: Iterable[Layer] | None = None) -> None:
        for kept in [self._there[layer] for layer in (self._there if layers is None else layers)]:
            for index in kept.frames:
                if not wanted(index):
                    remove(self._path(kept, index))
            kept.frames = [index for index in kept.frames if wanted(index)]

    def drop(self, spec: str, why: str) -> None:
        """Take the images of a denoiser away, and note why."""
        self.failed[spec] = why
        self.notes.append(f"{spec} failed: {why}")
        for layer in [layer for layer in self._there if layer.of == spec]:
            kept = self._there.pop(layer)
            for index in kept.frames:
                remove(self._path(kept, index))

    def entry(self) -> Entry:
        """Describe the clip for the page, as JSON."""
        frames = sorted({index for kept in self._there.values() for index in kept.frames})
        return {
            "name": self.label,
            "folder": self.folder.name,
            "height": self.size[0],
            "width": self.size[1],
            "frames": frames,
            "count": self.frames,
            "chosen": self._centre,
            "exposure": self.exposure,
            "notes": self.notes,
            "layers": [
                _described(layer, kept, frames) for layer, kept in self._there.items() if kept.frames or not frames
            ],
        }

    @property
    def folder(self) -> Path:
        """The folder of the clip's layers."""
        return self.recording.folder / slug(self.label)

    def _path(self, kept: "_Kept", index: int) -> Path:
        return self.folder / kept.key / f"{index:04d}.js"


@dataclass
class _Kept:
    """The frames of a layer that are on disk."""

    key: str  # its folder's name
    frames: list[int] = field(default_factory=list)
    scale: float = 0.0  # the largest over the frames
    components: int = 0
    picture: bool = False  # sRGB of 8 bits


def _described(layer: Layer, kept: _Kept, frames: list[int]) -> Entry:
    row = CHANNELS.get(layer.channel)
    shown = layer.shown or {1: "heat", 2: "motion"}.get(kept.components, "radiance")
    if kept.picture or layer.group == "flip":
        row, shown = None, "picture" if kept.picture else "flip"
    components = list(row.components) if row else list("RGB" if kept.picture else "XYZ"[: kept.components])
    if layer.group == "kernel":
        shown, components = "kernel", ["" for _ in range(kept.components - len(layer.further))] + [*layer.further]
    return {
        "key": kept.key,
        "group": layer.group,
        "of": layer.of,
        "channel": layer.channel,
        "shown": shown,
        "unit": row.unit if row else "",
        "components": components,
        "every": layer.every,
        "scale": kept.scale or 1.0,
        "brightened": BRIGHTENED.get(layer.channel.removeprefix("reference_"), 1.0) if shown == "radiance" else 1.0,
        "frames": None if kept.frames == frames else kept.frames,
    }


def titled(entry: Entry, titles: Mapping[str, str]) -> Entry:
    """Return the description of a clip with denoisers called by their titles (spec → title)."""
    layers = [{**layer, "of": titles.get(layer["of"], layer["of"])} for layer in entry["layers"]]
    return {**entry, "layers": layers}


def slug(*names: str) -> str:
    """Make the name of a folder from any texts; texts that differ give names that differ."""
    text = "_".join(dict.fromkeys(names))
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")[:40]
    return plain if plain == text else f"{plain}_{sha256(text.encode()).hexdigest()[:8]}"


def recorder_of(recording: Recording, label: str, clip: Clip) -> Recorder:
    """Make the recorder of a clip; its exposure is the clip's own, or that of its first frame."""
    return Recorder(recording, label, (clip.height, clip.width), len(clip), exposure_of(clip))


def exposure_of(clip: Clip) -> float:
    """Return the linear factor of a clip: its own, or estimated from the first noisy frame; 1 if it has neither."""
    if "exposure" in clip.info:
        return float(clip.info["exposure"])
    return float(sequence_scalars(clip.frame(0, ["color"]))[0][0]) if "color" in clip.channels else 1.0
