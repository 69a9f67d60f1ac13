"""An exported graph scatters the previous forward motion by itself, as PyTorch does, to the last bit."""

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper

from nte.motion.geometric import complete_forward_motion
from nte.runtime.switch import KNOWN, scatter_inside
from nte.runtime.tracing import OPSET


@pytest.fixture(scope="module")
def switch() -> onnxruntime.InferenceSession:
    """A graph that returns the vectors which a network in its place would get."""
    widths = {KNOWN: 2, "motion": 2, "depth": 1, "result": 2}
    infos = {
        name: helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width, "height", "width"])
        for name, width in widths.items()
    }
    result = infos.pop("result")
    graph = helper.make_graph([helper.make_node("Identity", [KNOWN], ["result"])], "g", list(infos.values()), [result])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=10)
    scatter_inside(model)
    onnx.checker.check_model(model, full_check=True)
    return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])


@settings(deadline=None, max_examples=100)
@given(
    st.integers(0, 2**31), st.integers(1, 9), st.integers(1, 9), st.integers(1, 3),
    st.sampled_from([0.3, 2.0, 20.0]), st.booleans(), st.sampled_from([0.0, 0.5, 1.0]),
)  # fmt: skip
def test_scattering_in_the_graph_is_that_of_pytorch(
    switch: onnxruntime.InferenceSession,
    seed: int, height: int, width: int, batch: int, reach: float, halves: bool, unknown: float,
) -> None:  # fmt: skip
    rng = np.random.default_rng(seed)
    motion = rng.normal(0, reach, (batch, 2, height, width)).astype(np.float32)
    if halves:  # positions on the edges of pixels and of the image
        motion = np.round(motion * 2) / 2
    motion[rng.random(motion.shape) < 0.05] = rng.choice([np.nan, np.inf, 1e30])
    depth = rng.integers(0, 4, (batch, 1, height, width)).astype(np.float32)  # many are equally near, or a miss
    depth[rng.random(depth.shape) < 0.05] = rng.choice([np.nan, np.inf, -1.0, 1e-30])
    forward = rng.normal(0, reach, motion.shape).astype(np.float32)
    forward[rng.random((batch, 1, height, width)).repeat(2, 1) < 0.3] = np.nan
    forward[rng.random(batch) < unknown] = np.nan
    expected = complete_forward_motion(*map(torch.from_numpy, (forward, motion, depth))).numpy()
    fed = {"previous_forward_motion": forward, "motion": motion, "depth": depth}
    (found,) = switch.run(None, fed)
    np.testing.assert_array_equal(found, expected)


def test_of_equally_near_surfaces_the_last_pixel_wins(switch: onnxruntime.InferenceSession) -> None:
    """By hand: pixels 1 to 4 arrive at pixel 2 from their places; 3 is far, 1 and 4 are equally near."""
    motion = np.zeros((1, 2, 1, 5), np.float32)
    motion[0, 0, 0] = [-9, 1, 0, -1, -2]
    depth = np.array([1, 2, 0, 3, 2], np.float32).reshape(1, 1, 1, 5)
    unknown = np.full_like(motion, np.nan)
    (found,) = switch.run(None, {"previous_forward_motion": unknown, "motion": motion, "depth": depth})
    np.testing.assert_array_equal(found[0, 0, 0], [np.nan, np.nan, 2, np.nan, np.nan])
