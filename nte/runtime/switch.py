"""The part of an exported graph that makes previous_forward_motion where an engine does not know it.

An If node in front of the network asks whether the input is NaN in a whole image; its branch scatters, traced from
nte.motion.geometric. So an engine that gives the vectors does not pay for the scattering.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import onnx
import torch
from onnx import TensorProto, compose, helper
from torch import Tensor, nn
from torch.onnx import symbolic_helper

from nte.motion.geometric import complete_forward_motion
from nte.recurrence import FORWARD
from nte.runtime.tracing import OPSET, traced

SCOPE = "/scatter"  # before the names of what is added, which makes it a step of its own in a profile
KNOWN = f"{SCOPE}/known"  # name by which the network must take the vectors


def scatter_inside(model: onnx.ModelProto) -> None:
    """Let a graph with the inputs KNOWN, motion and depth take previous_forward_motion instead of KNOWN.

    Where previous_forward_motion is NaN everywhere it is scattered from motion and depth, each sequence of a batch for
    itself, as by `complete_forward_motion`.
    """
    graph = model.graph
    next(i for i in graph.input if i.name == KNOWN).name = FORWARD
    network = list(graph.node)
    del graph.node[:]
    graph.node.extend([*_switch(), *network])


def _switch() -> list[onnx.NodeProto]:
    """The nodes that compute KNOWN: the input as it is, unless all of some image is NaN."""
    axes = helper.make_tensor("axes", TensorProto.INT64, [3], [1, 2, 3])
    as_given = helper.make_tensor_value_info(f"{SCOPE}/given", TensorProto.FLOAT, None)
    given = helper.make_graph([_node("Identity", FORWARD, as_given.name)], "given", [], [as_given])
    return [
        _node("IsNaN", FORWARD, f"{SCOPE}/nan"),
        _node("Cast", f"{SCOPE}/nan", f"{SCOPE}/numbers", to=TensorProto.FLOAT),
        _node("Constant", "", f"{SCOPE}/axes", value=axes),
        _node("ReduceMin", f"{SCOPE}/numbers {SCOPE}/axes", f"{SCOPE}/each", keepdims=0),
        _node("ReduceMax", f"{SCOPE}/each", f"{SCOPE}/any", keepdims=0),
        _node("Cast", f"{SCOPE}/any", f"{SCOPE}/unknown", to=TensorProto.BOOL),
        _node("If", f"{SCOPE}/unknown", KNOWN, then_branch=_scattering(), else_branch=given),
    ]


def _node(kind: str, inputs: str, output: str, **attributes: int | TensorProto | onnx.GraphProto) -> onnx.NodeProto:
    return helper.make_node(kind, inputs.split(), [output], f"{output}/{kind}", **attributes)


class _Completion(nn.Module):
    def forward(self, forward_motion: Tensor, motion: Tensor, depth: Tensor) -> Tensor:
        return complete_forward_motion(forward_motion, motion, depth)


def _scattering() -> onnx.GraphProto:
    """The branch: `complete_forward_motion`, which reads the inputs of the graph around it by their names."""
    unknown = torch.full((2, 2, 24, 32), float("nan"))  # so that what is traced is the scattering
    example = unknown, torch.rand(2, 2, 24, 32), torch.rand(2, 1, 24, 32)
    inputs = FORWARD, "motion", "depth"
    axes = {name: {0: "batch", 2: "height", 3: "width"} for name in (*inputs, "scattered")}
    with _plain_scattering():
        branch = traced(_Completion(), example, inputs, ["scattered"], axes).graph
    branch = compose.add_prefix_graph(branch, SCOPE, rename_inputs=False)  # names are those of the whole model
    del branch.input[:]
    return branch


class _Graph(Protocol):
    """What PyTorch hands to the symbolic function of an operator."""

    def op(self, kind: str, *inputs: object, **attributes: object) -> object:
        """Add an operator of ONNX."""


@contextmanager
def _plain_scattering() -> Iterator[None]:
    """Let scatter_reduce become one operator: by default two branches come with each, for tensors without axes."""

    @symbolic_helper.parse_args("v", "i", "v", "v", "s", "b")
    def scatter(
        graph: _Graph, tensor: object, axis: int, index: object, source: object, reduce: str, include_self: bool
    ) -> object:
        assert include_self, "as ONNX does"
        reduction = {"amin": "min", "amax": "max"}[reduce]
        return graph.op("ScatterElements", tensor, index, source, axis_i=axis, reduction_s=reduction)

    torch.onnx.register_custom_op_symbolic("aten::scatter_reduce", scatter, OPSET)  # type: ignore[attr-defined]
    try:
        yield
    finally:
        torch.onnx.unregister_custom_op_symbolic("aten::scatter_reduce", OPSET)  # type: ignore[attr-defined]
