"""The tracing of a module as a graph."""

import tempfile
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from torch import Tensor, nn

from nte.runtime.tracing import traced


class Doubled(nn.Module):
    def forward(self, image: Tensor) -> Tensor:
        return torch.where(image.isinf(), 0.0, 2 * image)


def test_a_graph_is_traced_without_a_temporary_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One would be left behind by a process that is killed, where nobody looks for it."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))  # where nothing can be written
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError):
        tempfile.mkdtemp()
    axes = {"image": {2: "height"}, "double": {2: "height"}}
    model = traced(Doubled(), (torch.rand(1, 3, 4, 6),), ["image"], ["double"], axes)
    assert not any(tmp_path.iterdir())
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    image = np.array([[1.0, np.inf, -3.0]], np.float32).repeat(18, 0).reshape(1, 3, 6, 3)[..., [0, 1, 2, 0, 1, 2]]
    (found,) = session.run(None, {"image": image})
    np.testing.assert_array_equal(found, np.where(np.isinf(image), 0, 2 * image))
