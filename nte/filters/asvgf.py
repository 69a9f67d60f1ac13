"""A-SVGF: SVGF that drops history where the lighting changed, which temporal gradients measure.

Schied, Peters, Dachsbacher 2018, «Gradient Estimation for Real-Time Adaptive Temporal Filtering». The gradients are
true ones: the same surface point is shaded with the same random numbers in both frames (channel `gradient`). Comparing
reprojected colours instead would measure noise too, and would be another method.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.filters.atrous import atrous_step
from nte.filters.moments import brightness, shorten, variance_of, with_square
from nte.filters.reproject import Geometry
from nte.filters.scope import scope
from nte.filters.svgf import Svgf, SvgfOptions, Weights, edge_stopping, geometry_guides, with_luminance
from nte.frames.frame import Frame
from nte.options import Alpha, Levels, NotNegative

STRATUM = 3  # px; each stratum of 3×3 pixels has one gradient sample
BOX = (1.0, 1.0)  # kernel of 3×3 strata of equal weight
GRADIENT_SIGMA_Z = 1.0
DARKEST = 1e-10  # least divisor of Δ, as a share of the mean luminance: what a sample across an edge leaks is no change
BRIGHTEST = 1e18  # of a gradient's light: what is brighter is a fault, and its square is no number in float32
CENTRE = STRATUM * STRATUM // 2


class Strata(NamedTuple):
    """What is known of each stratum, at a third of the resolution: tensors (N, ·, ⌈H/3⌉, ⌈W/3⌉)."""

    change: Tensor  # Δ = l − l′, 0 where there is no sample
    brightest: Tensor  # max(l, l′), 0 likewise
    moments: Tensor  # two channels: first and second moment of the luminance of the stratum's pixels
    geometry: Geometry  # at the sample, or at the stratum's centre if there is no sample


@dataclass(frozen=True)
class AsvgfOptions(SvgfOptions, name="asvgf"):
    """Options of A-SVGF: those of SVGF, and those of the gradients.

    gradient_iterations: of the gradients' à-trous filter. gradient_noise: number of standard deviations of the filtered
    Δ, computed as if Δ were all noise, that are subtracted from |Δ|. 0 is the published method, which mistakes the
    noise of indirect light's gradients for change and drops its history; 1 keeps that history.
    """

    alpha: Alpha = 0.1
    gradient_iterations: Levels = 5
    gradient_noise: NotNegative = 0.0


class Asvgf(Svgf):
    """A-SVGF of `color` or one light component: α ← lerp(max(α, 1/h), 1, λ), with λ from temporal gradients.

    Channel `gradient` (N, 2, H, W): luminance of the demodulated colour, shaded now with the previous frame's random
    numbers, and shaded in the previous frame. One pixel of each 3×3 stratum has values, the others are NaN. λ is 0
    where no sample is near. A target other than `color` uses the gradients of its own light: `gradient_visibility`,
    `gradient_indirect` or `gradient_glossy`. Clips without these use `gradient` instead; then a moving shadow also
    shortens the history of indirect and glossy light. The extra `alpha` is the weight that λ has raised.
    """

    options: AsvgfOptions
    options_type = AsvgfOptions

    def __init__(self, options: AsvgfOptions | None = None, *, device: str = "cpu") -> None:
        super().__init__(options, device=device)
        self.needs = (*self.needs, "gradient")
        self.own_gradient = f"gradient_{self.target}"
        if self.target != "color":
            self.optional = (*self.optional, self.own_gradient)

    def _weights(self, frame: Frame, light: Tensor, geometry: Geometry, length: Tensor) -> Weights:
        """SVGF's weights, pulled towards 1 where the light changed (section 4.4), with the shortened history length.

        The variance follows the length: a history that was dropped is young, so its variance is estimated in space.
        """
        with scope("asvgf: gradient"):
            gradient = frame[self.own_gradient if self.own_gradient in frame else "gradient"]
            strata = stratify(gradient, brightness(light), geometry)
            change = self._changed(strata)[..., : light.shape[2], : light.shape[3]]
        kept = super()._weights(frame, light, geometry, length)
        one = torch.ones_like(change)
        return Weights(shorten(length, change), kept.light.lerp(one, change), kept.moments.lerp(one, change))

    def _changed(self, strata: Strata) -> Tensor:
        """λ at full resolution, with this filter's parameters."""
        how = self.options
        return change_of(strata, how.sigma_l, how.sigma_n, how.gradient_iterations, how.gradient_noise)


def change_of(
    strata: Strata, sigma_l: float = 10.0, sigma_n: float = 128.0, iterations: int = 5, noise: float = 0.0
) -> Tensor:
    """Compute λ = min(1, max |Δ| / max(l, l′)) over the filtered 3×3 strata around each pixel (section 4.3).

    Returns (N, 1, 3·⌈H/3⌉, 3·⌈W/3⌉), full resolution rounded up to whole strata. iterations: of the à-trous filter.
    sigma_l, sigma_n: of its edge-stopping weights. noise: standard deviations of Δ that are subtracted as noise.
    """
    sums = torch.cat([strata.change, strata.brightest], 1)
    brightness = strata.moments[:, :1]
    # Variance of the brightness, and of Δ as if it were all noise.
    spread = torch.cat([variance_of(strata.moments), strata.change.square()], 1)
    guides, edge = geometry_guides(strata.geometry, GRADIENT_SIGMA_Z), edge_stopping(sigma_n)
    for level in range(iterations):
        seen = with_luminance(guides, brightness, spread[:, :1], sigma_l)
        # Δ keeps its sign, so that noise cancels and a change of light does not.
        filtered = atrous_step(torch.cat([sums, brightness], 1), 2**level, edge, seen, spread, BOX)
        assert filtered.variance is not None
        sums, brightness, spread = filtered.values[:, :2], filtered.values[:, 2:], filtered.variance
    change = (sums[:, :1].abs() - noise * spread[:, 1:].sqrt()).clamp_(min=0)
    # Numerator and denominator have the same weights, those of the strata with a sample, so the weights cancel.
    least = brightness.abs().mean((2, 3), keepdim=True).mul_(DARKEST).clamp_(min=1e-36)
    ratio = (change / sums[:, 1:].maximum(least)).clamp_(max=1)
    return F.interpolate(F.max_pool2d(ratio, 3, stride=1, padding=1), scale_factor=float(STRATUM))


def stratify(gradient: Tensor, brightness: Tensor, geometry: Geometry) -> Strata:
    """Divide a frame into strata of 3×3 pixels (section 4.2); strata at the right and lower border may be cut off.

    gradient (N, 2, H, W); brightness (N, 1, H, W); geometry of the frame.
    """
    pairs = _pixels(torch.where(gradient.isfinite(), gradient, float("nan")), float("nan"))  # (N, 2, 9, h, w)
    usable = pairs.isfinite().all(1, keepdim=True)
    known = usable.any(2)
    # The first usable pixel; where there is none, the centre.
    at = torch.where(known, usable.float().argmax(2), CENTRE)[:, :, None]
    now, before = _pick(pairs, at).where(known, 0.0).clamp(0, BRIGHTEST).split_with_sizes([1, 1], 1)
    inside = _pixels(torch.ones_like(brightness), 0)
    moments = _pixels(with_square(brightness), 0).sum(2) / inside.sum(2)
    # Slopes come from pixels: between samples, which lie anywhere in their strata, depth differences are random.
    widths = geometry.depth_width * STRATUM, geometry.normal_width * STRATUM
    parts = _pixels(geometry.depth, float("inf")), *(_pixels(part, 0) for part in (geometry.normal, *widths))
    sampled = Geometry(*(_pick(part, at) for part in parts))
    return Strata(now - before, torch.maximum(now, before), moments, sampled)


def _pixels(image: Tensor, fill: float) -> Tensor:
    """The pixels (N, C, 9, ⌈H/3⌉, ⌈W/3⌉) of every stratum, row by row; `fill` outside the image."""
    height, width = image.shape[-2:]
    padded = F.pad(image, (0, -width % STRATUM, 0, -height % STRATUM), value=fill)
    parts = F.pixel_unshuffle(padded, STRATUM)
    return parts.view(len(image), -1, STRATUM * STRATUM, *parts.shape[2:])


def _pick(pixels: Tensor, at: Tensor) -> Tensor:
    """The one pixel (N, C, h, w) of each stratum's nine (N, C, 9, h, w) with the index `at` (N, 1, 1, h, w)."""
    return pixels.gather(2, at.expand(-1, pixels.shape[1], -1, -1, -1))[:, :, 0]
