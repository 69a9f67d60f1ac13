"""Motion of what a surface shows instead of the surface: the shadow on it, and the reflection in it.

The hits of Mitsuba's rays are handed to the functions of `nte.motion.reliable` as images of float64. Every vector
starts at the point in the pixel that the path really hit, so the camera's jitter does not enter it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nte.filters.threads import own_threads
from nte.frames.channels import CHANNELS
from nte.frames.usable import usable
from nte.motion.reliable import mirror_image, reflection_covariance, shadow_point
from nte.render.engine.places import Indices
from nte.render.engine.stage import Moment, Timeless
from nte.render.passes.gbuffer import to_image
from nte.render.passes.hits import Hits, curvatures_at, normals_at, points_at
from nte.render.passes.projection import eye, pixel_positions
from nte.render.passes.rays import trace_film
from nte.render.world.scene import Pixels
from nte.render.world.transforms import Floats

Rows = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Shadow:
    """The hits of the shadow rays, one row per pixel."""

    receiver: Hits
    blocker: Hits
    light: Indices  # (P,) the light's instance number; 0 where it has none
    light_point: Floats  # (P, 3) world
    blocked: Rows  # (P,)


@dataclass(frozen=True)
class Bounce:
    """The hits of the paths, one row per pixel."""

    first: Hits
    second: Hits
    reflected: Rows  # (P,) whether a lobe other than the diffuse one reflected the path


@dataclass(frozen=True)
class Mirrored:
    """The places where mirrors show the second hits of the reflected paths."""

    first: Hits  # the reflectors, one row per reflected path
    image: Floats  # (R, 3) world, one frame earlier; NaN where nothing is shown
    reflected: Rows  # (P,) the pixels that these paths belong to


@own_threads()
def shadow_vectors(stage: Timeless, shadow: Shadow, time: float) -> Pixels:
    """Compute shadow_motion (2, H, W), pixels, current → previous: to where the same shadow was at time − 1.

    NaN where a pixel has no shadow, or the vector is invalid. shadow: what the shadow rays met at `time`, in frames.
    Traces no rays.
    """
    rows = shadow.blocked
    receiver = shadow.receiver.of(rows)
    light = stage.places.moved(shadow.light[rows], shadow.light_point[rows], time, time - 1)
    blocker, point = (points_at(stage, hits, time - 1) for hits in (shadow.blocker.of(rows), receiver))
    normal = normals_at(stage, receiver, time - 1)
    before = shadow_point(*(_line(values) for values in (light, blocker, point, normal)))
    return to_image(stage, _spread(rows, _motion(stage, receiver, _to_rows(before), time)))


@own_threads()
def mirror_images(stage: Timeless, bounce: Bounce, time: float) -> Mirrored:
    """Find where the reflectors show, at time − 1, what the paths of `time` met, by `mirror_image`. Traces no rays."""
    rows = bounce.reflected
    first, second = bounce.first.of(rows), bounce.second.of(rows)
    point, target = points_at(stage, first, time - 1), points_at(stage, second, time - 1)
    distant = second.instance == 0
    target[distant] = point[distant] + stage.distant * target[distant]
    normal = normals_at(stage, first, time - 1)
    bend = _bend(curvatures_at(stage, first, time - 1))
    camera = torch.from_numpy(eye(stage, time - 1).copy())[None]
    h, s, n = (_line(values) for values in (target, point, normal))
    image = mirror_image(h, s, n, camera, bend)
    return Mirrored(first, _to_rows(image), rows)


@own_threads()
def reflection_vectors(before: Moment, mirrored: Mirrored, time: float) -> tuple[Pixels, Pixels]:
    """Compute reflection_motion (2, H, W), px, and reflection_covariance (3, H, W), px², of the frame at `time`.

    before: the moment one frame earlier, at time − 1. Both are NaN where only the diffuse lobe reflected the path,
    where the mirrored point is behind the camera, where no surface is seen there at time − 1, and where the lobe covers
    more than any filter can look at: seen at a grazing angle, its linear approximation has no bound.
    """
    motion = _motion(before, mirrored.first, mirrored.image, time)
    vectors, lobes = (
        to_image(before, _spread(mirrored.reflected, values)) for values in (motion, footprint(before, mirrored.image))
    )
    lobes = usable(CHANNELS["reflection_covariance"], lobes[None])[0]
    return np.where(np.isnan(lobes).any(0), np.float32(np.nan), vectors), lobes


def footprint(moment: Moment, image: Floats) -> Floats:
    """Compute the covariance (P, 3), XX XY YY, px², of where the mirror images (P, 3) of points can be seen.

    Rays find the surface that is seen at each mirror image; its curvature and roughness determine the covariance
    (`reflection_covariance`). NaN where no surface is seen.
    """
    time = moment.time
    pixel = pixel_positions(moment, image, time)
    ahead = np.asarray(np.isfinite(pixel).all(1))
    if not ahead.any():
        return np.full((len(image), 3), np.nan)
    seen = trace_film(moment, pixel[ahead])
    of_seen = image[ahead], seen.point, seen.normal, seen.roughness[:, None]
    place, point, normal, roughness = (_line(values) for values in of_seen)
    view, projection = _camera(moment, time)
    bend, size = _bend(curvatures_at(moment, seen.hits, time)), (moment.height, moment.width)
    found = reflection_covariance(place, point, normal, roughness, view, projection, bend, size)
    return _spread(ahead, _only(seen.hit, _to_rows(found)))


def _motion(stage: Timeless, hits: Hits, before: Floats, time: float) -> Floats:
    """Vectors (R, 2), pixels, from where hits are seen at a time to where the camera of time − 1 sees points (R, 3)."""
    here = pixel_positions(stage, points_at(stage, hits, time), time)
    return pixel_positions(stage, before, time - 1) - here


def _camera(stage: Timeless, time: float) -> tuple[Tensor, Tensor]:
    """View and projection (1, 4, 4)."""
    camera = stage.camera
    matrices = camera.view(time), camera.projection(stage.width, stage.height)
    view, projection = (torch.from_numpy(np.ascontiguousarray(matrix))[None] for matrix in matrices)
    return view, projection


def _line(rows: Floats) -> Tensor:
    """(P, C) → (1, C, 1, P): points of some pixels, as an image of one line."""
    return torch.from_numpy(np.ascontiguousarray(rows.T))[None, :, None]


def _bend(curvature: Floats) -> Tensor:
    """(P, 3, 3) → (1, 3, 3, 1, P): curvatures of some pixels, as an image of one line."""
    return torch.from_numpy(np.ascontiguousarray(curvature.transpose(1, 2, 0)))[None, :, :, None]


def _to_rows(image: Tensor) -> Floats:
    """(1, C, H, W) → (P, C)."""
    return np.ascontiguousarray(image[0].flatten(1).T.numpy())


def _only(rows: Rows, values: Floats) -> Floats:
    """Values (P, C) with NaN outside of `rows` (P,)."""
    return np.where(rows[:, None], values, np.nan)


def _spread(rows: Rows, values: Floats) -> Floats:
    """Values (R, C) of the pixels in `rows` (P,) → (P, C), NaN elsewhere."""
    image = np.full((len(rows), values.shape[1]), np.nan)
    image[rows] = values
    return image
