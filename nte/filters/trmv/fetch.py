"""Fetching history from the surface that it belongs to: bilinear over those of the four pixels that show it."""

from typing import NamedTuple, TypeAlias

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.filters.bilateral import ROUGHNESS
from nte.filters.trmv.inputs import FrameInputs
from nte.motion.geometric import Reprojection
from nte.motion.neighbours import pairs
from nte.motion.warp import fetch_bilinear, inside, nearest_index, pixel_centres

DEEPER = 0.1  # relative tolerance of depth, which leaves room for motion in depth
LEAST_WEIGHT = 0.01  # least sum of the bilinear weights of pixels that show the surface
ALIKE = 0.9  # n·n′ of pixels that are interpolated, 26°: cones of one number lie elsewhere at another normal
CORNERS = ((0, 0), (1, 0), (0, 1), (1, 1))

Places: TypeAlias = tuple[Tensor, Tensor, Tensor]  # indices (P,) of batch, row and column


class MixedPixels(NamedTuple):
    """The P pixels whose four source pixels may not all show the same surface, and the weights to use for them."""

    at: Places
    source: Tensor  # (4, P) row-major indices of the four pixels
    weight: Tensor  # (4, P): they sum to 1, or to less where hardly any pixel shows the surface

    @staticmethod
    def mean(at: Places, source: Tensor, weight: Tensor) -> "MixedPixels":
        """Use bilinear weights (4, P) of the pixels that show the surface, over their sum."""
        return MixedPixels(at, source, weight / weight.sum(0).clamp(min=LEAST_WEIGHT))


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

    Where no pixel shows the surface there is no history. Where surfaces meet, depths are equal, and only pixels that
    face the same way are used.
    """
    plain = fetch_from_anything(vectors)
    if inputs.before is None:
        return plain
    four = _corners(vectors, inputs)
    nearest = nearest_index(pixel_centres(vectors.motion) + vectors.motion)
    creased = _creased(inputs.before.normal).flatten(2).gather(2, nearest).view_as(four.whole)
    chosen = _places(plain.valid & (creased | ~four.whole))
    source, weight = four.of(chosen)
    n, row, column = chosen
    facing = inputs.before.normal.flatten(2)[n, :, source]  # (4, P, 3)
    weight = weight * _alike(facing, inputs.gbuffer.normal[n, :, row, column], weight)
    total = four.total()
    total[n, 0, row, column] = weight.sum(0)
    return Fetcher(vectors.motion, plain.valid & (total >= LEAST_WEIGHT), MixedPixels.mean(chosen, source, weight))


def fetch_within_edges(vectors: Reprojection, inputs: FrameInputs, rough: bool = False) -> Fetcher:
    """Make a fetcher that is bilinear over those of the four pixels that show the surface, if any do, else over all.

    A plain mean across an edge, taken in every frame, makes light creep over it while things move: half a pixel of what
    lies beside is in the edge's own pixel. All pixels keep a history, since guides of an edge are means of surfaces,
    whose depth no pixel may have. rough: a pixel of another roughness shows another surface.
    """
    plain = fetch_from_anything(vectors)
    if inputs.before is None:
        return plain
    four = _corners(vectors, inputs, rough)
    chosen = _places(plain.valid & ~four.whole & (four.total() >= LEAST_WEIGHT))
    return Fetcher(vectors.motion, plain.valid, MixedPixels.mean(chosen, *four.of(chosen)))


def _places(mask: Tensor) -> Places:
    """Where a mask (N, 1, H, W) is true."""
    n, row, column = mask[:, 0].nonzero(as_tuple=True)
    return n, row, column


class _Corners(NamedTuple):
    """The four pixels around the ends of all vectors."""

    source: list[Tensor]  # four row-major indices (N, 1, H·W)
    weight: list[Tensor]  # four bilinear weights (N, 1, H, W), 0 for pixels that do not show the surface
    whole: Tensor  # (N, 1, H, W) bool: all show it

    def total(self) -> Tensor:
        """Sum the weights, (N, 1, H, W)."""
        first, second, third, fourth = self.weight
        return first + second + third + fourth

    def of(self, chosen: Places) -> tuple[Tensor, Tensor]:
        """Return indices and weights, each (4, P), for P pixels with these batch, row and column."""
        n, row, column = chosen
        at = row * self.whole.shape[3] + column
        return torch.stack([s[n, 0, at] for s in self.source]), torch.stack([w[n, 0, row, column] for w in self.weight])


def _corners(vectors: Reprojection, inputs: FrameInputs, rough: bool = False) -> _Corners:
    """Find the four pixels around the ends of vectors, and which have the surface's depth and, if `rough`, roughness.

    A vector other than the traditional one ends elsewhere: where the shadow or the reflection was, or beside what hid
    the surface. There the depth is that of the nearest pixel. A miss matches a miss. Depths are compared as 1/z, which
    is linear in the image on any plane, however steep.
    """
    assert inputs.before is not None
    end = pixel_centres(vectors.motion) + vectors.motion
    corner = end - 0.5
    x, y = (corner - corner.floor()).chunk(2, 1)
    before = torch.where(inputs.before.depth > 0, 1 / inputs.before.depth, 0.0).flatten(2)
    # Where a dual vector leaves the image, the traditional one is used, which ends on the occluder.
    elsewhere = (vectors.motion != inputs.traditional.motion).any(1, keepdim=True)
    beside = before.gather(2, nearest_index(end)).view_as(x)
    expected = torch.where(elsewhere, beside, inputs.guide.disparity)
    room = expected * DEEPER + inputs.guide.slope.abs().sum(1, keepdim=True)
    sources, weights, whole = [], [], torch.ones_like(vectors.valid)
    for right, down in CORNERS:
        index = nearest_index(corner.floor() + corner.new_tensor([right + 0.5, down + 0.5]).view(1, 2, 1, 1))
        seen = before.gather(2, index).view_as(x)
        same = ((seen - expected).abs() <= room) & ((seen > 0) == (expected > 0))
        if rough:
            roughness = inputs.before.roughness.flatten(2).gather(2, index).view_as(x)
            same &= (roughness - inputs.gbuffer.roughness).abs() < ROUGHNESS
        weights.append((x if right else 1 - x) * (y if down else 1 - y) * same)
        whole &= same
        sources.append(index)
    return _Corners(sources, weights, whole)


def _creased(normal: Tensor) -> Tensor:
    """Mark the pixels of normals (N, 3, H, W) with others around them that face elsewhere: (N, 1, H, W), bool."""
    marks = torch.zeros_like(normal[:, :1])
    for axis in (2, 3):
        one, other = pairs(normal, axis, 1)
        apart = (~_face_alike(one, other, 1)).unsqueeze(1)
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
    return _face_alike(facing, best, 2)


def _face_alike(one: Tensor, other: Tensor, dim: int) -> Tensor:
    """Whether n·n′ ≥ ALIKE, by ‖n − n′‖² = 2 (1 − n·n′), so that pixels of a sky, whose normal is 0, are alike."""
    return (one - other).square_().sum(dim) <= 2 * (1 - ALIKE)
