"""A clip as a unit of work: what its scores depend on, and with what denoisers are loaded again."""

from pathlib import Path

import pytest

from nte.config import to_yaml
from nte.evaluation.comparison.kept import unit_digest
from nte.evaluation.units import ClipUnit, evaluate_clip
from nte.models.registry import make_network
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
