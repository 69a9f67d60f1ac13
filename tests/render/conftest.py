"""One rendering that the tests of this folder share."""

import importlib.util
from pathlib import Path

import pytest

from tests.shared import made_once

if importlib.util.find_spec("mitsuba") is None:  # found, not imported: nte.render must choose the LLVM first
    collect_ignore = [
        "test_clips.py", "test_family_clips.py", "test_gbuffer.py", "test_lens.py", "test_media.py",
        "test_mitsuba.py", "test_shutter.py", "test_surroundings.py",
    ]  # fmt: skip

RECIPE = """\
name: tiny
seed: 7
train:
  - {scene: rooms, clips: 1, width: 48, height: 40, frames: 4, seeds: 2, reference_spp: 32}
test:
  - {scene: rooms, clips: 1, width: 40, height: 32, frames: 1, reference_spp: 8}
"""


@pytest.fixture(scope="session")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recipe") / "tiny.yaml"
    path.write_text(RECIPE)
    return path


@pytest.fixture(scope="session")
def rendered(recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the tiny recipe is rendered into; not to be written to."""
    from nte.render.recipes.clips import render_recipe

    return made_once(tmp_path_factory, "rendered", lambda out: render_recipe(recipe, out, progress=False))
