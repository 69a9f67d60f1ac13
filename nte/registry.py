"""Names → denoisers: what a user types becomes something with a `step`."""

import inspect
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from nte.denoiser import Denoiser
from nte.errors import NteError, needs_extra

# name → (module, class, extra that brings what it imports); imported when asked for
NAMES: dict[str, tuple[str, str, str]] = {
    "noisy": ("nte.denoiser", "Noisy", ""),
    "taa": ("nte.filters.taa", "Taa", "eval"),
    "svgf": ("nte.filters.svgf", "Svgf", "eval"),
    "asvgf": ("nte.filters.asvgf", "Asvgf", "eval"),
    "trmv": ("nte.filters.trmv", "Trmv", "eval"),
    "align_taa": ("nte.filters.align_taa", "AlignTaa", "eval"),
    "align_accumulate": ("nte.filters.align_accumulate", "AlignAccumulate", "eval"),
    "motion_blur": ("nte.filters.motion_blur", "MotionBlur", "eval"),
    "post_blur": ("nte.filters.post_blur", "PostBlur", "eval"),
    "mcguire": ("nte.filters.mcguire", "McGuire", "eval"),
    "oidn": ("nte.filters.oidn", "Oidn", "compare"),
}


def load_denoiser(spec: str, device: str = "cpu") -> Denoiser:
    """The denoiser that `spec` names: a run folder, an .onnx file, or `name:key=value,key=value`. A checkpoint
    in a run folder stands for it as well: RUN/best.safetensors.

    What exists on disk wins over a name. `estimate+` before any of them, or `estimate:key=value+`: with motion that is
    estimated from the images (nte.filters.estimated; noise, guides, known). Option `target=components`, of those that
    have `target`: a denoiser for each light component, put together. Raises NteError for anything unknown, listing
    what there is.

    >>> nte.load_denoiser("taa:alpha=0.2,clamp=clip").needs
    ('color', 'motion')
    """
    wrapper, plus, inner = spec.partition("+")
    if plus and wrapper.partition(":")[0] == "estimate":
        wrapped = {"denoiser": load_denoiser(inner, device)}
        how = _parse(spec, wrapper.partition(":")[2])
        return _construct("nte.filters.estimated", "EstimatedMotion", "eval", spec, how, device, wrapped)
    path = Path(spec)
    if path.suffix == ".onnx":
        from nte.runtime.session import OnnxDenoiser

        return OnnxDenoiser(path, [onnx_provider(device)])
    if (path / "config.yaml").is_file() or path.suffix == ".safetensors":
        return _construct("nte.training.run", "load_run", "train", spec, {"folder": path}, device)
    name, _, options = spec.partition(":")
    if name not in NAMES:
        if path.is_dir():
            raise NteError(f"'{spec}' is no run folder: config.yaml is missing")
        known = ", ".join(NAMES)
        raise NteError(f"'{spec}' is no denoiser: expected a run folder, an .onnx file, or one of {known}")
    module, attribute, extra = NAMES[name]
    parsed = _parse(spec, options)
    if parsed.get("target") == "components":
        from nte.filters.composition import COMPONENTS, Composition

        return Composition(
            {c: _construct(module, attribute, extra, spec, {**parsed, "target": c}, device) for c in COMPONENTS}
        )
    return _construct(module, attribute, extra, spec, parsed, device)


def _construct(
    module: str, attribute: str, extra: str, spec: str, options: dict[str, Any], device: str | None = None,
    given: Mapping[str, Any] | None = None,
) -> Denoiser:  # fmt: skip
    """The denoiser with options as they are typed, and with arguments that are `given` and that nobody types."""
    given = given or {}
    try:
        make = getattr(import_module(module), attribute)
    except ImportError as error:
        raise needs_extra(extra, f"'{spec}'", error) from error
    accepted = inspect.signature(make).parameters
    settable = {key: p for key, p in accepted.items() if key != "device" and key not in given}
    for key, value in options.items():
        if key not in accepted or key in given or (device is not None and key == "device"):
            raise NteError(f"'{spec}': unknown option '{key}'; it has {', '.join(settable) or 'none'}")
        options[key] = _convert(spec, key, value, accepted[key])
    if device is not None and "device" in accepted:
        check_device(device)
        options["device"] = device
    denoiser: Denoiser = make(**options, **given)
    return denoiser


def onnx_provider(device: str) -> tuple[str, dict[str, str]]:
    """ONNX Runtime's execution provider for a device, with its options: `cuda:1` is the CUDA provider on device 1.

    Raises NteError for a device number that is none.
    """
    kind, colon, number = device.partition(":")
    if colon and not (number.isascii() and number.isdigit()):
        raise NteError(f"--device {device}: '{number}' is no number of a device: expected for example {kind}:1")
    return f"{kind.upper()}ExecutionProvider", {"device_id": number} if number and kind != "cpu" else {}


def check_device(device: str) -> None:
    """Raise NteError where PyTorch has no such device."""
    import torch

    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise NteError(f"--device {device}: {str(error).splitlines()[0]}") from error


def _parse(spec: str, options: str) -> dict[str, Any]:
    pairs = [item.partition("=") for item in options.split(",") if item]
    for key, equals, value in pairs:
        if not equals or not value:
            raise NteError(f"'{spec}': '{key}' is no option: expected name:key=value,key=value")
    return {key.strip(): value.strip() for key, _, value in pairs}


def _convert(spec: str, key: str, value: Any, parameter: inspect.Parameter) -> Any:
    """A typed text as the type of the option's default: bool, int, float or str."""
    kind = type(parameter.default)
    if not isinstance(value, str) or kind not in (bool, int, float):
        return value
    try:
        if kind is bool:
            return {"true": True, "1": True, "false": False, "0": False}[value.lower()]
        return kind(value)
    except (ValueError, KeyError):
        raise NteError(f"'{spec}': {key} is '{value}', expected {kind.__name__}") from None
