"""How far an exported model on other providers, or in bf16, is from float32 on the CPU, over a recurrent sequence.

python -m benchmarks.providers MODEL.onnx CLIP provider=openvino provider=openvino,precision=bf16 [--size 64x48]

Of the image and of what is carried: the error |a − b| / (|b| + 0.01) of each value, its median, 99.9th percentile and
maximum over all frames. Of masks: the share of pixels that differ. `nte evaluate` takes the same options, as
MODEL.onnx:OPTIONS, and says what they cost in quality.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.command import count, make_parser, run
from nte.cli.parsing import parse_size
from nte.filters.named import parse
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.runtime.providers import OnnxOptions
from nte.runtime.session import OnnxDenoiser

MASKS = ("valid", "disoccluded")
Values = npt.NDArray[np.float32]


def outputs(denoiser: OnnxDenoiser, frames: Sequence[Frame]) -> Iterator[dict[str, Values]]:
    """Denoise a sequence; yield image, masks and state after each frame."""
    state, masks = None, tuple(name for name in MASKS if name in denoiser.extras)
    for frame in frames:
        result, state = denoiser.step(frame, state, masks)
        carried = {f"state {name}": np.asarray(value) for name, value in state.tensors.items()}
        yield {"image": np.asarray(result.image), **result.extras, **carried}


def errors(model: Path, options: str, frames: Sequence[Frame]) -> dict[str, tuple[float, ...]]:
    """Compare a model with these options to the CPU: output → median, 99.9th percentile and maximum, or a share."""
    other = OnnxDenoiser(model, OnnxOptions.parse(parse(f"{model}:{options}", options), options))
    found: dict[str, list[Values]] = {}
    for ours, theirs in zip(outputs(other, frames), outputs(OnnxDenoiser(model), frames), strict=True):
        for name, value in theirs.items():
            apart = np.abs(ours[name] - value) / (1 if name in MASKS else np.abs(value) + 0.01)
            found.setdefault(name, []).append(apart.ravel())
    every = {name: np.concatenate(values) for name, values in found.items()}
    quantiles = (0.5, 0.999, 1.0)
    return {
        name: (float(v.mean()),) if name in MASKS else tuple(float(np.quantile(v, q)) for q in quantiles)
        for name, v in every.items()
    }


def main(arguments: Sequence[str]) -> None:
    """Print the errors of each set of options."""
    parser = make_parser(__doc__)
    parser.add_argument("model", type=Path, metavar="MODEL.onnx")
    parser.add_argument("clip", type=Path, metavar="CLIP")
    parser.add_argument("options", nargs="+", metavar="key=value,…")
    parser.add_argument("--size", type=parse_size, help="upper left part of the frames (default: all)")
    parser.add_argument("--frames", type=count, default=20)
    given = parser.parse_args(arguments)
    height, width = given.size or (None, None)
    frames = [
        replace(frame, channels={name: v[:, :, :height, :width].copy() for name, v in frame.channels.items()})
        for frame, _ in zip(Clip(given.clip), range(given.frames), strict=False)
    ]
    print(f"{len(frames)} frames of {frames[0].size[1]}x{frames[0].size[0]}: median, 99.9th percentile, maximum")
    for options in given.options:
        for name, values in errors(given.model, options, frames).items():
            print(f"{options:36} {name:28} {'  '.join(f'{value:.1e}' for value in values)}")


if __name__ == "__main__":
    run(main)
