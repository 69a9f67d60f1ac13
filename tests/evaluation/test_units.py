"""A clip as a unit of work: what its scores depend on, and with what denoisers are loaded again."""

import importlib.metadata
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from nte.config import to_yaml
from nte.denoiser import Denoiser, Noisy
from nte.evaluation.comparison.kept import unit_digest
from nte.evaluation.comparison.networks import TRAINING
from nte.evaluation.units import EVALUATION, ClipUnit, evaluate_clip
from nte.jobs import Kind
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


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Whatever happens to the number of threads ends with the test."""
    before = torch.get_num_threads()
    monkeypatch.setenv("OIDN_NUM_THREADS", "not limited")
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("threads")
@pytest.mark.parametrize("kind", [EVALUATION, TRAINING])
def test_pytorch_oidn_and_exported_models_have_the_share_of_the_cores_that_a_process_has(
    clip: Path, monkeypatch: pytest.MonkeyPatch, kind: Kind
) -> None:
    given: list[int] = []

    def load(spec: str, device: str, threads: int = 0) -> Denoiser:
        given.append(threads)
        return Noisy()

    monkeypatch.setattr("nte.evaluation.units.load_denoiser", load)
    cores = os.cpu_count() or 1
    monkeypatch.setattr("nte.evaluation.units._threads", lambda: 3 * cores)  # OMP_NUM_THREADS may ask for more
    for jobs, share in ((3 * cores, 1), (3, cores), (1, 3 * cores)):
        kind.share_cores(jobs)
        assert not evaluate_clip(unit_of(clip, f"model to {kind.verb}, {jobs}")).failed
        assert (torch.get_num_threads(), os.environ["OIDN_NUM_THREADS"]) == (share, str(share))
        assert given[-1] == min(share, cores)  # more are refused
