"""Votes of small cells of the image for and against motion vectors, from the texture inside surfaces.

Albedo travels with its surface. A pixel inside a surface must therefore find its albedo in the previous frame, where
its vector leads, up to a pixel: any value between the smallest and the largest of the four pixels around that place
counts as found, so that interpolation, aliasing and half a pixel prove nothing. Pixels at silhouettes do not take
part: they show a mixture, and the surface that they fetch may have been hidden.

A cell votes *for* the vectors if they explain its texture, while neither no motion nor the opposite motion explains
it. A cell votes *against* them if they do not explain its texture, and a search finds one displacement that does, and
only one: if texture repeats or is flat, any vector is as good as another. Vectors and displacements are compared by
the same measure. A vector that leads out of the image fetches nothing: a cell contradicts such vectors only if it
really moves in their direction, as with vectors of another unit.
"""

from math import dist, hypot
from typing import NamedTuple

import torch
from torch import Tensor

from nte.checking.textures import Textures
from nte.checking.votes import STILL_PX, Against, Vector, Votes, rival_vectors
from nte.frames.frame import Frame

EXPLAINED = 0.01  # largest albedo error of a cell that vectors explain
BETTER = 0.3  # a displacement contradicts the vectors only if its error is at most this share of theirs
FEWEST = 10  # a cell's pixels that vectors must lose: one of 625 displacements finds 6 more of them by chance
ENOUGH = 0.2  # least share of a cell's pixels that must take part
ALONE = 0.15  # greatest share of the displacements that explain a cell as well as the best one
APART = 1.2  # pixels: least distance between the given vector and the true displacement in a contradiction
ALONG = 0.95  # least cosine of the angle between vectors of one direction
AROUND = 3.0  # pixels: equally good displacements this close count as one, and their mean is the true one
NEIGHBOURS = 3  # nearest contradicting cells, one of which must move alike; measured: fine aliased textures, lenses
COMPANY = 1 / 3  # least share of the contradicting cells with such a neighbour; fewer have one by chance
SIMILAR = 0.15  # greatest distance between two displacements of one motion, as a share of their length
SEARCHED = 48  # largest number of a frame's cells that are searched
LARGE = 200  # pixels: images whose shorter side exceeds this have cells of 16×16 pixels, others of 8×8


def cell_votes(previous: Frame, current: Frame) -> Votes:
    """Collect the votes of the cells of `current` on its `motion`.

    previous, current: consecutive PyTorch frames of batch 1 with albedo and motion. Depth and instance are optional;
    with them fewer pixels at silhouettes take part. Cost: up to 48 cells are searched over 625 displacements, or 1089
    in images with both sides above 200 pixels.
    """
    pair = _Pair(previous, current)
    motion = current["motion"]
    given, still, opposite = (pair.errors(vectors) for vectors in (motion, torch.zeros_like(motion), -motion))
    good = (given <= EXPLAINED) & ~(still <= EXPLAINED) & ~(opposite <= EXPLAINED) & pair.moves(motion)
    suspect = given > EXPLAINED
    if pair.share_outside(motion) > 0.5:  # vectors of another unit: nothing can be fetched, so nothing contradicts
        suspect |= given.isnan()
    votes = Votes(good=int(good.sum()), looked=pair.looked(motion), explained=int((given <= EXPLAINED).sum()))
    found, share = pair.search(motion, suspect, given)
    votes.weight_against = len(found) / share
    if not found and not votes.good:
        return votes
    errors = {
        rival: pair.errors(vectors).where(pair.moves(vectors), torch.nan)
        for rival, vectors in rival_vectors(previous, current)
    }
    votes.good_by.update({rival: int((good & (error <= EXPLAINED)).sum()) for rival, error in errors.items()})
    for piece in found:
        limit = max(EXPLAINED, 2 * piece.error, BETTER * float(given[piece.cell].nan_to_num(0.0)))
        explained_by = frozenset(rival for rival, error in errors.items() if error[piece.cell] <= limit)
        votes.against.append(Against(explained_by, piece.given, piece.seen))
    return votes


class Contradiction(NamedTuple):
    """A cell with wrong vectors: their mean and the true displacement, in pixels, and the latter's albedo error."""

    cell: int
    given: Vector
    seen: Vector
    error: float


class _Pair(Textures):
    """Two consecutive frames, and the cell of each pixel of the current one."""

    def __init__(self, previous: Frame, current: Frame) -> None:
        super().__init__(previous, current)
        self.side = 16 if min(current.size) > LARGE else 8
        self.reach, self.step = (24, 2) if self.side == 8 else (48, 3)  # range and step of tried displacements, pixels
        self.least = ENOUGH * self.side**2
        self.columns = -(-self.width // self.side)
        x, y = self.centres.long() // self.side
        self.cell = y * self.columns + x
        self.cells = self.columns * -(-self.height // self.side)

    def errors(self, motion: Tensor) -> Tensor:
        """Mean albedo error (cells,) of vectors (1, 2, H, W) in each cell; NaN if too few pixels can tell."""
        vectors = motion[0].flatten(1)
        everywhere = (self.usable & ~self.uncovered(vectors)).nonzero()[:, 0]
        error, tells = self.compare(everywhere, vectors[:, everywhere], self.near)
        return self._means(self.cell[everywhere], error, tells, self.least)

    def moves(self, motion: Tensor) -> Tensor:
        """Tell which cells (cells,) have vectors (1, 2, H, W) of more than no length.

        The four pixels around a place that is hardly beside its own are those on one side of it: vectors of another
        unit, which are tiny, would explain a slow motion to that side.
        """
        length = motion[0].flatten(1).norm(dim=0)
        known = self.usable & length.isfinite()
        return self._means(self.cell[known], length[known], torch.ones_like(known[known]), 1) >= STILL_PX

    def looked(self, motion: Tensor) -> int:
        """Count the cells of which enough pixels have vectors (1, 2, H, W) that end in the picture, found or not."""
        vectors = motion[0].flatten(1)
        *_, within = self.target(self.centres + vectors)
        pixels = within & self.usable & ~self.uncovered(vectors)
        return int((torch.bincount(self.cell[pixels], minlength=self.cells) >= self.least).sum())

    def share_outside(self, motion: Tensor) -> float:
        """Share of the pixels inside surfaces whose vectors (1, 2, H, W) end outside the image."""
        *_, within = self.target(self.centres + motion[0].flatten(1))
        return float((~within & self.usable).sum() / self.usable.sum().clamp(min=1))

    def search(self, motion: Tensor, suspect: Tensor, given: Tensor) -> tuple[list[Contradiction], float]:
        """Search the suspect cells for the one displacement that explains each; return those that contradict `motion`.

        motion: the given vectors (1, 2, H, W); suspect: (cells,) bool; given: the vectors' errors (cells,). A cell
        contradicts if hardly any other displacement is as good and the vectors are clearly worse. Also returns the
        share of the suspect cells that was searched. One half of a cell's pixels decides which displacement is best,
        the other half how good it is: the best of hundreds explains noise by chance, but not twice.
        """
        usable = self.usable & ~self.uncovered(motion[0].flatten(1))
        sizes = torch.bincount(self.cell[usable], minlength=self.cells)
        cells = (suspect & (sizes >= self.least)).nonzero()[:, 0]
        if not len(cells):
            return [], 1.0
        share = min(1.0, SEARCHED / len(cells))
        cells = cells[torch.linspace(0, len(cells) - 1, min(SEARCHED, len(cells))).round().long()]
        chosen = (usable & torch.isin(self.cell, cells)).nonzero()[:, 0]
        local = torch.searchsorted(cells, self.cell[chosen])
        half = 2 * local + self.centres[:, chosen].floor().sum(0).long() % 2
        steps = torch.arange(-self.reach, self.reach + 1, self.step)
        displacements = torch.cartesian_prod(steps, steps).float()
        compared = self.compare(chosen, motion[0].flatten(1)[:, chosen], self.wide)
        given_wide = self._means(local, *compared, self.least, len(cells))
        halves = self._displaced(chosen, steps, half, 2 * len(cells))
        first, second = halves.view(len(displacements), -1, 2).unbind(2)
        found = []
        for i, cell in enumerate(cells.tolist()):
            known = first[:, i].isfinite() & second[:, i].isfinite()
            if not known.any():
                continue
            best = int(first[:, i].masked_fill(~known, float("inf")).argmin())
            error = float(second[best, i])
            as_good = known & ((first[:, i] + second[:, i]) / 2 <= max(EXPLAINED / 2, 2 * error))
            by_vectors = float(given_wide[i].nan_to_num(1.0))
            contradicts = by_vectors > EXPLAINED and error <= min(EXPLAINED, BETTER * by_vectors)
            if contradicts and as_good.sum() <= ALONE * known.sum() and self._proves(cell, displacements[best], motion):
                around = (displacements - displacements[best]).square().sum(1) <= AROUND**2
                seen = displacements[as_good & around].mean(0)
                mean = motion[0].flatten(1)[:, self.usable & (self.cell == cell)].nan_to_num().mean(1)
                alike = float(seen @ mean) > ALONG * float(seen.norm() * mean.norm())
                if float((seen - mean).norm()) >= APART and (alike or bool(given[cell].isfinite())):
                    found.append(Contradiction(cell, _pair(mean), _pair(seen), error))
        accompanied = sum(self._has_company(piece, found) for piece in found)
        return found if accompanied >= COMPANY * len(found) else [], share

    def _proves(self, cell: int, displacement: Tensor, motion: Tensor) -> bool:
        """Tell whether that a displacement explains a cell says anything: finer or stronger texture explains anything.

        Such as the same texture farther away. There the pixels of the cell are found in reverse order as well; or what
        is there is not found in the cell, clearly better than where `motion` leads. And if `motion` loses few pixels of
        a texture that each frame samples anew, the best of hundreds of displacements finds all of them by chance.
        """
        pixels = (self.usable & (self.cell == cell)).nonzero()[:, 0]
        target, _, within = self.target(self.centres[:, pixels] + displacement.unsqueeze(1))
        pixels, target = pixels[within], target[within]
        error, reverse = (float(self.error(of, target, self.wide).mean()) for of in (pixels, pixels.flip(0)))
        back = float(self.error_back(pixels, target).mean())
        there, _, inside = self.target(self.centres[:, pixels] + motion[0].flatten(1)[:, pixels])
        back_by_vectors = float(self.error_back(pixels[inside], there[inside]).mean().nan_to_num(1.0))
        if int((~inside | (self.error(pixels, there, self.wide) > EXPLAINED)).sum()) < FEWEST:
            return False
        return reverse > max(EXPLAINED, error / BETTER) and back <= max(EXPLAINED, BETTER * back_by_vectors)

    def _has_company(self, piece: Contradiction, found: list[Contradiction]) -> bool:
        """Tell whether one of the nearest other pieces moves nearly alike, which chance hardly ever finds."""

        def apart(other: Contradiction) -> float:
            (y, x), (row, column) = (divmod(p.cell, self.columns) for p in (piece, other))
            return hypot(y - row, x - column)

        nearest = sorted((other for other in found if other.cell != piece.cell), key=apart)[:NEIGHBOURS]
        near_enough = max(2 * self.step, SIMILAR * hypot(*piece.seen))
        return any(dist(piece.seen, other.seen) <= near_enough for other in nearest)

    def _displaced(self, pixels: Tensor, steps: Tensor, group: Tensor, groups: int) -> Tensor:
        """Mean errors (S², groups) of displacements: each of steps (S,) whole pixels in x with each in y.

        All steps in y are taken together: fewer and larger operations, whose results still fit the processor's cache.
        """
        x, y = self.centres[:, pixels].long()
        rows = y + steps.unsqueeze(1)
        in_rows = (rows >= 0) & (rows < self.height)
        numbered = (group + groups * torch.arange(len(steps)).unsqueeze(1)).flatten()
        means = []
        for column in (x + step for step in steps):
            within = in_rows & (column >= 0) & (column < self.width)
            target = torch.where(within, rows * self.width + column, 0)
            error, tells = self.fetched(pixels, target, target, within, self.wide)
            each = self._means(numbered, error.flatten(), tells.flatten(), self.least / 2, groups * len(steps))
            means.append(each.view(-1, groups))
        return torch.cat(means)

    def _means(self, group: Tensor, error: Tensor, tells: Tensor, least: float, groups: int | None = None) -> Tensor:
        """Mean error (groups,) of the pixels that tell; NaN for groups with fewer than `least` of them."""
        groups = groups or self.cells
        count = torch.bincount(group, tells.float(), groups)
        total = torch.bincount(group, error * tells, groups)
        return torch.where(count >= least, total / count, torch.nan)


def _pair(vector: Tensor) -> Vector:
    return float(vector[0]), float(vector[1])
