"""The formulas of export/README.md convert what engines have to what the graph takes."""

import math
import re
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

PAGE = (Path(__file__).parents[2] / "export" / "README.md").read_text("utf-8")
W, H, NEAR, FAR = 640, 360, 0.3, 50.0


def table(heading: str) -> dict[str, list[str]]:
    """The rows of the first table behind a heading: first cell → the others."""
    lines = PAGE[PAGE.index(heading) :].splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("|---"))
    rows = list(takewhile(lambda line: line.startswith("|"), lines[start + 1 :]))
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    return {first: others for first, *others in cells}


def value(formula: str, **names: float) -> float:
    return float(eval(formula.replace("−", "-").replace("·", "*"), names))


MOTION, DEPTH = table("**Motion.**"), table("**Depth.**")


@pytest.mark.parametrize("row", MOTION)
def test_vectors_of_engines_become_ours(row: str) -> None:
    rng = np.random.default_rng(0)
    for now, before in rng.uniform(-1, 1, (20, 2, 2)):  # of one surface point: NDC, y up

        def in_engine(ndc: np.ndarray) -> np.ndarray:
            x, y = ndc[0], ndc[1] if "y up" in row else -ndc[1]
            if "NDC" in row:
                return np.array([x, y])
            uv = (np.array([x, y]) + 1) / 2
            return uv if "UV" in row else uv * (W, H)

        difference = in_engine(now) - in_engine(before)
        x, y = difference if "current − previous" in row else -difference
        found = [value(formula, v_x=x, v_y=y, W=W, H=H) for formula in MOTION[row]]
        expected = (before - now) * (W / 2, -H / 2)  # pixels, y down
        np.testing.assert_allclose(found, expected)


def test_jitter_is_taken_out_of_vectors() -> None:
    (formula,) = re.findall(r"`motion` = (v \+ j − j′),", PAGE)
    now, before, j, jitter_before = 100.0, 97.0, 0.25, -0.375
    v = (before + jitter_before) - (now + j)
    assert math.isclose(value(formula.replace("′", "_"), v=v, j=j, j_=jitter_before), before - now)


@pytest.mark.parametrize("row", DEPTH)
def test_depths_of_buffers_become_distances(row: str) -> None:
    """Against the matrices by which depth buffers are defined: clip = (a·z + b, z), buffer = clip₀ / clip₁."""
    near, far = (0.0, 1.0) if "near 0" in row else (-1.0, 1.0) if "near −1" in row else (1.0, 0.0)
    a, b = np.linalg.solve([[NEAR, 1], [FAR, 1]], [near * NEAR, far * FAR])
    if "infinity" in row:
        a, b = 0.0, NEAR
    for z in (NEAR, 1.0, 7.5, FAR):
        d = (a * z + b) / z
        assert math.isclose(value(DEPTH[row][0], d=d, n=NEAR, f=FAR), z, rel_tol=1e-9)
    assert len(DEPTH) == 4
