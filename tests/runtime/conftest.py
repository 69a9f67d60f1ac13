"""One exported model for all tests of the runtime: exporting takes seconds."""

from pathlib import Path

import pytest

from nte.models.temporal import TemporalDenoiser
from nte.runtime.export import export_onnx
from nte.runtime.providers import OnnxOptions
from nte.runtime.session import OnnxDenoiser
from tests.networks import small_network
from tests.shared import made_once

CHOICES = {"front": 2, "demodulate": True, "feed_masks": True, "kernel_size": 3, "scales": 2}


@pytest.fixture(scope="session")
def network() -> TemporalDenoiser:
    """The network that is exported: everything that a graph may contain, in small."""
    return small_network(**CHOICES)


@pytest.fixture(scope="session")
def model(network: TemporalDenoiser, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its ONNX file."""

    def export(folder: Path) -> None:
        export_onnx(network, folder / "model.onnx", progress=lambda line: None)

    return made_once(tmp_path_factory, "exported", export) / "model.onnx"


@pytest.fixture(scope="session")
def exported(model: Path) -> OnnxDenoiser:
    """The file as a denoiser, which several sequences share."""
    return OnnxDenoiser(model, OnnxOptions(threads=1))
