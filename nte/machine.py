"""The speed of this machine, measured: multiply-accumulates per second of a convolution, bytes per second of memory."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

_WIDTH, _SIDE, _BATCH = 64, 96, 4  # of the convolution: large enough for every core
_MACS = _BATCH * _SIDE**2 * 9 * _WIDTH**2  # of its forward pass; the gradients of image and weights take as many each
_TRIES = 4
_NUMBERS = 2**25  # in each of the triad's three arrays, 134 MB: more than caches hold


@dataclass(frozen=True)
class Speed:
    """The speed of a device, with a number of CPU threads."""

    float32: float  # multiply-accumulates per second of a large convolution
    bfloat16: float  # the same, autocast
    int8: float | None  # the same in ONNX Runtime on the CPU; None on another device and without the package onnx
    memory: float  # bytes per second that a + s·b reads and writes


def device_or_cpu(name: str) -> torch.device:
    """Return the device of this name; the CPU if PyTorch lacks it, as what only ONNX Runtime has waits by itself."""
    try:
        return torch.empty(0, device=name).device
    except (RuntimeError, AssertionError, NotImplementedError):
        return torch.device("cpu")


def wait_for(device: torch.device) -> None:
    """Wait until a device has done all its work; the CPU computes at once."""
    if device.type != "cpu":
        torch.accelerator.synchronize(device)


def measure_speed(device: torch.device, threads: int) -> Speed:
    """Measure the speed of a device on so many CPU threads, which PyTorch has again as many of as before afterwards.

    Takes some seconds and 400 MB.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        return Speed(
            convolution_peak(device),
            convolution_peak(device, torch.bfloat16),
            int8_peak(threads) if device.type == "cpu" else None,
            memory_bandwidth(device),
        )
    finally:
        torch.set_num_threads(before)


def convolution_peak(device: torch.device, kind: torch.dtype = torch.float32, training: bool = False) -> float:
    """Measure the multiply-accumulates per second of a large convolution of 3×3.

    kind: float32, or a type that autocast computes in. training: forward and backward pass, otherwise forward alone.
    """
    layer = nn.Conv2d(_WIDTH, _WIDTH, 3, padding=1).to(device)
    image = torch.rand(_BATCH, _WIDTH, _SIDE, _SIDE, device=device, requires_grad=training)

    def once() -> None:
        enabled = kind != torch.float32
        with torch.set_grad_enabled(training), torch.autocast(device.type, kind if enabled else None, enabled=enabled):
            made = layer(image)
        if training:
            made.float().sum().backward()
        wait_for(device)

    return (3 if training else 1) * _MACS / _least_seconds(once)


def int8_peak(threads: int) -> float | None:
    """Measure the same of bytes, uint8 by int8, in ONNX Runtime on the CPU; None without the package onnx."""
    try:
        from onnx import TensorProto, helper, numpy_helper
    except ImportError:
        return None
    import onnxruntime

    shape = (_BATCH, _WIDTH, _SIDE, _SIDE)
    rng = np.random.default_rng(0)
    constants = {
        "weights": rng.integers(-9, 10, (_WIDTH, _WIDTH, 3, 3), np.int8),
        "scale": np.float32(0.02),
        "zero": np.uint8(128),
        "no": np.int8(0),
    }
    inputs = ["image", "scale", "zero", "weights", "scale", "no", "scale", "zero"]
    graph = helper.make_graph(
        [helper.make_node("QLinearConv", inputs, ["made"], pads=[1, 1, 1, 1])],
        "convolution",
        [helper.make_tensor_value_info("image", TensorProto.UINT8, shape)],
        [helper.make_tensor_value_info("made", TensorProto.UINT8, shape)],
        [numpy_helper.from_array(np.asarray(values), name) for name, values in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    image = rng.integers(0, 256, shape, np.uint8)
    return _MACS / _least_seconds(lambda: session.run(None, {"image": image}))


def memory_bandwidth(device: torch.device, numbers: int = _NUMBERS) -> float:
    """Measure the bytes per second that a = b + s·c of large float32 arrays reads and writes.

    This is the triad of STREAM (McCalpin, https://www.cs.virginia.edu/stream/), which counts three arrays as well.
    """
    a, b, c = (torch.ones(numbers, device=device) for _ in range(3))

    def once() -> None:
        torch.add(b, c, alpha=0.5, out=a)
        wait_for(device)

    return 3 * 4 * numbers / _least_seconds(once)


def _least_seconds(once: Callable[[], object]) -> float:
    """The seconds of the fastest of some tries, as other programs only make it slower; one before them allocates."""
    times = []
    for _ in range(_TRIES + 1):
        begin = time.perf_counter()
        once()
        times.append(time.perf_counter() - begin)
    return min(times[1:])
