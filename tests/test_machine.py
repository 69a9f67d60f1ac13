"""The speed of the machine: plausible, obeying the number of threads, and leaving nothing changed."""

import sys

import pytest
import torch

from nte import machine

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Convolutions and arrays that take no time."""
    monkeypatch.setattr(machine, "_SIDE", 16)
    monkeypatch.setattr(machine, "_MACS", machine._BATCH * 16**2 * 9 * machine._WIDTH**2)
    monkeypatch.setattr(machine, "memory_bandwidth", lambda device: 1e9 * torch.get_num_threads())


def test_a_machine_is_measured_on_the_threads_that_it_shall_have() -> None:
    before = torch.get_num_threads()
    pytest.importorskip("onnx")
    speed = machine.measure_speed(CPU, 2)
    assert speed.memory == 2e9
    assert min(speed.float32, speed.bfloat16, speed.int8) > 1e7
    assert torch.get_num_threads() == before


def test_operations_and_bytes_are_counted_right(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(machine, "_least_seconds", lambda once: 0.5)
    # 4 images of 96² pixels, 64 channels to 64, 3×3
    forward = 4 * 96 * 96 * 64 * 64 * 9
    assert machine.convolution_peak(CPU) == 2 * forward
    assert machine.convolution_peak(CPU, training=True) == 2 * 3 * forward
    assert machine.memory_bandwidth(CPU, 1000) == 2 * 3 * 4000


def test_without_the_package_for_graphs_there_is_no_peak_of_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert machine.int8_peak(1) is None


def test_a_device_that_pytorch_lacks_is_waited_for_as_the_cpu() -> None:
    assert machine.device_or_cpu("dml") == CPU
    assert machine.device_or_cpu("meta").type == "meta"
