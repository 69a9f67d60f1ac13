"""What we rely on in Mitsuba itself, and the scalar variant as a slow twin of the vectorised one."""

import os
import subprocess
import sys

import numpy as np
import pytest

from nte.render.engine.backend import load_mitsuba
from nte.render.world.scene import Camera
from nte.render.world.transforms import look_at, still

_RENDER = """
import numpy as np
from nte.render.engine import backend
if {scalar}:
    backend.choose_llvm = lambda given: None
from nte.render.passes.gbuffer import guides
from nte.render.passes.radiance import radiance
from nte.render.scenes.families import FAMILIES
from nte.render.world.seeds import derive_generator
from nte.render.engine.mesh_stage import MeshStage
stage = MeshStage(FAMILIES["rooms"](derive_generator("twin")), 16, 12, 3)
with stage.at(1) as moment:
    channels = guides(moment) | {{"color": radiance(moment, 64, 3)}}
np.savez({path!r}, variant=backend.load_mitsuba().variant(), **channels)
"""


def test_projection_is_mitsubas():
    mi = load_mitsuba()
    theirs = mi.perspective_projection([160, 90], [160, 90], [0, 0], 60.0, 0.01, 1000.0).matrix
    ours = Camera(still(), 60.0).projection(160, 90)
    np.testing.assert_allclose(np.array(theirs).reshape(4, 4), ours, atol=1e-6)


def test_look_at_is_mitsubas():
    mi = load_mitsuba()
    theirs = mi.ScalarTransform4f().look_at([1, 2, 3], [0, 0.5, 1], [0, 1, 0]).matrix
    np.testing.assert_allclose(np.array(theirs), look_at((1, 2, 3), (0, 0.5, 1)), atol=1e-6)


@pytest.mark.slow
def test_scalar_twin(tmp_path):
    """Without any LLVM the same channels come out, with one line that says it is slow."""
    found = {}
    for scalar in (False, True):
        path = str(tmp_path / f"{scalar}.npz")
        code = _RENDER.format(scalar=scalar, path=path)
        run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, check=True)
        assert run.stderr.count("scalar_rgb, many times slower") == scalar
        found[scalar] = np.load(path)
    assert str(found[True]["variant"]) == "scalar_rgb"
    for name in set(found[True]) - {"variant", "color"}:
        np.testing.assert_allclose(found[True][name], found[False][name], atol=2e-3, err_msg=name)
    assert found[True]["color"].mean() == pytest.approx(found[False]["color"].mean(), rel=0.1)


@pytest.mark.slow
def test_mitsuba_imported_first_is_told_not_crashed(tmp_path):
    """Dr.Jit loads an LLVM as it is imported; if that is an old one, rendering would abort the process."""
    code = "import mitsuba; from nte.render.engine.backend import load_mitsuba; print(load_mitsuba().variant())"
    env = {key: value for key, value in os.environ.items() if key != "DRJIT_LIBLLVM_PATH"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, check=False)
    assert "already loaded" in run.stderr or run.stdout.strip() in ("llvm_ad_rgb", "scalar_rgb")
