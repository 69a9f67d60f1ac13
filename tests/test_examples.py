"""The examples in the documentation of everything that `nte` offers: each name has one, and it is true."""

import doctest
from pathlib import Path

import numpy as np
import pytest
import torch

import nte
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import write_clip
from tests.training.runs import CONFIG

RECIPE = """
name: small
seed: 1
train:
  - {scene: spheres, clips: 1, frames: 2, width: 16, height: 16, reference_spp: 2}
"""
SLOW = ("render", "train", "export")  # those that start a renderer or a training
IN_THE_OVERVIEW = ("CHANNELS", "Denoiser", "NteError", "Result")  # told by the package's own docstring
OPTIONS = doctest.ELLIPSIS


def examples(name: str) -> list[doctest.DocTest]:
    """The tests in the docstrings of `nte.NAME`, or of the package itself."""
    told = nte if name == "nte" else getattr(nte, name)
    if name == "render":
        told = type(told).__call__
    if name == "nte":
        return [doctest.DocTestParser().get_doctest(nte.__doc__, {}, "nte", nte.__file__, 0)]
    return [test for test in doctest.DocTestFinder(recurse=False).find(told, name) if test.examples]


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the examples call by name: a clip, a recipe, a configuration."""
    monkeypatch.chdir(tmp_path)
    write_clip(tmp_path / "data" / "clips" / "disc_000", noisy_frames(4))
    Path("recipe.yaml").write_text(RECIPE)
    Path("config.yaml").write_text(CONFIG.format(clip="data/clips", runs="runs"))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in ("nte", *nte.__all__)]
)
def test_examples_are_true(name: str, files: None) -> None:
    if name in (*IN_THE_OVERVIEW, "__version__"):
        assert name == "__version__" or f"nte.{name}" in nte.__doc__
        return
    if name == "export":
        nte.train("config.yaml", device="cpu", overrides=["name=mine"])
    found = examples(name)
    assert found, f"nte.{name} has no example"
    for test in found:
        test.globs = {"nte": nte, "np": np, "torch": torch, "Path": Path}
        said: list[str] = []
        assert doctest.DocTestRunner(optionflags=OPTIONS).run(test, out=said.append).failed == 0, "".join(said)


def test_every_name_is_there_and_documented() -> None:
    assert set(nte.__all__) <= set(dir(nte))
    for name in nte.__all__:
        assert name in ("__version__", "CHANNELS") or getattr(nte, name).__doc__, name
    with pytest.raises(AttributeError, match="module 'nte' has no attribute 'denoize'"):
        nte.denoize  # noqa: B018
