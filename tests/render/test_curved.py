"""Curved mirrors: where they show a point, against a search for the shortest way on a true ball."""

import numpy as np
import pytest
import torch

from nte.motion.curved import reflecting_points
from nte.render.engine import plugins
from nte.render.engine.mesh_stage import MeshStage
from nte.render.passes.hits import curvatures_at, normals_at
from nte.render.passes.rays import trace_centres
from nte.render.scenes import shapes
from nte.render.world.scene import Camera, Mesh, Scene
from nte.render.world.transforms import look_at, rotation, still, translation
from tests.render.test_vectors import CENTRES, FOV, SIZE, STILL, drift, pixels, square, thing, vectors


def fine_ball() -> Mesh:
    return shapes.revolved(lambda v: np.sin(np.pi * v), lambda v: -np.cos(np.pi * v), 120, 80)


def places(point, normal, curvature, target, eye) -> np.ndarray:
    rows = (torch.from_numpy(np.broadcast_to(x, y.shape).copy()) for x, y in ((target, point), (eye, point)))
    return reflecting_points(*map(torch.from_numpy, (point, normal, curvature)), *rows).numpy()


def mirrored_by_a_ball(radius: float, target: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Places (R, 3) of a ball about the origin that mirror targets (R, 3) to the eye: the shortest ways, by search."""
    place = target + eye
    for step in np.geomspace(0.3, 1e-7, 60):
        tries = place[:, None] + step * radius * np.random.default_rng(0).normal(size=(40, 3))
        tries = np.concatenate([place[:, None], tries], 1)
        tries *= radius / np.linalg.norm(tries, axis=2, keepdims=True)
        way = np.linalg.norm(tries - eye, axis=2) + np.linalg.norm(tries - target[:, None], axis=2)
        place = tries[np.arange(len(tries)), way.argmin(1)]
    return place


def test_a_ball_mirrors_at_the_place_of_the_shortest_way():
    """From points up to a tenth of the radius away, as between frames, where the plane's mirror image is far off."""
    rng = np.random.default_rng(3)
    radius, eye = 0.7, np.array([0.3, 0.5, -4.0])
    target = rng.normal(size=(200, 3)) * 3 + (2, 4, -5)
    exact = mirrored_by_a_ball(radius, target, eye)
    known = exact + 0.07 * rng.uniform(-1, 1, exact.shape) / np.sqrt(3)
    known *= radius / np.linalg.norm(known, axis=1, keepdims=True)
    normal = known / radius
    curvature = (np.eye(3) - normal[:, :, None] * normal[:, None, :]) / radius
    found = places(known, normal, curvature, target, eye)
    assert np.linalg.norm(found - exact, axis=1).max() < 0.002 * radius
    image = target - 2 * ((target - known) * normal).sum(1, keepdims=True) * normal
    ray = (image - eye) / np.linalg.norm(image - eye, axis=1, keepdims=True)
    away = np.linalg.norm(np.cross(exact - eye, ray), axis=1)
    assert np.median(away) > 10 * np.linalg.norm(found - exact, axis=1).max()


def test_where_no_place_near_by_mirrors_the_target_there_is_none():
    normal = np.array([[0.0, 0.0, -1.0]])
    curvature = np.diag([1.0, 1.0, 0.0])[None]
    behind = np.array([[0.0, 0.0, 5.0]])
    assert np.isnan(places(-normal * -1, normal, curvature, behind, np.array([0.0, 0.0, -4.0]))).all()


def test_curvature_of_a_ball_is_one_over_its_radius_and_of_a_square_none():
    ball = thing(fine_ball(), (0.3, 0.2, 0), lambda place: still(translation(place) @ np.diag([0.5, 0.5, 0.5, 1])))
    floor = thing(square(6), (0, -1, 0), STILL)
    made = MeshStage(Scene((ball, floor), Camera(still(look_at((0, 3, -4), (0, 0, 0))), FOV)), SIZE, SIZE, 3)
    with made.at(0) as moment:
        hits = trace_centres(moment)
    curvature, normal = curvatures_at(made, hits, 0), normals_at(made, hits, 0)
    round_ = hits.instance == 1
    assert round_.sum() > 80
    expected = (np.eye(3) - normal[:, :, None] * normal[:, None, :]) / 0.5
    assert np.abs(curvature - expected)[round_].max() < 0.2 * 2
    assert not curvature[hits.instance == 2].any()
    assert not curvature[hits.instance == 0].any()


def test_reflection_in_a_mirror_ball(monkeypatch: pytest.MonkeyPatch):
    """Camera, ball and the wall it shows all move: the vector leads to where the ball showed the same point."""
    ours = plugins.bsdf
    monkeypatch.setattr(plugins, "bsdf", lambda m: {"type": "conductor"} if m.surface == "metal" else ours(m))
    ball, wall = drift(0.05, 0.03, 0), drift(0.1, 0.0, 0.05)
    facing = lambda place: lambda t: wall(place)(t) @ rotation((1, 0, 0), np.pi / 2)  # noqa: E731
    place, radius, back = (0.0, 0.0, 0.0), 1.0, (0.0, 0.0, -5.0)
    camera = Camera(lambda time: translation((0.15 * time, 0, 0)) @ look_at((-0.1, 0.3, -4), (-0.1, 0, 0)), 32)
    scene = Scene(
        (
            thing(fine_ball(), place, ball, surface="metal", roughness=0.0),
            thing(square(40), back, facing),
            thing(square(1), (0, 9, 0), lambda p: still(translation(p) @ rotation((1, 0, 0), np.pi)), (9, 9, 9)),
        ),
        camera,
    )
    motion = vectors(scene)["reflection_motion"]
    # By hand, on a true ball: reflect each pixel's ray, meet the wall, and find the place that mirrored it before.
    here = on_plane_z(camera, 1, CENTRES)
    eye = camera.track(1)[:3, 3] - ball(place)(1)[:3, 3]
    ray = (here / np.linalg.norm(here, axis=0)).reshape(3, -1).T
    reach = ray @ eye
    root = reach**2 - eye @ eye + radius**2
    central = (root > 0.5) & np.isfinite(motion).all(0).ravel()
    ray, hit = ray[central], eye + (-reach - np.sqrt(np.maximum(root, 0)))[central, None] * ray[central]
    out = ray - 2 * (ray * hit).sum(1, keepdims=True) * hit
    shift = ball(place)(1)[:3, 3]
    depth = wall(back)(1)[2, 3] - shift[2]
    ahead = out[:, 2] < -0.3
    target = hit + out * ((depth - hit[:, 2]) / out[:, 2])[:, None] + shift
    target += wall(back)(0)[:3, 3] - wall(back)(1)[:3, 3]
    centre = ball(place)(0)[:3, 3]
    before = mirrored_by_a_ball(radius, target - centre, camera.track(0)[:3, 3] - centre) + centre
    expected = pixels(camera, 0, before.T[:, :, None])[:, :, 0] - CENTRES.reshape(2, -1)[:, central]
    error = np.abs(motion.reshape(2, -1)[:, central] - expected).max(0)[ahead]
    assert ahead.sum() > 200
    assert np.abs(expected[:, ahead]).max() > 1
    assert np.quantile(error, 0.9) < 0.1
    assert np.median(error) < 0.05


def on_plane_z(camera: Camera, time: float, position: np.ndarray) -> np.ndarray:
    """World directions (3, H, W) of the rays through pixel positions (2, H, W)."""
    scale = camera.projection(SIZE, SIZE)[0, 0]
    x, y = (position / SIZE - 0.5) / scale
    return np.einsum("ij,jhw->ihw", camera.track(time)[:3, :3], np.stack([x, y, np.ones_like(x)]))
