"""Light components against what they must sum to, and against scenes whose answer is known."""

from pathlib import Path

import numpy as np
import pytest

from nte.errors import NteError
from nte.frames import CHANNELS, Clip
from nte.frames.exr import read_exr
from nte.render.components.frame import noisy
from nte.render.components.lobes import Lobes
from nte.render.components.resampling import sample_direct
from nte.render.engine import plugins
from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.mesh_stage import MeshStage
from nte.render.recipes.clips import COMPONENTS, render_clip
from nte.render.recipes.recipe import plan, read_recipe
from nte.render.scenes import shapes
from nte.render.scenes.families import FAMILIES
from nte.render.world.scene import Camera, Material, Scene, SceneObject
from nte.render.world.seeds import derive_generator
from nte.render.world.transforms import look_at, rotation, still, translation
from tests.render.shots import guides_at, radiance_at, references_at

SIZE = 24
GREY = np.full((1, 1, 3), 0.6, np.float32)
BSDFS = {
    "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.6, 0.7]}},
    "principled": {"type": "principled", "base_color": {"type": "rgb", "value": [0.5, 0.6, 0.7]}, "roughness": 0.3},
    "half metal": {"type": "principled", "metallic": 0.5, "flatness": 0.3, "sheen": 0.5, "roughness": 0.4},
    "roughplastic": {"type": "roughplastic", "alpha": 0.2},
    "plastic": {"type": "plastic"},
    "roughconductor": {"type": "roughconductor", "alpha": 0.2},
    "dielectric": {"type": "dielectric"},
}


def thing(shape, place, *turn, color=GREY, radiance=None, **material) -> SceneObject:
    track = still(translation(place) @ rotation(*turn)) if turn else still(translation(place))
    return SceneObject(shape, Material(color, **material), track, radiance)


def table(*more: SceneObject, lamps=(((0.8, 2.2, 0), (6.0, 6.0, 6.0)),)) -> Scene:
    """A floor with a glossy ball and a box on it, below small square lamps that look down."""
    square = shapes.rectangle((-0.4, 0, -0.4), (0.8, 0, 0), (0, 0, 0.8))
    return Scene(
        (
            thing(shapes.rectangle((-3, 0, 3), (6, 0, 0), (0, 0, -6)), (0, 0, 0)),
            thing(shapes.sphere(), (0.3, 1.0, 0.3), color=GREY / 2, surface="glossy", roughness=0.3),
            *more,
            *(thing(square, place, radiance=light) for place, light in lamps),
        ),
        Camera(still(look_at((0, 2.5, -4), (0, 0.6, 0))), 50.0),
    )


def staged(scene: Scene, max_depth: int = 4, size: int = SIZE) -> MeshStage:
    return MeshStage(scene, size, size, max_depth)


def recombined(channels: dict[str, np.ndarray], prefix: str = "") -> np.ndarray:
    lit = channels["direct"] * channels[f"{prefix}visibility"]
    return channels["emission"] + lit + channels[f"{prefix}glossy"] + channels[f"{prefix}indirect"]


def agree(ours: np.ndarray, truth: np.ndarray, noise: np.ndarray, mean: float = 0.01) -> None:
    """Two images of independent noise are the same image: `noise` (same shape) has the deviation of their difference.

    Mean absolute values, as single bright samples would rule a mean of squares.
    """
    assert ours.mean() == pytest.approx(truth.mean(), rel=mean)
    assert np.abs(ours - truth).mean() < 1.2 * np.abs(noise).mean() + 1e-4 * truth.mean()


def direct_light(here: MeshStage, seeds: int) -> np.ndarray:
    """(3, H, W), the mean over noise seeds."""
    with here.at(0) as moment:
        means = [sample_direct(moment.scenery, seed).mean for seed in range(seeds)]
        return np.mean(means, 0).reshape(3, here.height, here.width)


def check_recombination(here: MeshStage) -> None:
    """direct·reference_visibility + the others is mi.render, pixel by pixel, edges included."""
    channels = guides_at(here, 0)
    halves = [radiance_at(here, 0, 512, seed) for seed in (1, 2)]
    found = references_at(here, 0, 1024, (11, 12))
    ours = (found["reference_a"] + found["reference_b"]) / 2
    agree(ours, sum(halves) / 2, (halves[0] - halves[1]) / np.sqrt(2), mean=0.03)  # caustics of the dielectric
    channels["direct"] = direct_light(here, 24)
    difference = recombined(channels | found, "reference_") - ours
    assert np.abs(difference).mean() < 0.03 * ours.mean()  # the noise of F: both have light points of their own
    assert abs(difference.mean()) < 4e-3 * ours.mean()


@pytest.mark.parametrize("name", BSDFS)
def test_lobes_sum_to_the_whole(name: str):
    mi = load_mitsuba()
    scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": BSDFS[name]}})
    rng = np.random.default_rng(1)
    x, y, u, v = (mi.Float(values) for values in rng.uniform(-0.9, 0.9, (4, 64)) / [[1.5], [1.5], [2], [2]])
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, y, 4), mi.Vector3f(0, 0, -1)))
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(u + 0.5, v + 0.5))
    diffuse, others = Lobes(si, si.is_valid()).split(wo)
    whole = np.array(si.bsdf().eval(mi.BSDFContext(), si, wo))
    np.testing.assert_allclose(np.array(diffuse + others), whole, atol=1e-6, rtol=1e-5)
    assert (np.array(diffuse).max() > 0) == (name not in ("roughconductor", "dielectric"))
    assert (np.array(others).max() > 1e-5) == (name not in ("diffuse", "plastic", "dielectric"))


def test_the_diffuse_lobe_of_principled_is_what_its_colour_adds():
    mi, dr = load_mitsuba(), load_drjit()
    black = {**BSDFS["principled"], "base_color": {"type": "rgb", "value": 0.0}}
    scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": BSDFS["principled"]}})
    x = dr.linspace(mi.Float, -0.9, 0.9, 16)
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, 0.1, 4), mi.Vector3f(0, 0, -1)))
    wo = mi.warp.square_to_uniform_hemisphere(mi.Point2f(dr.abs(x), x * 0.5 + 0.5))
    without = mi.load_dict(black).eval(mi.BSDFContext(), si, wo)
    added = si.bsdf().eval(mi.BSDFContext(), si, wo) - without
    np.testing.assert_allclose(Lobes(si, si.is_valid()).diffuse(wo), added, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["principled", "roughplastic", "dielectric"])
def test_references_recombine_to_a_plain_path_trace(name: str, monkeypatch: pytest.MonkeyPatch):
    ours = plugins.bsdf
    monkeypatch.setattr(
        plugins, "bsdf", lambda material: BSDFS[name] if material.surface == "glossy" else ours(material)
    )
    check_recombination(staged(table()))


@pytest.mark.slow
def test_many_lights_of_one_colour():
    lamps = (((0.8, 2.2, 0), (6.0, 5.0, 3.0)), ((-1.2, 1.8, 1), (3.0, 2.5, 1.5)), ((0, 2.5, 1), (1.2, 1.0, 0.6)))
    check_recombination(staged(table(lamps=lamps)))


@pytest.mark.slow
def test_many_seeds_have_the_references_mean():
    here, count = staged(table()), 128
    found = references_at(here, 0, 4096, (1, 2))
    clean, runs = noisy(here, 0, range(count))
    direct = clean["direct"]
    for name in ("visibility", "indirect", "glossy"):
        weight = direct if name == "visibility" else 1
        samples = blocks(weight * np.stack([channels[name] for channels in runs]))
        error = samples.std(0, ddof=1) / np.sqrt(count)
        truth = blocks(weight * found[f"reference_{name}"])
        each = samples.mean((1, 2, 3))
        assert abs(each.mean() - truth.mean()) < 4 * each.std() / np.sqrt(count), name
        if name == "visibility":  # the others have too rare, too bright samples to ask this of a block
            z = (samples.mean(0) - truth) / (error + 1e-2 * truth.mean())
            assert abs(z.mean()) < 0.5
            assert np.abs(z).max() < 5
    color = np.mean([channels["color"] for channels in runs], 0)
    assert color.mean() == pytest.approx((found["reference_a"] + found["reference_b"]).mean() / 2, rel=0.01)


def blocks(images: np.ndarray) -> np.ndarray:
    """Means over 4×4 pixels: single pixels of rare bright samples are far from Gaussian."""
    return images.reshape(*images.shape[:-2], SIZE // 4, 4, SIZE // 4, 4).mean((-3, -1))


@pytest.mark.slow
def test_furnace():
    """Where everything is white and light comes from everywhere, everything is as bright as the light."""
    white = np.ones((1, 1, 3), np.float32)
    world = Scene(
        (thing(shapes.sphere(), (0.9, 0, 3), color=white), thing(shapes.sphere(), (-0.9, 0.3, 3.5), color=white)),
        Camera(still(look_at((0, 0, -1), (0, 0, 3))), 50.0),
        environment=(1.0, 1.0, 1.0),
    )
    here = staged(world, max_depth=64)
    channels = guides_at(here, 0)
    sky = channels["instance"][0] == 0
    found = references_at(here, 0, 1024, (1, 2))
    image = (found["reference_a"] + found["reference_b"]) / 2
    np.testing.assert_allclose(image, 1, atol=0.1)
    assert image.mean() == pytest.approx(1, abs=2e-3)
    direct = direct_light(here, 32)
    back = recombined(channels | found | {"direct": direct}, "reference_")
    assert back.mean() == pytest.approx(1, abs=3e-3)
    assert np.abs(back - 1).mean() < 0.02
    assert (found["reference_glossy"] == 0).all()
    assert (found["reference_indirect"][:, ~sky] > 0.01).any()  # between the balls


def test_a_clip_with_components(tmp_path: Path):
    text = "name: c\nseed: 3\ntrain:\n  - {clips: 1, width: 24, height: 20, frames: 2, seeds: 2, reference_spp: 8"
    (tmp_path / "r.yaml").write_text(text + ", components: true}")
    unit = plan(read_recipe(tmp_path / "r.yaml"))[0]
    render_clip(unit, tmp_path)
    clip = Clip(tmp_path / unit.name)
    further = read_exr(tmp_path / unit.name / "seed_01" / "frame_0001.exr")
    assert {name.rsplit(".", 1)[0] for name in further} == {"color", *COMPONENTS}
    assert all(CHANNELS[name].noisy for name in COMPONENTS)
    for seed in (0, 1):
        frame = clip.frame(1, seeds=(seed,))
        channels = {name: frame[name][0] for name in clip.channels}
        for name in ("reference_visibility", "reference_indirect", "reference_glossy", "direct", *COMPONENTS):
            assert channels[name].shape == (len(CHANNELS[name].components), 20, 24)
            assert CHANNELS[name].nan_means or np.isfinite(channels[name]).all()
        sum_, color = recombined(channels), channels["color"]
        assert (np.abs(sum_ - color) <= 2e-3 * sum_ + 1e-6).all()  # half floats: 2⁻¹¹ of each term
        assert set(np.unique(channels["visibility"])) <= {0, 1}
        assert (channels["visibility"][:, (channels["direct"] == 0).all(0)] == 1).all()
        length = np.linalg.norm(channels["indirect_direction"], axis=0)
        np.testing.assert_allclose(length[length > 0], 1, atol=1e-3)
        assert (channels["indirect_radiance"][:, length == 0] == 0).all()
        shadowed = channels["visibility"][0] == 0
        assert np.isnan(channels["shadow_motion"][:, ~shadowed]).all()
        assert np.isfinite(channels["shadow_motion"][:, shadowed]).mean() > 0.9
    before = {p: p.read_bytes() for p in sorted((tmp_path / unit.name).rglob("*.*"))}
    (tmp_path / unit.name / "frame_0001.exr").unlink()
    (tmp_path / unit.name / "seed_01" / "frame_0000.exr").unlink()
    (tmp_path / unit.name / "clip.json").unlink()
    render_clip(unit, tmp_path)
    assert {p: p.read_bytes() for p in sorted((tmp_path / unit.name).rglob("*.*"))} == before


def test_components_need_one_sample_per_pixel(tmp_path: Path):
    (tmp_path / "r.yaml").write_text("name: c\ntrain: [{clips: 1, spp: 2, components: true}]")
    with pytest.raises(NteError, match=r"train\[0\].spp is 2: expected 1 with components"):
        read_recipe(tmp_path / "r.yaml")


def test_kernels_are_shared_between_frames():
    dr = load_drjit()
    here = MeshStage(FAMILIES["rooms"](derive_generator("kernels")), 20, 16, 4)

    def frame(time: int) -> None:
        noisy(here, time, [time])
        references_at(here, time, 8, (time, time + 50))

    frame(0)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        frame(1)
        history = dr.kernel_history((dr.KernelType.JIT,))
    dear = [kernel for kernel in history if kernel["operation_count"] > 1000]
    # Surfaces with lobes; candidates; shadow ray and path; the gradient then and now; each half of the references.
    assert len(dear) == 7
    assert all(kernel["cache_hit"] for kernel in dear)
