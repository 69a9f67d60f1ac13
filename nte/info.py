"""Descriptions of a clip, an exported model, a run or a training configuration, for `nte info`."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from nte.errors import NteError, printable
from nte.frames.channels import CHANNELS
from nte.frames.clip import Clip
from nte.released import model_path

if TYPE_CHECKING:
    from nte.models.trainable import TrainableDenoiser


def describe(source: Path) -> str:
    """Describe the clip, exported or released model, run or training configuration `source` in a few lines.

    A network is described with its cost: parameters, multiply-accumulates per pixel, receptive field. Raises NteError
    for anything else.
    """
    if not source.is_file() and not any((source / name).is_file() for name in ("clip.json", "config.yaml")):
        source = model_path(str(source)) or source
    if (source / "clip.json").is_file():
        return _clip(Clip(source))
    if source.suffix == ".onnx":
        return _model(source)
    if (source / "config.yaml").is_file():
        return _run(source)
    if source.suffix in (".yaml", ".yml"):
        return _configuration(source)
    raise NteError(
        f"{source}: expected a clip (with clip.json), an .onnx file or a released model, a run folder (with "
        "config.yaml), or a training configuration (.yaml)"
    )


def _clip(clip: Clip) -> str:
    known = ("spp", "reference_spp", "seeds", "fps", "exposure", "clean_guides")
    facts = {key: clip.info[key] for key in known if key in clip.info}
    lines = [f"clip {clip.folder}: {len(clip)} frames, {clip.width}x{clip.height}"]
    lines += [f"  {key}: {value}" for key, value in facts.items()]
    lines += [f"  {name}: {', '.join(CHANNELS[name].components)} in {CHANNELS[name].unit}" for name in clip.channels]
    return _text(lines)


def _model(path: Path) -> str:
    from nte.runtime.session import OnnxDenoiser

    model = OnnxDenoiser(path)
    lines = [f"model {path}: exported by nte {model.info['version']}, denoises '{model.target}'"]
    lines += [f"  needs: {', '.join(model.needs)}", f"  optional: {', '.join(model.optional) or 'none'}"]
    if model.prior:
        lines += [f"  prior: made by {model.prior}; with it only what that needs must be there, and all else is wanted"]
    if lower := model.info.get("precision"):
        lines += [f"  the network computes in {lower}, all else in f32"]
    lines += [f"  {line}" for line in model.info.get("cost", [])]
    lines += [f"  {line}" for line in _places(path)]
    return _text(lines + [f"  {key}: {value}" for key, value in model.info["conventions"].items()])


def _places(path: Path) -> Iterator[str]:
    """What each provider does with an exported model, which the CPU has loaded."""
    from nte.runtime.placement import Placement, placement
    from nte.runtime.providers import PROVIDERS

    yield Placement((), asked=True).said("cpu")  # it loads nothing that it cannot compute
    for provider in [name for name in PROVIDERS if name != "cpu"]:
        try:
            found = placement(path, provider)
        except NteError as error:  # it is installed, but this machine has no such device
            yield f"{provider}: does not start: {str(error).removeprefix(f'{path}: ')}"
        else:
            yield f"{provider}: not installed, and has no list" if found is None else found.said(provider)


def _run(folder: Path) -> str:
    from nte.training.checkpoint import BEST, read_checkpoint
    from nte.training.run import load_run

    step, _ = read_checkpoint(folder)
    lines = [f"run {folder}: {step} steps done; every choice is in {folder / 'config.yaml'}"]
    lines += _network(load_run(folder))
    if (folder / BEST).is_file():
        best, state = read_checkpoint(folder, BEST)
        lines.append(f"  best validation: {state['psnr'].item():.2f} dB after {best} steps, in {folder / BEST}")
    return _text(lines)


def _configuration(path: Path) -> str:
    from nte.models.registry import make_network
    from nte.training.config import load_train_config

    return _text([f"training configuration {path}", *_network(make_network(load_train_config(path, []).network))])


def _network(network: "TrainableDenoiser") -> list[str]:
    """What a network denoises and needs, and what it costs."""
    from nte.models.cost import cost_of

    about = f"network '{network.config.kind}' denoises '{network.target}'; needs: {', '.join(network.needs)}"
    about += f"; prior is made by {network.prior}" if network.prior else ""
    return [f"  {line}" for line in (about, *cost_of(network).lines())]


def _text(lines: list[str]) -> str:
    """Join lines, none of which a text from a file can break or end."""
    return "\n".join(map(printable, lines))
