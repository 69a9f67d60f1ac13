"""Forward and backward time of kernel application: autograd over a loop of slices, and a backward pass of its own.

Then the time in ONNX Runtime of weights by a softmax, and of positive weights whose sum is divided by.

python -m benchmarks.kernels [--batch 4] [--size 96]
"""

import tempfile
import time
import warnings
from collections.abc import Callable, Sequence

import onnxruntime
import torch
from torch import Tensor, nn

from benchmarks.command import count, make_parser, run
from benchmarks.record import record
from nte.models.kernels import _sum_of_taps, apply_kernels, average
from nte.models.prediction import weights


def by_slices(image: Tensor, kernels: Tensor) -> Tensor:
    """Apply kernels and leave the backward pass to autograd, in which each slice gives a padded gradient of zeros."""
    return _sum_of_taps(torch.nn.functional.pad(image, [2] * 4, mode="replicate"), kernels)


def milliseconds(apply: Callable[[Tensor, Tensor], Tensor], image: Tensor, kernels: Tensor) -> tuple[float, float]:
    """Return (forward, backward) in milliseconds, the least of 20 runs."""
    times = []
    for _ in range(20):
        image.grad = kernels.grad = None
        start = time.perf_counter()
        filtered = apply(image, kernels)
        middle = time.perf_counter()
        filtered.backward(torch.ones_like(filtered))  # type: ignore[no-untyped-call]
        times.append((middle - start, time.perf_counter() - middle))
    forward, backward = (1000 * min(column) for column in zip(*times, strict=True))
    return forward, backward


class BySoftmax(nn.Module):
    """Kernels that sum to 1."""

    def forward(self, image: Tensor, values: Tensor) -> Tensor:
        """Apply them."""
        return apply_kernels(image, values.softmax(1))


class ByDivision(nn.Module):
    """Positive weights, whose sum is divided by."""

    def forward(self, image: Tensor, values: Tensor) -> Tensor:
        """Apply them."""
        return average(image, weights(values))


def milliseconds_in_onnx_runtime(module: nn.Module, image: Tensor, values: Tensor) -> float:
    """Return the time of a run, the least of 5."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            module, (image, values), f"{folder}/graph.onnx", dynamo=False, input_names=["image", "values"]
        )
        session = onnxruntime.InferenceSession(f"{folder}/graph.onnx", providers=["CPUExecutionProvider"])
    feed, times = {"image": image.numpy(), "values": values.numpy()}, []
    for _ in range(5):
        start = time.perf_counter()
        session.run(None, feed)
        times.append(time.perf_counter() - start)
    return 1000 * min(times)


def main(arguments: Sequence[str]) -> None:
    """Print the times of both."""
    parser = make_parser(__doc__)
    parser.add_argument("--batch", type=count, default=4)
    parser.add_argument("--size", type=count, default=96)
    options = parser.parse_args(arguments)
    image = torch.rand(options.batch, 3, options.size, options.size, requires_grad=True)
    kernels = torch.rand(options.batch, 25, options.size, options.size, requires_grad=True)
    for name, apply in (("slices", by_slices), ("own", apply_kernels)):
        forward, backward = milliseconds(apply, image, kernels)
        of = f"{name}, {options.batch} × {options.size}²"
        record("kernels", {f"{of}, forward": forward, f"{of}, backward": backward}, "ms")
        print(f"{name:7} forward {forward:6.2f} ms, backward {backward:6.2f} ms")
    image, values = torch.rand(1, 3, 720, 1280), torch.randn(1, 25, 720, 1280)
    for name, module in (("softmax", BySoftmax()), ("divided", ByDivision())):
        taken = milliseconds_in_onnx_runtime(module, image, values)
        record("kernels", {f"{name} in ONNX Runtime, 1280x720": taken}, "ms")
        print(f"{name} in ONNX Runtime, 1280x720: {taken:.0f} ms")


if __name__ == "__main__":
    run(main)
