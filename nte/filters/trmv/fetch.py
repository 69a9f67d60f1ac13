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
LEAST_WEIGHT = 0.01  # least bilinear weight of a pixel that shows the surface, where others are to count with it
ALIKE = 0.9  # n·n′ of pixels that are interpolated, 26°: cones of one number lie elsewhere at another normal
ABREAST = 0.02  # relative difference of depth, beyond the slope's, of pixels that are interpolated
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
    """Make a fetcher that uses only pixels of the previous frame that show the surface.

    Where no pixel shows it there is no history, nor where what is seen there hid the surface and has moved away.
    """
    plain = fetch_from_anything(vectors)
    if inputs.before is None:
        return plain
    four = _corners(vectors, inputs)
    chosen = _places(plain.valid & ~four.whole)
    dual = (vectors.motion != inputs.traditional.motion).any(1, keepdim=True)  # ends beside what hid the surface
    valid = plain.valid & (dual | ~four.hidden(inputs)) & four.shows()
    return Fetcher(vectors.motion, valid, MixedPixels.mean(chosen, *four.of(chosen, inputs)))


def fetch_within_edges(vectors: Reprojection, inputs: FrameInputs, rough: bool = False) -> Fetcher:
    """Make a fetcher that is bilinear over those of the four pixels that show the surface, if any do, else over all.

    A plain mean across an edge, taken in every frame, makes light creep over it while things move: half a pixel of what
    lies beside is in the edge's own pixel. Pixels keep a history where none of the four shows the surface, since guides
    of an edge are means of surfaces, whose depth no pixel may have; but not where what is seen there hid the surface
    and has moved away. rough: a pixel of another roughness shows another surface.
    """
    plain = fetch_from_anything(vectors)
    if inputs.before is None:
        return plain
    four = _corners(vectors, inputs, rough)
    valid = plain.valid & ~four.hidden(inputs)
    chosen = _places(valid & ~four.whole & four.shows())
    return Fetcher(vectors.motion, valid, MixedPixels.mean(chosen, *four.of(chosen, inputs)))


def _places(mask: Tensor) -> Places:
    """Where a mask (N, 1, H, W) is true."""
    n, row, column = mask[:, 0].nonzero(as_tuple=True)
    return n, row, column


class _Corners(NamedTuple):
    """The four pixels around the ends of all vectors."""

    source: list[Tensor]  # four row-major indices (N, 1, H·W)
    bilinear: list[Tensor]  # four weights (N, 1, H, W)
    weight: list[Tensor]  # the same, 0 for pixels that do not show the surface
    plane: Tensor  # (N, 1, H, W) disparity of the surface's plane there
    expected: Tensor  # (N, 1, H, W) disparity that shows it: the same, or that of the nearest pixel
    whole: Tensor  # (N, 1, H, W) bool: all show it, and face the same way

    def shows(self) -> Tensor:
        """Mark where one of the pixels shows the surface, and so can lead the others, (N, 1, H, W), bool."""
        return _largest(self.weight) >= LEAST_WEIGHT

    def of(self, chosen: Places, inputs: FrameInputs) -> tuple[Tensor, Tensor]:
        """Return indices and weights, each (4, P), for P pixels with these batch, row and column.

        Depth leaves room for motion in depth, and is equal where surfaces meet. So of the four pixels only those count
        that face as the one does that faces most like the surface, and are as deep as the one of these that is nearest
        to it in depth.
        """
        source, facing, disparity = self._seen(chosen, inputs)
        normal, slope = self._surface(chosen, inputs)
        (expected,), weight = _at([self.expected], chosen), _at(self.weight, chosen)
        best = _leader((facing * normal).sum(2), weight)[..., None].expand(1, -1, 3)
        weight = weight * _face_alike(facing, facing.gather(0, best), 2)
        nearest = disparity.gather(0, _leader(-(disparity - expected).abs(), weight))
        return source, weight * ((disparity - nearest).abs() <= ABREAST * nearest + slope)

    def hidden(self, inputs: FrameInputs) -> Tensor:
        """Mark where the surface was hidden by what has moved away, (N, 1, H, W), bool.

        There, all of the pixels that would count are nearer, or face elsewhere. A sky, which faces nowhere, hides too.
        """
        chosen = _places(inputs.apart)
        _, facing, disparity = self._seen(chosen, inputs)
        normal, slope = self._surface(chosen, inputs)
        nearer = disparity > _at([self.plane], chosen) * (1 + ABREAST) + slope
        other = nearer | ~_face_alike(facing, normal, 2)
        n, row, column = chosen
        marks = torch.zeros_like(inputs.apart)
        marks[n, 0, row, column] = (other | (_at(self.bilinear, chosen) < LEAST_WEIGHT)).all(0)
        return marks

    def _seen(self, chosen: Places, inputs: FrameInputs) -> tuple[Tensor, Tensor, Tensor]:
        """Indices (4, P), normals (4, P, 3) and disparities (4, P) of the pixels around P ends."""
        assert inputs.before is not None
        n, row, column = chosen
        at = row * self.whole.shape[3] + column
        source = torch.stack([s[n, 0, at] for s in self.source])
        return (
            source,
            inputs.before.normal.flatten(2)[n, :, source],
            _disparity(inputs.before.depth).flatten(1)[n, source],
        )

    def _surface(self, chosen: Places, inputs: FrameInputs) -> tuple[Tensor, Tensor]:
        """Normal (P, 3), and slope of the disparity (P,), of P surfaces."""
        n, row, column = chosen
        return inputs.gbuffer.normal[n, :, row, column], inputs.guide.slope[n, :, row, column].abs().sum(1)


def _at(images: list[Tensor], chosen: Places) -> Tensor:
    """The values (K, P) of P pixels in K images (N, 1, H, W)."""
    n, row, column = chosen
    return torch.stack([image[n, 0, row, column] for image in images])


def _largest(weights: list[Tensor]) -> Tensor:
    """The largest of four weights, (N, 1, H, W)."""
    first, second, third, fourth = weights
    return torch.maximum(torch.maximum(first, second), torch.maximum(third, fourth))


def _leader(score: Tensor, weight: Tensor) -> Tensor:
    """The index (1, P) of the best of four pixels by score (4, P); one whose weight is under LEAST_WEIGHT leads none.

    Not the surface itself leads, since surfaces turn and move in depth.
    """
    return torch.where(weight >= LEAST_WEIGHT, score, -float("inf")).argmax(0)[None]


def _corners(vectors: Reprojection, inputs: FrameInputs, rough: bool = False) -> _Corners:
    """Find the four pixels around the ends of vectors, and which have the surface's depth and, if `rough`, roughness.

    Depths are compared as 1/z, which is linear in the image on any plane, however steep. A vector other than the
    traditional one ends elsewhere: where the shadow or the reflection was, or beside what hid the surface. If its plane
    is not seen there, the surface of the nearest pixel takes its place. A miss matches a miss.
    """
    assert inputs.before is not None
    end = pixel_centres(vectors.motion) + vectors.motion
    corner = end - 0.5
    x, y = (corner - corner.floor()).chunk(2, 1)
    before, slope = _disparity(inputs.before.depth).flatten(2), inputs.guide.slope.abs().sum(1, keepdim=True)
    sources, bilinear, seen, alike = [], [], [], torch.ones_like(vectors.valid)
    for right, down in CORNERS:
        index = nearest_index(corner.floor() + corner.new_tensor([right + 0.5, down + 0.5]).view(1, 2, 1, 1))
        weight = (x if right else 1 - x) * (y if down else 1 - y)
        if rough:
            roughness = inputs.before.roughness.flatten(2).gather(2, index).view_as(x)
            same = (roughness - inputs.gbuffer.roughness).abs() < ROUGHNESS
            weight, alike = weight * same, alike & same
        sources.append(index)
        bilinear.append(weight)
        seen.append(before.gather(2, index).view_as(x))

    def show(expected: Tensor) -> list[Tensor]:
        """Which of the pixels have about this depth, (N, 1, H, W) each."""
        room = expected * DEEPER + slope
        return [((one - expected).abs() <= room) & ((one > 0) == (expected > 0)) for one in seen]

    # Where a dual vector leaves the image, the traditional one is used, which ends on the occluder.
    away = vectors.motion - inputs.traditional.motion
    expected = inputs.guide.disparity
    on_plane = expected + (inputs.guide.slope * away).sum(1, keepdim=True).where(expected > 0, 0.0)
    shown = show(on_plane)
    lost = _largest([w * s for w, s in zip(bilinear, shown, strict=True)]) < LEAST_WEIGHT
    lost = lost & (away != 0).any(1, keepdim=True)
    expected = torch.where(lost, before.gather(2, nearest_index(end)).view_as(x), on_plane)
    shown = show(expected) if lost.any() else shown
    deepest, nearest = torch.stack(seen).aminmax(dim=0)
    whole = torch.stack(shown).all(0) & alike & (nearest - deepest <= ABREAST * nearest + slope)
    creased = _creased(inputs.before.normal).flatten(2).gather(2, nearest_index(end)).view_as(whole)
    weights = [weight * own for weight, own in zip(bilinear, shown, strict=True)]
    return _Corners(sources, bilinear, weights, on_plane, expected, whole & ~creased)


def _disparity(depth: Tensor) -> Tensor:
    """1/z (N, 1, H, W), 0 for a miss."""
    return torch.where(depth > 0, 1 / depth, 0.0)


def _creased(normal: Tensor) -> Tensor:
    """Mark the pixels of normals (N, 3, H, W) with others around them that face elsewhere: (N, 1, H, W), bool."""
    marks = torch.zeros_like(normal[:, :1])
    for axis in (2, 3):
        one, other = pairs(normal, axis, 1)
        apart = (~_face_alike(one, other, 1)).unsqueeze(1)
        for side in pairs(marks, axis, 1):
            side.add_(apart)
    return F.max_pool2d(marks, 3, 1, 1) > 0


def _face_alike(one: Tensor, other: Tensor, dim: int) -> Tensor:
    """Whether n·n′ ≥ ALIKE, by ‖n − n′‖² = 2 (1 − n·n′), so that pixels of a sky, whose normal is 0, are alike."""
    return (one - other).square_().sum(dim) <= 2 * (1 - ALIKE)
