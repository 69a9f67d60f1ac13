"""History of shadows and reflections beside silhouettes, and at edges between rough and smooth, in motion."""

import numpy as np
import numpy.typing as npt
import pytest
import torch

from nte.filters.trmv import Trmv
from nte.filters.trmv.fetch import fetch_from_surface, fetch_within_edges
from nte.filters.trmv.inputs import prepare
from nte.filters.trmv.options import TrmvOptions
from nte.frames.frame import Frame
from nte.session import Session
from tests.filters.trmv_frames import plane

SIZE = (20, 40)
SPEED = 0.37  # px a frame
Mask = npt.NDArray[np.bool_]


def left_of(column: float) -> Mask:
    return np.broadcast_to(np.arange(SIZE[1]) + 0.5 < column, (1, 1, *SIZE))


def both(left: Mask, one: object, other: object) -> npt.NDArray[np.float32]:
    """(1, C, H, W): one value left of the edge, another one right of it."""
    one, other = (np.reshape(value, (1, -1, 1, 1)) for value in (one, other))
    return np.where(left, one, other).astype(np.float32)


def silhouette(index: int, background: float) -> tuple[Frame, Mask]:
    """A lit wall runs before a dark one, which moves by `background`, px a frame."""
    left = left_of(12 + SPEED * index)
    depth, motion = both(left, 2, 5), both(left, (-SPEED, 0), (-background, 0))
    x = np.arange(SIZE[1]) - SIZE[1] / 2 - background * index
    position = np.stack(np.broadcast_arrays(x * depth[0, 0] / 20, np.arange(SIZE[0])[:, None] / 20, depth[0, 0]))[None]
    channels = {
        "depth": depth,
        "position": position.astype(np.float32),
        "visibility": both(left, 1, 0),
        "shadow_motion": np.where(left, np.nan, motion).astype(np.float32),
        "motion": motion,
        "previous_forward_motion": -motion,
    }
    return plane(index, SIZE, **channels), left


@pytest.mark.parametrize("clamp", [3.0, float("inf")])
@pytest.mark.parametrize("background", [0, SPEED], ids=["object", "camera"])
def test_a_shadow_does_not_creep_over_a_silhouette_in_motion(background: float, clamp: float) -> None:
    session = Session(Trmv(TrmvOptions("visibility", clamp=clamp)))
    for index in range(12):
        frame, left = silhouette(index, background)
        image = np.asarray(session.step(frame).image)
    np.testing.assert_allclose(image, left, atol=1e-5)


@pytest.mark.parametrize("clamp", [3.0, float("inf")])
@pytest.mark.parametrize("speed", [0, SPEED])
def test_reflections_end_where_the_reflector_does(speed: float, clamp: float) -> None:
    """Polished and rough stone in one plane: vectors drawn from the lobe end between pixels of both."""
    session = Session(Trmv(TrmvOptions("glossy", clamp=clamp)))
    for index in range(12):
        left = left_of(20 + speed * index)
        motion = both(left, (-speed, 0), (-speed, 0))
        channels = {
            "roughness": both(left, 0.2, 0.9),
            "glossy": both(left, (1, 1, 1), (0, 0, 0)),
            "reflection_motion": np.where(left, motion, np.nan).astype(np.float32),
            "reflection_covariance": both(left, (4, 0, 4), [np.nan] * 3),
            "motion": motion,
            "previous_forward_motion": -motion,
        }
        image = np.asarray(session.step(plane(index, SIZE, **channels)).image)
    np.testing.assert_allclose(image, left.repeat(3, 1), atol=1e-5)


@pytest.mark.parametrize("target", ["visibility", "glossy"])
def test_a_pixel_like_no_other_keeps_its_history(target: str) -> None:
    """Guides of an edge are means of two surfaces: their depth was nowhere before."""
    session, there = Session(Trmv(TrmvOptions(target))), (0, 0, 10, 20)  # type: ignore[arg-type]
    for index in range(4):
        frame = plane(index, SIZE)
        frame["depth"][there] = 5 + 2 * index
        alpha = session.step(frame, (f"{target}_alpha",)).extras[f"{target}_alpha"]
    assert alpha[there] == pytest.approx(1 / 4, abs=1e-3)


def test_a_sky_is_fetched_as_quickly_as_a_wall() -> None:
    """Its pixels, whose normals are 0, face nowhere else: only those at the horizon are weighed one by one."""
    sky = np.broadcast_to(np.arange(SIZE[0])[:, None] < 10, (1, 1, *SIZE))
    frame = plane(0, SIZE, depth=np.where(sky, 0.0, 5.0), normal=np.where(sky, 0.0, np.reshape([0, 0, 1.0], (3, 1, 1))))
    inputs = prepare(frame.torch(), None)
    mixed = fetch_from_surface(inputs.dual, inputs._replace(before=inputs.gbuffer)).mixed
    assert mixed is not None
    rows = torch.unique(mixed.at[1])
    assert rows.tolist() == [8, 9, 10, 11]


@pytest.mark.parametrize("share", [0.004, 0.009, 0.012, 0.019, 0.03])
def test_a_share_of_a_pixel_that_shows_the_surface_tells_all_of_the_history_or_nothing(share: float) -> None:
    """Vectors end on a wall's edge, and so far beyond it that each of the wall's pixels has half of this share."""
    above = np.broadcast_to(np.arange(SIZE[0])[:, None] < 10, (1, 1, *SIZE))
    facing = both(above, (0, 0.6, 0.8), (0, 0, 1))
    motion = np.broadcast_to(np.reshape([0.5, share - 1], (1, 2, 1, 1)), (1, 2, *SIZE)).astype(np.float32)
    channels = {"depth": both(above, 5, 2), "normal": facing, "motion": motion, "previous_forward_motion": -motion}
    inputs = prepare(plane(0, SIZE, **channels).torch(), None)
    inputs = inputs._replace(before=inputs.gbuffer)
    for fetcher in (fetch_from_surface(inputs.traditional, inputs), fetch_within_edges(inputs.traditional, inputs)):
        light = fetcher(torch.ones(1, 1, *SIZE))
        torch.testing.assert_close(light[fetcher.valid], torch.ones_like(light[fetcher.valid]))
