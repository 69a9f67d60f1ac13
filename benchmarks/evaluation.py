"""The core seconds that an evaluation takes: python -m benchmarks.evaluation CLIP SPEC…

Each denoiser is evaluated alone. A line has the core seconds of a frame, with reading and scoring, and those beyond the
line of the noisy input, which are the denoiser's own. They hardly depend on what else the machine does.
"""

import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.command import make_parser, run
from nte.evaluation.units import ClipUnit, score_clip
from nte.frames.clip import Clip
from nte.registry import load_denoiser


def seconds(clip: Path, spec: str) -> float:
    """Measure the core seconds that the evaluation of a frame takes, on PyTorch's threads."""
    denoiser = load_denoiser(spec)
    unit = ClipUnit(clip.name, clip, (spec,), 0, (denoiser.target,), "cpu")
    start = time.process_time()
    score_clip(unit, {spec: denoiser})
    return (time.process_time() - start) / len(Clip(clip))


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    parser = make_parser(__doc__)
    parser.add_argument("clip", type=Path)
    parser.add_argument("denoisers", nargs="+", metavar="SPEC")
    given = parser.parse_args(arguments)
    target = load_denoiser(given.denoisers[0]).target
    baseline = f"noisy:target={target}"
    seconds(given.clip, baseline)  # imports and caches
    base = seconds(given.clip, baseline)
    width = max(map(len, (baseline, *given.denoisers)))
    print(f"{'':{width}}  s/frame     own")
    print(f"{baseline:{width}}  {base:7.3f}       –")
    for spec in given.denoisers:
        found = seconds(given.clip, spec)
        print(f"{spec:{width}}  {found:7.3f} {found - base:7.3f}", flush=True)


if __name__ == "__main__":
    run(main)
