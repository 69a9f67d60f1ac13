"""A noisy image that repeats, or shares its noise, is noted, and so is one albedo for all surfaces."""

from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.checking import check
from nte.checking.noise import ALONG, BEFORE, NEIGHBOURS, NoiseTally
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.motion.warp import warp
from tests.checking.test_late import SHOTS, noisy
from tests.synthetic import Pixels, write_clip

FRAMES = [SHOTS[i] | {"color": noisy(SHOTS[i]["color"], i)} for i in range(5)]


def told(folder: Path, kept: dict[int, int]) -> list[str]:
    frames = [frame | {"color": FRAMES[kept.get(i, i)]["color"]} for i, frame in enumerate(FRAMES)]
    report = check(Clip(write_clip(folder / "clip", frames)))
    return [f.found for f in report.findings if f.channel == "color" and not f.fault and not f.doubt]


@pytest.mark.parametrize(
    ("kept", "where"), [({3: 2}, "1 of 4 frames, the first is 3"), (dict.fromkeys(range(5), 0), "4 of 4 frames")]
)
def test_a_frame_that_was_kept_is_noted(tmp_path: Path, kept: dict[int, int], where: str) -> None:
    (found,) = told(tmp_path, kept)
    assert found.startswith(f"is the same image as in the frame before in {where}")


def test_nothing_is_said_of_new_noise_and_of_black_frames(tmp_path: Path) -> None:
    assert told(tmp_path / "a", {}) == []
    dark = [frame | {"color": 0 * frame["color"]} if i else frame for i, frame in enumerate(FRAMES)]
    report = check(Clip(write_clip(tmp_path / "b", dark)))
    assert not [f for f in report.findings if "same image" in f.found]


def blurred(images: list[Pixels]) -> list[Pixels]:
    return [np.mean([np.roll(image, by, (1, 2)) for by in product((-1, 0, 1), repeat=2)], 0) for image in images]


def upscaled(images: list[Pixels]) -> list[Pixels]:
    return [image[:, ::2, ::2].repeat(2, 1).repeat(2, 2) for image in images]


def of_one_seed(images: list[Pixels]) -> list[Pixels]:
    return [noisy(FRAMES[i]["reference"], 0) for i in range(len(images))]


def accumulated(images: list[Pixels]) -> list[Pixels]:
    found = [torch.tensor(images[0])[None]]
    for image, frame in zip(images[1:], FRAMES[1:], strict=True):
        history = warp(found[-1], torch.tensor(frame["motion"])[None]).image
        found.append(0.7 * history + 0.3 * torch.tensor(image)[None])
    return [image[0].numpy() for image in found]


@pytest.mark.parametrize(
    ("change", "who"),
    [(blurred, NEIGHBOURS), (upscaled, NEIGHBOURS), (of_one_seed, BEFORE), (accumulated, ALONG)],
)
def test_noise_that_is_shared_is_noted(
    tmp_path: Path, change: Callable[[list[Pixels]], list[Pixels]], who: str
) -> None:
    images = change([frame["color"] for frame in FRAMES])
    frames = [frame | {"color": np.float32(image)} for frame, image in zip(FRAMES, images, strict=True)]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    (found,) = (f for f in report.findings if f.found.startswith("shares its noise with"))
    assert not found.fault
    assert who in found.found


def test_a_reference_that_is_held_is_a_doubt(tmp_path: Path) -> None:
    """A film on twos: every second frame shows the one before."""
    frames = [frame | {"reference": FRAMES[i // 2 * 2]["reference"]} for i, frame in enumerate(FRAMES)]
    report = check(Clip(write_clip(tmp_path / "a", frames)))
    assert report.verdict == "undecidable"
    assert "is the same image as in the frame before in 2 of 4 frames, the first is 1, though" in report.reason
    still = [frame | {n: v for n, v in FRAMES[0].items() if n != "color"} for frame in FRAMES]
    for frame in still:
        frame["motion"] = 0 * frame["motion"]
    report = check(Clip(write_clip(tmp_path / "b", still)))
    assert not [f for f in report.findings if f.channel == "reference" and "same image" in f.found]


@pytest.mark.parametrize("light", [0.0, 0.5])
def test_nothing_is_said_of_a_reference_in_the_dark_or_in_an_even_light(tmp_path: Path, light: float) -> None:
    """A film that fades in begins with frames that are all black, and things move there."""
    frames = [frame | {"reference": np.full_like(frame["reference"], light)} for frame in FRAMES[:3]]
    frames = [frame | {"color": 2 * light * noisy(np.float32(frame["reference"] > 0), 1)} for frame in frames]
    report = check(Clip(write_clip(tmp_path / "clip", [*frames, *FRAMES[3:]])))
    assert not [f for f in report.findings if f.channel == "reference" and "same image" in f.found]


@pytest.mark.parametrize("value", [0.25, 1.0])
def test_one_albedo_for_all_is_noted(tmp_path: Path, value: float) -> None:
    """Engines without that pass write white, or grey."""
    frames = [frame | {"albedo": np.full_like(frame["albedo"], value)} for frame in FRAMES]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert [f.found for f in report.findings if f.channel == "albedo"] == [f"{value:g} everywhere"]


@pytest.mark.parametrize("seed", range(8))
def test_a_few_pixels_share_noise_by_chance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tally = NoiseTally()
    light = torch.ones(1, 3, 4, 4)
    frames = [{"color": torch.tensor(rng.exponential(size=(1, 3, 4, 4))).float(), "reference": light} for _ in range(2)]
    tally.add(*map(Frame, frames))
    assert list(tally.judge()) == []
