"""`nte import noisebase`: per-sample data, zarr in a zip file, which is reduced to pixels.

Each pixel has S samples, with positions, motion (to the previous frame's position) and normals in world space.
`view_proj_mat` is for row vectors, with normalised device coordinates in [−1, 1] and y up over the whole rendering;
the images may be crops of the rendering, whose offset changes from frame to frame.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.clip import Pixels
from nte.importing.cameras import Camera
from nte.importing.channel_map import Vectors
from nte.importing.convert import unit
from nte.importing.exr import Imported
from nte.importing.noisebase_files import NoisebaseSequence
from nte.importing.notes import OddValues
from nte.importing.sky import OUTSIDE, motion_at_infinity, pixel_centres
from nte.importing.write import refuse_existing, write_imported

Floats = npt.NDArray[np.float64]
_PER_SAMPLE = ("position", "motion", "normal", "diffuse")
_CHUNK = 4  # samples read at a time: the files' own chunks; a 1080p frame of 32 samples then fits into memory
_OWN_PIXEL = 1.0  # px: largest distance between a sample's projected position and its pixel's centre
_ENOUGH = 100  # least number of pixels that can measure the rendering's size and the crop's place


class Surface(NamedTuple):
    """The visible surface of each pixel: position from its most central sample, the rest as means over samples."""

    hit: npt.NDArray[np.bool_]  # (H, W)
    position: Floats  # (3, H, W), world
    before: Floats  # (3, H, W), world: the same point in the previous frame
    normal: Pixels  # (3, H, W), world, unit length; 0 without a hit
    albedo: Pixels  # (3, H, W), in [0, 1]


def import_noisebase(source: Path, out: Path, spp: int = 1, force: bool = False) -> Imported:
    """Import a sequence (a zip file, or a folder with a zip per frame) as the clip `out`.

    spp: the number of stored samples per pixel that `color` averages. force: replace a clip that exists at `out`.
    Raises NteError for faulty files, for more spp than are stored, and for an `out` that exists without `force` or
    that is not a clip.
    """
    refuse_existing(out, force)
    sequence = NoisebaseSequence(source)
    if not 1 <= spp <= sequence.samples:
        raise NteError(f"{source}: has {sequence.samples} samples per pixel, {spp} are asked for")
    cameras = _cameras(sequence)
    odd = OddValues()
    frames = _frames(sequence, cameras, spp, odd)
    write_imported(out, frames, sequence.frames, "noisebase", cameras, force, spp=spp)
    return Imported(out, Vectors(), notes=list(odd.notes()))


def decode_rgbe(color: npt.NDArray[np.uint8], exposure: Pixels) -> Pixels:
    """Decode radiance (3, …) from color (4, …) uint8: three mantissas in units of 1/255, and an exponent.

    The exponent (e + 1)/256 interpolates the logarithm of the scale in the range `exposure` (2,).
    """
    low, high = (float(e) for e in exposure)
    scale = np.exp((color[3].astype(np.float32) + 1) / 256 * (high - low) + low)
    return np.asarray(color[:3] / np.float32(255) * scale, np.float32)


def _frames(
    sequence: NoisebaseSequence, cameras: list[Camera], spp: int, odd: OddValues
) -> Iterator[dict[str, Pixels]]:
    for frame, camera in enumerate(cameras):
        surface = _surface(sequence, frame, camera)
        seen = decode_rgbe(sequence.read(frame, "color", slice(0, spp)), sequence.read(frame, "exposure"))
        depth = np.einsum("j,jhw->hw", camera.view[2, :3], surface.position) + camera.view[2, 3]
        hit = surface.hit
        channels = {
            "color": seen.mean(-1),
            "reference": sequence.read(frame, "reference").astype(np.float32),
            "albedo": surface.albedo,
            "normal": surface.normal * hit,
            "depth": np.where(hit, depth, 0)[None].astype(np.float32),
            "position": (surface.position * hit).astype(np.float32),
            "motion": _motion(surface, camera, cameras[frame - 1] if frame else None),
        }
        odd.look(channels, dict.fromkeys(channels, sequence.path(frame)))
        yield channels


def _surface(sequence: NoisebaseSequence, frame: int, camera: Camera) -> Surface:
    """Reduce the samples of every pixel to one surface. A pixel is hit if at least half of its samples are.

    A sample is a hit if it has a normal and its position projects into its own pixel; a renderer's miss does neither.
    """
    size = sequence.height, sequence.width
    centres = pixel_centres(size)
    normal, albedo, position, before = np.zeros((4, 3, *size))
    hits, nearest = np.zeros(size, int), np.full(size, np.inf)
    for start in range(0, sequence.samples, _CHUNK):
        some = slice(start, min(start + _CHUNK, sequence.samples))
        read = (np.moveaxis(sequence.read(frame, name, some), -1, 0) for name in _PER_SAMPLE)
        for point, motion, sample_normal, diffuse in zip(*read, strict=True):
            distance = np.abs(project(point, camera, size) - centres).max(0)
            hit = (distance < _OWN_PIXEL) & sample_normal.any(0)
            closer = hit & (distance < nearest)
            nearest = np.where(closer, distance, nearest)
            position = np.where(closer, point, position)
            before = np.where(closer, point.astype(np.float64) + motion, before)
            hits += hit
            normal += np.where(hit, sample_normal, 0)
            albedo += diffuse
    mean_albedo = np.clip(albedo / sequence.samples, 0, 1).astype(np.float32)
    return Surface(2 * hits >= sequence.samples, position, before, unit(normal).astype(np.float32), mean_albedo)


def _motion(surface: Surface, camera: Camera, previous: Camera | None) -> Pixels:
    """Pixel vectors (2, H, W), current → previous: of the surface point, or of the ray where nothing is hit.

    A vector starts at the sample's own place in the pixel, so it contains no jitter. The first frame has no history,
    so its vectors are 0.
    """
    size = surface.hit.shape
    if previous is None:
        return np.zeros((2, *size), np.float32)
    then = project(surface.before, previous, size)
    motion = np.where(np.isnan(then), OUTSIDE * max(size), then - project(surface.position, camera, size))
    sky = motion_at_infinity(camera.to_pixels(size), previous.to_pixels(size), size)
    return np.where(surface.hit, motion, sky).astype(np.float32)


def project(points: Floats, camera: Camera, size: tuple[int, ...]) -> Floats:
    """Project world points (3, H, W) to pixel positions (2, H, W), x first; NaN behind the camera.

    size: (height, width) of the image in pixels.
    """
    matrix = camera.to_pixels(size)
    with np.errstate(invalid="ignore", over="ignore"):  # a miss may hold any value, even infinity
        x, y, w = np.tensordot(matrix[:, :3], points, 1) + matrix[:, 3].reshape(3, 1, 1)
        return np.stack([x, y]) / np.where(w > 0, w, np.nan)


def _cameras(sequence: NoisebaseSequence) -> list[Camera]:
    """Measure the camera of every frame's crop, for column vectors.

    The files do not store the rendering's size, nor reliably the crop's place in it (the authors' own loader of test
    data replaces `crop_offset`). Both follow from the samples, each of which projects into its own pixel.
    """
    size = sequence.height, sequence.width
    views = [_view(sequence, frame) for frame in range(sequence.frames)]
    screens = (_screen(sequence, frame) for frame in range(sequence.frames))
    scale: Floats | None = None  # pixels of the whole rendering, (2,)
    offset = np.zeros(2)
    cameras = []
    for frame, (view, (uv, centres)) in enumerate(zip(views, screens, strict=True)):
        if uv.shape[1] >= _ENOUGH:
            if scale is None:
                scale = np.array([_slope(u, at) for u, at in zip(uv, centres, strict=True)])
            apart = scale[:, None] * uv - centres
            offset = np.median(apart, axis=1).round()
            off = np.median(np.abs(apart - offset[:, None]))
            if not off < _OWN_PIXEL or (scale < size[::-1]).any():
                raise NteError(
                    f"{sequence.path(frame)}: frame {frame}: positions are not seen in their own pixels: expected "
                    "'view_proj_mat' for row vectors, and 'position' in world space"
                )
        elif scale is None:
            raise NteError(
                f"{sequence.path(frame)}: frame {frame}: no surface is seen in the image: expected one in the first "
                "frame, and 'view_proj_mat' for row vectors"
            )
        # [−1, 1] with y up → pixels of the whole rendering → [0, 1] of the crop with y down
        to_crop = np.eye(4)
        to_crop[0, [0, 3]] = np.array([scale[0] / 2, scale[0] / 2 - offset[0]]) / size[1]
        to_crop[1, [1, 3]] = np.array([-scale[1] / 2, scale[1] / 2 - offset[1]]) / size[0]
        world_to_clip = sequence.read(frame, "view_proj_mat").astype(np.float64).T
        cameras.append(Camera(view, to_crop @ world_to_clip @ np.linalg.inv(view)))
    return cameras


def _view(sequence: NoisebaseSequence, frame: int) -> Floats:
    """World to view space: x to the right, y up, z forward."""
    position, target, up = (
        sequence.read(frame, f"camera_{name}").astype(np.float64) for name in ("position", "target", "up")
    )
    forward = unit(target - position)
    right = unit(np.cross(forward, up))
    view = np.eye(4)
    view[:3, :3] = right, np.cross(right, forward), forward
    view[:3, 3] = -view[:3, :3] @ position
    if not np.isfinite(view).all() or abs(np.linalg.det(view)) < 0.5:
        raise NteError(f"{sequence.path(frame)}: frame {frame}: the camera's position, target and up give no view")
    return view


def _screen(sequence: NoisebaseSequence, frame: int) -> tuple[Floats, Floats]:
    """First samples in [0, 1] over the whole rendering, y down, and their pixels' centres, both (2, K)."""
    points, normals = (sequence.read(frame, name, slice(0, 1))[..., 0] for name in ("position", "normal"))
    to_uv = np.diag([0.5, -0.5, 1, 1])
    to_uv[:2, 3] = 0.5
    camera = Camera(np.eye(4), to_uv @ sequence.read(frame, "view_proj_mat").astype(np.float64).T)
    uv = project(points, camera, (1, 1))
    usable = (np.abs(uv - 0.5) < 1).all(0) & normals.any(0)
    return uv[:, usable], pixel_centres(usable.shape)[:, usable]


def _slope(u: Floats, at: Floats) -> float:
    """The whole number of pixels over which u runs from 0 to 1: a line, fitted again without its outliers."""
    line = np.polyfit(u, at, 1)
    off = np.abs(np.polyval(line, u) - at)
    near = off <= 2 * np.median(off) + _OWN_PIXEL
    return float(np.polyfit(u[near], at[near], 1)[0].round())
