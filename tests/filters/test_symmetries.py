"""What no filter may notice: a mirror, the order of x and y, units of light and length, and where constant light moves.

The frames show a slanted, coloured disc that moves before a slanted, textured wall and sky, with noise in every light.
Sizes are whole numbers of strata of 3×3 pixels, so that mirroring maps strata onto strata.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from torch import Tensor

from nte.frames.channels import reference_of
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.session import Session
from nte.training.augment import Augmentation

SIZE = (24, 36)
# Random numbers of a pixel, and the frame in which cones lie, are not mirrored with the image. So glossy vectors that
# are drawn, `mcguire`, the pre-filter of motion blur, and cones are left out here.
FILTERS = [
    "taa", "taa:clamp=none", "taa:clamp=clip", "svgf", "svgf:target=visibility", "asvgf", "asvgf:target=glossy",
    "trmv:indirect=colour,glossy=specular", "trmv:preset=gradient", "trmv:target=visibility", "motion_blur",
    "post_blur",
]  # fmt: skip
OTHERS = ["trmv:target=indirect", "motion_blur:preset=paper", "mcguire"]


@cache
def frames(size: tuple[int, int] = SIZE, count: int = 4) -> tuple[Frame, ...]:
    """A slanted disc before a slanted wall and sky; both move by parts of pixels."""
    rng, (height, width) = np.random.default_rng(0), size
    y, x = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
    speed, drift = np.reshape([1.3, -0.7], (2, 1, 1)), np.reshape([-0.6, 0.45], (2, 1, 1))

    def one(i: int) -> Frame:
        u, v = x - width * 0.4 - speed[0] * i, y - height * 0.55 - speed[1] * i
        disc = u**2 + v**2 < (0.27 * height) ** 2
        sky = (x + 2 * y < 0.35 * width) & ~disc
        depth = np.where(disc, 1 / (0.25 + 0.003 * u - 0.002 * v), 1 / (0.1 + 0.002 * x + 0.004 * y)) * ~sky
        normal = np.where(disc, np.reshape([-0.36, 0.48, 0.8], (3, 1, 1)), np.reshape([0.48, -0.6, 0.64], (3, 1, 1)))
        wall = np.stack([0.5 + 0.3 * np.sin(0.3 * (x - drift[0] * i)), 0.4 + 0 * x, 0.5 + 0.3 * np.sin(0.4 * y)])
        albedo = np.where(disc, np.stack([0.3 + 0.2 * np.sin(0.5 * u), 0.5 + 0 * x, 0.2 + 0.1 * np.cos(0.7 * v)]), wall)
        light = np.reshape([1, 0.8, 0.5], (3, 1, 1)) * np.where(disc, 1.5, 0.6 + 0.3 * np.sin(0.2 * x + 0.3 * y))
        forward = np.where(disc, speed, drift) + 0 * x
        blocked, reflected = rng.random((1, *size)) < 0.4, (rng.random((1, *size)) < 0.6) & ~sky
        direction = normal + 0.999 * _unit(rng.normal(size=(3, *size)))
        centre = (np.arange(height)[:, None] % 3 == 1) & (np.arange(width) % 3 == 1)
        pairs = np.where(centre, rng.exponential(size=(1, *size)) * rng.choice([1, 1, 0.3], (2, *size)), np.nan)

        def noise() -> np.ndarray:
            return rng.exponential(size=(1, *size))

        def vector(u: float, v: float, where: np.ndarray) -> np.ndarray:
            return np.where(where, np.reshape([u, v], (2, 1, 1)) + 0.2 * rng.normal(size=(2, *size)), np.nan)

        channels = {
            "color": albedo * light * ~sky * noise() + sky * 0.5,
            "albedo": albedo * ~sky,
            "diffuse_albedo": albedo * ~sky,
            "emission": sky * np.full((3, 1, 1), 0.5),
            "normal": normal * ~sky,
            "depth": depth[None],
            "position": np.stack([x * depth, y * depth, 9 * depth]),
            "roughness": np.where(disc, 0.2, 0.5)[None],
            "motion": -forward,
            "previous_forward_motion": forward,
            "direct": albedo * light * ~sky,
            "visibility": ~blocked,
            "indirect": albedo * light * ~sky * noise(),
            "indirect_radiance": light * ~sky * noise(),
            "indirect_direction": _unit(direction) * ~sky,
            "glossy": 0.5 * reflected * rng.exponential(size=(3, *size)),
            "shadow_motion": vector(0.7, -1.1, blocked),
            "reflection_motion": vector(-0.9, 0.4, reflected),
            "reflection_covariance": np.where(reflected, np.reshape([1.5, 0.3, 0.8], (3, 1, 1)), np.nan),
            "gradient": pairs,
            "gradient_visibility": pairs.clip(max=1),
            "gradient_indirect": pairs,
            "gradient_glossy": pairs,
            "time": rng.random((1, *size)),
            "shutter_motion": 3 * forward,
            "shutter_depth": depth[None],
        }
        return Frame({n: torch.from_numpy(np.asarray(c, np.float32)[None]) for n, c in channels.items()}, i)

    return tuple(one(i) for i in range(count))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=0)


def images(spec: str, given: tuple[Frame, ...]) -> list[Tensor]:
    session = Session(load_denoiser(spec))
    return [session.denoise(frame).clone() for frame in given]


def changed(given: tuple[Frame, ...], change: Augmentation) -> tuple[Frame, ...]:
    return tuple(replace(frame, channels=change(frame.channels)) for frame in given)


def require_the_same(spec: str, change: Augmentation, atol: float = 2e-4) -> None:
    """Require that the filter commutes with the change."""
    name = reference_of(load_denoiser(spec).target)
    for image, other in zip(images(spec, frames()), images(spec, changed(frames(), change)), strict=True):
        expected = change({name: image})[name]
        level = expected.mean()
        torch.testing.assert_close(other / level, expected / level, rtol=0, atol=atol)


@pytest.mark.parametrize("spec", FILTERS)
@pytest.mark.parametrize("axis", ["flip_x", "flip_y"])
def test_a_mirrored_sequence_gives_mirrored_images(spec: str, axis: str) -> None:
    require_the_same(spec, Augmentation(**{axis: True}))  # type: ignore[arg-type]


@pytest.mark.parametrize("spec", [spec for spec in FILTERS if not spec.startswith("trmv")])
def test_x_and_y_can_be_exchanged(spec: str) -> None:
    """TRMV's filters are separable, first along x, so they are left out."""
    require_the_same(spec, Augmentation(transpose=True))


@pytest.mark.parametrize("spec", [*FILTERS, *OTHERS])
def test_the_unit_of_light_does_not_matter(spec: str) -> None:
    for stops in (-33, 6):  # scenes whose light is 1e-10, and brighter ones
        require_the_same(spec, Augmentation(light=2.0**stops))


@pytest.mark.parametrize("spec", ["svgf", "asvgf", "trmv:target=visibility", "trmv:target=indirect", "motion_blur"])
@pytest.mark.parametrize("unit", [2.0**-10, 2.0**10])
def test_the_unit_of_length_does_not_matter(spec: str, unit: float) -> None:
    lengths = ("depth", "position", "shutter_depth")
    given = tuple(f.with_channels(**{name: f[name] * unit for name in lengths}) for f in frames())
    for image, other in zip(images(spec, frames()), images(spec, given), strict=True):
        torch.testing.assert_close(other, image, rtol=1e-3, atol=1e-4)


def moved(kind: str) -> Tensor:
    """Motion (1, 2, H, W), px."""
    height, width = SIZE
    y, x = torch.meshgrid(torch.arange(height) - height / 2, torch.arange(width) - width / 2, indexing="ij")
    random = torch.Generator().manual_seed(0)
    motion = {
        "zoom": 0.1 * torch.stack([x, y]),
        "random": 5 * torch.randn(2, height, width, generator=random),
        "unknown": torch.where(
            torch.rand(1, height, width, generator=random) < 0.3, torch.nan, torch.stack([x, y]) / 9
        ),
    }
    return motion[kind][None]


@pytest.mark.parametrize("kind", ["zoom", "random", "unknown"])
@pytest.mark.parametrize("spec", ["taa", "svgf", "asvgf", "trmv", "trmv:preset=gradient", *OTHERS, "align_accumulate"])
def test_constant_light_stays_constant_however_it_moves(spec: str, kind: str) -> None:
    """Whatever vectors say, and of whatever surface, only the same light is there to be fetched."""
    motion, light = moved(kind), torch.tensor([0.2, 0.5, 0.9]).view(1, 3, 1, 1)
    given = []
    for frame in frames():
        lit = light + 0 * frame["albedo"]
        reflected = 0.5 + 0 * lit
        flat = torch.where(frame["depth"] > 0, frame["depth"], 20.0)
        facing = torch.where(frame["depth"] > 0, frame["normal"], torch.tensor([0.0, 0, 1]).view(1, 3, 1, 1))
        channels = {"color": lit, "emission": 0 * lit, "direct": lit, "visibility": 1 + 0 * flat, "glossy": lit}
        channels |= {"albedo": reflected, "diffuse_albedo": reflected, "indirect": lit, "indirect_radiance": 2 * lit}
        channels |= {"normal": facing, "indirect_direction": facing}
        channels |= {"depth": flat, "shutter_depth": flat, "motion": motion, "previous_forward_motion": -motion}
        channels |= {"shadow_motion": motion, "reflection_motion": motion, "shutter_motion": -motion.nan_to_num()}
        given.append(frame.with_channels(**channels))
    denoiser = load_denoiser(spec)
    level = {"visibility": 1.0, "color": (3.0 if spec.startswith("trmv") else 1.0) * light}.get(denoiser.target, light)
    for image in images(spec, tuple(given)):
        torch.testing.assert_close(image, (level + 0 * image), rtol=1e-5, atol=1e-6)
