"""Motion of what a surface shows instead of the surface: its shadow, and the reflection in it.

Zeng et al. 2021, «Temporally Reliable Motion Vectors for Real-time Ray Tracing», sections 4.1 and 4.2. One row
per pixel, NumPy float64. Every vector starts at the point in the pixel that the path has really hit, so
that the camera's jitter is not in it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nte.render.curved import reflecting_points, solve, tangents, within
from nte.render.film import eye, image_of, pixel_positions
from nte.render.rays import Hits, Indices, curvatures_at, normals_at, points_at, trace_film
from nte.render.scene import Pixels
from nte.render.stage import Stage
from nte.render.transforms import Floats

_GRAZING = 0.05  # least cosine at which a lobe meets a plane: the ellipse does not become infinite
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
    """Where mirrors show what the reflected paths met, one row per reflected path."""

    rows: Rows  # (P,) which pixels' paths those are
    first: Hits  # the reflectors
    image: Floats  # (R, 3) world, at the time before; NaN where nothing is shown


def shadow_vectors(stage: Stage, shadow: Shadow, time: float) -> Pixels:
    """shadow_motion (2, H, W), pixels, to where the same shadow was at time − 1; NaN where there is none.

    Eq. 3: x^V = P(intersect[line(T⁻¹l, T⁻¹b), T⁻¹plane(s)]), all at time − 1; each of light, blocker and
    receiver with its own T. Invalid, thus NaN too, where the line is parallel to the plane or meets it behind
    the light or the camera.
    """
    rows = shadow.blocked
    receiver, blocker = shadow.receiver.of(rows), shadow.blocker.of(rows)
    light = stage.places.moved(shadow.light[rows], shadow.light_point[rows], time, time - 1)
    point, normal = points_at(stage, receiver, time - 1), normals_at(stage, receiver, time - 1)
    along = points_at(stage, blocker, time - 1) - light
    with np.errstate(divide="ignore", invalid="ignore"):
        t = _dot(point - light, normal) / _dot(along, normal)
        before = light + t * along
    before[~(t[:, 0] > 0)] = np.nan
    return _motion(stage, rows, receiver, before, time)


def mirror_images(stage: Stage, bounce: Bounce, time: float) -> Mirrored:
    """mirror[T⁻¹h, T⁻¹plane(s)] of Eq. 5, at time − 1, of the paths of `time`.

    Where the surface is curved, it is the place that mirrors T⁻¹h by the curvature at T⁻¹s (`nte.render.curved`),
    and T⁻¹s itself if there is none near by. NaN where nothing can be reflected. Needs no rays.
    """
    rows = bounce.reflected
    first, second = bounce.first.of(rows), bounce.second.of(rows)
    point, normal = points_at(stage, first, time - 1), normals_at(stage, first, time - 1)
    target = points_at(stage, second, time - 1)
    distant = second.instance == 0
    target[distant] = point[distant] + stage.distant * target[distant]
    height = _dot(target - point, normal)
    image = target - 2 * height * normal
    camera = eye(stage, time - 1)
    side = np.sign(_dot(camera - point, normal))
    image[(height * side)[:, 0] <= 0] = np.nan  # no reflection is seen
    curvature = curvatures_at(stage, first, time - 1) * side[:, :, None]
    bent = curvature.any((1, 2)) & np.isfinite(image[:, 0])
    image[bent] = _unfolded(point[bent], (normal * side)[bent], curvature[bent], target[bent], camera)
    return Mirrored(rows, first, image)


def reflection_vectors(stage: Stage, mirrored: Mirrored, time: float) -> tuple[Pixels, Pixels]:
    """reflection_motion (2, H, W) px, and reflection_covariance (3, H, W) px².

    Eq. 5: x^R = sample(P(mirror[T⁻¹h, T⁻¹plane(s)]), Σ), all at time − 1; its two parameters are returned, the
    mean as a vector from the pixel. NaN where no lobe but the diffuse one has reflected the path, where the
    mirrored point is behind the camera, and where no surface is seen there at time − 1.

    Σ is the image of the points about s^C, the surface seen there, that reflect the same h into the camera, by the
    roughness at s^C: see `footprint`. `stage` must be set to time − 1.
    """
    image = mirrored.image.copy()
    covariance = footprint(stage, image, time - 1)
    image[np.isnan(covariance).any(1)] = np.nan
    return _motion(stage, mirrored.rows, mirrored.first, image, time), _scattered(stage, mirrored.rows, covariance)


def _unfolded(point: Floats, normal: Floats, curvature: Floats, target: Floats, eye: Floats) -> Floats:
    """Where a plane mirror would have to show targets (R, 3) for the eye to see them where the curved one shows them.

    That is, behind the place that mirrors them and as far behind as they are before it.
    """
    place = reflecting_points(point, normal, curvature, target, eye)
    place = np.where(np.isfinite(place), place, point)
    gaze = place - eye
    gaze /= np.maximum(np.linalg.norm(gaze, axis=1, keepdims=True), 1e-9)
    return np.asarray(place + gaze * np.linalg.norm(target - place, axis=1, keepdims=True))


def footprint(stage: Stage, image: Floats, time: float) -> Floats:
    """Covariance (R, 3), XX XY YY, px², of where the mirror images (R, 3) of points can be seen at `time`.

    A mirror shows each at one point s^C of its surface, a rough one at all points about it whose microfacets
    can turn the light. Slopes of a Beckmann distribution have a deviation of α/√2, α = roughness². A step δ along the
    surface turns the half vector of camera and point by (1/d + 1/d') (δ − a a·δ), d and d' being their distances
    from s^C and a the ray's direction, and the normal by the curvature: what is between the two the microfacets
    must make up, 2 cos θ each radian of it. δ of that deviation is an ellipse, projected to first order.

    Zeng et al. trace the whole lobe from the image, which is too wide by (d + d')/d: four times where a floor
    nearby reflects what is far away; and know no curvature.
    """
    pixel = pixel_positions(stage, image, time)
    usable = np.isfinite(pixel).all(1)
    covariance = np.full((len(image), 3), np.nan)
    if not usable.any():
        return covariance
    seen = trace_film(stage, pixel[usable])
    axis = seen.point - image[usable]
    distance = np.linalg.norm(axis, axis=1, keepdims=True)
    axis /= np.maximum(distance, 1e-9)
    to_camera = np.linalg.norm(eye(stage, time) - seen.point, axis=1, keepdims=True)
    side = np.where(_dot(axis, seen.normal) < 0, -1.0, 1.0)  # the axis runs from the image to the camera
    normal = seen.normal * side
    cosine = np.maximum(_dot(axis, normal), _GRAZING)
    frame = tangents(normal, axis)
    # In this frame the flat part is diagonal: across the plane of incidence, and within it.
    flat = (1 / np.maximum(distance, 1e-9) + 1 / np.maximum(to_camera, 1e-9)) * np.concatenate(
        [np.ones_like(cosine), cosine**2], 1
    )
    bend = 2 * cosine[:, :, None] * within(frame, curvatures_at(stage, seen.hits, time) * side[:, :, None])
    turning = bend + flat[:, :, None] * np.eye(2)
    deviation = np.sqrt(2) * seen.roughness[:, None] ** 2 * cosine
    ends = frame @ solve(turning, deviation[:, :, None] * np.eye(2))
    total = np.zeros((len(axis), 3))
    for end in ends.transpose(2, 0, 1):
        x, y = image_of(stage, seen.point, end, time).T
        total += np.stack([x * x, x * y, y * y], 1)
    total[~seen.hit] = np.nan
    covariance[usable] = total
    return covariance


def _motion(stage: Stage, rows: Rows, here: Hits, before: Floats, time: float) -> Pixels:
    """Vectors (2, H, W) from the pixel positions of `here` at `time` to those of `before` (R, 3) at time − 1."""
    motion = pixel_positions(stage, before, time - 1) - pixel_positions(stage, points_at(stage, here, time), time)
    return _scattered(stage, rows, motion)


def _scattered(stage: Stage, rows: Rows, values: Floats) -> Pixels:
    """Values (R, C) of the pixels in `rows` (P,) → (C, H, W), NaN elsewhere."""
    image = np.full((len(rows), values.shape[1]), np.nan, np.float32)
    image[rows] = values
    return np.ascontiguousarray(image.T.reshape(-1, stage.height, stage.width))


def _dot(a: Floats, b: Floats) -> Floats:
    """(R, 1)."""
    return np.asarray((a * b).sum(1, keepdims=True))
