"""Transfer of numbers between NumPy and Dr.Jit."""

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.types import Lanes
from nte.render.world.transforms import Floats


def to_jit(kind: type[Lanes], values: npt.NDArray[np.generic]) -> Lanes:
    """Copy values (P,) into a Dr.Jit array of `kind`: mi.Float, mi.UInt32 or mi.Bool.

    The array owns its memory. `kind(values)` would read NumPy's memory in place, with two faults: a frozen kernel
    (Scenery.frozen) keeps reading the values that it was recorded with (Dr.Jit 1.5.0), and every kernel is compiled
    anew for memory that is not aligned, as NumPy's sometimes is.
    """
    mi, dr = load_mitsuba(), load_drjit()
    wanted = np.dtype({mi.Float: np.float32, mi.UInt32: np.uint32, mi.Bool: np.bool_}[kind])
    shared = kind(np.ascontiguousarray(values, wanted))
    copy = dr.select(dr.opaque(mi.Bool, True), shared, kind(0))
    dr.eval(copy)
    return copy


def to_rows(columns: Iterable[Lanes]) -> Floats:
    """Return K Dr.Jit arrays (P,) as rows (P, K) of float64."""
    return np.stack([np.array(column, float) for column in columns], axis=1)
