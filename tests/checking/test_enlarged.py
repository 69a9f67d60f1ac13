"""Guides that were rendered at a smaller size and enlarged are told; pictures that consist of blocks are not."""

from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from nte.checking import CheckReport, check
from nte.checking.enlarged import EXPECTED, EnlargedTally
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from tests.checking.test_late import SHOTS, Shot, noisy
from tests.synthetic import Pixels, smooth_texture, write_clip

GUIDES = ("albedo", "normal", "depth", "position", "motion")


def enlarged(values: Pixels, factor: float, mode: str) -> Pixels:
    """A picture of a smaller size, at the size of the given one."""
    size = values.shape[1:]
    small = F.interpolate(torch.tensor(values)[None], size=[round(n / factor) for n in size], mode="area")
    return F.interpolate(small, size=size, mode=mode)[0].half().float().numpy()


def report_of(folder: Path, frames: list[Shot], without: tuple[str, ...] = ()) -> CheckReport:
    frames = [{n: v for n, v in frame.items() if n not in without} for frame in frames]
    return check(Clip(write_clip(folder / "clip", frames)))


def told(report: CheckReport) -> dict[str, str]:
    return {f.channel: f.found for f in report.findings if f.expected == EXPECTED}


@pytest.mark.parametrize(("factor", "mode"), [(2, "nearest"), (1.5, "nearest"), (4, "nearest"), (2, "bilinear")])
@pytest.mark.parametrize("without", [(), ("reference",)])
def test_enlarged_guides_are_told(tmp_path: Path, factor: float, mode: str, without: tuple[str, ...]) -> None:
    """The noise of color says nothing of its resolution: without reference it is a note."""
    frames = []
    for i, shot in enumerate(SHOTS[:4]):
        small = {name: enlarged(shot[name], factor, mode) for name in GUIDES}
        frames.append(shot | {"color": noisy(shot["color"], i)} | small)
    report = report_of(tmp_path, frames, without)
    found = told(report)
    assert set(found) == set(GUIDES)
    how = f"by {factor}, interpolated" if mode == "bilinear" else f"by {factor}, without interpolation"
    assert all(how in words for words in found.values())
    assert any(f.doubt for f in report.findings if f.expected == EXPECTED) == (not without)
    assert not any(f.fault for f in report.findings if f.expected == EXPECTED)


def test_an_enlarged_reference_is_noted(tmp_path: Path) -> None:
    frames = [
        shot | {"color": noisy(shot["color"], i), "reference": enlarged(shot["reference"], 2, "nearest")}
        for i, shot in enumerate(SHOTS[:4])
    ]
    assert told(report_of(tmp_path, frames)) == {"reference": "its columns are enlarged, by 2, without interpolation"}


def test_nothing_is_said_of_the_resolution_of_the_light(tmp_path: Path) -> None:
    frames = [shot | {"color": noisy(shot["color"], i)} for i, shot in enumerate(SHOTS[:4])]
    assert not told(report_of(tmp_path, frames))


@pytest.mark.parametrize("side", [2, 4, 8])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_textures_of_blocks_are_right_where_the_light_has_them(side: int, noise: float) -> None:
    """Pixel art, in light that falls off, and is not quite free of noise."""
    rng, tally = np.random.default_rng(0), EnlargedTally()
    y, x = np.mgrid[:64, :96]
    blocks = rng.uniform(0.1, 0.9, (3, 64 // side, 96 // side)).repeat(side, 1).repeat(side, 2)
    for i in range(4):
        light = blocks * np.exp(-0.03 * x - 0.02 * y) * rng.normal(1, noise, (3, 64, 96)).clip(0.1)
        channels = {"albedo": blocks, "reference": light, "color": light * rng.exponential(size=(64, 96))}
        tally.add(Frame({name: torch.tensor(np.float32(values))[None] for name, values in channels.items()}, i))
    assert "albedo" not in {finding.channel for finding in tally.judge()}


def test_outlines_on_every_second_column_are_no_enlargement() -> None:
    """Of boxes that stand at multiples of 8 pixels before a wall, in a picture with a texture."""
    tally = EnlargedTally()
    y, x = np.mgrid[:64, :96]
    depth = np.where((x // 8 + y // 8) % 3 == 0, 3.0, 5.0)[None]
    reference = smooth_texture(4.1 * x, 3.7 * y)
    tally.add(
        Frame({n: torch.tensor(np.float32(v))[None] for n, v in {"depth": depth, "reference": reference}.items()})
    )
    assert not list(tally.judge())


@pytest.mark.parametrize("size", [(1, 400), (400, 2), (300, 4), (5, 300)])
def test_narrow_pictures_tell_nothing(size: tuple[int, int]) -> None:
    tally = EnlargedTally()
    tally.add(Frame({"color": torch.rand(1, 3, *size), "albedo": torch.rand(1, 3, *size)}))
    assert not list(tally.judge())
