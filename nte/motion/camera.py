"""Motion vectors for people with their own engine: from matrices and points, as pure functions.

Cameras are (N, 4, 4) matrices for column vectors: `view` takes world to view space, `projection` takes view
space to homogeneous [0, 1]² with y down. Points are (N, 3, H, W) in world space, positions in pixels.
"""

import torch
from torch import Tensor

from nte.motion.warp import pixel_centres


def project(points: Tensor, view: Tensor, projection: Tensor, hit: Tensor | None = None) -> Tensor:
    """Pixel positions (N, 2, H, W) of world points (N, 3, H, W); NaN for what lies behind the camera.

    Where `hit` (N, 1, H, W) is false, the point is taken as a direction: a point at infinity, which only
    the camera's rotation moves.
    """
    height, width = points.shape[-2:]
    weight = torch.ones_like(points[:, :1]) if hit is None else hit.to(points.dtype)
    homogeneous = torch.cat([points, weight], 1)
    clip = torch.einsum("nij,njhw->nihw", projection @ view, homogeneous)
    size = points.new_tensor([width, height]).view(1, 2, 1, 1)
    position = clip[:, :2] / clip[:, 3:] * size
    return torch.where(clip[:, 3:] > 0, position, float("nan"))


def motion_of(points_then: Tensor, view_then: Tensor, projection_then: Tensor, hit: Tensor | None = None) -> Tensor:
    """Vectors (N, 2, H, W) from each pixel's centre to where its surface point is seen at another time.

    points_then: the surface points of the current pixels, where they are at that time (`move`). With the
    previous frame's points and camera this is `motion`, with the next frame's `forward_motion`.
    """
    return project(points_then, view_then, projection_then, hit) - pixel_centres(points_then)


def move(points: Tensor, instance: Tensor, transforms: Tensor) -> Tensor:
    """World points (N, 3, H, W) moved by the rigid motion of the object that each pixel sees.

    instance (N, 1, H, W): whole numbers below K; transforms (K, 4, 4): for the previous frame
    T_k = O_k(i−1) · O_k(i)⁻¹, with O_k the object-to-world matrix of object k. Sky is an identity.
    """
    per_pixel = transforms[instance[:, 0].long()]  # (N, H, W, 4, 4)
    rotated = torch.einsum("nhwij,njhw->nihw", per_pixel[..., :3, :3], points)
    return rotated + per_pixel[..., :3, 3].permute(0, 3, 1, 2)


def points_from_depth(depth: Tensor, view: Tensor, projection: Tensor) -> Tensor:
    """World points (N, 3, H, W) at the pixel centres, for depth (N, 1, H, W) along the view axis.

    Where depth is 0 (a miss) the result is the direction of the pixel's ray, as `project` wants it.
    Works for cameras that look along +z or −z, and for any near and far plane.
    """
    height, width = depth.shape[-2:]
    uv = pixel_centres(depth) / depth.new_tensor([width, height]).view(1, 2, 1, 1)
    unproject = torch.linalg.inv(projection)

    def at(clip_depth: float) -> Tensor:
        ones = torch.ones_like(uv[:, :1])
        point = torch.einsum("nij,njhw->nihw", unproject, torch.cat([uv, clip_depth * ones, ones], 1))
        return point[:, :3] / point[:, 3:]

    # Two points of the ray well inside the frustum: an infinite far plane has no point at 1.
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
