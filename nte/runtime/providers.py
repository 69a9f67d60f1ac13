"""Where an exported model runs: providers by short names, the options of each, and the package that brings it."""

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from nte.errors import NteError
from nte.options import Allowed, Options

if TYPE_CHECKING:
    from onnxruntime import OrtEpDevice

_CORES = os.cpu_count() or 1


class Provider(NamedTuple):
    """One way to run a graph: an execution provider of ONNX Runtime, or OpenVINO itself."""

    package: str  # on PyPI
    name: str = ""  # ONNX Runtime's; "" for OpenVINO
    options: Mapping[str, str] = MappingProxyType({})
    device: str = ""  # its option for the number of a device; "" if it has none
    memory: str = "cpu"  # where ONNX Runtime keeps what is carried from frame to frame
    then: tuple[str, ...] = ()  # ONNX Runtime's providers for operators that it leaves over, before the CPU
    plugin: str = ""  # the module with its library, which stands beside onnxruntime; "" where ONNX Runtime has it


# TF32 is off: it rounds what a convolution reads to 10 bits of mantissa, and f32 is what was asked for.
_CUDA = Provider("onnxruntime-gpu", "CUDAExecutionProvider", {"use_tf32": "0"}, "device_id", "cuda")
PROVIDERS: dict[str, Provider] = {
    "cpu": Provider("onnxruntime", "CPUExecutionProvider"),
    "openvino": Provider("openvino"),
    "cuda": _CUDA,
    "tensorrt": _CUDA._replace(name="TensorrtExecutionProvider", options={}, then=("CUDAExecutionProvider",)),
    "directml": Provider("onnxruntime-directml", "DmlExecutionProvider", {}, "device_id", "dml"),
    "coreml": Provider("onnxruntime", "CoreMLExecutionProvider", {"ModelFormat": "MLProgram"}),  # in that for macOS
    "webgpu": Provider(
        "onnxruntime-ep-webgpu", "WebGpuExecutionProvider", memory="webgpu", plugin="onnxruntime_ep_webgpu"
    ),
}


@dataclass(frozen=True)
class OnnxOptions(Options, name="exported model"):
    """Where and how an exported model runs.

    provider: one of PROVIDERS. index: number of its device, where it has several. threads: of the CPU; None (typed
    auto) lets the provider choose. precision: bf16 lets OpenVINO compute in bfloat16 where it likes. ahead: let the
    Open Image Denoise that a model builds on see the next frame, too, where a sequence has it.
    """

    provider: Literal["cpu", "openvino", "cuda", "tensorrt", "directml", "coreml", "webgpu"] = "cpu"
    index: Annotated[int, Allowed("a number of a device, 0 or more", lambda n: n >= 0)] = 0
    threads: Annotated[  # a thousand threads on two cores take half a minute to start
        int | None,
        Allowed(
            f"auto, or a whole number from 1 to {_CORES}, the cores of this machine",
            lambda n: n is None or 1 <= n <= _CORES,
        ),
    ] = None
    precision: Literal["f32", "bf16"] = "f32"
    ahead: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.precision != "f32" and self.provider != "openvino":
            raise NteError(f"{self.name}: precision is {self.precision}, which only openvino has, not {self.provider}")
        if self.index and not PROVIDERS[self.provider].device:
            raise NteError(f"{self.name}: index is {self.index}, but {self.provider} has one device")


def installed() -> list[str]:
    """Return the short names of the providers that are there."""
    return [name for name in PROVIDERS if _is_there(name)]


def require_installed(provider: str) -> None:
    """Raise NteError for a provider that is not there; the error names the package that brings it.

    It says so too of a package that is installed, but cannot be loaded or finds no device.
    """
    known = PROVIDERS[provider]
    if known.plugin and find_spec(known.plugin):
        if not devices_of(provider):
            raise NteError(f"the package {known.package} is installed, but finds no device; on Linux it needs Vulkan")
        return
    if _is_there(provider):
        if not known.name:
            _require_importable(known.package)
        return
    how = f"it comes with the package {known.package}"
    if known.plugin:
        how += f": pip install {known.package}"
    elif known.package.startswith("onnxruntime-"):  # each of them brings the module onnxruntime
        how += f", which takes the place of onnxruntime: pip uninstall onnxruntime; pip install {known.package}"
    elif known.package == "openvino":
        how += ": pip install 'nte-denoiser[openvino]'"
    else:
        how += " for macOS"
    raise NteError(f"provider {provider} is not installed; there is {', '.join(installed())}; {how}")


@cache
def devices_of(provider: str) -> "list[OrtEpDevice]":
    """Let ONNX Runtime load the library of a provider with a plugin; return the devices that it finds.

    Raises NteError for a library that does not fit ONNX Runtime.
    """
    import onnxruntime

    known = PROVIDERS[provider]
    try:
        library = import_module(known.plugin).get_library_path()
        onnxruntime.register_execution_provider_library(known.plugin, library)
    except Exception as error:  # ONNX Runtime raises classes of its own that share no public base
        reason = next(iter(str(error).splitlines()), "no reason is given")
        raise NteError(f"the package {known.package} is installed, but cannot be loaded: {reason}") from error
    return [device for device in onnxruntime.get_ep_devices() if device.ep_name == known.name]


def asked_of_onnx_runtime(options: OnnxOptions) -> list[tuple[str, dict[str, str]]]:
    """Return ONNX Runtime's providers with their options, best first; the CPU takes what is left over."""
    known = PROVIDERS[options.provider]
    number = {known.device: str(options.index)} if known.device else {}
    first = (known.name, {**known.options, **number})
    others = [(name, {**_CUDA.options, **number} if name == _CUDA.name else {}) for name in known.then]
    rest: list[tuple[str, dict[str, str]]] = [("CPUExecutionProvider", {})]
    return [first, *others, *([] if options.provider == "cpu" else rest)]


def _require_importable(package: str) -> None:
    try:
        import_module(package)
    except ImportError as error:  # a library of the system that it needs
        reason = next(iter(str(error).splitlines()), "no reason is given")
        raise NteError(f"the package {package} is installed, but cannot be imported: {reason}") from error


def _is_there(provider: str) -> bool:
    known = PROVIDERS[provider]
    if not known.name:
        return _has_openvino()
    if known.plugin:
        with suppress(NteError):
            return find_spec(known.plugin) is not None and bool(devices_of(provider))
        return False
    import onnxruntime

    return known.name in onnxruntime.get_available_providers()


def _has_openvino() -> bool:
    return find_spec("openvino") is not None
