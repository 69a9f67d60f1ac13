"""Motion vectors for other engines, from matrices and points, as pure functions.

Cameras are (N, 4, 4) matrices for column vectors: `view` takes world space to view space, `projection` takes view
space to homogeneous [0, 1]² with y down. Points are (N, 3, H, W) in world space; image positions are in pixels.

All of them compute in the precision of what they are given. Far from the world's origin, give points and matrices in
double precision: in single precision, for things 2 to 12 units away in an image 1280 px wide, vectors are off by 0.1 px
in the median 10⁴ units from the origin, and by 1.5 px at 10⁵.
"""

import torch
from torch import Tensor

from nte.motion.warp import pixel_centres


def project(points: Tensor, view: Tensor, projection: Tensor, hit: Tensor | None = None) -> Tensor:
    """Project world points (N, 3, H, W) to pixel positions (N, 2, H, W); NaN for points behind the camera.

    hit (N, 1, H, W): where it is false, the vector is a direction, that is a point at infinity, which only the camera's
    rotation moves. None: all are points.
    """
    height, width = points.shape[-2:]
    weight = torch.ones_like(points[:, :1]) if hit is None else hit.to(points.dtype)
    homogeneous = torch.cat([points, weight], 1)
    clip = torch.einsum("nij,njhw->nihw", projection @ view, homogeneous)
    size = points.new_tensor([width, height]).view(1, 2, 1, 1)
    position = clip[:, :2] / clip[:, 3:] * size
    return torch.where(clip[:, 3:] > 0, position, float("nan"))


def motion_of(points_then: Tensor, view_then: Tensor, projection_then: Tensor, hit: Tensor | None = None) -> Tensor:
    """Compute vectors (N, 2, H, W), px, from each pixel's centre to where its surface point is seen at another time.

    points_then: the world points (N, 3, H, W) of the current pixels' surfaces at the other time (`move` gives them).
    view_then and projection_then: the camera at that time. With the previous frame's points and camera the result is
    `motion`, with the next frame's it is `forward_motion`. hit (N, 1, H, W): false for sky, as in `project`.
    """
    return project(points_then, view_then, projection_then, hit) - pixel_centres(points_then)


def move(points: Tensor, instance: Tensor, transforms: Tensor) -> Tensor:
    """Move world points (N, 3, H, W) by the rigid motion of the object that each pixel shows.

    instance (N, 1, H, W): whole numbers from 0 to K − 1. transforms (K, 4, 4): one per object. To the previous frame,
    with the object-to-world matrix O_k of object k, it is T_k = O_k(i−1) · O_k(i)⁻¹. The transform of sky is the
    identity.
    """
    per_pixel = transforms[instance[:, 0].long()]  # (N, H, W, 4, 4)
    rotated = torch.einsum("nhwij,njhw->nihw", per_pixel[..., :3, :3], points)
    return rotated + per_pixel[..., :3, 3].permute(0, 3, 1, 2)


def points_from_depth(depth: Tensor, view: Tensor, projection: Tensor) -> Tensor:
    """Reconstruct world points (N, 3, H, W) at the pixel centres from depth (N, 1, H, W) along the view axis.

    Where depth is 0 (a miss) the result is the direction of the pixel's ray, which `project` accepts with `hit` false.
    Works for cameras that look along +z or −z, and for any near and far plane.
    """
    height, width = depth.shape[-2:]
    uv = pixel_centres(depth) / depth.new_tensor([width, height]).view(1, 2, 1, 1)
    unproject = torch.linalg.inv(projection)

    def at(clip_depth: float) -> Tensor:
        ones = torch.ones_like(uv[:, :1])
        point = torch.einsum("nij,njhw->nihw", unproject, torch.cat([uv, clip_depth * ones, ones], 1))
        return point[:, :3] / point[:, 3:]

    # Two points of the ray well inside the frustum: with an infinite far plane, depth 1 has no finite point.
    first, second = at(0.25), at(0.75)
    axis = (first[:, 2:] + second[:, 2:]).sign()
    along = second - first
    t = (axis * depth - first[:, 2:]) / along[:, 2:]
    hit = depth > 0
    ray = along * (axis * along[:, 2:]).sign()
    in_view = torch.where(hit, first + t * along, ray)
    to_world = torch.linalg.inv(view)
    rotated = torch.einsum("nij,njhw->nihw", to_world[:, :3, :3], in_view)
    return torch.where(hit, rotated + to_world[:, :3, 3].view(-1, 3, 1, 1), rotated)
