"""Names → denoisers: what a user types becomes something with a `step`."""

from collections.abc import Mapping
from importlib import import_module
from os.path import isdir, isfile  # false of text that is no name of a file, such as options that are longer
from pathlib import Path
from typing import Any

from nte.denoiser import Denoiser, Filter
from nte.errors import NteError, needs_extra
from nte.filters.composition import EACH, Composition
from nte.frames.channels import COMPONENTS
from nte.options import Options

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


def load_denoiser(spec: str | Path, device: str = "cpu") -> Denoiser:
    """The denoiser that `spec` names: a run folder, an .onnx file, or `name:key=value,key=value`. A checkpoint
    in a run folder stands for it as well: RUN/best.safetensors.

    What exists on disk wins over a name. Options are fields of the filter's options class; `preset=…` sets those of a
    named preset, where it has presets, and the others change them. `estimate+` before any denoiser, or
    `estimate:key=value+`: with motion that is estimated from the images (nte.filters.estimated; noise, guides, known).
    Option `target=components`, of those that have `target`: a denoiser for each light component, put together. Raises
    NteError for anything unknown, listing what there is.

    >>> nte.load_denoiser("taa:alpha=0.2,clamp=clip").needs
    ('color', 'motion')
    """
    spec = str(spec)
    wrapper, plus, inner = spec.partition("+")
    if plus and wrapper.partition(":")[0] == "estimate":
        return _estimated(spec, wrapper.partition(":")[2], load_denoiser(inner, device), device)
    path = Path(spec)
    if path.suffix == ".onnx":
        from nte.runtime.session import OnnxDenoiser

        return OnnxDenoiser(path, [onnx_provider(device)])
    if isfile(path / "config.yaml") or path.suffix == ".safetensors":
        load = _import("nte.training.run", "load_run", "train", spec)
        check_device(device)
        loaded: Denoiser = load(path, device=device)
        return loaded
    name, _, text = spec.partition(":")
    if name not in NAMES:
        if isdir(path):
            raise NteError(f"'{spec}' is no run folder: config.yaml is missing")
        known = ", ".join(NAMES)
        raise NteError(f"'{spec}' is no denoiser: expected a run folder, an .onnx file, or one of {known}")
    kind: type[Filter[Options]] = _import(*NAMES[name], spec)
    given = _parse(spec, text)
    if given.get("target") == EACH:
        return Composition({c: _make(kind, {**given, "target": c}, spec, device) for c in COMPONENTS})
    return _make(kind, given, spec, device)


def _make(kind: type[Filter[Options]], given: Mapping[str, str], spec: str, device: str) -> Denoiser:
    """The filter with options as they are typed."""
    options = kind.options_type.parse(given, spec)
    if kind.uses_device:
        check_device(device)
    return kind(options, device=device)


def _estimated(spec: str, text: str, denoiser: Denoiser, device: str) -> Denoiser:
    kind = _import("nte.filters.estimated", "EstimatedMotion", "eval", spec)
    wrapped: Denoiser = kind(denoiser, kind.options_type.parse(_parse(spec, text), spec), device=device)
    return wrapped


def _import(module: str, attribute: str, extra: str, spec: str) -> Any:
    """What is called `attribute` in the module. Raises NteError that names the extra which brings what it imports."""
    try:
        return getattr(import_module(module), attribute)
    except ImportError as error:
        if (error.name or "").startswith("nte."):
            raise  # a mistake of ours, which no installation mends
        raise needs_extra(extra, f"'{spec}'", error) from error


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


def _parse(spec: str, options: str) -> dict[str, str]:
    """Key → value, as they are typed."""
    typed: dict[str, str] = {}
    for item in filter(None, options.split(",")):
        key, equals, value = map(str.strip, item.partition("="))
        if not equals or not value:
            raise NteError(f"'{spec}': '{key}' is no option: expected name:key=value,key=value")
        if key in typed:
            raise NteError(f"'{spec}': {key} is given twice, as '{typed[key]}' and '{value}': expected it once")
        typed[key] = value
    return typed
