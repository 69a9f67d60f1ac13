"""The table of named denoisers, and the function that loads a denoiser from what a user types."""

from collections.abc import Mapping
from importlib import import_module
from os.path import isdir, isfile  # false of text that is no name of a file, such as options that are longer
from pathlib import Path
from typing import Any

from nte.denoiser import Denoiser, Filter
from nte.errors import NteError, needs_extra
from nte.filters.composition import COMPOSITE, EACH, Composition, lights_of
from nte.frames.channels import COMPONENTS
from nte.options import Options

# name → (module, class, the extra that installs what it imports); modules are imported on demand
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
    """Load the denoiser that `spec` describes.

    `spec` is a run folder, a checkpoint in a run folder (RUN/best.safetensors), an .onnx file, or
    `name:key=value,key=value`. An existing file or folder wins over a name. The keys are fields of the filter's options
    class; for filters with presets `preset=…` sets several fields at once, and the other keys override it.

    `estimate+` or `estimate:key=value+` before any denoiser estimates the motion vectors from the images (module
    nte.filters.estimated; keys noise, guides, known). `target=components`, for filters that have every component as a
    target, denoises each light component separately and sums them. So does
    `composite:visibility=SPEC,glossy=SPEC,indirect=SPEC`, with a denoiser of its own for each; a SPEC with commas
    stands in brackets, and a filter gets the light as its target. Raises NteError for anything unknown, and lists what
    there is.

    >>> nte.load_denoiser("taa:alpha=0.2,clamp=clip").needs
    ('color', 'motion')
    """
    spec = str(spec)
    wrapper, plus, inner = spec.partition("+")
    if plus and wrapper.partition(":")[0] == "estimate":
        return _estimated(spec, wrapper.partition(":")[2], load_denoiser(inner, device), device)
    if spec.partition(":")[0] == COMPOSITE and not isdir(spec):
        return Composition({light: _of_light(light, inner, spec, device) for light, inner in lights_of(spec).items()})
    path = Path(spec)
    if path.suffix == ".onnx":
        from nte.runtime.session import OnnxDenoiser

        return complete(OnnxDenoiser(path, [onnx_provider(device)]))
    if isfile(path / "config.yaml") or path.suffix == ".safetensors":
        load = _import("nte.training.run", "load_run", "train", spec)
        require_device(device)
        return complete(load(path, device=device), device)
    name, _, text = spec.partition(":")
    if name not in NAMES:
        if isdir(path):
            raise NteError(f"'{spec}' is no run folder: config.yaml is missing")
        known = ", ".join([*NAMES, COMPOSITE])
        raise NteError(f"'{spec}' is no denoiser: expected a run folder, an .onnx file, or one of {known}")
    kind: type[Filter[Options]] = _import(*NAMES[name], spec)
    given = _parse(spec, text)
    if given.get("target") == EACH:
        _refuse_missing_target(kind.options_type, spec)
        return Composition({c: _make(kind, {**given, "target": c}, spec, device) for c in COMPONENTS})
    return _make(kind, given, spec, device)


def complete(denoiser: Denoiser, device: str = "cpu") -> Denoiser:
    """Put a network that builds on another denoiser's image on top of that one; any other network stays as it is.

    Raises NteError for a `prior` that is no denoiser by name, or denoises something else.
    """
    spec = getattr(denoiser, "prior", "")
    if not spec:
        return denoiser
    if spec.partition(":")[0] not in NAMES:  # a model's file must not name other files to be loaded
        raise NteError(f"prior '{spec}': expected a denoiser by name, one of {', '.join(NAMES)}")
    from nte.filters.prior import OnTop

    return OnTop(denoiser, load_denoiser(spec, device))


def _of_light(light: str, inner: str, spec: str, device: str) -> Denoiser:
    """The denoiser of one light of the composite `spec`; a filter that is told no target gets this one."""
    name, _, options = inner.partition(":")
    try:
        if name in NAMES and not isfile(Path(inner) / "config.yaml") and "target" not in _parse(inner, options):
            kind: type[Filter[Options]] = _import(*NAMES[name], inner)
            inner = f"{name}:target={light},{options}" if "target" in kind.options_type.names() else inner
        denoiser = load_denoiser(inner, device)
    except NteError as error:
        raise NteError(f"{COMPOSITE}, {light}: {error}") from error
    if denoiser.target != light:
        raise NteError(f"'{spec}': '{inner}' denoises {denoiser.target}, expected a denoiser of {light}")
    return denoiser


def _refuse_missing_target(options: type[Options], spec: str) -> None:
    """Raise NteError if these options have a target, but not every component is one."""
    offered = options.choices("target") if "target" in options.names() else COMPONENTS
    if missing := [name for name in COMPONENTS if name not in offered]:
        raise NteError(
            f"'{spec}': {options.name} has no target {', '.join(missing)}, which {EACH} need: expected a target out of "
            f"{', '.join(offered)}"
        )


def _make(kind: type[Filter[Options]], given: Mapping[str, str], spec: str, device: str) -> Denoiser:
    """The filter with the options as they are typed."""
    options = kind.options_type.parse(given, spec)
    if kind.uses_device:
        require_device(device)
    return kind(options, device=device)


def _estimated(spec: str, text: str, denoiser: Denoiser, device: str) -> Denoiser:
    kind = _import("nte.filters.estimated", "EstimatedMotion", "eval", spec)
    wrapped: Denoiser = kind(denoiser, kind.options_type.parse(_parse(spec, text), spec), device=device)
    return wrapped


def _import(module: str, attribute: str, extra: str, spec: str) -> Any:
    """The attribute of a module. Raises NteError, with the extra that installs what is missing, if an import fails."""
    try:
        return getattr(import_module(module), attribute)
    except ImportError as error:
        if (error.name or "").startswith("nte."):
            raise  # an error in nte itself, which no installation can fix
        raise needs_extra(extra, f"'{spec}'", error) from error


def onnx_provider(device: str) -> tuple[str, dict[str, str]]:
    """Return ONNX Runtime's execution provider for a device, with its options.

    `cuda:1` gives the CUDA provider on device 1. Raises NteError if the part after the colon is not a number.
    """
    kind, colon, number = device.partition(":")
    if colon and not (number.isascii() and number.isdigit()):
        raise NteError(f"--device {device}: '{number}' is no number of a device: expected for example {kind}:1")
    return f"{kind.upper()}ExecutionProvider", {"device_id": number} if number and kind != "cpu" else {}


def require_device(device: str) -> None:
    """Raise NteError if PyTorch has no such device."""
    import torch

    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise NteError(f"--device {device}: {str(error).splitlines()[0]}") from error


def _parse(spec: str, options: str) -> dict[str, str]:
    """A mapping from key to value, both as they are typed."""
    typed: dict[str, str] = {}
    for item in filter(None, options.split(",")):
        key, equals, value = map(str.strip, item.partition("="))
        if not equals or not value:
            raise NteError(f"'{spec}': '{key}' is no option: expected name:key=value,key=value")
        if key in typed:
            raise NteError(f"'{spec}': {key} is given twice, as '{typed[key]}' and '{value}': expected it once")
        typed[key] = value
    return typed
