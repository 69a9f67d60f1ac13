"""Keys of shapes and lights: the whole numbers by which kernels name them."""

from collections.abc import Iterable, Sequence

import numpy as np

from nte.render.engine.backend import is_scalar, load_drjit, load_mitsuba
from nte.render.engine.places import Indices
from nte.render.engine.types import Emitter, Lanes, Shape


def shape_key(shape: Shape) -> Lanes:
    """Return a whole number per shape, 0 for none: Dr.Jit's registry id, which starts at 1 and has no fixed order."""
    if is_scalar():
        return int(shape.id().rsplit("_", 1)[1]) + 1 if shape else 0
    return load_drjit().reinterpret_array(load_mitsuba().UInt32, shape)


def emitter_key(emitter: Emitter) -> Lanes:
    """Return a whole number per light, 0 for none: Dr.Jit's registry id. Vectorised variants only."""
    return load_drjit().reinterpret_array(load_mitsuba().UInt32, emitter)


def key_of(shape: Shape) -> int:
    """Return the key of a single shape."""
    return int(shape_key(shape) if is_scalar() else shape_key(load_mitsuba().ShapePtr(shape))[0])


def key_of_emitter(emitter: Emitter) -> int:
    """Return the key of a single light. Vectorised variants only."""
    return int(emitter_key(load_mitsuba().EmitterPtr(emitter))[0])


def numbers_by_key(keys: Sequence[int], numbers: Iterable[int]) -> Indices:
    """Make the table (max key + 1,) from keys of shapes or lights to numbers; all other keys map to 0."""
    table = np.zeros(max(keys, default=0) + 1, np.int64)
    table[[*keys]] = [*numbers]
    return table
