"""A few frames of every family: nte check finds no fault with their vectors, and there is light."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import check
from nte.frames import Clip
from nte.render.recipes.clips import render_clip
from nte.render.recipes.recipe import ClipPlan, Group
from nte.render.scenes.families import FAMILIES

# Texture moves by several pixels in this clip. Elsewhere too little does at this size, or only light moves: no verdict.
MOVING = {"limits", "motion_blur", "ocean", "pica", "restaurant", "robot", "rooms", "temple"}


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_three_frames_pass_the_check(family: str, tmp_path: Path):
    group = Group(scene=family, clips=1, width=64, height=64, frames=3, spp=1, reference_spp=8, max_depth=4)
    unit = ClipPlan("test", 5, "test", 0, group)
    render_clip(unit, tmp_path)
    clip = Clip(tmp_path / unit.name)
    report = check(clip)
    assert report.verdict == "plausible" or (report.verdict == "undecidable" and family not in MOVING), report.reason
    assert all(tally.bad == 0 for tally in report.tallies.values())
    frame = clip.frame(1)
    luminance = frame["reference"].mean(1)
    assert (luminance > 0.02 * luminance.mean()).mean() > 0.8  # no large black areas
    assert np.quantile(luminance, 0.95) > 1.5 * np.quantile(luminance, 0.2)  # contrast
    seen = np.broadcast_to(frame.hit, frame["albedo"].shape)  # the sky has none, and is most of a picture of clouds
    assert 0.1 < frame["albedo"][seen].mean() < 0.9
