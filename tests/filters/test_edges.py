"""Light stays on its side of an edge while things move by parts of a pixel, whatever tells the two surfaces apart."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.session import Session

SIZE = (9, 27)
Pixels = npt.NDArray[np.float32]
Three = tuple[float, float, float]

FORWARD = (0.0, 0.0, 1.0)
LEFT, RIGHT = (-0.6, 0.0, 0.8), (0.6, 0.0, 0.8)


class Edge(NamedTuple):
    """Two surfaces: depths (0: sky), normals, and how many columns the first one is wide (0: up to the border)."""

    depths: tuple[float, float]
    normals: tuple[Three, Three] = (FORWARD, FORWARD)
    width: int = 0


EDGES = {
    "step": Edge((2, 5)),
    "small step": Edge((4.4, 5)),
    "ridge": Edge((5, 5), (LEFT, RIGHT)),
    "sky": Edge((2, 0), (FORWARD, (0.0, 0.0, 0.0))),
    "post": Edge((2, 5), width=1),
    "wide post": Edge((2, 5), width=2),
    "turned post": Edge((2, 5), (RIGHT, FORWARD), 1),
    "groove": Edge((5, 5), (LEFT, RIGHT), 1),
    "post before the sky": Edge((2, 0), (FORWARD, (0.0, 0.0, 0.0)), 1),
}
FILTERS = ["svgf", "asvgf:target=glossy", "trmv:target=visibility", "trmv:target=glossy", "trmv:target=indirect"]


def picture(edge: Edge, index: int, speed: float, whole: bool, lit: int) -> Frame:
    """A frame whose light is 1 on the first surface, or on the second if `lit` is 1, and 0 on the other.

    The first surface moves by `speed`, px a frame, and the second one too if `whole`.
    """

    def both(one: npt.ArrayLike, other: npt.ArrayLike, index: int = index) -> Pixels:
        start, x = 10 + speed * index, np.arange(SIZE[1]) + 0.5
        first = (x >= start - edge.width) & (x < start) if edge.width else x < start
        values = (np.reshape(value, (1, -1, 1, 1)) for value in (one, other))
        return np.where(np.broadcast_to(first, (1, 1, *SIZE)), *values).astype(np.float32)

    vectors = ((-speed, 0), (-speed if whole else 0, 0))
    motion, depth, light = both(*vectors), both(*edge.depths), both(1 - lit, lit)
    hit, three = depth > 0, np.ones((1, 3, 1, 1))
    light = light * hit
    y, x = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5, indexing="ij")
    stratum = (y % 3 == 1.5) & (x % 3 == 1.5)
    channels: dict[str, Any] = {
        "color": 0.5 * light * three,
        "albedo": 0.5 * hit * three,
        "normal": both(*edge.normals),
        "depth": depth,
        "position": np.concatenate([(x - speed * whole * index) * depth / 20, y * depth / 20, depth], 1),
        "roughness": 0.3 * hit,
        "motion": motion,
        "previous_forward_motion": -both(*vectors, index - 1),
        "direct": hit * three,
        "visibility": np.where(hit, light, 1),
        "shadow_motion": np.where(hit & (light == 0), motion, np.nan),
        "indirect": 0.5 * light * three,
        "indirect_radiance": light * three,
        "indirect_direction": both(*edge.normals),
        "glossy": light * three,
        "reflection_motion": np.where(hit, motion, np.nan),
        "reflection_covariance": np.where(hit, np.reshape([1e-4, 0, 1e-4], (1, 3, 1, 1)), np.nan),
        "gradient": np.where(stratum, light.repeat(2, 1), np.nan),
    }
    given = {name: np.asarray(np.broadcast_to(c, (1, c.shape[1], *SIZE)), np.float32) for name, c in channels.items()}
    return Frame(given, index)


@pytest.mark.parametrize("spec", FILTERS)
@pytest.mark.parametrize("edge", EDGES)
def test_no_light_crosses_an_edge_in_motion(edge: str, spec: str) -> None:
    """The camera moves, or the object, which covers and uncovers, faster and slower than a dual vector's half pixel."""
    target = load_denoiser(spec).target
    for speed, whole, lit in ((0.37, True, 0), (-0.37, True, 1), (-0.3, False, 1), (0.9, False, 0)):
        session = Session(load_denoiser(spec))
        for index in range(6):
            frame = picture(EDGES[edge], index, speed, whole, lit)
            image = np.asarray(session.denoise(frame))
            expected = np.broadcast_to(np.asarray(frame[target]), image.shape)
            np.testing.assert_allclose(image, expected, atol=2e-3, err_msg=f"{speed} px, frame {index}")
