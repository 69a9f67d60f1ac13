"""Every filter, and every choice of TRMV, on frames that Mitsuba rendered: it comes nearer to the reference."""

import numpy as np
import pytest

from nte.filters.trmv.options import TrmvOptions
from nte.frames.channels import reference_of
from nte.frames.clip import Clip, Pixels
from nte.registry import load_denoiser
from nte.session import Session
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

    group = Group(scene="temple", clips=1, width=48, height=32, frames=3, reference_spp=64, components=True)
    unit = ClipPlan("rendered", 1, "train", 0, group)
    out = made_once(tmp_path_factory, "temple", lambda out: render_clip(unit, out))
    return Clip(out / unit.folder)


def error(image: Pixels, reference: Pixels) -> float:
    """Mean squared difference of light x as x / (1 + x), where single bright pixels do not decide."""
    return float(np.mean((image / (1 + image) - reference / (1 + reference)) ** 2))


# Of the third frame: the error as a share of the noisy image's, and how far the mean may be off.
LIMITS = (0.25, 0.04)
SPECIAL = {
    "trmv:target=visibility": (0.28, 0.04),
    "trmv:target=indirect": (0.15, 0.08),
    "trmv:target=glossy": (0.45, 0.2),  # a clamp to the neighbourhood of few bright samples takes light away
    "trmv:glossy=none": (0.28, 0.04),  # no history of reflections
    "taa:target=components": (0.4, 0.13),
    "trmv:reshading=paper": (0.55, 0.3),  # as printed, a white environment does not stay white
    "trmv:preset=paper": (0.55, 0.3),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")
@pytest.mark.parametrize("spec", [*CHOSEN, *OTHERS])
def test_it_comes_nearer_to_the_reference_and_keeps_the_light(temple: Clip, spec: str) -> None:
    denoiser = load_denoiser(spec)
    session = Session(denoiser)
    for frame in temple:
        image = session.denoise(frame)
        assert np.isfinite(image).all()
        assert image.min() >= 0
    noisy, reference = frame[denoiser.target], frame[reference_of(denoiser.target)]
    share, lost = SPECIAL.get(spec, LIMITS)
    assert error(image, reference) < share * error(noisy, reference)
    assert image.mean() == pytest.approx(reference.mean(), rel=lost)
