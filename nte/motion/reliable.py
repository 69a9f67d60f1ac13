"""Motion of shadows and reflections, rather than of the surfaces that show them, as pure functions.

Zeng et al. 2021, «Temporally Reliable Motion Vectors for Real-time Ray Tracing», sections 4.1 and 4.2. Points, normals
and directions are (N, 3, H, W) in world space. Cameras are (N, 4, 4) matrices `view` and `projection`, as in
`nte.motion.camera`. Vectors are (N, 2, H, W) in pixels, from the current position to the previous one, NaN where there
is none. «Before» means in the previous frame; a point is taken there by its T⁻¹, for rigid objects with
`nte.motion.camera.move`.
"""

import math

import torch
from torch import Tensor

from nte.motion.camera import project
from nte.motion.curved import bend_within, length, reflecting_points, solve, tangents
from nte.motion.warp import pixel_centres

GRAZING = 0.05  # least cosine between a lobe and a plane's normal, which keeps the ellipse finite
_CONTACT = 1e-3  # share of the way from blocker to s by which the plane may lie before the blocker and still touch it


def shadow_motion(
    light: Tensor,
    blocker: Tensor,
    point: Tensor,
    normal: Tensor,
    view: Tensor,
    projection: Tensor,
    position: Tensor | None = None,
) -> Tensor:
    """Compute shadow vectors (N, 2, H, W), Eq. 3: m^V = P intersect[line(T⁻¹l, T⁻¹b), T⁻¹plane(s)] − x.

    light, blocker and point: the light sample l, the blocker b and the shading point s of each shadowed pixel, before,
    each moved by its own T⁻¹. normal: of s, before, of any length. view and projection: the camera before. position
    (N, 2, H, W): where x is in the current frame, px; None stands for the pixel centres. NaN where the line is parallel
    to the plane, where it meets the plane on the light's side of the blocker, which then casts no shadow there, and
    where it meets the plane behind the camera.

    Example: a light 4 above the floor, and a blocker halfway. The light was 1 to the left, so the shadow was 1 to the
    right. That is half a pixel for this camera, which looks down on 4×4 units with 2×2 pixels.

    >>> view, projection = torch.eye(4)[None], torch.eye(4)[None]
    >>> projection[0, 0, 3] = projection[0, 1, 3] = 0.5
    >>> projection[0, 0, 0], projection[0, 1, 1] = 0.25, 0.25
    >>> light, blocker, point, normal = (
    ...     torch.tensor(xyz).view(1, 3, 1, 1).expand(1, 3, 2, 2)
    ...     for xyz in ((-1.0, 0.0, 4.0), (0.0, 0.0, 2.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    ... )
    >>> centre = torch.ones(1, 2, 2, 2)
    >>> nte.shadow_motion(light, blocker, point, normal, view, projection, centre)[0, :, 0, 0].tolist()
    [0.5, 0.0]
    """
    return project(shadow_point(light, blocker, point, normal), view, projection) - _position(position, point)


def shadow_point(light: Tensor, blocker: Tensor, point: Tensor, normal: Tensor) -> Tensor:
    """Intersect lines from lights through blockers with planes, all (N, 3, H, W); NaN unless beyond the blocker.

    >>> light, blocker, point, normal = (
    ...     torch.tensor(xyz).view(1, 3, 1, 1)
    ...     for xyz in ((-1.0, 0.0, 4.0), (0.0, 0.0, 2.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    ... )
    >>> nte.shadow_point(light, blocker, point, normal).flatten().tolist()
    [1.0, 0.0, 0.0]
    """
    along, reach = blocker - light, point - blocker
    t = _dot(reach, normal) / _dot(along, normal)  # counted from the blocker: from a distant sun, t would lose digits
    # Where blocker and plane touch, t is 0 except for rounding.
    beyond = (t * length(along, 1) >= -_CONTACT * length(reach, 1)) & torch.isfinite(t)
    return torch.where(beyond, blocker + t * along, math.nan)


def mirror_image(target: Tensor, point: Tensor, normal: Tensor, eye: Tensor, curvature: Tensor | None = None) -> Tensor:
    """Compute where reflectors show targets, (N, 3, H, W): mirror[T⁻¹h, T⁻¹plane(s)] of Eq. 5, all before.

    target: the reflected point h. point and unit normal: of the reflector s. eye (N, 3): the camera's position.
    curvature (N, 3, 3, H, W): the change of the unit normal per scene unit along the surface; None: flat. On a curved
    surface the result lies behind the nearby point that reflects h to the eye, as far behind as h is in front of it.
    NaN where h and the camera are on different sides of the plane, so that no reflection is seen.

    >>> target, point, normal = (
    ...     torch.tensor(xyz).view(1, 3, 1, 1) for xyz in ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    ... )
    >>> nte.mirror_image(target, point, normal, torch.tensor([[0.0, 0.0, 5.0]])).flatten().tolist()
    [1.0, 2.0, -3.0]
    """
    from_eye = eye[:, :, None, None]
    height = _dot(target - point, normal)
    side = _dot(from_eye - point, normal).sign()
    image = torch.where(height * side > 0, target - 2 * height * normal, math.nan)
    if curvature is None:
        return image
    bent = (curvature != 0).flatten(1, 2).any(1, keepdim=True) & torch.isfinite(image[:, :1])
    rows = bent[:, 0]
    if not rows.any():
        return image
    picked = [_rows(values, rows) for values in (point, normal * side, target, from_eye.expand_as(point))]
    bend = (curvature * side[:, None]).permute(0, 3, 4, 1, 2)[rows]
    unfolded = _unfolded(picked[0], picked[1], bend, picked[2], picked[3])
    image = image.permute(0, 2, 3, 1).clone()
    image[rows] = unfolded
    return image.permute(0, 3, 1, 2).contiguous()


def reflection_motion(image: Tensor, view: Tensor, projection: Tensor, position: Tensor | None = None) -> Tensor:
    """Compute the mean of reflection vectors (N, 2, H, W), Eq. 5: P(image) − x.

    image: from `mirror_image`. view and projection: the camera before. position (N, 2, H, W): where x is, px; None
    stands for the pixel centres.

    >>> image = torch.tensor([0.5, 0.0, -3.0]).view(1, 3, 1, 1)
    >>> view, projection = torch.eye(4)[None], torch.eye(4)[None]
    >>> projection[0, 0, 3] = projection[0, 1, 3] = 0.5  # parallel rays, one unit is one pixel
    >>> nte.reflection_motion(image, view, projection).flatten().tolist()
    [0.5, 0.0]
    """
    return project(image, view, projection) - _position(position, image)


def reflection_covariance(
    image: Tensor,
    point: Tensor,
    normal: Tensor,
    roughness: Tensor,
    view: Tensor,
    projection: Tensor,
    curvature: Tensor | None = None,
    size: tuple[int, int] | None = None,
) -> Tensor:
    """Compute Σ of Eq. 5: the covariance (N, 3, H, W), XX XY YY, px², of where mirror images can be seen before.

    point, unit normal, roughness (N, 1, H, W, perceptual) and curvature (N, 3, 3, H, W; None: flat) belong to s^C, the
    surface that the previous frame shows where it would show `image`. view and projection: the camera before. size:
    (height, width) of the image in whose pixels the result is; None takes the arrays' own size. With a size the arrays
    may hold any points.

    A mirror shows each image at one point s^C of its surface. A rough surface shows it at all points around s^C whose
    microfacets can reflect the light to the camera. Slopes of a Beckmann distribution have the deviation α/√2, where α
    is roughness². A step δ along the surface turns the half vector of camera and image point by (1/d + 1/d')
    (δ − a a·δ). Here d and d' are the distances of the two from s^C, and a is the ray's direction. The step also turns
    the normal, by the curvature. Microfacets must make up the difference: each radian of their tilt makes up 2 cos θ of
    it. The steps δ of that deviation form an ellipse, which is projected to first order.

    Zeng et al. trace the whole lobe from the image and ignore curvature. Their lobe is too wide by (d + d')/d, which is
    four times where a floor nearby reflects a distant object.

    Example: a camera 1 above a floor looks straight down on the image of a point that is also 1 above the floor.

    >>> view, projection = torch.eye(4)[None], torch.zeros(1, 4, 4)
    >>> projection[0, 0, 0] = projection[0, 1, 1] = projection[0, 3, 2] = 1.0
    >>> image, point, normal = (
    ...     torch.tensor(xyz).view(1, 3, 1, 1) for xyz in ((0.0, 0.0, 2.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
    ... )
    >>> rough = torch.full((1, 1, 1, 1), 0.1)
    >>> xx, xy, yy = nte.reflection_covariance(image, point, normal, rough, view, projection, size=(100, 100)).flatten()
    >>> [round(value.sqrt().item(), 3) for value in (xx, yy)]  # px
    [0.707, 0.707]
    """
    eye = _eye(view)[:, :, None, None].expand_as(point)
    height, width = size or point.shape[-2:]
    pixels = point.new_tensor([width, height])
    flat = [_flat(values) for values in (image, point, normal, roughness, eye)]
    bend = point.new_zeros(()) if curvature is None else curvature.permute(0, 3, 4, 1, 2).flatten(1, 2)
    ends = _ellipse(flat[0], flat[1], flat[2], flat[3], flat[4], bend)
    matrix = (projection @ view)[:, None]
    total = point.new_zeros((*flat[1].shape[:2], 3))
    for end in ends.unbind(-1):
        x, y = _image_of(matrix, flat[1], end, pixels).unbind(-1)
        total = total + torch.stack([x * x, x * y, y * y], -1)
    return total.transpose(1, 2).reshape(point.shape)


def _ellipse(image: Tensor, point: Tensor, normal: Tensor, roughness: Tensor, eye: Tensor, curvature: Tensor) -> Tensor:
    """The half axes (…, 3, 2), world, of the ellipse of points around `point` (…, 3) that show the image."""
    axis = point - image
    distance = length(axis)
    axis = axis / distance
    to_camera = length(eye - point)
    side = torch.where(
        (axis * normal).sum(-1, keepdim=True) < 0, -1.0, 1.0
    )  # the axis runs from the image to the camera
    normal = normal * side
    cosine = (axis * normal).sum(-1, keepdim=True).clamp(min=GRAZING)
    frame = tangents(normal, axis)
    # In this frame the matrix of a flat mirror is diagonal: across the plane of incidence, and within it.
    flat = (1 / distance + 1 / to_camera) * torch.cat([torch.ones_like(cosine), cosine**2], -1)
    turning = torch.diag_embed(flat)
    if curvature.dim():
        turning = turning + 2 * cosine[..., None] * bend_within(frame, curvature * side[..., None])
    deviation = math.sqrt(2) * roughness**2 * cosine
    return frame @ solve(turning, torch.diag_embed(deviation.expand_as(flat)))


def _unfolded(point: Tensor, normal: Tensor, curvature: Tensor, target: Tensor, eye: Tensor) -> Tensor:
    """Where a plane mirror would have to show targets (R, 3) to look like the curved mirror from the eye.

    That is behind the point that reflects the target, as far behind as the target is in front of it. `point` takes its
    place where no such point is found.
    """
    place = reflecting_points(point, normal, curvature, target, eye)
    place = torch.where(torch.isfinite(place), place, point)
    gaze = place - eye
    return place + gaze / length(gaze) * length(target - place)


def _image_of(matrix: Tensor, points: Tensor, offsets: Tensor, size: Tensor) -> Tensor:
    """The first-order displacement in the image, px (N, P, 2), of points that move by small offsets (N, P, 3)."""
    clip = (matrix[..., :3] @ points[..., None])[..., 0] + matrix[..., 3]
    step = (matrix[..., :3] @ offsets[..., None])[..., 0]
    return size * (step[..., :2] - clip[..., :2] / clip[..., 3:] * step[..., 3:]) / clip[..., 3:]


def _eye(view: Tensor) -> Tensor:
    """The camera's position (N, 3), world."""
    to_world: Tensor = torch.linalg.inv(view)
    return to_world[:, :3, 3]


def _position(position: Tensor | None, like: Tensor) -> Tensor:
    return pixel_centres(like) if position is None else position


def _rows(values: Tensor, mask: Tensor) -> Tensor:
    """The values (R, C), out of (N, C, H, W), of the pixels in `mask` (N, H, W)."""
    return values.permute(0, 2, 3, 1)[mask]


def _flat(values: Tensor) -> Tensor:
    """(N, C, H, W) → (N, H·W, C)."""
    return values.flatten(2).transpose(1, 2)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(1, keepdim=True)
