"""Furniture and tableware of real size, in metres, each as one mesh that stands on y = 0 and faces −z."""

import numpy as np

from nte.render.scenes.solids import block, cushion, merged, placed, turned
from nte.render.world.scene import Mesh
from nte.render.world.transforms import translation


def chair() -> Mesh:
    """Make a chair: four legs, a seat, and a back of three rails at +z."""
    legs = [block((0.05, 0.45, 0.05), (x, 0, z), 0.5) for x in (-0.19, 0.19) for z in (-0.19, 0.19)]
    seat = cushion((0.46, 0.06, 0.46), 0.025, (0, 0.43, 0), 0.5)
    posts = [block((0.05, 0.5, 0.05), (x, 0.45, 0.19), 0.5) for x in (-0.19, 0.19)]
    rails = [block((0.38, 0.07, 0.03), (0, y, 0.19), 0.5) for y in (0.58, 0.72, 0.86)]
    return merged([*legs, seat, *posts, *rails])


def table(width: float, depth: float, height: float = 0.74) -> Mesh:
    """Make a table: a slab on four legs."""
    top = block((width, 0.05, depth), (0, height - 0.05, 0), 1.0)
    x, z = width / 2 - 0.08, depth / 2 - 0.08
    return merged([top, *(block((0.07, height - 0.05, 0.07), (a * x, 0, b * z)) for a in (-1, 1) for b in (-1, 1))])


def round_table(radius: float, height: float = 0.74) -> Mesh:
    """Make a round table: a disc on a turned foot."""
    top = height - 0.05
    profile = [
        (0, 0), (0.6 * radius, 0), (0.6 * radius, 0.03), (0.07, 0.08), (0.05, top / 2), (0.09, top - 0.02),
        (radius - 0.02, top), (radius, top + 0.025), (radius - 0.02, height), (radius - 0.06, height), (0, height),
    ]  # fmt: skip
    return turned(profile, columns=48, rows=80)


def shelf(width: float, height: float, depth: float, boards: int) -> Mesh:
    """Make a shelf: two sides, a back at +z, and boards."""
    sides = [block((0.04, height, depth), (x, 0, 0)) for x in (-width / 2, width / 2)]
    back = block((width, height, 0.02), (0, 0, depth / 2))
    levels = np.linspace(0.05, height - 0.04, boards)
    return merged([*sides, back, *(block((width, 0.04, depth), (0, float(y), 0)) for y in levels)])


def books(rng: np.random.Generator, width: float) -> Mesh:
    """Make a row of upright books, `width` wide in all."""
    row, x = [], -width / 2
    while x < width / 2 - 0.08:
        thickness, height = rng.uniform(0.03, 0.07), rng.uniform(0.2, 0.3)
        row.append(block((thickness * 0.9, height, 0.18), (x + thickness / 2, 0, 0), rng.uniform(0.2, 0.6)))
        x += thickness
    return merged(row)


def bed() -> Mesh:
    """Make a bed: a frame with a headboard at +z, 1.5 by 2.1."""
    return merged(
        [
            block((1.5, 0.28, 2.1), (0, 0.08, 0)),
            block((1.5, 0.95, 0.07), (0, 0, 1.05)),
            *(block((0.08, 0.1, 0.08), (x, 0, z)) for x in (-0.68, 0.68) for z in (-0.95, 0.95)),
        ]
    )


def lamp_shade(radius: float = 0.2, height: float = 0.25) -> Mesh:
    """Make a lamp shade: a cone without ends, visible from both sides, about y = 0."""
    r, h = radius, height
    return turned([(r, 0), (0.6 * r, h), (0.57 * r, h), (0.97 * r, 0)], rows=40)


def stand(height: float) -> Mesh:
    """Make the foot and pole of a lamp."""
    return turned([(0, 0), (0.16, 0), (0.16, 0.02), (0.03, 0.05), (0.015, 0.1), (0.015, height), (0, height)], 24, 60)


def plate(radius: float = 0.13) -> Mesh:
    """Make a plate with a rim."""
    r = radius
    return turned([(0, 0), (0.6 * r, 0), (r, 0.022), (r, 0.028), (0.65 * r, 0.01), (0, 0.008)], rows=60)


def glass(height: float = 0.16) -> Mesh:
    """Make a stemmed glass whose wall has a thickness, so that it bends light as a real glass does."""
    h = height
    return turned([
        (0, 0), (0.035, 0), (0.035, 0.004), (0.009, 0.012), (0.008, 0.4 * h), (0.03, 0.5 * h), (0.038, 0.7 * h),
        (0.033, h), (0.031, h), (0.035, 0.7 * h), (0.026, 0.53 * h), (0, 0.48 * h),
    ], 36, 90)  # fmt: skip


def bottle(height: float = 0.3) -> Mesh:
    """Make a closed bottle."""
    h = height
    return turned([
        (0, 0), (0.036, 0), (0.04, 0.01), (0.04, 0.6 * h), (0.03, 0.72 * h), (0.014, 0.8 * h), (0.014, 0.97 * h),
        (0.017, 0.98 * h), (0.017, h), (0, h),
    ], 32, 70)  # fmt: skip


def apple(rng: np.random.Generator) -> tuple[Mesh, Mesh]:
    """Make body and stem of an apple of about unit radius, dented at both ends, standing on y = 0."""
    waist, dent = rng.uniform(0.95, 1.08), rng.uniform(0.3, 0.42)
    body = turned([
        (0, 0.18), (0.12, 0.1), (0.3, 0), (0.55, 0.06), (0.85 * waist, 0.5), (waist, 1.0), (0.86 * waist, 1.5),
        (0.5, 1.75), (0.25, 1.72), (0.1, 1.75 - 0.6 * dent), (0, 1.75 - dent),
    ], 40, 56)  # fmt: skip
    rod = turned([(0, 0), (0.05, 0.02), (0.04, 0.3), (0.06, 0.52), (0.04, 0.55), (0, 0.55)], 10, 24)
    bend = np.float32(rng.uniform(-0.5, 0.5)) * rod.positions[:, 1:2] ** 2 * np.array([1, 0, 0.4], np.float32)
    stem = Mesh(rod.positions + bend, rod.normals, rod.uv, rod.faces)
    return body, placed(stem, translation((0, 1.75 - dent - 0.02, 0)))
