"""Frozen kernels: recorded once for a clip, and the same light as if every frame traced its own."""

import gc
import os
import signal

import numpy as np
import pytest

from nte.render.components.first_hit import trace_path
from nte.render.components.frame import noisy
from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.camera_rays import sample_camera_ray
from nte.render.engine.mesh_stage import MeshStage
from nte.render.scenes.families import FAMILIES
from nte.render.world.seeds import derive_generator

SIZE = 16


@pytest.fixture(autouse=True)
def nothing_left_of_other_scenes() -> None:
    """With a medium, for instance, that a failed test's traceback keeps, nothing is recorded."""
    gc.collect()


def staged(family: str) -> MeshStage:
    return MeshStage(FAMILIES[family](derive_generator("frozen")), SIZE, SIZE, 4)


@pytest.mark.slow
# Of rigid objects, many parts, a wave, curved reflectors under a moving camera, and of a lens, which is not frozen.
@pytest.mark.parametrize("family", ["fence", "robot", "ocean", "temple", "spheres"])
def test_a_frame_does_not_depend_on_what_was_recorded_before_it(family):
    used = staged(family)
    _, later, back = (noisy(used, time, [7, 8]) for time in (0, 2, 1))
    assert not np.array_equal(later[1][0]["color"], back[1][0]["color"])
    fresh = noisy(staged(family), 1, [7, 8])
    for found, expected in zip((back[0], *back[1]), (fresh[0], *fresh[1]), strict=True):
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values, err_msg=name)


def test_it_is_traced_once_and_gives_what_tracing_gives():
    mi, dr = load_mitsuba(), load_drjit()
    here, traced = staged("fence"), []

    def light(scenery, key):
        traced.append(gc.isenabled())
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(key, SIZE * SIZE)
        path = trace_path(scenery, sample_camera_ray(scenery, dr.arange(mi.UInt32, SIZE * SIZE), sampler), sampler)
        return path.shadowed, path.indirect, *path.second[1:]

    for time in range(4):
        with here.at(time) as moment:
            key = dr.opaque(mi.UInt32, 100 + time)
            found = moment.frozen(light)(key)
            for mine, theirs in zip(found, light(moment.scenery, key), strict=True):
                np.testing.assert_array_equal(np.array(mine), np.array(theirs))
    # Once for all frames, when a collected scene would have aborted the process; and each time for the comparison.
    assert traced == [False, True, True, True, True]
    assert gc.isenabled()


def test_ctrl_c_waits_for_the_recording():
    mi, dr = load_mitsuba(), load_drjit()
    here, pressed = staged("fence"), []

    def double(scenery, number):
        if not pressed:
            pressed.append(os.kill(os.getpid(), signal.SIGINT))
        return 2 * number

    with here.at(0) as moment:
        with pytest.raises(KeyboardInterrupt):
            moment.frozen(double)(mi.Float([1, 2, 3]))
        assert gc.isenabled()
        np.testing.assert_array_equal(moment.frozen(double)(dr.arange(mi.Float, 3)), [0, 2, 4])


def test_what_cannot_be_recorded_is_traced():
    mi, dr = load_mitsuba(), load_drjit()
    here, traced = staged("fence"), []

    def double(scenery, number):
        traced.append(number)
        if len(traced) == 1:
            raise RuntimeError("cannot be recorded")
        return 2 * number

    with here.at(0) as moment:
        for start in (0, 1):
            doubled = moment.frozen(double)(dr.arange(mi.Float, 3) + start)
            np.testing.assert_array_equal(doubled, 2 * (np.arange(3) + start))
    assert len(traced) == 3
