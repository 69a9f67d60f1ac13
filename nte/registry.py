"""The loading of any denoiser from what a user types: a filter by name, a composite, a run, an exported model."""

from os.path import isdir, isfile  # false of text that is no name of a file, such as options that are longer
from pathlib import Path

from nte.denoiser import Denoiser
from nte.errors import NteError
from nte.filters.composition import COMPOSITE, EACH, Composition, lights_of
from nte.filters.named import NAMES, filter_type, load, make, parse, require_device
from nte.filters.prior import complete
from nte.frames.channels import COMPONENTS
from nte.options import Options

_ESTIMATE = "estimate"  # the wrapper around any denoiser that comes before a +


def load_denoiser(spec: str | Path, device: str = "cpu", threads: int = 0) -> Denoiser:
    """Load the denoiser that `spec` describes.

    `spec` is a run folder, a checkpoint in a run folder (RUN/best.safetensors), an .onnx file, or
    `name:key=value,key=value`. An existing file or folder wins over a name. The keys are fields of the filter's options
    class; for filters with presets `preset=…` sets several fields at once, and the other keys override it.

    `estimate+` or `estimate:key=value+` before any denoiser estimates the motion vectors from the images (module
    nte.filters.estimated; keys noise, guides, known). `target=components`, for filters that have every component as a
    target, denoises each light component separately and sums them. So does
    `composite:visibility=SPEC,glossy=SPEC,indirect=SPEC`, with a denoiser of its own for each; a SPEC with commas
    stands in brackets, and a filter gets the light as its target.

    threads: number of CPU threads of an exported model, 0 lets ONNX Runtime choose; everything else computes on those
    that PyTorch has in this process. Raises NteError for anything unknown, and lists what there is.

    >>> nte.load_denoiser("taa:alpha=0.2,clamp=clip").needs
    ('color', 'motion')
    """
    spec = str(spec)
    wrapper, plus, inner = spec.partition("+")
    if plus and wrapper.partition(":")[0] == _ESTIMATE:
        return _estimated(spec, wrapper.partition(":")[2], load_denoiser(inner, device, threads), device)
    if spec.partition(":")[0] == COMPOSITE and not isdir(spec):
        parts = lights_of(spec).items()
        return Composition({light: _of_light(light, inner, spec, device, threads) for light, inner in parts})
    path = Path(spec)
    if path.suffix == ".onnx":
        from nte.runtime.session import OnnxDenoiser

        return complete(OnnxDenoiser(path, [onnx_provider(device)], threads))
    if isfile(path / "config.yaml") or path.suffix == ".safetensors":
        load_run = load("nte.training.run", "load_run", "train", spec)
        require_device(device)
        return complete(load_run(path, device=device), device)
    name, _, text = spec.partition(":")
    if name not in NAMES:
        if isdir(path):
            raise NteError(f"'{spec}' is no run folder: config.yaml is missing")
        known = ", ".join([*NAMES, COMPOSITE])
        raise NteError(f"'{spec}' is no denoiser: expected a run folder, an .onnx file, or one of {known}")
    kind = filter_type(spec)
    given = parse(spec, text)
    if given.get("target") == EACH:
        _refuse_missing_target(kind.options_type, spec)
        return Composition({c: make(kind, {**given, "target": c}, spec, device) for c in COMPONENTS})
    return make(kind, given, spec, device)


def parts_of(spec: str) -> list[str]:
    """Return what a specification is made of: those in a composite, that below `estimate`, or itself."""
    wrapper, plus, inner = spec.partition("+")
    if plus and wrapper.partition(":")[0] == _ESTIMATE:
        return parts_of(inner)
    if spec.partition(":")[0] == COMPOSITE and not isdir(spec):
        return [part for inner in lights_of(spec).values() for part in parts_of(inner)]
    return [spec]


def _of_light(light: str, inner: str, spec: str, device: str, threads: int) -> Denoiser:
    """The denoiser of one light of the composite `spec`; a filter that is told no target gets this one."""
    name, _, options = inner.partition(":")
    try:
        if name in NAMES and not isfile(Path(inner) / "config.yaml") and "target" not in parse(inner, options):
            kind = filter_type(inner)
            inner = f"{name}:target={light},{options}" if "target" in kind.options_type.names() else inner
        denoiser = load_denoiser(inner, device, threads)
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


def _estimated(spec: str, text: str, denoiser: Denoiser, device: str) -> Denoiser:
    kind = load("nte.filters.estimated", "EstimatedMotion", "eval", spec)
    wrapped: Denoiser = kind(denoiser, kind.options_type.parse(parse(spec, text), spec), device=device)
    return wrapped


def onnx_provider(device: str) -> tuple[str, dict[str, str]]:
    """Return ONNX Runtime's execution provider for a device, with its options.

    `cuda:1` gives the CUDA provider on device 1. Raises NteError if the part after the colon is not a number.
    """
    kind, colon, number = device.partition(":")
    if colon and not (number.isascii() and number.isdigit()):
        raise NteError(f"--device {device}: '{number}' is no number of a device: expected for example {kind}:1")
    return f"{kind.upper()}ExecutionProvider", {"device_id": number} if number and kind != "cpu" else {}
