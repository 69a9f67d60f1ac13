"""One exported model for all tests of the runtime: exporting takes seconds."""

from pathlib import Path

import pytest

from nte.models.temporal import TemporalDenoiser
from nte.runtime.export import export_onnx
from tests.networks import small_network

CHOICES = {"front": 2, "demodulate": True, "feed_masks": True, "kernel_size": 3, "scales": 2}


@pytest.fixture(scope="session")
def network() -> TemporalDenoiser:
    """The network that is exported: everything that a graph may contain, in small."""
    return small_network(**CHOICES)


@pytest.fixture(scope="session")
def model(network: TemporalDenoiser, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its ONNX file."""
    path = tmp_path_factory.mktemp("exported") / "model.onnx"
    export_onnx(network, path, progress=lambda line: None)
    return path
