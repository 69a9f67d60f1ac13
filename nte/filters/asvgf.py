"""A-SVGF: SVGF that forgets where the lighting changed, measured by temporal gradients.

Schied, Peters, Dachsbacher 2018, «Gradient Estimation for Real-Time Adaptive Temporal Filtering». The gradients are
true ones: the same surface point shaded with the same random numbers in both frames (channel `gradient`).
Approximating them by comparing reprojected colours would measure noise as well, and is another method.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.profiler import record_function

from nte.errors import NteError
from nte.filters.atrous import atrous_step
from nte.filters.moments import brightness, variance_of, with_square
from nte.filters.reproject import Surface, surface_of
from nte.filters.svgf import Svgf, edge_stopping, geometry_guides, with_luminance
from nte.frames.frame import Frame

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
    surface: Surface  # where the sample lies, or the stratum's centre


class Asvgf(Svgf):
    """A-SVGF of `color` or one light component: α ← lerp(max(α, 1/h), 1, λ), λ from the channel `gradient`.

    `gradient` (N, 2, H, W): luminance of the demodulated colour shaded now with the previous frame's random numbers,
    and the previous one; one pixel in each 3×3 stratum, elsewhere NaN. λ is 0 where no sample is near.
    gradient_iterations: of its à-trous filter. Other options as those of SVGF; the extra `alpha` shows λ.
    """

    def __init__(
        self,
        target: str = "color",
        alpha: float = 0.1,
        moments_alpha: float = 0.2,
        history: float = 32,
        iterations: int = 5,
        gradient_iterations: int = 5,
        feedback: int = 1,
        sigma_l: float = 10.0,
        sigma_z: float = 1.0,
        sigma_n: float = 128.0,
        young: float = 4.0,
        albedo_floor: float = 1e-3,
        depth_floor: float = 0.01,
        device: str = "cpu",
    ) -> None:
        super().__init__(
            target, alpha, moments_alpha, history, iterations, feedback, sigma_l, sigma_z, sigma_n, young,
            albedo_floor, depth_floor, device,
        )  # fmt: skip
        if gradient_iterations < 0:
            raise NteError(f"asvgf: gradient_iterations is {gradient_iterations}, expected 0 or more")
        self.gradient_iterations = gradient_iterations
        self.needs = (*self.needs, "gradient")

    def _weights(self, frame: Frame, light: Tensor, surface: Surface, length: Tensor) -> tuple[Tensor, Tensor]:
        """SVGF's weights, pulled towards 1 where the light changed: section 4.4."""
        with record_function("asvgf: gradient"):
            strata = stratify(frame["gradient"], brightness(light), surface)
            change = self._changed(strata)[..., : light.shape[2], : light.shape[3]]
        alpha, moments_alpha = super()._weights(frame, light, surface, length)
        return alpha.lerp(torch.ones_like(alpha), change), moments_alpha.lerp(torch.ones_like(alpha), change)

    def _changed(self, strata: Strata) -> Tensor:
        """λ at full resolution, with this filter's parameters."""
        return change_of(strata, self.sigma_l, self.sigma_n, self.gradient_iterations)


def change_of(strata: Strata, sigma_l: float = 10.0, sigma_n: float = 128.0, iterations: int = 5) -> Tensor:
    """λ = min(1, max |Δ| / max(l, l′)) over the 3×3 strata around, filtered (section 4.3): at full resolution.

    (N, 1, 3·⌈H/3⌉, 3·⌈W/3⌉). iterations: of the à-trous filter; sigma_l, sigma_n: of its edge-stopping weights.
    """
    sums = torch.cat([strata.change, strata.brightest, strata.known], 1)
    brightness, variance = strata.moments[:, :1], variance_of(strata.moments)
    guides, edge = geometry_guides(strata.surface, GRADIENT_SIGMA_Z), edge_stopping(sigma_n)
    for level in range(iterations):
        seen = with_luminance(guides, brightness, variance, sigma_l)
        # Δ keeps its sign: that of noise cancels, that of a light does not.
        filtered = atrous_step(torch.cat([sums, brightness], 1), 2**level, edge, seen, variance, BOX)
        assert filtered.variance is not None
        sums, brightness, variance = filtered.values[:, :3], filtered.values[:, 3:], filtered.variance
    # Numerator and denominator carry the same weights of the strata that have a sample.
    ratio = (sums[:, :1].abs() / sums[:, 1:2].clamp(min=1e-10)).clamp_(max=1)
    return F.interpolate(F.max_pool2d(ratio, 3, stride=1, padding=1), scale_factor=float(STRATUM))


def stratify(gradient: Tensor, brightness: Tensor, surface: Surface) -> Strata:
    """Strata of a frame: section 4.2. Strata at the right and lower border may be cut."""
    pairs = _pixels(torch.where(gradient.isfinite(), gradient, float("nan")), float("nan"))  # (N, 2, 9, h, w)
    usable = pairs.isfinite().all(1, keepdim=True)
    known = usable.any(2)
    # The first usable pixel; where there is none, the centre.
    at = torch.where(known, usable.float().argmax(2), CENTRE)[:, :, None]
    now, before = _pick(pairs, at).where(known, 0.0).clamp(min=0).split_with_sizes([1, 1], 1)
    inside = _pixels(torch.ones_like(brightness), 0)
    moments = _pixels(with_square(brightness), 0).sum(2) / inside.sum(2)
    depth = surface.depth.where(surface.depth < float("inf"), 0.0)
    sampled = surface_of(_pick(_pixels(depth, 0), at), _pick(_pixels(surface.normal, 0), at))
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
