"""Rendered clips in other people's conventions: each of them fails, and is named where it can be told."""

from pathlib import Path

import pytest

from benchmarks.check import WRONG, Changed, judge
from nte.checking import check
from nte.frames.clip import Clip
from nte.render.recipes.clips import render_clip
from nte.render.recipes.recipe import ClipPlan, Group


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rendered")
    group = Group(scene="rooms", clips=1, width=128, height=96, frames=3, spp=1, reference_spp=8, max_depth=3)
    plan = ClipPlan("check", 11, "test", 0, group)
    render_clip(plan, out)
    return out / plan.name


@pytest.mark.slow
def test_right_vectors_pass_without_a_word(folder: Path) -> None:
    report = check(Clip(folder))
    assert report.verdict == "plausible"
    assert not report.findings


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_other_conventions_fail(folder: Path, name: str) -> None:
    change, words = WRONG[name]
    report = check(Changed(folder, change))
    if name == "half":  # short motion is explained within a pixel, so only where it is long they are seen to be short
        assert report.verdict in ("implausible", "undecidable")
        assert "times too short" in report.reason
    else:
        assert judge(report, words) in ("named", "failed")
