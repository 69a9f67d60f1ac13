"""Guides of one sample are aliased, those through a lens noisy; means of many samples are neither."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import check
from nte.frames.clip import Clip
from nte.frames.guides import guides_are_clean
from tests.synthetic import Pixels, smooth_texture, write_clip

FINE = 4  # samples per axis


def fine_frame(size: tuple[int, int] = (96, 128)) -> dict[str, Pixels]:
    """Slanted discs of one colour before a textured wall, (C, FINE · H, FINE · W)."""
    y, x = (np.mgrid[: FINE * size[0], : FINE * size[1]] + 0.5) / FINE
    albedo, instance = smooth_texture(x / 8, y / 8), np.ones_like(x)
    for k in range(12):
        inside = (x - 11 * k - 3.3) ** 2 + ((y - 7 * k - 9.1) * 1.3) ** 2 < (6 + k % 4) ** 2
        albedo[:, inside], instance[inside] = np.reshape([0.1, 0.8, 0.05 * k], (3, 1)), k + 2
    return {"albedo": albedo, "instance": instance[None]}


def shrink(frame: dict[str, Pixels], kind: str) -> dict[str, Pixels]:
    albedo, rng = frame["albedo"], np.random.default_rng(1)
    channels, height, width = albedo.shape
    blocks = albedo.reshape(channels, height // FINE, FINE, width // FINE, FINE)
    y, x = np.mgrid[: height // FINE, : width // FINE] * FINE
    spread = {"aliased": (2, 3), "jittered": (0, FINE), "lens": (-5, 9)}.get(kind, (0, 1))
    y, x = (np.clip(p + rng.integers(*spread, p.shape), 0, n - 1) for p, n in ((y, height), (x, width)))
    picked = albedo[:, y, x]
    mean = blocks.mean((2, 4))
    small = {"mean": mean, "noise": mean + rng.normal(0, 0.03, mean.shape)}.get(kind, picked)
    centre = frame["instance"][:, FINE // 2 :: FINE, FINE // 2 :: FINE]
    return {"albedo": small.astype("f"), "instance": centre.astype("f"), "color": small.astype("f")}


@pytest.mark.parametrize(
    ("kind", "told"),
    [("mean", ""), ("aliased", "aliased"), ("jittered", "aliased"), ("lens", "noisy"), ("noise", "noisy")],
)
def test_only_means_of_samples_are_clean(tmp_path: Path, kind: str, told: str) -> None:
    clip = Clip(write_clip(tmp_path / "clip", [shrink(fine_frame(), kind)] * 2))
    assert guides_are_clean(clip) == (not told)
    report = check(clip)
    assert report.verdict == "undecidable"  # told, not failed
    assert any(f.channel == "albedo" and f.found.startswith(told) for f in report.findings) == bool(told)


def test_a_clip_without_guides_has_no_clean_ones(tmp_path: Path) -> None:
    clip = Clip(write_clip(tmp_path / "clip", [{"color": np.ones((3, 8, 8), np.float32)}]))
    assert not guides_are_clean(clip)


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_fine_textures_that_the_reference_shows_are_no_noise(tmp_path: Path, noise: float) -> None:
    """Each pixel is lighter or darker than those around, and so is its light; noise of albedo is not in the light."""
    rng = np.random.default_rng(2)
    texture = rng.uniform(0.3, 0.9, (3, 96, 128))
    light = texture * np.exp(-np.arange(128) / 60) * rng.normal(1, 0.05, texture.shape)
    frame = {
        "albedo": texture + rng.normal(0, noise, texture.shape).clip(-0.3, 0.1),
        "reference": light,
        "color": light,
    }
    clip = Clip(write_clip(tmp_path / "clip", [{name: np.float32(values) for name, values in frame.items()}] * 2))
    assert guides_are_clean(clip) == (not noise)
    assert any(f.found.startswith("noisy") for f in check(clip).findings) == bool(noise)
