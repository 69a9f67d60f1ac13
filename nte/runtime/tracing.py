"""The tracing of a PyTorch module as an ONNX graph."""

import warnings
from collections.abc import Mapping, Sequence
from io import BytesIO

import onnx
import torch
from torch import Tensor, nn

OPSET = 18

Axes = Mapping[str, Mapping[int, str]]  # input or output → axis → the name of its free size


def traced(
    module: nn.Module, example: tuple[Tensor, ...], inputs: Sequence[str], outputs: Sequence[str], axes: Axes
) -> onnx.ModelProto:
    """Trace a module with an example of its inputs, whose sizes are free along the given axes.

    Uses the tracing exporter: on two cores it takes 2 s for a network, where torch.export needs 150 s to reason about
    the sizes of 75 shifted images. A check at several sizes must find whatever size tracing has frozen. The graph stays
    in memory: a process that is killed leaves no temporary file.
    """
    file = BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the tracer warns about frozen sizes
        torch.onnx.export(
            module, example, file, dynamo=False, input_names=list(inputs),  # type: ignore[arg-type]  # see its tracer
            output_names=list(outputs), dynamic_axes=axes, opset_version=OPSET,
        )  # fmt: skip
    model = onnx.load_from_string(file.getvalue())
    _test_for_infinity_in_floats(model.graph)
    return model


def _test_for_infinity_in_floats(graph: onnx.GraphProto) -> None:
    """Remove PyTorch's casts to float64 before IsInf, which takes float32: some runtimes lack float64."""
    casts = {node.output[0]: node for node in graph.node if node.op_type == "Cast"}
    tests = [node for node in graph.node if node.op_type == "IsInf" and node.input[0] in casts]
    for test in tests:
        cast = casts[test.input[0]]
        if cast.attribute[0].i == onnx.TensorProto.DOUBLE:
            test.input[0] = cast.input[0]
            if not any(cast.output[0] in node.input for node in graph.node):
                graph.node.remove(cast)
