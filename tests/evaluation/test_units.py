"""A clip as a unit of work: what its scores depend on, and with what denoisers are loaded again."""

import importlib.metadata
from pathlib import Path

import pytest

from nte.config import to_yaml
from nte.evaluation.comparison.kept import unit_digest
from nte.evaluation.comparison.networks import TRAINING
from nte.evaluation.units import EVALUATION, ClipUnit, evaluate_clip
from nte.models.registry import make_network
from nte.runtime.providers import PROVIDERS
from nte.training.checkpoint import PLAIN, module_state, write_checkpoint
from tests.training.runs import tiny_config


@pytest.fixture
def run(clip: Path, tmp_path: Path) -> Path:
    """A run whose checkpoints have the weights that it began with."""
    config = tiny_config(tmp_path, clip)
    (tmp_path / "config.yaml").write_text(to_yaml(config))
    for name in ("checkpoint.safetensors", "best.safetensors"):
        write_checkpoint(tmp_path, 0, module_state(PLAIN, make_network(config.network)), name)
    return tmp_path


def unit_of(clip: Path, *denoisers: str) -> ClipUnit:
    return ClipUnit("disc", clip, denoisers, first=1, lights=None, device="cpu")


@pytest.mark.parametrize("checkpoint", ["", "best.safetensors"])
def test_a_run_with_another_configuration_is_another_denoiser(clip: Path, run: Path, checkpoint: str) -> None:
    unit = unit_of(clip, str(run / checkpoint))
    before = unit_digest(unit)
    assert not evaluate_clip(unit).failed
    config = run / "config.yaml"
    config.write_text(config.read_text().replace("kernel_size: 3", "kernel_size: 5"))
    assert unit_digest(unit) != before
    assert "does not fit" in str(evaluate_clip(unit).failed)


@pytest.mark.parametrize("package", ["torch", "pyoidn", *sorted({known.package for known in PROVIDERS.values()})])
def test_scores_and_clusters_depend_on_the_versions_of_all_that_denoises(
    clip: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    def found() -> tuple[str, dict[str, str], dict[str, str]]:
        return unit_digest(unit_of(clip, "noisy")), EVALUATION.versions(), TRAINING.versions()

    def version(name: str) -> str:
        return "0.0.1" if name == package else installed(name)

    before, installed = found(), importlib.metadata.version
    monkeypatch.setattr(importlib.metadata, "version", version)
    assert all(now != then for now, then in zip(found(), before, strict=True))
