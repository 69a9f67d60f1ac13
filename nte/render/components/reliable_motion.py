"""Motion of what a surface shows instead of the surface: its shadow, and the reflection in it.

What rays of Mitsuba have met, handed to the functions of `nte.motion.reliable` as images of float64. Every vector
starts at the point in the pixel that the path has really hit, so that the camera's jitter is not in it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nte.motion.reliable import mirror_image, reflection_covariance, reflection_motion, shadow_motion
from nte.render.engine.places import Indices
from nte.render.engine.stage import Moment, Timeless
from nte.render.passes.projection import eye, pixel_positions
from nte.render.passes.rays import Hits, curvatures_at, normals_at, points_at, trace_film
from nte.render.world.scene import Pixels
from nte.render.world.transforms import Floats

Rows = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Shadow:
    """What the shadow rays met, one row per pixel."""

    receiver: Hits
    blocker: Hits
    light: Indices  # (P,) the light's instance; 0 where it has none
    light_point: Floats  # (P, 3) world
    blocked: Rows  # (P,)


@dataclass(frozen=True)
class Bounce:
    """What the paths met, one row per pixel."""

    first: Hits
    second: Hits
    reflected: Rows  # (P,) whether a lobe other than the diffuse one has reflected the path


@dataclass(frozen=True)
class Mirrored:
    """Where mirrors show what the reflected paths met."""

    first: Hits  # the reflectors, one row per pixel
    image: Floats  # (P, 3) world, at the time before; NaN where nothing is shown or no path was reflected


def shadow_vectors(stage: Timeless, shadow: Shadow, time: float) -> Pixels:
    """Compute shadow_motion (2, H, W), pixels, to where the same shadow was at time − 1; NaN where there is none.

    shadow: what the shadow rays of `time`, in frames, have met. Needs no rays.
    """
    light = stage.places.moved(shadow.light, shadow.light_point, time, time - 1)
    blocker, point = (points_at(stage, hits, time - 1) for hits in (shadow.blocker, shadow.receiver))
    light, blocker, point = (_only(shadow.blocked, points) for points in (light, blocker, point))
    normal = normals_at(stage, shadow.receiver, time - 1)
    source, b, s, n = (_image(stage, values) for values in (light, blocker, point, normal))
    view, projection = _camera(stage, time - 1)
    return _pixels(shadow_motion(source, b, s, n, view, projection, _position(stage, shadow.receiver, time)))


def mirror_images(stage: Timeless, bounce: Bounce, time: float) -> Mirrored:
    """Find where the reflectors show, at time − 1, what the paths of `time` have met: `mirror_image`. Needs no rays."""
    first, second = bounce.first, bounce.second
    point, target = points_at(stage, first, time - 1), points_at(stage, second, time - 1)
    distant = second.instance == 0
    target[distant] = point[distant] + stage.distant * target[distant]
    normal = normals_at(stage, first, time - 1)
    camera = torch.from_numpy(eye(stage, time - 1).copy())[None]
    rows = np.asarray(bounce.reflected)  # few pixels reflect: only those are computed
    h, s, n, bend = (
        _line(values[rows]) for values in (target, point, normal, curvatures_at(stage, first, time - 1).reshape(-1, 9))
    )
    image = mirror_image(h, s, n, camera, bend.view(1, 3, 3, 1, -1))
    return Mirrored(first, _spread(rows, _to_rows(image)))


def reflection_vectors(before: Moment, mirrored: Mirrored, time: float) -> tuple[Pixels, Pixels]:
    """Compute reflection_motion (2, H, W) px, and reflection_covariance (3, H, W) px², of the frame at `time`.

    before: the moment a frame earlier, at time − 1. NaN where no lobe but the diffuse one has reflected the path, where
    the mirrored point is behind the camera, and where no surface is seen there at time − 1.
    """
    covariance = footprint(before, mirrored.image)
    seen = np.asarray(~np.isnan(covariance).any(1))
    image = _only(seen, mirrored.image)
    position = _position(before, mirrored.first, time)
    motion = reflection_motion(_image(before, image), *_camera(before, before.time), position)
    return _pixels(motion), _pixels(_image(before, covariance))


def footprint(moment: Moment, image: Floats) -> Floats:
    """Compute the covariance (P, 3), XX XY YY, px², of where the mirror images (P, 3) of points can be seen.

    By the surface that is seen there (`reflection_covariance`), at which rays look.
    """
    time = moment.time
    pixel = pixel_positions(moment, image, time)
    usable = np.asarray(np.isfinite(pixel).all(1))
    if not usable.any():
        return np.full((len(image), 3), np.nan)
    seen = trace_film(moment, pixel[usable])
    curvature = curvatures_at(moment, seen.hits, time)
    of_seen = image[usable], seen.point, seen.normal, seen.roughness[:, None], curvature.reshape(-1, 9)
    *surface, bend = (_line(values) for values in of_seen)
    view, projection = _camera(moment, time)
    place, point, normal, roughness = surface
    bend, size = bend.view(1, 3, 3, 1, -1), (moment.height, moment.width)
    found = reflection_covariance(place, point, normal, roughness, view, projection, bend, size)
    return _spread(usable, _only(seen.hit, _to_rows(found)))


def _position(stage: Timeless, hits: Hits, time: float) -> Tensor:
    """Where hits are seen, (1, 2, H, W) pixels."""
    return _image(stage, pixel_positions(stage, points_at(stage, hits, time), time))


def _camera(stage: Timeless, time: float) -> tuple[Tensor, Tensor]:
    """View and projection (1, 4, 4)."""
    camera = stage.camera
    matrices = camera.view(time), camera.projection(stage.width, stage.height)
    view, projection = (torch.from_numpy(np.ascontiguousarray(matrix))[None] for matrix in matrices)
    return view, projection


def _image(stage: Timeless, rows: Floats) -> Tensor:
    """(P, C) → (1, C, H, W)."""
    return torch.from_numpy(np.ascontiguousarray(rows.T)).view(1, -1, stage.height, stage.width)


def _line(rows: Floats) -> Tensor:
    """(P, C) → (1, C, 1, P): points of some pixels, as an image of one line."""
    return torch.from_numpy(np.ascontiguousarray(rows.T))[None, :, None]


def _to_rows(image: Tensor) -> Floats:
    """(1, C, H, W) → (P, C)."""
    return np.ascontiguousarray(image[0].flatten(1).T.numpy())


def _pixels(image: Tensor) -> Pixels:
    """(1, C, H, W) → (C, H, W) float32."""
    return np.ascontiguousarray(image[0].numpy(), np.float32)


def _only(rows: Rows, values: Floats) -> Floats:
    """Values (P, C) with NaN outside of `rows` (P,)."""
    return np.where(rows[:, None], values, np.nan)


def _spread(rows: Rows, values: Floats) -> Floats:
    """Values (R, C) of the pixels in `rows` (P,) → (P, C), NaN elsewhere."""
    image = np.full((len(rows), values.shape[1]), np.nan)
    image[rows] = values
    return image
