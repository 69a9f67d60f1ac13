"""Image metrics of one frame, over the whole image or over a region of it.

Images are (N, 3, H, W) after the display transform (nte.color.display), so in [0, 1]; maps and regions are
(N, 1, H, W). A metric of a region without any pixel is None. `regions_of` defines the regions.
"""

from collections.abc import Callable, Mapping

import flip_evaluator
import numpy as np
import torch
from torch import Tensor
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from nte.color import PSNR_MAX, luminance
from nte.errors import NteError
from nte.frames.frame import Frame
from nte.motion.geometric import frame_vectors, traditional_motion

REGIONS = ("all", "disoccluded", "static", "moving", "shadowed", "glossy")
MOVING_PX = 0.1  # a pixel that moved further than this since the previous frame is «moving»
SHADOWED = 0.99  # a pixel with less visibility is in shadow or penumbra, beyond the noise of the reference
GLOSSY = 0.1  # a pixel is glossy if lobes other than the diffuse one give at least this share of its luminance
FLIP_PPD = 67.0  # pixels per degree: 0.7 m in front of a 0.7 m wide screen of 3840 pixels
_SSIM_SMALLEST = 6  # pixels; the 11×11 window is mirrored at the border


Scores = dict[str, dict[str, float | None]]  # region → metric → value


def score(image: Tensor, reference: Tensor, regions: Mapping[str, Tensor]) -> tuple[Scores, dict[str, Tensor]]:
    """Compute the metrics of an image in every region, and the maps (N, 1, H, W) that they are means of.

    image, reference: (N, 3, H, W) in [0, 1]. regions: name → bool (N, 1, H, W). Raises NteError below 6×6 pixels.
    """
    maps = {name: make(image, reference) for name, make in MAPS.items()}
    scores: Scores = {}
    for name, region in regions.items():
        values = {metric: region_mean(errors, region) for metric, errors in maps.items()}
        scores[name] = {"psnr": psnr(image, reference, region), **values, "rmse": _root(values["mse"])}
    return scores, maps


def psnr(image: Tensor, reference: Tensor, region: Tensor | None = None) -> float | None:
    """Compute the peak signal-to-noise ratio in dB, with peak 1, over the region; at most 100, None without pixels.

    image, reference: (N, C, H, W). region: bool (N, 1, H, W); None takes all pixels.
    """
    ours, theirs = (pixels_of(x, region) for x in (image, reference))
    if not len(ours):
        return None
    return min(float(peak_signal_noise_ratio(ours, theirs, data_range=1.0)), PSNR_MAX)


def region_mean(values: Tensor, region: Tensor | None = None) -> float | None:
    """Average a map (N, C, H, W) over a region, bool (N, 1, H, W); None if the region has no pixel."""
    picked = pixels_of(values, region)
    return float(picked.double().mean()) if len(picked) else None


def pixels_of(values: Tensor, region: Tensor | None = None) -> Tensor:
    """Select the pixels (K, C) of `values` (N, C, H, W) in a region, bool (N, 1, H, W); all of them if it is None."""
    channels_last = values.movedim(1, -1)
    return channels_last.flatten(0, 2) if region is None else channels_last[region[:, 0]]


def absolute_error(image: Tensor, reference: Tensor) -> Tensor:
    """Compute |image − reference| as a map (N, 1, H, W): the mean over the colour channels."""
    return (image - reference).abs().mean(1, keepdim=True)


def squared_error(image: Tensor, reference: Tensor) -> Tensor:
    """Compute (image − reference)² as a map (N, 1, H, W): the mean over the colour channels."""
    return (image - reference).square().mean(1, keepdim=True)


def ssim_map(image: Tensor, reference: Tensor) -> Tensor:
    """Compute structural similarity as a map (N, 1, H, W): Gaussian 11×11 window of σ 1.5, mean over the channels.

    Raises NteError for an image smaller than 6×6.
    """
    height, width = image.shape[-2:]
    if min(height, width) < _SSIM_SMALLEST:
        raise NteError(f"SSIM of a {width}x{height} image: expected at least {_SSIM_SMALLEST}x{_SSIM_SMALLEST}")
    _, full = structural_similarity_index_measure(image, reference, data_range=1.0, return_full_image=True)
    assert isinstance(full, Tensor)
    return full.mean(1, keepdim=True)


def flip_map(image: Tensor, reference: Tensor) -> Tensor:
    """Compute NVIDIA's LDR-FLIP at 67 pixels per degree as a map (N, 1, H, W) in [0, 1]; 0 is no visible difference."""
    pairs = zip(_flip_input(reference), _flip_input(image), strict=True)
    maps = [
        flip_evaluator.evaluate(theirs, ours, "LDR", applyMagma=False, parameters={"ppd": FLIP_PPD})[0]
        for theirs, ours in pairs
    ]
    return torch.from_numpy(np.stack(maps)).movedim(-1, 1)


MAPS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "ssim": ssim_map,
    "flip": flip_map,
    "l1": absolute_error,
    "mse": squared_error,
}


def temporal_l1(image: Tensor, before: Tensor, reference: Tensor, reference_before: Tensor) -> Tensor:
    """Compute |Δimage − Δreference| as a map (N, 1, H, W): the mean over the colour channels.

    Δ is this frame minus the previous one, `before` and `reference_before`. The result is 0 for motion that agrees with
    the reference, and for an error that stays the same from frame to frame.
    """
    return absolute_error(image - before, reference - reference_before)


def temporal_l1_floor(a: Tensor, a_before: Tensor, b: Tensor, b_before: Tensor) -> Tensor:
    """Estimate the `temporal_l1` (N, 1, H, W) of a perfect denoiser, which only the reference's noise causes.

    The reference r = (a + b)/2 is the mean of two independent halves a = t + e and b = t + e' of the truth t. A perfect
    output t differs from it by Δt − Δr = −(Δe + Δe')/2. The halves give Δa − Δb = Δe − Δe', which has the same
    distribution as Δe + Δe', since noise and its negative are equally likely. So the result is half of |Δa − Δb|.
    """
    return temporal_l1(a, a_before, b, b_before) / 2


def regions_of(frame: Frame, previous_depth: Tensor | None = None) -> dict[str, Tensor]:
    """Return the regions of a PyTorch frame that its channels define: name → bool (N, 1, H, W); always has `all`.

    disoccluded: the mask of the dual vectors, sharper with the depth of the previous frame, previous_depth
    (N, 1, H, W); empty in frame 0, which has no history. A missing previous_forward_motion is scattered from motion
    and depth; without depth the region is left out. moving: |motion| > 0.1 px; static: all other pixels. shadowed:
    reference visibility below 0.99. glossy: at least a tenth of the reference's luminance is glossy light.
    """
    height, width = frame.size
    everywhere = torch.ones(frame.batch, 1, height, width, dtype=torch.bool)
    found = {"all": everywhere}
    if "motion" in frame:
        motion = traditional_motion(frame["motion"]).motion
        moving = motion.square().sum(1, keepdim=True) > MOVING_PX**2
        found |= {"static": ~moving, "moving": moving}
        if frame.index == 0:
            found["disoccluded"] = ~everywhere
        elif "previous_forward_motion" in frame or "depth" in frame:
            found["disoccluded"] = frame_vectors(frame, previous_depth).disoccluded
    if "reference_visibility" in frame:
        found["shadowed"] = frame["reference_visibility"] < SHADOWED
    if "reference_glossy" in frame and "reference" in frame:
        light = luminance(frame["reference"])
        found["glossy"] = (light > 0) & (luminance(frame["reference_glossy"]) >= GLOSSY * light)
    return found


def _flip_input(images: Tensor) -> np.ndarray:
    return np.ascontiguousarray(images.detach().cpu().movedim(1, -1).numpy(), np.float32)


def _root(value: float | None) -> float | None:
    return None if value is None else value**0.5
