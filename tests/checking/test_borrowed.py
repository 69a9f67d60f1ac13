"""Albedo that is another channel is told: normals and depth move with their surfaces as albedo does."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport, check
from nte.frames.clip import Clip
from tests.checking.test_late import SHOTS, Shot, noisy
from tests.synthetic import Pixels, write_clip

FAR = max(float(shot["depth"].max()) for shot in SHOTS)
TAKEN: dict[str, tuple[Callable[[Shot], Pixels], str]] = {
    "normal": (lambda f: f["normal"].clip(0, 1), "is normal, in"),
    "bytes": (lambda f: np.round(255 * f["normal"].clip(0, 1)) / 255, "is normal, in"),
    "encoded": (lambda f: f["normal"] / 2 + 0.5, "is normal, stored as n/2 + 1/2, in"),
    "depth": (lambda f: np.repeat(f["depth"] / FAR, 3, 0), "is depth, in"),
    "inverse depth": (lambda f: np.where(f["depth"] > 0, 1 / f["depth"].clip(1), 0).repeat(3, 0), "is depth, in"),
}


def report_of(folder: Path, change: Callable[[Shot], Shot], reference: bool = True) -> CheckReport:
    frames = [shot | {"color": noisy(shot["color"], i)} | change(shot) for i, shot in enumerate(SHOTS)]
    left = [{n: v for n, v in frame.items() if reference or n != "reference"} for frame in frames]
    return check(Clip(write_clip(folder / "clip", left)))


@pytest.mark.parametrize("reference", [True, False])
@pytest.mark.parametrize("taken", TAKEN)
def test_another_channel_is_no_albedo(tmp_path: Path, taken: str, reference: bool) -> None:
    channel, told = TAKEN[taken]
    report = report_of(tmp_path, lambda f: {"albedo": channel(f).astype(np.float32)}, reference)
    assert any(f.channel == "albedo" and f.fault and told in f.found for f in report.findings), report.findings
    assert report.verdict == "implausible"


def test_the_noisy_image_is_no_albedo(tmp_path: Path) -> None:
    frames = [shot | {"color": noisy(shot["color"], i)} for i, shot in enumerate(SHOTS)]
    frames = [frame | {"albedo": frame["color"].clip(0, 1)} for frame in frames]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert any(f.channel == "albedo" and f.fault and "is color, in" in f.found for f in report.findings)


@pytest.mark.parametrize(("brightness", "fault"), [(1.0, True), (0.25, False)])
def test_the_reference_is_no_albedo(tmp_path: Path, brightness: float, fault: bool) -> None:
    """Only what is brighter than 1 tells: where one light of 1 falls on everything, albedo is the reference."""
    frames = []
    for i, shot in enumerate(SHOTS):
        light = (brightness * shot["reference"]).astype(np.float32)
        frames.append(shot | {"color": noisy(light, i), "reference": light, "albedo": light.clip(0, 1)})
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    told = [(f.fault, f.doubt) for f in report.findings if f.channel == "albedo" and "is reference, in" in f.found]
    assert told == [(fault, False)]
    assert report.verdict == ("implausible" if fault else "plausible")


@pytest.mark.parametrize(("white", "emission"), [(0.8, False), (1.0, True)])
def test_a_lamp_in_one_light_of_1_is_no_fault(tmp_path: Path, white: float, emission: bool) -> None:
    frames = []
    for i, shot in enumerate(SHOTS):
        shines = (shot["instance"] == shot["instance"].max()) & (np.arange(shot["instance"].shape[2]) % 4 == 0)
        albedo = np.where(shines, white, shot["albedo"].clip(0, 1)).astype(np.float32)
        light = np.where(shines, 5, albedo).astype(np.float32)
        given = {"emission": np.where(shines, 4, 0).repeat(3, 0).astype(np.float32)} if emission else {}
        frames.append(shot | {"color": noisy(light, i), "reference": light, "albedo": albedo} | given)
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    told = [f for f in report.findings if f.channel == "albedo" and "is reference, in" in f.found]
    assert [(f.fault, f.doubt) for f in told] == [(False, False)], report.findings


@pytest.mark.parametrize("grey", [False, True])
def test_albedo_is_no_other_channel(tmp_path: Path, grey: bool) -> None:
    def change(frame: Shot) -> Shot:
        return {"albedo": frame["albedo"].mean(0, keepdims=True).repeat(3, 0)} if grey else {}

    findings = report_of(tmp_path, change, reference=not grey).findings
    assert not [f for f in findings if f.channel == "albedo" and (f.fault or f.doubt)]


def test_one_normal_for_all_is_noted(tmp_path: Path) -> None:
    """Without position nothing contradicts it."""

    def change(frame: Shot) -> Shot:
        hit = frame["depth"] > 0
        return {"normal": np.where(hit, np.reshape([0, 0, 1], (3, 1, 1)), 0).astype(np.float32)}

    frames = [{n: v for n, v in (shot | change(shot)).items() if n != "position"} for shot in SHOTS]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert "(0, 0, 1) everywhere" in [f.found for f in report.findings if f.channel == "normal"]
    assert not [f for f in report_of(tmp_path / "right", lambda f: {}).findings if "everywhere" in f.found]
