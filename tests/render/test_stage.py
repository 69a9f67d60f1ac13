"""Moments: the only way to render a stage, one at a time, and nothing is left of them."""

import gc
import weakref
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.render.components.frame import noisy, references
from nte.render.engine.backend import is_scalar, load_drjit, load_mitsuba
from nte.render.engine.mesh_stage import MeshStage
from nte.render.engine.stage import Moment, Stage
from nte.render.engine.xml.stage import XmlStage
from nte.render.passes.gbuffer import geometry, guides, surface
from nte.render.passes.hits import points_at
from nte.render.passes.radiance import radiance
from nte.render.passes.rays import trace_centres
from nte.render.passes.shutter import centre_motion
from nte.render.scenes.families import FAMILIES
from nte.render.world.keyframes import read_animation
from nte.render.world.seeds import derive_generator
from tests.render.shots import radiance_at

OWN = Path(__file__).parents[2] / "datasets" / "own_scene" / "lighthouse.yaml"
SIZE = 12


def mesh_stage() -> Stage:
    return MeshStage(FAMILIES["fence"](derive_generator("moments")), SIZE, SIZE, 2)


def xml_stage() -> Stage:
    return XmlStage(read_animation(OWN), SIZE, SIZE, 2)


@pytest.fixture(params=[mesh_stage, xml_stage])
def made(request: pytest.FixtureRequest) -> Stage:
    if is_scalar() and request.param is xml_stage:
        pytest.skip("an XML scene needs the llvm variant")
    return request.param()


PASSES: dict[str, Callable[[Moment], object]] = {
    "guides": guides,
    "geometry": geometry,
    "surface": surface,
    "radiance": lambda moment: radiance(moment, 1, 0),
    "references": lambda moment: references(moment, 2, (1, 2)),
    "centre_motion": lambda moment: centre_motion(moment, 0.5),
}


def test_no_pass_takes_a_moment_that_is_over(made: Stage):
    with made.at(3) as moment:
        hits = trace_centres(moment)
    for render in PASSES.values():
        with pytest.raises(RuntimeError, match="the moment at time 3 is over"):
            render(moment)
    with pytest.raises(RuntimeError, match="the moment at time 3 is over"):
        points_at(moment, hits, 3)
    assert np.isfinite(points_at(made, hits, 4)).all()  # where things will be, the stage knows at any time


def test_no_kernel_outlives_its_moment(made: Stage):
    if is_scalar():
        pytest.skip("nothing is frozen without LLVM")
    with made.at(1) as moment:
        kernel = moment.frozen(lambda scenery: load_drjit().arange(load_mitsuba().UInt32, scenery.width))
        assert list(kernel()) == [*range(SIZE)]
    with made.at(2), pytest.raises(RuntimeError, match="the moment at time 1 is over"):
        kernel()


def test_one_moment_at_a_time(made: Stage):
    with made.at(1) as moment:
        expected = radiance(moment, 1, 5)
        with pytest.raises(RuntimeError, match="cannot be at time 2: its moment at time 1 is still open"), made.at(2):
            pass
        assert moment.time == 1
        np.testing.assert_array_equal(radiance(moment, 1, 5), expected)
    assert not np.array_equal(radiance_at(made, 9, 1, 5), expected)
    np.testing.assert_array_equal(radiance_at(made, 1, 1, 5), expected)


def test_a_pass_that_fails_ends_its_moment(made: Stage):
    with pytest.raises(ValueError, match="on purpose"), made.at(1) as moment:
        raise ValueError("on purpose")
    with pytest.raises(RuntimeError, match="is over"):
        _ = moment.scenery
    assert radiance_at(made, 1, 1, 5).any()


@pytest.mark.parametrize("make", [mesh_stage, xml_stage])
def test_a_scene_goes_with_its_stage(make: Callable[[], Stage]):
    """No cycle waits for the garbage collector, which would hold a clip's scene while the next one is built."""
    if is_scalar():
        pytest.skip("nothing is frozen without LLVM")
    gc.collect()
    gc.disable()
    try:
        stage = make()
        noisy(stage, 1, [4])
        with stage.at(2) as moment:
            scenery = weakref.ref(moment.scenery)
        del stage
        assert moment.time == 2
        assert scenery() is None
    finally:
        gc.enable()
