"""TRMV as a denoiser: what must hold for the whole system and each of its switches."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.filters.trmv import Trmv
from nte.filters.trmv.options import TrmvOptions
from nte.frames.channels import COMPONENTS
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.session import Session
from tests.filters.trmv_frames import Pixels, ball_normals, directions, plane

EVERYTHING = (*COMPONENTS, *(f"{name}_alpha" for name in COMPONENTS), "disoccluded")
VARIANTS: tuple[dict[str, Any], ...] = (
    {},
    {"shadow": "traditional", "glossy": "traditional", "occlusion": "traditional", "indirect": "colour"},
    {"shadow": "none", "glossy": "none", "occlusion": "none"},
    {"glossy": "specular"},
    {"shadow": "gradient", "glossy": "gradient", "occlusion": "gradient"},
    {"occlusion": "gradient", "indirect": "colour", "clamp": float("inf"), "cleanup": False},
    {"occlusion": "dual", "indirect": "colour"},
    {"clamp": float("inf"), "cleanup": False},
    {"history": "blended", "warm_up": False, "reshading": "paper", "half_angle": 30.0},
)


def run(frames: list[Frame], extras: tuple[str, ...] = COMPONENTS, **options: Any) -> list[dict[str, Pixels]]:
    session = Session(Trmv(TrmvOptions(**options)))
    results = [session.step(frame, extras) for frame in frames]
    return [{"image": np.asarray(r.image), **{k: np.asarray(v) for k, v in r.extras.items()}} for r in results]


def moving(count: int, **given: Any) -> list[Frame]:
    """A noisy plane under a camera that moves, with shadows and reflections that move otherwise."""
    rng = np.random.default_rng(3)
    frames = []
    for index in range(count):
        frame = plane(index, batch=given.get("batch", 1))
        shadow = np.where(np.isnan(frame["shadow_motion"]), np.nan, rng.normal(0, 3, frame["shadow_motion"].shape))
        frames.append(
            frame.with_channels(
                motion=np.full_like(frame["motion"], 1.25),
                previous_forward_motion=np.full_like(frame["motion"], -1.25),
                shadow_motion=shadow.astype(np.float32),
                reflection_motion=rng.normal(0, 3, frame["motion"].shape).astype(np.float32),
                reflection_covariance=np.broadcast_to(
                    np.array([2, 0.5, 1], np.float32).reshape(1, 3, 1, 1), frame["reflection_covariance"].shape
                ).copy(),
            )
        )
    return frames


@pytest.mark.parametrize("options", VARIANTS)
def test_the_image_is_the_sum_of_its_light(options: dict[str, Any]) -> None:
    frames = moving(3)
    for frame, found in zip(frames, run(frames, **options), strict=True):
        light = frame["emission"] + frame["direct"] * found["visibility"] + found["glossy"] + found["indirect"]
        np.testing.assert_allclose(found["image"], light, rtol=1e-5, atol=1e-6)
        assert found["visibility"].min() >= 0
        assert found["visibility"].max() <= 1 + 1e-6


def test_a_frame_without_emission_has_none() -> None:
    """As of denoisers that are composed of one for each component."""
    dark = moving(2)
    assert not dark[0]["emission"].any()
    without = [replace(f, channels={k: v for k, v in f.channels.items() if k != "emission"}) for f in dark]
    for there, absent in zip(run(dark), run(without), strict=True):
        np.testing.assert_array_equal(absent["image"], there["image"])
    composed = load_denoiser("svgf:target=components")
    assert all("emission" in denoiser.optional for denoiser in (Trmv(), composed))


def errors(frames: list[Frame], **options: Any) -> dict[str, list[float]]:
    """RMSE over time of what the plane's noise is about: half shadowed, light of mean 1."""
    truths = {"visibility": 0.5, "glossy": 1.0, "indirect": frames[0]["albedo"]}
    outputs = run(frames, **options)
    return {name: [float(np.sqrt(np.mean((o[name] - truth) ** 2))) for o in outputs] for name, truth in truths.items()}


# After n frames 1/√n of a single frame's error is left, until α = 1/10, and then √(α / (2 − α)).
FLOOR = (0.1 / 1.9) ** 0.5


@pytest.mark.slow
def test_at_rest_errors_fall_like_those_of_a_running_mean_to_the_floor_of_alpha() -> None:
    # Sixteen sequences: the filters leave so few independent pixels in one that its own error is a matter of luck.
    frames = [plane(index, batch=16) for index in range(40)]
    found = errors(frames, clamp=float("inf"), cleanup=False)
    for name, by_frame in found.items():
        assert by_frame[3] == pytest.approx(by_frame[0] / 2, rel=0.2), name
        assert by_frame[9] == pytest.approx(by_frame[0] / 10**0.5, rel=0.2), name
        assert np.mean(by_frame[30:]) == pytest.approx(FLOOR * by_frame[0], rel=0.2), name


@pytest.mark.slow
@pytest.mark.parametrize("lobe", [0.0, 36.0])
def test_at_rest_the_whole_system_converges_too(lobe: float) -> None:
    """Clamp and clean-up do not stand in the way: neither of a mirror nor where filters are wide."""
    size = (48, 64)
    wide = np.broadcast_to(np.reshape([lobe, 0, lobe], (1, 3, 1, 1)), (4, 3, *size)).astype(np.float32)
    frames = [plane(index, size, batch=4, reflection_covariance=wide) for index in range(30)]
    alone = errors(frames[:1], cleanup=False)
    for name, by_frame in errors(frames).items():
        # At the border some of the vectors drawn from a lobe leave the image, and there is no history.
        most = 2 if name == "glossy" and lobe else 1.25
        assert np.mean(by_frame[-8:]) < most * FLOOR * alone[name][0], name


def test_without_warming_up_alpha_is_constant() -> None:
    frames = [plane(index) for index in range(4)]
    by_frame = run(frames, ("visibility_alpha",), shadow="traditional", warm_up=False, alpha=0.2)
    assert [float(np.unique(o["visibility_alpha"]).squeeze()) for o in by_frame] == pytest.approx([1, 0.2, 0.2, 0.2])
    warmed = run(frames, ("visibility_alpha",), shadow="traditional", alpha=0.3)
    assert [float(o["visibility_alpha"].mean()) for o in warmed] == pytest.approx([1, 1 / 2, 1 / 3, 0.3])


@pytest.mark.parametrize("options", [{}, {"indirect": "colour"}, {"clamp": 1.0, "half_angle": 30.0}])
def test_a_white_environment_stays_exactly_white(options: dict[str, Any]) -> None:
    normal = ball_normals((20, 28))
    albedo = np.random.default_rng(0).uniform(0.1, 1, (1, 3, 20, 28)).astype(np.float32)
    frames = []
    for index in range(6):
        rng = np.random.default_rng(index)
        taken = rng.random((1, 1, 20, 28)) < 0.6
        frames.append(
            plane(
                index,
                normal=normal,
                albedo=albedo,
                motion=np.full((1, 2, 20, 28), 0.7, np.float32),
                indirect=albedo,
                indirect_radiance=np.broadcast_to(taken, (1, 3, 20, 28)).astype(np.float32),
                indirect_direction=directions(rng, normal) * taken,
            )
        )
    for found in run(frames, **options):
        np.testing.assert_allclose(found["indirect"], albedo, rtol=2e-5, atol=0)


def test_the_papers_reshading_makes_white_twice_as_bright() -> None:
    white = plane(indirect_radiance=np.ones((1, 3, 20, 28), np.float32))
    direction = directions(np.random.default_rng(0), white["normal"])
    found = run([white.with_channels(indirect_direction=direction)], reshading="paper")[0]
    np.testing.assert_allclose(found["indirect"], 2 * white["albedo"], rtol=1e-5)


@pytest.mark.parametrize("options", VARIANTS)
def test_without_motion_no_pixel_moves(options: dict[str, Any]) -> None:
    # Stripes 4 px wide, each a surface of its own with light of its own: whatever moved a pixel would mix two.
    stripe = np.arange(28) // 4
    rng = np.random.default_rng(2)

    def by_stripe(channels: int, low: float, high: float) -> Pixels:
        return np.tile(rng.uniform(low, high, (1, channels, 1, 7))[..., stripe], (1, 1, 20, 1)).astype(np.float32)

    light = by_stripe(3, 0.1, 5)
    still = plane(
        depth=np.broadcast_to(5 * 1.5**stripe, (1, 1, 20, 28)),
        visibility=by_stripe(1, 0, 1),
        glossy=by_stripe(3, 0, 3),
        indirect_radiance=light,
        indirect=light * plane()["albedo"],
        indirect_direction=plane()["normal"],
        shadow_motion=np.zeros((1, 2, 20, 28)),
    )
    outputs = run([replace(still, index=index) for index in range(5)], **options)
    for found in outputs:
        np.testing.assert_allclose(found["visibility"], still["visibility"], rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(found["glossy"], still["glossy"], rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(found["indirect"], outputs[0]["indirect"], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("options", VARIANTS)
def test_a_reset_is_a_new_start_bit_for_bit(options: dict[str, Any]) -> None:
    frames = moving(4, batch=2)
    frames[2] = replace(frames[2], reset=np.array([0, 1], np.float32))
    fresh = run(frames[2:], EVERYTHING, **options)
    for again, new in zip(run(frames, EVERYTHING, **options)[2:], fresh, strict=True):
        for name in new:
            if name != "disoccluded":
                np.testing.assert_array_equal(again[name][1], new[name][1], err_msg=name)


@pytest.mark.parametrize("options", VARIANTS)
def test_a_batch_is_its_sequences_side_by_side(options: dict[str, Any]) -> None:
    frames = moving(3, batch=2)
    both = run(frames, EVERYTHING, **options)
    for element in range(2):
        alone = [replace(f, channels={k: v[element : element + 1] for k, v in f.channels.items()}) for f in frames]
        for together, single in zip(both, run(alone, EVERYTHING, **options), strict=True):
            for name in single:
                np.testing.assert_allclose(together[name][element], single[name][0], rtol=1e-4, atol=1e-5, err_msg=name)


def test_the_same_frames_give_the_same_numbers_in_numpy_and_in_torch() -> None:
    frames = moving(3)
    ours, again, theirs = run(frames), run(frames), run([frame.torch() for frame in frames])
    for a, b, c in zip(ours, again, theirs, strict=True):
        np.testing.assert_array_equal(a["image"], b["image"])
        np.testing.assert_array_equal(a["image"], c["image"])


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (3, 2), (40, 5)])
def test_images_smaller_than_the_kernels(size: tuple[int, int]) -> None:
    for found in run([plane(index, size=size) for index in range(3)], EVERYTHING):
        assert all(np.isfinite(values).all() for values in found.values())


def test_a_frame_of_sky_is_its_emission() -> None:
    nothing = {name: np.zeros((1, c, 20, 28), np.float32) for name, c in (
        ("normal", 3), ("depth", 1), ("position", 3), ("direct", 3), ("glossy", 3), ("indirect", 3), ("albedo", 3),
        ("indirect_radiance", 3), ("indirect_direction", 3),
    )}  # fmt: skip
    nothing |= {name: np.full((1, c, 20, 28), np.nan, np.float32) for name, c in (
        ("shadow_motion", 2), ("reflection_motion", 2), ("reflection_covariance", 3),
    )}  # fmt: skip
    sky = np.random.default_rng(0).random((1, 3, 20, 28)).astype(np.float32)
    frames = [plane(i, emission=sky, visibility=np.ones((1, 1, 20, 28), np.float32), **nothing) for i in range(3)]
    for found in run([*frames, plane(3), frames[0]])[:3]:
        np.testing.assert_array_equal(found["image"], sky)


def test_a_single_pixel_object_keeps_its_own_light() -> None:
    frames = []
    for index in range(5):
        frame = plane(index, glossy=np.ones((1, 3, 20, 28), np.float32))
        frame["depth"][..., 10, 12] = 1
        frame["normal"][..., 10, 12] = [[1, 0, 0]]
        frame["glossy"][..., 10, 12] = 50
        frame["visibility"][..., 10, 12] = 1
        covariance = np.full((1, 3, 20, 28), [[[[4]], [[0]], [[4]]]], np.float32)
        frames.append(frame.with_channels(reflection_covariance=covariance))
    assert np.isfinite(run(frames)[-1]["image"]).all()
    found = run(frames, glossy="traditional", clamp=float("inf"))[-1]
    np.testing.assert_allclose(found["glossy"][0, :, 10, 12], 50, rtol=1e-4)
    np.testing.assert_allclose(np.delete(found["glossy"].reshape(3, -1), 10 * 28 + 12, axis=1), 1, rtol=1e-4)
    np.testing.assert_allclose(found["visibility"][0, 0, 10, 12], 1, rtol=1e-4)


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
@pytest.mark.parametrize("options", VARIANTS)
def test_bad_pixels_do_not_spread(options: dict[str, Any]) -> None:
    frames = moving(3)
    for frame in frames:
        for offset, name in enumerate(frame.channels):
            frame[name][..., 5, offset] = [np.nan, np.inf, -np.inf, -1][offset % 4]
    for found in run(frames, EVERYTHING, **options):
        for name, values in found.items():
            assert np.isfinite(values).all(), name


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
@pytest.mark.parametrize("options", [{}, {"indirect": "colour"}])
@pytest.mark.parametrize("lobe", [0.0, 4.0], ids=["mirror", "rough"])
def test_pixels_that_tell_nothing_do_not_darken(options: dict[str, Any], lobe: float) -> None:
    """A tenth of them broken in each frame, at rest: their neighbours and their history speak for them."""
    size, names = (36, 48), ("indirect", "indirect_radiance", "glossy", "visibility")
    whole, broken = [], []
    for index in range(14):
        covariance = np.broadcast_to(np.float32([lobe, 0, lobe]).reshape(1, 3, 1, 1), (1, 3, *size))
        frame = plane(index, size, reflection_covariance=covariance)
        bad = np.random.default_rng([index, 5]).random((1, 1, *size)) < 0.1
        whole.append(frame)
        broken.append(frame.with_channels(**{n: np.where(bad, np.float32(np.nan), frame[n]) for n in names}))
    expected, found = (run(frames, **options)[6:] for frames in (whole, broken))
    for name in COMPONENTS:
        means = [np.mean([frame[name].mean() for frame in frames]) for frames in (expected, found)]
        assert means[1] == pytest.approx(means[0], rel=0.02), name


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
@pytest.mark.parametrize("options", [{}, {"indirect": "colour"}])
def test_a_frame_that_tells_nothing_leaves_history_as_it_is(options: dict[str, Any]) -> None:
    names = ("indirect", "indirect_radiance", "glossy", "visibility")
    frames = [plane(index) for index in range(10)]
    broken = frames[8].with_channels(**{n: np.full_like(frames[8][n], np.nan) for n in names})
    before, during, after = run([*frames[:8], broken, frames[9]], **options)[-3:]
    for name in COMPONENTS:
        np.testing.assert_allclose(during[name].mean(), before[name].mean(), rtol=0.01, err_msg=name)
        np.testing.assert_allclose(after[name].mean(), before[name].mean(), rtol=0.05, err_msg=name)


@pytest.mark.parametrize("options", [{}, {"indirect": "colour"}])
def test_small_things_before_the_sky_keep_their_light(options: dict[str, Any]) -> None:
    """The sky has no light to compare history with; it is not a black surface."""
    size = (28, 36)
    thing = np.zeros((1, 1, *size), bool)
    thing[..., 12:15, 16:20] = True
    frames = []
    for index in range(30):
        frame = plane(index, size)
        empty = {n: np.where(thing, frame[n], np.float32(0)) for n in frame.channels if n != "visibility"}
        unknown = {n: np.where(thing, frame[n], np.float32(np.nan)) for n in frame.channels if "reflection" in n}
        lit = np.where(thing, frame["visibility"], np.float32(1))
        frames.append(frame.with_channels(**empty, visibility=lit).with_channels(**unknown))
    found = run(frames, **options)[8:]
    for name, level in (("visibility", 0.5), ("glossy", 1.0), ("indirect", 0.5)):
        inside = np.mean([image[name][np.broadcast_to(thing, image[name].shape)].mean() for image in found])
        assert inside == pytest.approx(level, rel=0.15), name


@pytest.mark.parametrize("options", [{}, {"warm_up": False}, {"shadow": "traditional", "warm_up": False}])
def test_shadows_are_there_at_once_when_a_lamp_is_switched_on(options: dict[str, Any]) -> None:
    """Where there was no direct light, the visibility of 1 was nothing that history could hold."""
    frames = [plane(index) for index in range(10)]
    dark = {"direct": np.zeros((1, 3, 20, 28), np.float32), "visibility": np.ones((1, 1, 20, 28), np.float32)}
    dark["shadow_motion"] = np.full((1, 2, 20, 28), np.nan, np.float32)
    found = run([frame.with_channels(**dark) if frame.index < 8 else frame for frame in frames], **options)
    assert found[7]["visibility"].min() > 0.999
    for image in found[8:]:
        assert image["visibility"].mean() == pytest.approx(0.5, abs=0.05)


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
@pytest.mark.parametrize("options", VARIANTS)
def test_where_the_vector_is_unknown_there_is_no_history(options: dict[str, Any]) -> None:
    """No shadow and no reflection either, whose own vectors would say where history is."""
    unknown = np.arange(20)[:, None] < 8
    alone = {"visibility": np.ones((1, 1, 20, 28)), "reflection_covariance": np.full((1, 3, 20, 28), np.nan)}
    alone |= {name: np.full((1, 2, 20, 28), np.nan) for name in ("shadow_motion", "reflection_motion")}
    still = np.where(unknown, np.nan, np.zeros((1, 2, 20, 28)))
    frames = [plane(i, motion=still, previous_forward_motion=still, **alone) for i in range(3)]
    found = run(frames, EVERYTHING, **options)[-1]
    for name in COMPONENTS:
        assert (found[f"{name}_alpha"][..., :8, :] == 1).all(), name
        assert (found[f"{name}_alpha"][..., 8:, :] < 1).all() or "none" in options.values(), name


def test_without_vectors_history_is_not_used() -> None:
    frames = moving(4)
    options = {"shadow": "none", "glossy": "none", "occlusion": "none"}
    np.testing.assert_array_equal(run(frames, **options)[3]["image"], run(frames[3:], **options)[0]["image"])


@pytest.mark.parametrize("target", COMPONENTS)
def test_a_component_alone_is_that_of_the_whole(target: str) -> None:
    frames = moving(3)
    alone = Trmv(TrmvOptions(target))
    wanted = (*alone.needs, *alone.optional)
    needed = [replace(f, channels={name: f[name] for name in wanted if name in f}) for f in frames]
    assert len(needed[0].channels) < len(Trmv().needs)
    for whole, part in zip(run(frames), run(needed, (), target=target), strict=True):
        np.testing.assert_array_equal(part["image"], whole[target])


def test_what_the_history_is_changes_what_comes_next_and_not_what_is_shown() -> None:
    frames = moving(3)
    cleaned, blended = run(frames), run(frames, history="blended")
    np.testing.assert_array_equal(cleaned[0]["image"], blended[0]["image"])
    assert not np.array_equal(cleaned[2]["image"], blended[2]["image"])


def test_vectors_and_masks_are_to_be_had() -> None:
    frames = moving(2)
    names = tuple(f"{name}_vector" for name in COMPONENTS)
    found = run(frames, (*names, *EVERYTHING))[1]
    inside = np.isfinite(found["indirect_vector"]).all(1)[0]
    assert inside.any()
    assert not inside.all()
    np.testing.assert_allclose(found["indirect_vector"][0][:, inside], 1.25)
    np.testing.assert_array_equal(found["indirect_alpha"][0, 0] == 1, ~inside)
    with pytest.raises(NteError, match=r"Trmv has no extra 'kernels', expected one of disoccluded, visibility"):
        run(frames, ("kernels",))


def test_missing_components_name_the_recipe_that_renders_them() -> None:
    frame = plane()
    bare = replace(frame, channels={n: v for n, v in frame.channels.items() if n not in ("direct", "glossy")})
    with pytest.raises(NteError, match=r"Trmv needs direct, glossy, which is missing; .* groups that set components"):
        Session(Trmv()).step(bare)


def test_options_are_typed_like_any_other() -> None:
    made = load_denoiser("trmv:shadow=traditional,clamp=inf,cleanup=false,history=blended,half_angle=30")
    assert isinstance(made, Trmv)
    assert made.options.clamp == float("inf")
    assert "shadow_motion" not in made.needs
    for wrong, said in (
        ("shadow=best", "trmv: shadow is 'best', expected one of reliable, gradient, traditional, none"),
        ("alpha=0", "trmv: alpha is 0.0, expected a number above 0, at most 1"),
        ("clamp=-1", "trmv: clamp is -1.0"),
        ("target=direct", "expected one of color, visibility, glossy, indirect"),
    ):
        with pytest.raises(NteError, match=said):
            load_denoiser(f"trmv:{wrong}")


def test_options_ask_for_the_channels_that_they_use() -> None:
    plain = Trmv(TrmvOptions(shadow="traditional", glossy="traditional", occlusion="traditional", indirect="colour"))
    unused = ("shadow_motion", "position", "reflection_motion", "indirect_radiance", "indirect_direction", "gradient")
    assert not {*unused, "geometric_normal"} & {*plain.needs, *plain.optional}
    frames = [frame.with_channels() for frame in moving(3)]
    bare = [replace(f, channels={n: v for n, v in f.channels.items() if n not in unused}) for f in frames]
    assert np.isfinite(np.asarray(Session(plain).step(bare[0]).image)).all()
    assert "position" not in Trmv(TrmvOptions("glossy")).needs
    assert "gradient" in Trmv(TrmvOptions(glossy="gradient")).needs
    assert "gradient_glossy" in Trmv(TrmvOptions("glossy", glossy="gradient")).optional


@pytest.mark.parametrize("name", COMPONENTS)
def test_a_temporal_gradient_forgets_where_the_light_changed_and_only_there(name: str) -> None:
    frames = []
    for index in range(4):
        pairs = np.full((1, 2, 24, 48), np.nan, np.float32)
        pairs[:, :, 1::3, 1::3] = 1.0
        pairs[:, 0, 1::3, 1:24:3] = 0.5 if index == 3 else 1.0  # half as bright as before, on the nearer of two walls
        depth = np.broadcast_to(np.where(np.arange(48) < 24, 5, 50), (1, 1, 24, 48)).astype(np.float32)
        frames.append(plane(index, (24, 48), depth=depth).with_channels(gradient=pairs))
    option = {"visibility": "shadow", "glossy": "glossy", "indirect": "occlusion"}[name]
    alpha = run(frames, (f"{name}_alpha",), target=name, **{option: "gradient"})[3][f"{name}_alpha"][0, 0]
    np.testing.assert_allclose(alpha[:, :24], 0.25 + 0.75 * 0.5, atol=1e-3)  # lerp(α, 1, λ)
    np.testing.assert_allclose(alpha[:, 28:], 0.25, atol=1e-3)
    own = [f.with_channels(**{f"gradient_{name}": np.where(np.isnan(f["gradient"]), np.nan, 1.0)}) for f in frames]
    alpha = run(own, (f"{name}_alpha",), target=name, **{option: "gradient"})[3][f"{name}_alpha"]
    np.testing.assert_allclose(alpha, 0.25, atol=1e-3)


@pytest.mark.parametrize("options", [{}, {"indirect": "colour"}])
def test_indirect_light_leaves_by_the_diffuse_lobe_alone(options: dict[str, Any]) -> None:
    """A surface half metal: its albedo is that of both lobes, and only half of it is diffuse."""
    frames = []
    for index in range(20):
        frame = plane(index, (36, 48), albedo=np.full((1, 3, 36, 48), 0.8, np.float32))
        diffuse = np.where(np.arange(48) < 24, 0.4, 0.8).astype(np.float32) * np.ones((1, 3, 36, 48), np.float32)
        light = np.random.default_rng(index).exponential(size=(1, 1, 36, 48)).astype(np.float32)
        direction = directions(np.random.default_rng(index), frame["normal"])
        frames.append(
            frame.with_channels(
                diffuse_albedo=diffuse,
                indirect=light * diffuse,
                indirect_radiance=light * np.ones_like(diffuse),
                indirect_direction=direction,
            )
        )
    image = np.mean([found["indirect"] for found in run(frames, ("indirect",), target="indirect", **options)[5:]], 0)
    assert image[..., :24].mean() == pytest.approx(0.4, rel=0.02)
    assert image[..., 24:].mean() == pytest.approx(0.8, rel=0.02)


@pytest.mark.parametrize("options", [{}, {"indirect": "colour"}])
def test_indirect_history_comes_from_the_surface_itself(options: dict[str, Any]) -> None:
    """A bright near half and a dark far half, seen half a pixel further in each frame."""
    frames = []
    for index in range(8):
        near = np.broadcast_to(np.arange(48) + 0.5 * index < 24, (1, 1, 24, 48))
        light = np.where(near, 50.0, 1.0) * np.ones((1, 3, 24, 48))
        frame = plane(index, (24, 48), albedo=np.ones((1, 3, 24, 48), np.float32))
        given = {
            "depth": np.where(near, 5.0, 10.0),
            "indirect": light,
            "indirect_radiance": light,
            "indirect_direction": frame["normal"],
            "motion": np.full((1, 2, 24, 48), [[[[0.5]], [[0]]]]),
            "previous_forward_motion": np.full((1, 2, 24, 48), [[[[-0.5]], [[0]]]]),
        }
        frames.append(frame.with_channels(**{name: values.astype(np.float32) for name, values in given.items()}))
    found = run(frames, ("indirect",), target="indirect", clamp=float("inf"), cleanup=False, **options)[-1]["indirect"]
    np.testing.assert_allclose(found, frames[-1]["indirect"], rtol=1e-3)


def test_each_sequence_of_a_batch_has_its_own_noise() -> None:
    wide = np.broadcast_to(np.float32([25, 0, 25]).reshape(1, 3, 1, 1), (2, 3, 20, 28)).copy()
    frames = [plane(index, batch=2, reflection_covariance=wide) for index in range(2)]
    vectors = run(frames, ("glossy_vector",), target="glossy")[1]["glossy_vector"]
    both = np.isfinite(vectors).all((0, 1))
    assert not np.allclose(vectors[0][:, both], vectors[1][:, both])
    turned = [replace(f, channels={k: v[::-1].copy() for k, v in f.channels.items()}) for f in frames]
    again = run(turned, ("glossy_vector",), target="glossy")[1]["glossy_vector"]
    np.testing.assert_array_equal(vectors[::-1], again)  # wherever in the batch it is


def test_a_frame_of_another_size_is_refused() -> None:
    _, state = Trmv().step(plane(), None)
    with pytest.raises(NteError, match="start a new sequence"):
        Trmv().step(plane(1, size=(9, 9)), state)


def test_nothing_warns() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(moving(2))
    assert torch.get_default_dtype() == torch.float32


@pytest.mark.parametrize("occlusion", ["dual", "traditional"])
def test_where_the_dual_vector_leaves_the_image_the_occluder_is_no_history(occlusion: str) -> None:
    near = np.arange(28) < 10
    frames = [plane(0), plane(1)]
    frames[0] = frames[0].with_channels(depth=np.where(near, np.float32(3), frames[0]["depth"]))
    moved = np.stack([np.where(near, 20, 0), 0 * near]).astype(np.float32)
    frames[1] = frames[1].with_channels(previous_forward_motion=np.broadcast_to(moved[:, None], (1, 2, 20, 28)).copy())
    found = run(frames, EVERYTHING, occlusion=occlusion)[1]
    assert (found["disoccluded"] == near).all()
    np.testing.assert_array_equal(found["indirect_alpha"][0, 0] == 1, np.broadcast_to(near, (20, 28)))


@pytest.mark.parametrize("strip", [7, 20])
def test_strips_make_no_difference(monkeypatch: pytest.MonkeyPatch, strip: int) -> None:
    """Cones are fetched and blended in place, some rows at a time; edges between depths run across the strips."""
    frames = [
        frame.with_channels(depth=np.where(np.arange(28) < 9 + frame.index, np.float32(3), frame["depth"]))
        for frame in moving(4, batch=2)
    ]
    whole = run(frames, EVERYTHING)
    monkeypatch.setattr("nte.filters.trmv.indirect.STRIP", strip)
    for found, expected in zip(run(frames, EVERYTHING), whole, strict=True):
        for name, values in expected.items():
            np.testing.assert_allclose(found[name], values, rtol=1e-4, atol=1e-5, err_msg=name)
