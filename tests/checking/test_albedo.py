"""Albedo that is encoded, or of another order of components, is told by its edges in the reference; right one never."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.checking import CheckReport, check
from nte.checking.albedo import LINEAR, ORDER, SEEN, AlbedoTally
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from tests.checking.test_late import SHOTS, noisy
from tests.checking.test_tone import srgb
from tests.synthetic import Pixels, disc_frame, smooth_texture, write_clip

Change = Callable[[Pixels], Pixels]
WRONG: dict[str, tuple[Change, dict[str, str]]] = {
    "sRGB": (srgb, {LINEAR: "is encoded"}),
    "gamma": (lambda x: x ** (1 / 2.2), {LINEAR: "is encoded"}),
    "BGR": (lambda x: x[::-1], {ORDER: "order BGR"}),
    "GBR": (lambda x: x[[1, 2, 0]], {ORDER: "order GBR"}),
    "sRGB in BGR": (lambda x: srgb(x[::-1]), {LINEAR: "is encoded", ORDER: "order BGR"}),
}
SKY = np.reshape([0.3, 0.5, 1.0], (3, 1, 1))
LIGHTS: dict[str, Callable[[Pixels, Pixels], Pixels]] = {  # of light and albedo
    "as it is": lambda light, albedo: light,
    "a coloured lamp": lambda light, albedo: light * [[[3.0]], [[1.0]], [[0.3]]],
    "gloss": lambda light, albedo: light + SKY * (albedo > 0),
    "a noisy reference": lambda light, albedo: noisy(light, 77),
}


def of(
    folder: Path, albedo: Change, light: str = "as it is", without: tuple[str, ...] = (), lit: Change | None = None
) -> CheckReport:
    """Check frames of a given albedo. lit: the change of the albedo that the light shows, if it does."""
    frames = []
    for i, shot in enumerate(SHOTS[:4]):
        shown = (lit or (lambda values: values))(shot["albedo"])
        diffuse = shot["reference"] * shown / np.where(shot["albedo"] > 0, shot["albedo"], 1)
        reference = LIGHTS[light](np.where(shot["albedo"] > 0, diffuse, shot["reference"]), shown).astype(np.float32)
        given = np.ascontiguousarray(albedo(shot["albedo"]), np.float32) * (shot["depth"] > 0)
        frame = shot | {"color": noisy(reference, i), "reference": reference, "albedo": given.astype(np.float32)}
        frames.append({name: values for name, values in frame.items() if name not in without})
    return check(Clip(write_clip(folder / "clip", frames)))


def told(report: CheckReport) -> dict[str, str]:
    return {f.expected: f.found for f in report.findings if f.expected in (LINEAR, ORDER, SEEN)}


@pytest.mark.parametrize("without", [(), ("instance", "normal"), ("depth", "position")])
@pytest.mark.parametrize("name", WRONG)
def test_wrong_albedo_is_named(tmp_path: Path, name: str, without: tuple[str, ...]) -> None:
    change, named = WRONG[name]
    report = of(tmp_path, change, without=without)
    found = told(report)
    assert found.keys() == named.keys()
    assert all(words in found[expected] for expected, words in named.items())
    assert report.verdict == "implausible"


@pytest.mark.parametrize("light", LIGHTS)
def test_nothing_is_said_of_right_albedo(tmp_path: Path, light: str) -> None:
    assert not told(of(tmp_path, lambda x: x, light))


@pytest.mark.parametrize("known", [True, False])
def test_light_that_motion_blurs_does_not_step_where_albedo_does(tmp_path: Path, known: bool) -> None:
    """Albedo is that of one moment, and light that of the open shutter: moving stripes become grey."""
    frames = []
    for i in range(4):
        frame = disc_frame(i, size=(64, 96), radius=0, wall_velocity=(12, 0))
        wave = np.sin(2 * np.pi * np.arange(96) / 6).reshape(1, 1, -1)
        frame["albedo"] = (0.5 + 0.3 * wave + 0 * frame["albedo"]).astype(np.float32)
        frame["color"] = noisy(frame["reference"] * 0 + 1, i)
        frame["reference"] = frame["reference"] * 0 + 1
        frames.append(frame | ({"shutter_motion": -frame["motion"] / 2} if known else {}))
    assert bool(told(check(Clip(write_clip(tmp_path / "clip", frames))))) != known


@pytest.mark.parametrize("hardly", [0.0, 0.01])
def test_gloss_of_the_sky_on_brown_textures_is_no_order(tmp_path: Path, hardly: float) -> None:
    """Its blue weakens the steps of one component most: what little colour they have points elsewhere."""
    brown = np.reshape([1.0, 1.4, 2.0], (3, 1, 1))
    frames = []
    for i, shot in enumerate(SHOTS[:4]):
        albedo = np.where(shot["depth"] > 0, shot["albedo"][:1] ** brown + hardly, 0)
        light = shot["reference"] / np.maximum(shot["albedo"], 0.01) * albedo + SKY * (albedo > 0)
        reference = light.astype(np.float32)
        changed = {"color": noisy(reference, i), "reference": reference, "albedo": albedo.astype(np.float32)}
        frames.append(shot | changed)
    assert not told(check(Clip(write_clip(tmp_path / "clip", frames))))


def test_gloss_that_albedo_counts_is_no_encoding(tmp_path: Path) -> None:
    """Some renderers add what a surface reflects at its front, which matt light does not show."""
    assert not told(of(tmp_path, lambda x: np.minimum(x + 0.05, 1)))


def test_a_wrong_reference_accuses_no_albedo(tmp_path: Path) -> None:
    frames = [shot | {"reference": shot["reference"][::-1].copy()} for shot in SHOTS[:4]]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "implausible"
    assert not told(report)


def test_albedo_that_is_inverted_is_named(tmp_path: Path) -> None:
    report = of(tmp_path, lambda x: 1 - x)
    assert "it is inverted" in told(report)[SEEN]
    assert report.verdict == "implausible"


def test_albedo_of_another_picture_is_a_doubt_and_says_nothing_of_vectors(tmp_path: Path) -> None:
    """It moves otherwise than the vectors say, but they are not wrong."""
    other = iter(range(9))
    report = of(tmp_path, lambda x: smooth_texture(*(0.9 * np.mgrid[:64, :96] + 3 * next(other)), 1.0))
    assert "it is another picture's" in told(report)[SEEN]
    assert report.verdict == "undecidable"
    assert "motion" not in report.reason


def test_light_that_falls_off_along_a_smooth_texture_is_no_encoding() -> None:
    """It adds to the steps of one half of each wave, and takes from those of the other, which are not as many."""
    x = np.arange(96) * np.ones((64, 1))
    wave = np.where(x % 8 < 3, x % 8 / 3, (8 - x % 8) / 5)
    albedo = np.repeat(0.3 + 0.4 * wave[None], 3, 0)
    channels = {"albedo": albedo, "reference": albedo * np.exp(-0.15 * x), "instance": np.ones((1, 64, 96))}
    tally = AlbedoTally()
    tally.add(Frame({name: torch.tensor(np.float32(values))[None] for name, values in channels.items()}))
    assert list(tally.judge()) == []
