"""Sequences of another renderer's EXR files, read by a channel map as frames in nte's conventions."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from nte.errors import NteError
from nte.files import is_inside
from nte.frames.channels import CHANNELS, RGB, VECTORS
from nte.frames.clip import Pixels
from nte.frames.exr import Part, read_parts
from nte.frames.exr_copy import Place
from nte.frames.frame import About, Array
from nte.importing.cameras import Camera, load_cameras
from nte.importing.channel_map import NORMALS, find_map, load_channel_map, needs_camera
from nte.importing.convert import convert_vectors, fill_unknown, to_ours, with_motion, without_misses
from nte.importing.ids import Ids
from nte.importing.inputs import Input, plan
from nte.importing.layers import Found, find, find_prefix, missing, partly_there, read, step
from nte.importing.notes import CoarseVectors, LeftInFiles, LostValues, OddValues
from nte.importing.parts import choose, outside, part_name, places, without_view
from nte.importing.sky import with_sky_motion
from nte.importing.source import Source
from nte.importing.still import with_still_geometry


class ForeignSequence:
    """Numbered EXR frames of another renderer, read by a channel map; all frames must have the first one's channels.

    source: a folder, a file, a glob pattern, or a list of files. reference: the same, without a list. map_name: a
    channel map, or the name of one that ships; overrides: `key=value` for it. choose_frames: the frame numbers of the
    whole sequence → the slice of it that is read. Raises NteError for a faulty map and for sequences that do not match.
    """

    def __init__(
        self,
        source: Path | Sequence[Path],
        map_name: Path | str,
        reference: Path | None = None,
        overrides: Sequence[str] = (),
        choose_frames: Callable[[Sequence[int]], slice] = lambda numbers: slice(None),
    ) -> None:
        self.map = find_map(map_name)
        self.how = how = load_channel_map(self.map, overrides)
        numbers, self.inputs = plan(source, reference, how)
        self.cameras: list[Camera] = []
        if how.cameras:
            typed = any(item.startswith("cameras=") for item in overrides)
            self.cameras = load_cameras(_cameras_file(self.map, how.cameras, typed), len(self))
        part = choose_frames(numbers)
        self.inputs = [replace(channel, files=channel.files[part]) for channel in self.inputs]
        self.cameras = self.cameras[part]
        self.ids = Ids()
        self.first: dict[str, tuple[Path, Found | None]] = {}
        self.left, self.odd, self.lost, self.coarse = LeftInFiles(), OddValues(), LostValues(how), CoarseVectors()

    def __len__(self) -> int:
        return len(self.inputs[0].files)

    @property
    def files(self) -> Sequence[Path]:
        """The files that hold the noisy image."""
        return self.inputs[0].files

    def frames(self) -> Iterator[dict[str, Pixels]]:
        """Read the channels (C, H, W) of every frame in nte's conventions, and make missing motion where possible.

        Raises NteError for a size that differs from the first frame's, for a channel that only some frames have, and
        for files that cannot be read.
        """
        frames = self._stored()
        if self.how.still:
            positions = [channel.files for channel in self.inputs if channel.name == "position"] or [self.files]
            frames = with_still_geometry(frames, positions[0], self.cameras)
            frames = (without_misses(frame, self.how) for frame in frames)  # which only the depth made of them tells
        return with_motion(map(fill_unknown, with_sky_motion(frames, self.cameras)))

    def about(self, index: int) -> About:
        """Return a frame's values besides channels: the shutter's open share (1,), and the camera if the map names any.

        The camera's view and projection are (1, 4, 4).
        """
        found: About = {"shutter": np.array([self.how.shutter], np.float32)}
        if self.cameras:
            found |= {key: np.array([matrix], np.float32) for key, matrix in self.cameras[index]._asdict().items()}
        return found

    def replacing(self, index: int, image: Pixels) -> dict[Place, Pixels]:
        """Encode `image` (3, H, W), in nte's units, as the file of frame `index` stores it: Place → (H, W).

        The places are those of the noisy image, or of the layer that the map calls `result`. Raises NteError if the
        noisy image is a sum of layers, and if the file has no layer of the name that `result` has.
        """
        color = self.inputs[0]
        source, path = color.source, color.files[index]
        parts = read_parts(path)
        stored, place = choose(path, parts, source), places(path, parts, source)
        layer = Source(layer=[self.how.result]) if self.how.result else source
        prefix = self._prefix(color, index, parts)
        found = find(stored, "color", layer, prefix)
        if found is None:
            raise NteError(f"{path}: no layer {' '.join(layer.layer)} for the denoised image to replace: see 'result'")
        if len(found.names) != 1:
            raise NteError(f"{path}: the noisy image is no layer of its own: name one with result=LAYER in the map")
        scale, offset = (np.reshape(np.array(n, np.float64), (-1, 1, 1)) for n in (source.scale, source.offset))
        planes = ((image - offset) / scale).astype(np.float32)
        if len(set(found.names[0])) == 1:  # a grey image
            planes = np.broadcast_to(planes.mean(0), planes.shape)
        return {place[name]: plane for name, plane in zip(found.names[0], planes, strict=True)}

    def _stored(self) -> Iterator[dict[str, Pixels]]:
        """Read the channels that every frame's files have; unknown vectors are NaN."""
        size: tuple[int, ...] | None = None
        for index in range(len(self.inputs[0].files)):
            parts: dict[Path, list[Part]] = {}
            given: dict[str, Pixels] = {}
            for channel in self.inputs:
                path = channel.files[index]
                if path not in parts:
                    parts[path] = read_parts(path)
                    self.left.look(parts[path])
                values = self._read(channel, index, parts[path])
                if values is None:
                    continue
                size = size or values.shape[1:]
                if values.shape[1:] != size:
                    found, expected = (f"{s[1]}x{s[0]}" for s in (values.shape[1:], size))
                    first = self.inputs[0].files[0]
                    raise NteError(f"{path}: '{channel.name}' is {found}, expected {expected} like {first}")
                given[channel.name] = values
            aspect = parts[self.files[index]][0].aspect
            ours = to_ours(given, self.how, self.cameras[index] if self.cameras else None, aspect)
            self.lost.look(given, ours)
            hit = ours["depth"] > 0 if "depth" in ours else True
            normals = {name: np.where(hit, given[name], 0) for name in NORMALS if name in given}  # with their NaN
            self.odd.look({**ours, **normals}, {channel.name: channel.files[index] for channel in self.inputs})
            yield ours

    def _read(self, channel: Input, index: int, parts: Sequence[Part]) -> Array:
        name, path = channel.name, channel.files[index]
        if name != "color":  # an eye's reference may be a file of one eye
            channel = replace(channel, source=without_view(parts, channel.source))
        source = channel.source
        stored = choose(path, parts, source)
        prefix = self._prefix(channel, index, parts)
        found = find(stored, name, source, prefix)
        own = replace(source, plus=[]) if channel.needed else source  # what is added may be missing, but not the layer
        if not find(stored, name, own, prefix) and (channel.needed or partly_there(stored, source, prefix)):
            raise missing(path, stored, name, source, prefix, parts)
        found = found and replace(found, part=part_name(path, parts, source))
        first_path, first = self.first.setdefault(name, (path, found))
        if found != first:
            self._refuse_change(name, (first_path, first), (path, found))
        if found is None:
            return None
        values = read(stored, name, source, found, self.how.depth.sky)
        if (empty := outside(path, parts, source, found)) is not None:
            values = np.where(empty, np.nan if name in VECTORS or CHANNELS[name].nan_means else 0, values)
        if name in VECTORS:
            pixels = convert_vectors(np.ones_like(values), getattr(self.how, name).convention())
            self.coarse.look(name, step(stored, source, found) * float(np.abs(pixels).max()))
        if name == "position":
            self.coarse.look_at_positions(step(stored, source, found))
        if CHANNELS[name].kind == "id":
            return self.ids.keep(values, half=stored[found.names[0][0]].dtype == np.float16)
        return values

    def _prefix(self, channel: Input, index: int, parts: Sequence[Part]) -> str:
        """The prefix of the layers' names in the file of frame `index` that holds `channel`.

        If the map leaves it open, the file's noisy image decides, or the channel itself where that does not fit it: in
        a file or a part of its own.
        """
        if self.how.prefix != "*":
            return self.how.prefix
        path, source = channel.files[index], channel.source
        stored = choose(path, parts, source)
        color = self.inputs[0]
        if path == color.files[index]:
            of_color = choose(path, parts, color.source)
            prefix = find_prefix(path, of_color, color.name, color.source, self.how.prefix_not)
            if not source.part or find(stored, channel.name, source, prefix):
                return prefix
        return find_prefix(path, stored, channel.name, source, self.how.prefix_not)

    def _refuse_change(self, name: str, *ends: tuple[Path, Found | None]) -> None:
        """Raise NteError for a channel that the first file (ends[0]) has in another place than a later one."""
        (has, found), (lacks, instead) = ends if ends[0][1] else ends[::-1]
        called, other = (place.called if place else "" for place in (found, instead))
        if found and instead and called == other:  # whose components have other names
            called, other = (" ".join(sum(place.names, ())) for place in (found, instead))
        there = f"there is {other} instead" if instead else "there is none"
        raise NteError(f"{lacks}: '{name}': {there}, where {has.name} has {called}: expected the same passes in each")

    @property
    def left_out(self) -> dict[str, str]:
        """Channels of the map that are not read → the camera that they lack, in words."""
        return {name: lacks for name in self.how.channels if (lacks := needs_camera(self.how, name))}

    def has(self, name: str) -> bool:
        """Tell whether the files have a channel; known only after frames have been read."""
        return self.first.get(name, (None, None))[1] is not None

    def notes(self) -> Iterable[str]:
        """List what a user should know: which layer became which channel, odd values, channels made, renumbered ids.

        Complete only after all frames have been read.
        """
        own_files = {channel.name for channel in self.inputs if channel.source.file}
        taken = (
            f"{name} from {found.called}{f' of {path.name}' if name in own_files or name == 'reference' else ''}"
            for name, (path, found) in self.first.items()
            if found
        )
        yield f"read {', '.join(taken)}"
        for name, (_, found) in self.first.items():
            if found and CHANNELS[name].components == RGB and found.names[0][0].rpartition(".")[2] in ("X", "x"):
                yield f"not converted: {name} is stored as X, Y and Z, which are shown as if they were R, G and B"
        for channel in self.inputs:
            if channel.renumbered and not channel.source.file:  # which would name it
                both = f"{channel.files[0].name} is taken for {self.files[0].name}, whose number is another"
                yield f"{channel.name}: {both}: are they the same frame?"
        yield from self.left.notes()
        yield from self.odd.notes()
        yield from self.lost.notes()
        yield from self.coarse.notes()
        if self.how.still and self.has("position"):
            made = [name for name in ("depth", "motion") if not self.has(name)]
            yield f"made from position, as if only the camera moves: {' and '.join(made) or 'nothing'}"
        elif self.has("forward_motion") and not self.has("motion"):
            yield "made from forward_motion: motion"
        if self.ids.renumbered:
            yield f"renumbered: {len(self.ids.renumbered)} ids of instance, which are no small whole numbers"
        if self.ids.rounded:
            where = f"{self.ids.rounded} pixels of instance hold ids above 2047 in half floats"
            yield f"rounded: {where}, which leave out every second one: store 32 bits"
        if self.ids.averaged:
            where = f"{self.ids.averaged} pixels of instance hold fractions beside whole ids"
            yield f"averaged: {where}, so they show no object: store ids without a pixel filter"


def _cameras_file(map_path: Path, name: str, typed: bool) -> Path:
    """The file of the cameras. A map's own key names one in its folder; who types a path may name any.

    What is typed lies in the current folder, else beside the map. Raises NteError for a map that leads elsewhere.
    """
    beside = map_path.parent / name
    if typed:
        return Path(name) if Path(name).is_file() else beside
    if not is_inside(beside, map_path.parent):
        raise NteError(
            f"{map_path}: 'cameras' is '{name}', which leads out of {map_path.parent}: expected a file in that folder; "
            "the command line may name any (cameras=FILE)"
        )
    return beside
