"""The loading of any denoiser from what a user types: a name, a composite, a run, an exported model."""

from collections.abc import Sequence
from os.path import isdir, isfile  # false of text that is no name of a file, such as options that are longer
from pathlib import Path

from nte.denoiser import Denoiser, Filter
from nte.elsewhere import class_elsewhere, is_elsewhere
from nte.errors import NteError, expected_one_of
from nte.filters.composition import COMPOSITE, EACH, Composition, lights_of
from nte.filters.named import NAMES, filter_type, load, make, parse, require_device
from nte.filters.prior import complete
from nte.frames.channels import COMPONENTS
from nte.options import Options
from nte.released import model_path, names
from nte.runtime.providers import PROVIDERS, OnnxOptions

_MODEL = ".onnx"
_ESTIMATE = "estimate"  # the wrapper around any denoiser that comes before a +
_BELOW = "below"  # what stands behind that +


def load_denoiser(spec: str | Path, device: str = "cpu", threads: int = 0) -> Denoiser:
    """Load the denoiser that `spec` describes.

    `spec` is a run folder, a checkpoint in a run folder (RUN/best.safetensors), an .onnx file, the name of a released
    model, or `name:key=value,key=value` of a filter. An existing run wins over a name. The keys are fields of the
    filter's options class; for filters with presets `preset=…` sets several fields at once, and the other keys override
    it.

    An .onnx file and a released model take options too: `model.onnx:provider=openvino,threads=2`
    (nte.runtime.providers.OnnxOptions). Where they name no provider it is that of `device`, whose number is kept:
    `cuda:1`.

    A class of another package is `package.module:Class`, or `package.module:Class:key=value` for a Filter.

    `estimate+` or `estimate:key=value+` before any denoiser estimates the motion vectors from the images (module
    nte.filters.estimated; keys noise, guides, known). `target=components`, for filters that have every component as a
    target, denoises each light component separately and sums them. So does
    `composite:visibility=SPEC,glossy=SPEC,indirect=SPEC`, with a denoiser of its own for each; a SPEC with commas
    stands in brackets, and a filter gets the light as its target.

    threads: number of CPU threads of an exported model that names none, 0 lets it choose. Everything else computes on
    those that PyTorch has in this process, and Open Image Denoise, also below a network, on all cores or as many as the
    environment variable OIDN_NUM_THREADS says. Raises NteError for anything unknown, and lists what there is.

    >>> nte.load_denoiser("taa:alpha=0.2,clamp=clip").needs
    ('color', 'motion')
    """
    spec = str(spec)
    around, inside = _split(spec)
    if inside and around == COMPOSITE:
        parts = inside.items()
        return Composition({light: _of_light(light, inner, spec, device, threads) for light, inner in parts})
    if inside:
        return _estimated(spec, around, load_denoiser(inside[_BELOW], device, threads), device)
    if model := model_of(spec):
        from nte.runtime.session import OnnxDenoiser

        where = _onnx_options(spec, model[1], device, threads)
        return complete(OnnxDenoiser(model[0], where), ahead=where.ahead)
    path = Path(spec)
    if isfile(path / "config.yaml") or path.suffix == ".safetensors":
        load_run = load("nte.training.run", "load_run", "train", spec)
        require_device(device)
        return complete(load_run(path, device=device), device)
    name, _, text = spec.partition(":")
    if name not in NAMES:
        if isdir(spec):
            raise NteError(f"'{spec}' is no run folder: config.yaml is missing")
        attribute, _, options = text.partition(":")
        if is_elsewhere(f"{name}:{attribute}"):
            return _elsewhere(f"{name}:{attribute}", options, spec, device)
        instead = expected_one_of(name, [*names(), *NAMES, COMPOSITE])
        raise NteError(f"'{spec}' is no denoiser{instead}, a run folder, an .onnx file, or package.module:Class")
    kind = filter_type(spec)
    given = parse(spec, text)
    if given.get("target") == EACH:
        _refuse_missing_target(kind.options_type, spec)
        return Composition({c: make(kind, {**given, "target": c}, spec, device) for c in COMPONENTS})
    return make(kind, given, spec, device)


def _elsewhere(name: str, options: str, spec: str, device: str) -> Denoiser:
    """The denoiser of a class in another package; only a Filter has options."""
    kind = class_elsewhere(name, Denoiser, f"'{spec}'")
    if Filter in kind.__mro__ and hasattr(kind, "options_type"):
        return make(kind, parse(spec, options), spec, device)
    if options:
        raise NteError(f"'{spec}': {kind.__name__} is no Filter, so it has no options: leave out '{options}'")
    try:
        made: Denoiser = kind()
    except TypeError as error:
        raise NteError(f"'{spec}': {kind.__name__} cannot be made without arguments: {error}") from error
    return made


def parts_of(spec: str) -> list[str]:
    """Return what a specification is made of: those in a composite, that below `estimate`, or itself."""
    _, inside = _split(spec)
    if inside:
        return [part for inner in inside.values() for part in parts_of(inner)]
    return [str(model[0]) if (model := model_of(spec)) else spec]


def model_of(spec: str) -> tuple[Path, str] | None:
    """Split the specification of an exported or released model into its file and the text of its options.

    None for any other specification.
    """
    path, marked, text = spec.rpartition(_MODEL + ":")
    if spec.endswith(_MODEL) or marked:
        return (Path(spec), "") if spec.endswith(_MODEL) else (Path(path + _MODEL), text)
    name, _, text = spec.partition(":")
    released = None if isfile(Path(spec, "config.yaml")) else model_path(name)
    return None if released is None else (released, text)


def with_provider(specs: Sequence[str], provider: str) -> list[str]:
    """Let every exported model in the specifications run on a provider, unless it names one of its own.

    Raises NteError if there is no exported model.
    """
    if not any(path.endswith(_MODEL) for spec in specs for path in parts_of(spec)):
        raise NteError(f"--provider {provider}: no exported model (.onnx) among {', '.join(specs)}: expected one")
    return [_with_provider(spec, provider) for spec in specs]


def _with_provider(spec: str, provider: str) -> str:
    around, inside = _split(spec)
    changed = {name: _with_provider(inner, provider) for name, inner in inside.items()}
    if inside and around == COMPOSITE:
        return f"{COMPOSITE}:" + ",".join(f"{light}=[{inner}]" for light, inner in changed.items())
    if inside:
        return f"{around}+{changed[_BELOW]}"
    model = model_of(spec)
    if model is None or "provider" in parse(spec, model[1]):
        return spec
    return f"{model[0]}:" + ",".join(filter(None, [f"provider={provider}", model[1]]))


def _split(spec: str) -> tuple[str, dict[str, str]]:
    """Split a specification by one level into what stands around, and the specifications inside, by name.

    A composite has one inside for each light. `estimate:key=value` has one, with the name _BELOW. Anything else is
    returned as it is, with nothing inside.
    """
    wrapper, plus, inner = spec.partition("+")
    if plus and wrapper.partition(":")[0] == _ESTIMATE:
        return wrapper, {_BELOW: inner}
    if spec.partition(":")[0] == COMPOSITE and not isdir(spec):
        return COMPOSITE, lights_of(spec)
    return spec, {}


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


def _estimated(spec: str, wrapper: str, denoiser: Denoiser, device: str) -> Denoiser:
    kind = load("nte.filters.estimated", "EstimatedMotion", "eval", spec)
    options = kind.options_type.parse(parse(spec, wrapper.partition(":")[2]), spec)
    wrapped: Denoiser = kind(denoiser, options, device=device)
    return wrapped


def _onnx_options(spec: str, text: str, device: str, threads: int) -> OnnxOptions:
    """The options of an exported model: those of its specification, else what `device` (cuda:1) and `threads` say."""
    kind, colon, number = device.partition(":")
    if colon and not (number.isascii() and number.isdigit()):
        raise NteError(f"--device {device}: '{number}' is no number of a device: expected for example {kind}:1")
    given = parse(spec, text)
    provider = given.setdefault("provider", kind)
    if provider == kind and kind not in PROVIDERS:
        raise NteError(f"--device {device}: no exported model runs there: expected one of {', '.join(PROVIDERS)}")
    if number and (provider == kind or (provider in PROVIDERS and PROVIDERS[provider].device)):
        given.setdefault("index", number)
    if threads:
        given.setdefault("threads", str(threads))
    return OnnxOptions.parse(given, spec)
