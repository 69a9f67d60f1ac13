"""Fetching history from the surface that it belongs to: bilinear over those of the four pixels that show it."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.filters.trmv.inputs import FrameInputs
from nte.motion.geometric import Reprojection
from nte.motion.neighbours import pairs
from nte.motion.warp import fetch_bilinear, inside, nearest_index, pixel_centres

DEEPER = 0.1  # relative tolerance of depth, which leaves room for motion in depth
LEAST_WEIGHT = 0.01  # least sum of the bilinear weights of pixels that show the surface
ALIKE = 0.9  # n·n′ of pixels that are interpolated, 26°: cones of one number lie elsewhere at another normal
CORNERS = ((0, 0), (1, 0), (0, 1), (1, 1))


class MixedPixels(NamedTuple):
    """The P pixels whose four source pixels may not all show the same surface, and the weights to use for them."""

    at: tuple[Tensor, Tensor, Tensor]  # indices (P,) of batch, row and column
    source: Tensor  # (4, P) row-major indices of the four pixels
    weight: Tensor  # (4, P): they sum to 1, or to 0 where no pixel shows the surface


class Fetcher(NamedTuple):
    """Vectors, and the pixels at whose vectors' ends surfaces are mixed; calling it fetches an image."""

    motion: Tensor  # (N, 2, H, W) px, to the previous frame
    valid: Tensor  # (N, 1, H, W) bool: a pixel at the end of the vector shows the surface
    mixed: MixedPixels | None = None

    def __call__(self, image: Tensor, first: int = 0, rows: int | None = None) -> Tensor:
        """Fetch the previous frame's image (N, C, H, W) at the ends of the vectors.

        rows: number of rows to fetch, beginning with row `first`; None: all from there on.
        """
        motion = self.motion[:, :, first : None if rows is None else first + rows]
        position = pixel_centres(motion) + motion.new_tensor([0, first]).view(1, 2, 1, 1) + motion
        fetched = fetch_bilinear(image, position)
        if self.mixed is not None and self.mixed.source.shape[1]:
            _, y, _ = self.mixed.at
            here = ((y >= first) & (y < first + motion.shape[2])).nonzero()[:, 0]
            n, y, x = (index[here] for index in self.mixed.at)
            flat, source, weight = image.flatten(2), self.mixed.source[:, here], self.mixed.weight[:, here]
            fetched[n, :, y - first, x] = sum(flat[n, :, s] * w[:, None] for s, w in zip(source, weight, strict=True))
        return fetched


def fetch_from_anything(vectors: Reprojection) -> Fetcher:
    """Make a fetcher that is plainly bilinear: across edges, and from whatever hid the surface."""
    return Fetcher(vectors.motion, vectors.valid & inside(pixel_centres(vectors.motion) + vectors.motion))


def fetch_from_surface(vectors: Reprojection, inputs: FrameInputs) -> Fetcher:
    """Make a fetcher that uses only pixels of the previous frame whose depth is that of the surface.

    Where the surface was hidden, so that history comes from beside the occluder, the expected depth is that of the
    nearest pixel there. A miss matches a miss. Depths are compared as 1/z, which is linear in the image on any plane,
    however steep. Where surfaces meet, depths are equal, and only pixels that face the same way are used.
    """
    plain = fetch_from_anything(vectors)
    if inputs.before is None:
        return plain
    width = vectors.motion.shape[3]
    end = pixel_centres(vectors.motion) + vectors.motion
    corner = end - 0.5
    x, y = (corner - corner.floor()).chunk(2, 1)
    before = torch.where(inputs.before.depth > 0, 1 / inputs.before.depth, 0.0).flatten(2)

    def at(position: Tensor) -> tuple[Tensor, Tensor]:
        index = nearest_index(position)
        return index, before.gather(2, index).view_as(x)

    nearest, beside = at(end)
    # Where a dual vector leaves the image, the traditional one is used, which ends on the occluder.
    dual = vectors.disoccluded & (vectors.motion != inputs.traditional.motion).any(1, keepdim=True)
    expected = torch.where(dual, beside, inputs.guide.disparity)
    room = expected * DEEPER + inputs.guide.slope.abs().sum(1, keepdim=True)
    whole = ~_creased(inputs.before.normal).flatten(2).gather(2, nearest).view_as(x)
    sources, weights = [], []
    for right, down in CORNERS:
        index, seen = at(corner.floor() + corner.new_tensor([right + 0.5, down + 0.5]).view(1, 2, 1, 1))
        same = ((seen - expected).abs() <= room) & ((seen > 0) == (expected > 0))
        weights.append((x if right else 1 - x) * (y if down else 1 - y) * same)
        whole &= same
        sources.append(index)
    n, row, column = (~whole & plain.valid)[:, 0].nonzero(as_tuple=True)
    source = torch.stack([index[n, 0, row * width + column] for index in sources])
    weight = torch.stack([share[n, 0, row, column] for share in weights])
    facing = inputs.before.normal.flatten(2)[n, :, source]  # (4, P, 3)
    weight = weight * _alike(facing, inputs.gbuffer.normal[n, :, row, column], weight)
    total = weights[0] + weights[1] + weights[2] + weights[3]
    total[n, 0, row, column] = found = weight.sum(0)
    mixed = MixedPixels(
        (n, row, column),
        source,
        weight * torch.where(found >= LEAST_WEIGHT, 1 / found.clamp(min=LEAST_WEIGHT), 0.0),
    )
    return Fetcher(vectors.motion, plain.valid & (total >= LEAST_WEIGHT), mixed)


def _creased(normal: Tensor) -> Tensor:
    """Mark the pixels of normals (N, 3, H, W) with others around them that face elsewhere: (N, 1, H, W), bool."""
    marks = torch.zeros_like(normal[:, :1])
    for axis in (2, 3):
        one, other = pairs(normal, axis, 1)
        apart = ((one * other).sum(1, keepdim=True) < ALIKE).to(marks.dtype)
        for side in pairs(marks, axis, 1):
            side.add_(apart)
    return F.max_pool2d(marks, 3, 1, 1) > 0


def _alike(facing: Tensor, normal: Tensor, weight: Tensor) -> Tensor:
    """Tell which of four pixels' normals, (4, P, 3), are like that of the pixel that faces most like `normal`, (P, 3).

    Not like `normal` itself, since surfaces turn. weight (4, P): of the pixels; one under LEAST_WEIGHT leads none.
    Returns (4, P), bool.
    """
    likeness = torch.where(weight >= LEAST_WEIGHT, (facing * normal).sum(2), -2.0)
    best = facing.gather(0, likeness.argmax(0)[None, :, None].expand(1, -1, 3))
    # A sky has no normal: its pixels are alike.
    return ((facing * best).sum(2) >= ALIKE) | (best == 0).all(2)
