"""Text and pictures of a CheckReport, for `nte check`."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from torch import Tensor

from nte.checking.report import CheckReport
from nte.checking.residuals import COMPARED, visible_in_both
from nte.errors import printable
from nte.frames.clip import Clip
from nte.frames.show import RGB, Picture, grid, heat, quantise, show
from nte.motion.geometric import frame_vectors, traditional_motion
from nte.motion.warp import warp


def describe(report: CheckReport) -> str:
    """Write the report as text: the verdict, then faults and notes, then the numbers behind them."""
    lines = [f"{report.clip}: {report.verdict}: {report.reason}"]
    for finding in report.findings:
        mark = "fault" if finding.fault else "doubt" if finding.doubt else "note"
        lines.append(f"  {mark}: {finding.channel}: {finding.found}; expected {finding.expected}")
    lines += [f"  not judged: {channel}: {why}" for channel, why in report.not_judged.items()]
    lines.append(f"  {report.frames} frames")
    if report.errors:
        lines[-1] += f", {report.disoccluded:.2%} disoccluded, {report.invalid:.2%} from outside the image"
        lines.append("  mean |difference| to the frame before   unwarped  traditional       dual")
    for region in ("visible", "disoccluded"):
        for name in COMPARED:
            errors = [report.errors.get((name, vectors, region)) for vectors in ("none", "traditional", "dual")]
            if any(error and error.count for error in errors):
                values = "".join(f"{error.value:11.4f}" if error else f"{'':11}" for error in errors)
                lines.append(f"  {name + ', ' + region:37}{values}")
    lines.append("  channel                          minimum       mean    maximum  bad pixels  verdict")
    for name, tally in report.tallies.items():
        low, high = (math.nan, math.nan) if tally.low > tally.high else (tally.low, tally.high)
        found = [finding for finding in report.findings if finding.channel == name]
        verdict = "fault" if any(f.fault for f in found) else "doubt" if any(f.doubt for f in found) else "note"
        verdict = verdict if found else "not judged" if name in report.not_judged else "ok"
        lines.append(f"  {name:28}{low:12.4g}{tally.mean:11.4g}{high:11.4g}{tally.bad:12d}  {verdict}")
    return "\n".join(map(printable, lines))


def undrawable(clip: Clip) -> str:
    """Tell why `draw` has nothing to draw of this clip: a frame or channels that are missing; "" if it has."""
    if len(clip) < 2:
        return "the clip has one frame, expected two"
    missing = [name for name in ("albedo", "motion") if name not in clip.channels]
    return f"the clip has no {' and no '.join(missing)}" if missing else ""


def draw(clip: Clip, index: int) -> RGB:
    """Draw motion, masks and residuals of frame `index`, at least 1, side by side, as (H, W, 3) uint8.

    Raises NteError if the clip has no albedo, no motion, or no such frame.
    """
    previous, current = clip.frame(index - 1).torch(), clip.frame(index).torch()
    dual = frame_vectors(current, previous.get("depth"))
    traditional = traditional_motion(current["motion"])
    visible = visible_in_both(previous, current, dual)
    length = max(1.0, typical_length(current["motion"]))
    warped = {
        "unwarped": previous["albedo"],
        "traditional vectors": warp(previous["albedo"], traditional.motion).image,
        "dual vectors": warp(previous["albedo"], dual.motion).image,
    }
    pictures = [
        show("albedo", _pixels(current["albedo"])),
        show("motion", _pixels(current["motion"]), scale=length),
        replace(show("motion", _pixels(dual.motion), scale=length), title="dual motion"),
        _mask("visible in both frames", visible),
        _mask("disoccluded", dual.disoccluded),
        _mask("from outside the image", ~dual.valid),
        *(replace(show("albedo", _pixels(image)), title=f"albedo, {name}") for name, image in warped.items()),
        *(_residual(f"|residual|, {name}", current["albedo"] - image) for name, image in warped.items()),
    ]
    return grid(pictures, columns=3)


def typical_length(motion: Tensor) -> float:
    """Return the length that 99 % of vectors (1, 2, H, W) stay below, in pixels; others than finite ones are 0."""
    lengths = motion.nan_to_num(0, 0, 0).square().sum(1).sqrt().numpy()
    return float(np.percentile(lengths, 99))  # PyTorch's quantile takes no more than 16 million values


def _pixels(tensor: Tensor) -> npt.NDArray[np.float32]:
    return tensor[0].numpy()


def _mask(title: str, mask: Tensor) -> Picture:
    return Picture(title, quantise(_pixels(mask.float())), f"{mask.float().mean():.2%}")


def _residual(title: str, difference: Tensor) -> Picture:
    return Picture(title, quantise(heat(difference[0].abs().mean(0).numpy(), "magma")), "0 to 1")
