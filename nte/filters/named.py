"""The table of the filters that are known by name, and the function that makes one from what a user types."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from nte.denoiser import Denoiser, Filter
from nte.errors import NteError, expected_one_of, needs_extra
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
    "oidn": ("nte.filters.oidn", "Oidn", "oidn"),
}


def load_filter(spec: str, device: str = "cpu") -> Denoiser:
    """Make the filter that `spec` describes, name:key=value,key=value; the keys are fields of its options class.

    Raises NteError for anything unknown, and lists what there is.
    """
    name, _, text = spec.partition(":")
    if name not in NAMES:
        raise NteError(f"'{spec}' is no denoiser by name{expected_one_of(name, NAMES)}")
    return make(filter_type(spec), parse(spec, text), spec, device)


def filter_type(spec: str) -> type[Filter[Options]]:
    """Return the class of the filter that `spec` names, which must be in NAMES; its module is imported."""
    name = spec.partition(":")[0]
    found = load(*NAMES[name], spec)
    if not (isinstance(found, type) and issubclass(found, Filter) and hasattr(found, "options_type")):
        raise NteError(f"'{spec}': {':'.join(NAMES[name][:2])} is no Filter: expected a subclass with options_type")
    return found


def make(kind: type[Filter[Options]], given: Mapping[str, str], spec: str, device: str) -> Denoiser:
    """Make a filter with options as they are typed."""
    options = kind.options_type.parse(given, spec)
    if kind.uses_device:
        require_device(device)
    return kind(options, device=device)


def load(module: str, attribute: str, extra: str, spec: str) -> Any:
    """Import the attribute of a module.

    Raises NteError, with the extra that installs what is missing, if an import fails.
    """
    try:
        return getattr(import_module(module), attribute)
    except ImportError as error:
        if (error.name or "").startswith("nte."):
            raise  # an error in nte itself, which no installation can fix
        raise needs_extra(extra, f"'{spec}'", error) from error


def require_device(device: str) -> None:
    """Raise NteError if PyTorch has no such device."""
    import torch

    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise NteError(f"--device {device}: {str(error).splitlines()[0]}") from error


def parse(spec: str, options: str) -> dict[str, str]:
    """Split options into a mapping from key to value, both as they are typed."""
    typed: dict[str, str] = {}
    for item in filter(None, options.split(",")):
        key, equals, value = map(str.strip, item.partition("="))
        if not equals or not value:
            raise NteError(f"'{spec}': '{key}' is no option: expected name:key=value,key=value")
        if key in typed:
            raise NteError(f"'{spec}': {key} is given twice, as '{typed[key]}' and '{value}': expected it once")
        typed[key] = value
    return typed
