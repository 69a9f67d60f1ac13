"""The hits of rays as NumPy rows, and where the hit points are at other times."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nte.render.engine.arrays import to_rows
from nte.render.engine.places import Indices
from nte.render.engine.stage import Moment, Timeless
from nte.render.engine.types import Lanes
from nte.render.world.transforms import Floats


@dataclass(frozen=True)
class Hits:
    """The hits of rays: one row per ray."""

    instance: Indices  # (P,) 0 = miss, else index in scene.objects + 1
    place: Floats  # (P, places.width) where on the object: see Places
    direction: Floats  # (P, 3) of the ray, world; all that is known of a miss

    def of(self, rows: npt.NDArray[np.bool_] | Indices) -> "Hits":
        """Select rays. rows: (P,) bool, or row numbers."""
        return Hits(self.instance[rows], self.place[rows], self.direction[rows])


def to_hits(moment: Moment, met: Sequence[Lanes], direction: Lanes) -> Hits:
    """Make rows of what `Scenery.met` returned at this moment, already evaluated, and of the rays' directions (3,)."""
    with np.errstate(invalid="ignore"):  # the barycentrics of a miss are undefined
        return hits_of(moment, to_rows(met), np.array(direction, float).T)


def hits_of(moment: Moment, met: Floats, direction: Floats) -> Hits:
    """Make hits of columns (P, 1 + width) that `Scenery.met` returned at this moment, and of directions (P, 3)."""
    instance = moment.scenery.instances[met[:, 0].astype(np.int64)]
    return Hits(instance, moment.places.stored(instance, met[:, 1:], moment.time), direction)


def points_at(timeless: Timeless, hits: Hits, time: float) -> Floats:
    """Return where the surface points of `hits` are at a time in frames, (P, 3), world; the ray's direction for a miss.

    A point at rest has exactly the same position at every time.
    """
    return np.where(hits.instance[:, None] > 0, timeless.places.points(hits.instance, hits.place, time), hits.direction)


def normals_at(timeless: Timeless, hits: Hits, time: float) -> Floats:
    """Return unit shading normals (P, 3) of `hits` at a time in frames, outwards; the ray's direction for a miss."""
    normals = timeless.places.normals(hits.instance, hits.place, time)
    normals = np.where(hits.instance[:, None] > 0, normals, hits.direction)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def curvatures_at(timeless: Timeless, hits: Hits, time: float) -> Floats:
    """Return curvatures (P, 3, 3) of the surfaces of `hits` at a time in frames: see Places.curvatures."""
    return timeless.places.curvatures(hits.instance, hits.place, time)
