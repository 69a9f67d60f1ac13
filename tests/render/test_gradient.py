"""Temporal gradients: nothing where nothing changes, and what they must be on average."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from nte.color import REC709
from nte.filters.asvgf import Asvgf, AsvgfOptions
from nte.frames.frame import Frame
from nte.render.components.frame import noisy
from nte.render.components.gradient import GRADIENTS, STRATUM, shade_again, shade_before
from nte.render.engine.mesh_stage import MeshStage
from nte.render.scenes import shapes
from nte.render.world.scene import Camera, Material, Scene, SceneObject
from nte.render.world.transforms import Track, look_at, moving, still, translation
from nte.session import Session
from tests.render.shots import guides_at, references_at

pytestmark = pytest.mark.slow
SIZE, UP = 24, (0.0, 1.0, 0.0)
EYE = still(look_at((0, 3, -3), (0, 0, 0.2)))
GREY = np.full((1, 1, 3), 0.6, np.float32)


def thing(mesh: shapes.Mesh, track: Track, radiance=None, **material) -> SceneObject:
    return SceneObject(mesh, Material(GREY, **material), track, radiance)


def floor(*more: SceneObject, lamp: Track | None = None, camera: Track = EYE) -> Scene:
    """A floor wider than the image, a glossy ball on it, and a small lamp above that looks down."""
    square = shapes.rectangle((-0.4, 0, -0.4), (0.8, 0, 0), (0, 0, 0.8))
    return Scene(
        (
            thing(shapes.rectangle((-9, 0, 9), (18, 0, 0), (0, 0, -18)), still()),
            thing(shapes.sphere(), still(translation((0.3, 0.5, 0.3))), surface="glossy", roughness=0.4),
            thing(square, lamp or still(translation((0.8, 2.2, 0))), (6.0, 6.0, 6.0)),
            *more,
        ),
        Camera(camera, 40.0),
    )


def gradients(scene: Scene, seed: int = 1, width: int = SIZE, height: int = SIZE) -> np.ndarray:
    """That of all light, (2, H, W) at time 1."""
    return of(MeshStage(scene, width, height, 4), seed)["gradient"]


def of(stage: MeshStage, seed: int) -> dict[str, np.ndarray]:
    with stage.at(0) as before:
        replay = shade_before(before, 1, seed)
    with stage.at(1) as moment:
        return shade_again(moment, replay)


def strata(image: np.ndarray) -> np.ndarray:
    """(H, W) → (strata, 9), padded with 0."""
    height, width = (-(-size // STRATUM) * STRATUM for size in image.shape)
    full = np.zeros((height, width), image.dtype)
    full[: image.shape[0], : image.shape[1]] = image
    return full.reshape(height // 3, 3, width // 3, 3).swapaxes(1, 2).reshape(-1, 9)


def test_nothing_changes_so_nothing_differs():
    """Not even in the last bit, and every stratum has its sample, those cut by the border too."""
    for now, then in of(MeshStage(floor(), 26, 22, 4), 1).values():
        np.testing.assert_array_equal(now, then)
        assert (strata(np.isfinite(now)).sum(1) == 1).all()
        assert np.nanmean(now) > 1e-3


def test_the_sample_is_a_random_pixel_of_its_stratum():
    found = [strata(np.isfinite(gradients(floor(), seed)[0])).argmax(1) for seed in (1, 2)]
    assert (np.bincount(np.concatenate(found), minlength=9) > 0).all()
    assert (found[0] != found[1]).any()


def test_only_what_the_light_reaches_differs():
    """A second lamp rises; it looks to −x, so that only the floor on its far side is lit by it."""
    square = shapes.rectangle((0, -0.4, -0.4), (0, 0, 0.8), (0, 0.8, 0))
    rises = moving(lambda time: np.array((-0.3, 0.6 + time, 0)), UP, 0.0)
    matt = floor(thing(square, rises, (20.0, 20.0, 20.0)))
    stage = MeshStage(replace(matt, objects=(matt.objects[0], *matt.objects[2:])), SIZE, SIZE, 4)
    now, then = of(stage, 1)["gradient"]
    known, x = np.isfinite(now), guides_at(stage, 1)["position"][0]
    lit, unlit = known & (x < -0.8), known & (x > 0)
    assert min(lit.sum(), unlit.sum()) > 10
    assert (now[lit] != then[lit]).mean() > 0.9
    assert (now[unlit] == then[unlit]).mean() > 0.9  # the rest is light that the lamps themselves reflect


def test_hidden_surfaces_are_rejected():
    """A plate slides in from outside, over what the previous frame saw, and was not itself in view."""
    plate = shapes.rectangle((-2, 0, 2), (4, 0, 0), (0, 0, -4))
    slides = moving(lambda time: np.array((-5 * (1 - time), 1.0, 0)), UP, 0.0)
    now, _ = gradients(floor(thing(plate, slides)))
    stage = MeshStage(floor(thing(plate, slides)), SIZE, SIZE, 4)
    instance = guides_at(stage, 1)["instance"][0]
    covered = instance == 4
    assert covered.mean() > 0.2
    inner = strata(covered).all(1)
    assert not strata(np.isfinite(now))[inner].any()
    assert (strata(np.isfinite(now)).sum(1) <= 1).all()


def test_samples_follow_a_moving_camera():
    """At most one in each stratum, most strata have one, and on a matt floor in still light they hardly differ."""
    moves = lambda time: translation((0.2 * time, 0, 0.1 * time)) @ EYE(time)  # noqa: E731
    matt = replace(floor(camera=moves), objects=floor().objects[::2])
    now, then = gradients(matt)
    count = strata(np.isfinite(now)).sum(1)
    assert count.max() == 1
    assert count.mean() > 0.8
    known = np.isfinite(now)
    np.testing.assert_allclose(now[known], then[known], rtol=1e-4, atol=1e-6)


def test_the_components_make_up_the_whole():
    """In shadow there is indirect and glossy light alone; elsewhere more. Everything here has one albedo."""
    lamp = moving(lambda time: np.array((0.8 - 0.7 * time, 2.2, 0)), UP, 0.0)
    found = of(MeshStage(floor(lamp=lamp), 40, 28, 4), 3)
    whole, visible, indirect, glossy = (found[name] for name in GRADIENTS)
    known = np.isfinite(whole)
    assert all((np.isfinite(values) == known).all() for values in found.values())
    assert set(np.unique(visible[known])) == {0, 1}
    shadowed = known & (visible == 0)
    np.testing.assert_allclose((indirect + glossy / 0.6)[shadowed], whole[shadowed], rtol=1e-5)
    assert ((indirect + glossy / 0.6)[known] <= whole[known] * (1 + 1e-5)).all()
    assert (visible[0] != visible[1])[known[0]].any()


def shadow_runs(frames: int) -> Iterator[Frame]:
    """A bar runs below a small lamp, above the view; a wall with a light of its own lights the floor indirectly.

    One bounce, so that the shadow itself lights nothing.
    """
    lamp = shapes.rectangle((-0.05, 0, -0.05), (0.1, 0, 0), (0, 0, 0.1))
    bar = shapes.rectangle((-0.08, 0, -1), (0.16, 0, 0), (0, 0, 2))
    runs = moving(lambda time: np.array((-0.3 + 0.06 * time, 2.4, 0)), UP, 0.0)
    scene = Scene(
        (
            thing(shapes.rectangle((-9, 0, 9), (18, 0, 0), (0, 0, -18)), still()),
            thing(shapes.rectangle((-4, 0, 3), (0, 6, 0), (8, 0, 0)), still()),
            thing(shapes.rectangle((-3, 1, 2), (6, 0, 0), (0, 1, 0)), still(), (5.0, 5.0, 5.0)),
            thing(lamp, still(translation((0, 3, 0))), (200.0, 200.0, 200.0)),
            SceneObject(bar, Material(np.full((1, 1, 3), 0.01, np.float32)), runs),
        ),
        Camera(EYE, 40.0),
    )
    stage = MeshStage(scene, 48, 36, 3)
    for time in range(frames):
        clean, (sample,) = noisy(stage, time, [time])
        yield Frame({name: values[None] for name, values in (clean | sample).items()}, time)


def test_a_moving_shadow_resets_visibility_and_not_indirect_light():
    """Rendered frames, filtered: what is forgotten is what has changed."""
    frames = list(shadow_runs(8))
    now, then = frames[-1]["gradient_visibility"][0]
    swept = np.isfinite(now) & (now != then)
    assert swept.sum() > 20

    def lengths(target: str, *without: str) -> np.ndarray:
        session = Session(Asvgf(AsvgfOptions(target, gradient_iterations=1)))
        for frame in frames:
            seen = {name: values for name, values in frame.channels.items() if name not in without}
            found = session.step(Frame(seen, frame.index), ("history_length",)).extras["history_length"]
        return found[0, 0][swept]

    assert np.median(lengths("visibility")) < 3
    assert np.median(lengths("indirect")) > 7
    assert np.median(lengths("indirect", "gradient_indirect")) < 3  # with the gradient of all light


def test_all_are_unbiased():
    """The mean over seeds is the reference of each frame, as filters see it: everything here has one albedo.

    On the floor: where a pixel shows two surfaces, its visibility is a mean weighted by light, which no point knows.
    """
    lamp = moving(lambda time: np.array((0.8 - 0.7 * time, 2.2, 0)), UP, 0.0)
    stage = MeshStage(floor(lamp=lamp), SIZE, SIZE, 4)
    runs = [of(stage, seed) for seed in range(64)]
    on_floor = np.repeat(strata(guides_at(stage, 1)["instance"][0] == 1).all(1), 9).reshape(-1, 9)
    expected = []
    for time in (0, 1):
        emission = guides_at(stage, time)["emission"]
        light = references_at(stage, time, 1024, (5, 6))
        color = (light["reference_a"] + light["reference_b"]) / 2 - emission
        visible, indirect, glossy = (light[f"reference_{name}"] for name in ("visibility", "indirect", "glossy"))
        expected.append((luminance(color) / 0.6, visible[0], luminance(indirect) / 0.6, luminance(glossy)))
    assert abs(expected[1][0].mean() / expected[0][0].mean() - 1) > 0.02
    for number, name in enumerate(GRADIENTS):
        chosen = on_floor if name == "gradient_visibility" else np.ones_like(on_floor)
        for which, images in enumerate(expected[::-1]):
            mean = strata(images[number])[chosen].mean()
            each = np.array([np.nanmean(strata(run[name][which])[chosen]) for run in runs])
            error = each.std() / np.sqrt(len(each))
            assert error < (0.03 if number < 2 else 0.25) * mean, name
            assert abs(each.mean() - mean) < 4 * error, name


def luminance(image: np.ndarray) -> np.ndarray:
    return (image * np.array(REC709)[:, None, None]).sum(0)
