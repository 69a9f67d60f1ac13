"""A-SVGF: SVGF that forgets where the lighting changed, measured by temporal gradients.

Schied, Peters, Dachsbacher 2018, «Gradient Estimation for Real-Time Adaptive Temporal Filtering». The gradients are
true ones: the same surface point shaded with the same random numbers in both frames (channel `gradient`).
Approximating them by comparing reprojected colours would measure noise as well, and is another method.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.profiler import record_function

from nte.filters.atrous import atrous_step
from nte.filters.moments import brightness, shorten, variance_of, with_square
from nte.filters.reproject import Geometry
from nte.filters.svgf import Svgf, SvgfOptions, Weights, edge_stopping, geometry_guides, with_luminance
from nte.frames.frame import Frame
from nte.options import Allowed, Alpha, NotNegative

STRATUM = 3  # pixels; one gradient sample in each stratum of 3×3
BOX = (1.0, 1.0)  # 3×3 strata of equal weight
GRADIENT_SIGMA_Z = 1.0
CENTRE = STRATUM * STRATUM // 2


class Strata(NamedTuple):
    """A third of the resolution: what one stratum knows, each (N, ·, ⌈H/3⌉, ⌈W/3⌉)."""

    change: Tensor  # Δ = l − l′, 0 where there is no sample
    brightest: Tensor  # max(l, l′)
    known: Tensor  # 1 where there is a sample, else 0
    moments: Tensor  # of the luminance of the stratum's pixels, two channels
    geometry: Geometry  # where the sample lies, or the stratum's centre


@dataclass(frozen=True)
class AsvgfOptions(SvgfOptions, name="asvgf"):
    """Options of A-SVGF: those of SVGF and of its gradients.

    gradient_iterations: of their à-trous filter. gradient_noise: how many standard deviations of the filtered Δ, if the
    pairs differed by chance alone, do not count as change. 0 is the published method, which takes the noise of indirect
    light's gradients for change and gives away its history; 1 keeps it (docs/svgf.md).
    """

    alpha: Alpha = 0.1
    gradient_iterations: Annotated[int, Allowed("a whole number of 0 or more", lambda n: n >= 0)] = 5
    gradient_noise: NotNegative = 0.0


class Asvgf(Svgf):
    """A-SVGF of `color` or one light component: α ← lerp(max(α, 1/h), 1, λ), λ from temporal gradients.

    Channel `gradient` (N, 2, H, W): luminance of the demodulated colour shaded now with the previous frame's random
    numbers, and the previous one; one pixel in each 3×3 stratum, elsewhere NaN. λ is 0 where no sample is near.
    A target other than `color` takes the pairs of its own light from `gradient_visibility`, `gradient_indirect` or
    `gradient_glossy`. Where a clip has none, those of `gradient` stand for them, and then a shadow that moves
    shortens the history of indirect and glossy light, too. The extra `alpha` shows λ.
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
        """SVGF's weights, pulled towards 1 where the light changed (section 4.4), and the length that is left.

        The variance follows the length: a history that was forgotten is young, and its variance spatial.
        """
        with record_function("asvgf: gradient"):
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
    """λ = min(1, max |Δ| / max(l, l′)) over the 3×3 strata around, filtered (section 4.3): at full resolution.

    (N, 1, 3·⌈H/3⌉, 3·⌈W/3⌉). iterations: of the à-trous filter; sigma_l, sigma_n: of its edge-stopping weights; noise:
    standard deviations of Δ that count as chance.
    """
    sums = torch.cat([strata.change, strata.brightest, strata.known], 1)
    brightness = strata.moments[:, :1]
    spread = torch.cat([variance_of(strata.moments), strata.change.square()], 1)  # of brightness; of Δ, as if noise
    guides, edge = geometry_guides(strata.geometry, GRADIENT_SIGMA_Z), edge_stopping(sigma_n)
    for level in range(iterations):
        seen = with_luminance(guides, brightness, spread[:, :1], sigma_l)
        # Δ keeps its sign: that of noise cancels, that of a light does not.
        filtered = atrous_step(torch.cat([sums, brightness], 1), 2**level, edge, seen, spread, BOX)
        assert filtered.variance is not None
        sums, brightness, spread = filtered.values[:, :3], filtered.values[:, 3:], filtered.variance
    change = (sums[:, :1].abs() - noise * spread[:, 1:].sqrt()).clamp_(min=0)
    # Numerator and denominator carry the same weights of the strata that have a sample.
    ratio = (change / sums[:, 1:2].clamp(min=1e-10)).clamp_(max=1)
    return F.interpolate(F.max_pool2d(ratio, 3, stride=1, padding=1), scale_factor=float(STRATUM))


def stratify(gradient: Tensor, brightness: Tensor, geometry: Geometry) -> Strata:
    """Strata of a frame: section 4.2. Strata at the right and lower border may be cut."""
    pairs = _pixels(torch.where(gradient.isfinite(), gradient, float("nan")), float("nan"))  # (N, 2, 9, h, w)
    usable = pairs.isfinite().all(1, keepdim=True)
    known = usable.any(2)
    # The first usable pixel; where there is none, the centre.
    at = torch.where(known, usable.float().argmax(2), CENTRE)[:, :, None]
    now, before = _pick(pairs, at).where(known, 0.0).clamp(min=0).split_with_sizes([1, 1], 1)
    inside = _pixels(torch.ones_like(brightness), 0)
    moments = _pixels(with_square(brightness), 0).sum(2) / inside.sum(2)
    # Slopes are the pixels': between samples, which lie anywhere in their strata, the depth changes by chance.
    widths = geometry.depth_width * STRATUM, geometry.normal_width * STRATUM
    parts = _pixels(geometry.depth, float("inf")), *(_pixels(part, 0) for part in (geometry.normal, *widths))
    sampled = Geometry(*(_pick(part, at) for part in parts))
    return Strata(now - before, torch.maximum(now, before), known.float(), moments, sampled)


def _pixels(image: Tensor, fill: float) -> Tensor:
    """(N, C, 9, ⌈H/3⌉, ⌈W/3⌉): the pixels of every stratum, row by row; `fill` outside the image."""
    height, width = image.shape[-2:]
    padded = F.pad(image, (0, -width % STRATUM, 0, -height % STRATUM), value=fill)
    parts = F.pixel_unshuffle(padded, STRATUM)
    return parts.view(len(image), -1, STRATUM * STRATUM, *parts.shape[2:])


def _pick(pixels: Tensor, at: Tensor) -> Tensor:
    """(N, C, h, w): of the nine pixels (N, C, 9, h, w) of each stratum the one at (N, 1, 1, h, w)."""
    return pixels.gather(2, at.expand(-1, pixels.shape[1], -1, -1, -1))[:, :, 0]
