"""Every filter, and every option of TRMV, on frames that Mitsuba rendered: nothing is missing, all is finite."""

import numpy as np
import pytest

from nte.denoiser import Session
from nte.filters.trmv.options import TrmvOptions
from nte.frames.clip import Clip
from nte.registry import load_denoiser
from tests.shared import made_once

CHOSEN = [f"trmv:{key}={choice}" for key in TrmvOptions.names() for choice in TrmvOptions.choices(key)]
OTHERS = (
    "taa:target=components", "svgf", "svgf:target=components", "asvgf", "asvgf:target=components", "estimate+svgf",
)  # fmt: skip


@pytest.fixture(scope="module")
def temple(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """Three frames with light components of a glossy floor, columns and a curved statue."""
    from nte.render.recipes.clips import render_clip
    from nte.render.recipes.recipe import ClipPlan, Group

    group = Group(scene="temple", clips=1, width=48, height=32, frames=3, reference_spp=4, components=True)
    unit = ClipPlan("rendered", 1, "train", 0, group)
    out = made_once(tmp_path_factory, "temple", lambda out: render_clip(unit, out))
    return Clip(out / unit.folder)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")
@pytest.mark.parametrize("spec", [*CHOSEN, *OTHERS])
def test_it_denoises_rendered_frames(temple: Clip, spec: str) -> None:
    session = Session(load_denoiser(spec))
    for index in range(len(temple)):
        image = session.denoise(temple.frame(index))
        assert np.isfinite(image).all()
        assert image.min() >= 0
        assert image.max() > 0
