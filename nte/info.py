"""Descriptions of a clip, an exported model or a run, for `nte info`."""

from pathlib import Path

from nte.errors import NteError
from nte.frames.channels import CHANNELS
from nte.frames.clip import Clip


def describe(source: Path) -> str:
    """Describe the clip, exported model or run at `source` in a few lines. Raises NteError for anything else."""
    if (source / "clip.json").is_file():
        return _clip(Clip(source))
    if source.suffix == ".onnx":
        return _model(source)
    if (source / "config.yaml").is_file():
        return _run(source)
    raise NteError(f"{source}: expected a clip (with clip.json), an .onnx file, or a run folder (with config.yaml)")


def _clip(clip: Clip) -> str:
    known = ("spp", "reference_spp", "seeds", "fps", "exposure", "clean_guides")
    facts = {key: clip.info[key] for key in known if key in clip.info}
    lines = [f"clip {clip.folder}: {len(clip)} frames, {clip.width}x{clip.height}"]
    lines += [f"  {key}: {value}" for key, value in facts.items()]
    lines += [f"  {name}: {', '.join(CHANNELS[name].components)} in {CHANNELS[name].unit}" for name in clip.channels]
    return "\n".join(lines)


def _model(path: Path) -> str:
    from nte.runtime.session import OnnxDenoiser

    model = OnnxDenoiser(path)
    lines = [f"model {path}: exported by nte {model.info['version']}, denoises '{model.target}'"]
    lines += [f"  needs: {', '.join(model.needs)}", f"  optional: {', '.join(model.optional) or 'none'}"]
    return "\n".join(lines + [f"  {key}: {value}" for key, value in model.info["conventions"].items()])


def _run(folder: Path) -> str:
    from nte.training.checkpoint import BEST, read_checkpoint
    from nte.training.run import load_run

    step, _ = read_checkpoint(folder)
    network = load_run(folder)
    parameters = sum(p.numel() for p in network.parameters())
    said = f"run {folder}: {step} steps done, {parameters:,} parameters; every choice is in {folder / 'config.yaml'}"
    said += f"\n  network '{network.config.kind}' denoises '{network.target}'; needs: {', '.join(network.needs)}"
    if not (folder / BEST).is_file():
        return said
    best, state = read_checkpoint(folder, BEST)
    return f"{said}\n  best validation: {state['psnr'].item():.2f} dB after {best} steps, in {folder / BEST}"
