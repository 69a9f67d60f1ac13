"""SVGF: temporal accumulation, then an à-trous filter that is wider where the accumulated light has more variance.

Schied et al. 2017, «Spatiotemporal Variance-Guided Filtering: Real-Time Reconstruction for Path-Traced Global
Illumination». Constants are those of NVIDIA's Falcor, except the number of iterations and the one that is fed back,
which are the paper's. The functions follow the paper's sections.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.color import demodulate, remodulate
from nte.denoiser import Filter, Result, require_size, sanitised
from nte.errors import NteError
from nte.filters.atrous import Edge, atrous_step
from nte.filters.blocks import restarts, texture_of
from nte.filters.composition import Target
from nte.filters.moments import (
    brightness,
    estimated_variance,
    lengthen,
    running_mean_weight,
    told_by_others,
    with_square,
)
from nte.filters.reproject import DEPTH_FLOOR, Fetched, Geometry, geometry_of, previous_depth, reproject
from nte.filters.scope import scope
from nte.frames.channels import TEXTURES
from nte.frames.frame import Frame
from nte.frames.usable import mask_of
from nte.motion.geometric import traditional_motion
from nte.options import Allowed, Alpha, Levels, NotNegative, Options, Positive

SLOPE_FLOOR = 1e-4  # least slope, as a share of the depth: the rounding of depth on a wall that faces the camera
# The root of ε in Eq. 5, as a share of the mean luminance. Falcor's ε of 1e-10 is that of an image of mean 1; in scenes
# of small units it would exceed every variance, and edges of light would not stop the filter.
LUMINANCE_FLOOR = 1e-5


class SvgfState(NamedTuple):
    """The state for the next frame: the history, and the surfaces that it belongs to."""

    history: Tensor  # (N, C + 3, H, W): filtered light, the two moments of its luminance, history length
    geometry: Geometry
    view: Tensor | None


class Weights(NamedTuple):
    """The weights by which history and the current frame are mixed, each (N, 1, H, W)."""

    length: Tensor  # of the history, in frames, this one included
    light: Tensor  # α: weight of the current frame's light
    moments: Tensor  # weight of the current frame's moments


@dataclass(frozen=True)
class SvgfOptions(Options, name="svgf"):
    """Options of SVGF.

    target: the channel to denoise; `components` denoises each light component separately (nte.filters.composition).
    alpha, moments_alpha: least weights of the current frame, for light and for moments. history: greatest length of the
    history in frames. iterations: of the à-trous filter. feedback: the iteration, counted from 1, whose result becomes
    the history; 1 in the paper, 2 in Falcor, 0 for the accumulated light. sigma_l, sigma_z, sigma_n: of the
    edge-stopping weights of luminance, depth and normal. young: history length in frames below which the variance is
    estimated in space. albedo_floor: least divisor of demodulation. depth_floor: tolerance of depths in reprojection,
    as a share of the depth.
    """

    target: Target = "color"
    alpha: Alpha = 0.05
    moments_alpha: Alpha = 0.2
    history: Annotated[float, Allowed("a number of frames, 1 or more", lambda n: 1 <= n < math.inf)] = 32
    iterations: Levels = 5
    feedback: Levels = 1
    sigma_l: Positive = 10.0
    sigma_z: Positive = 1.0
    sigma_n: Positive = 128.0
    young: NotNegative = 4.0
    albedo_floor: Positive = 1e-3
    depth_floor: Positive = DEPTH_FLOOR

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.feedback <= self.iterations:
            raise NteError(
                f"{self.name}: feedback is {self.feedback}, expected 0 to iterations, which is {self.iterations}"
            )


class Svgf(Filter[SvgfOptions]):
    """SVGF of `color` or of one light component (`target`), which filters the light without its texture.

    Extras: `history_length`, `alpha` and `variance` (of the filtered luminance), each (N, 1, H, W).
    """

    options_type = SvgfOptions
    extras = ("history_length", "alpha", "variance")

    def __init__(self, options: SvgfOptions | None = None, *, device: str = "cpu") -> None:
        super().__init__(options, device=device)
        self.target = self.options.target
        self.textured = self.target in TEXTURES
        self.needs = (self.target, *(["albedo"] if self.textured else []), "normal", "depth", "motion")
        self.optional = {"color": ("emission",), "indirect": ("diffuse_albedo",)}.get(self.target, ())

    @sanitised
    @torch.no_grad()
    def step(self, frame: Frame, state: SvgfState | None, extras: tuple[str, ...] = ()) -> tuple[Result, SvgfState]:
        """Denoise `target` (N, C, H, W) of one frame."""
        how = self.options
        with scope("svgf: reprojection"):
            geometry = geometry_of(frame["depth"], frame["normal"])
            past = self._fetch(frame, geometry, state)
        light = self._demodulated(frame)
        with scope("svgf: accumulation"):
            length = lengthen(past.values[:, -1:], past.valid, how.history)
            length, alpha, moments_alpha = self._weights(frame, light, geometry, length)
            usable = frame[mask_of(self.target)]
            alpha, moments_alpha = alpha * usable, moments_alpha * usable
            moments = torch.lerp(past.values[:, -3:-1], with_square(brightness(light)), moments_alpha)
            light = torch.lerp(past.values[:, :-3], light, alpha)
        with scope("svgf: variance"):
            guides, edge = geometry_guides(geometry, how.sigma_z), edge_stopping(how.sigma_n)
            light, moments = told_by_others(light, moments, length > 1 - usable, edge, guides)
            variance = estimated_variance(moments, length, how.young, edge, guides)
        with scope("svgf: à-trous"):
            history = light
            for level in range(how.iterations):
                light, variance = wavelet_level(light, variance, level, edge, guides, how.sigma_l)
                if level + 1 == how.feedback:
                    history = light
        found = {"history_length": length, "alpha": alpha, "variance": variance}
        result = Result(self._remodulated(light, frame), {name: found[name] for name in extras})
        view = None if frame.view is None else frame.view.clone()  # a caller may fill its buffer again
        return result, SvgfState(torch.cat([history, moments, length - (1 - usable)], 1), geometry, view)

    def _fetch(self, frame: Frame, geometry: Geometry, state: SvgfState | None) -> Fetched:
        """The history along the motion vectors (section 4.1), none in a first frame."""
        if state is None:
            channels = frame[self.target].shape[1] + 3
            depth = geometry.depth
            return Fetched(depth.new_zeros(len(depth), channels, *depth.shape[2:]), torch.zeros_like(depth).bool())
        require_size(frame, state.history)
        motion = traditional_motion(frame["motion"])
        allowed = motion.valid & ~restarts(frame)
        expected = None
        if frame.view is not None and frame.projection is not None and state.view is not None:
            expected = previous_depth(geometry.depth, frame.view, frame.projection, state.view)
        return reproject(
            state.history, motion.motion, allowed, geometry, state.geometry, expected, self.options.depth_floor
        )

    def _weights(self, frame: Frame, light: Tensor, geometry: Geometry, length: Tensor) -> Weights:
        """The weights of the current frame beside a history of this length (N, 1, H, W)."""
        floors = self.options.alpha, self.options.moments_alpha
        return Weights(length, *(running_mean_weight(length, floor) for floor in floors))

    def _demodulated(self, frame: Frame) -> Tensor:
        """The light (c − emission) / max(albedo, floor) (section 3); light that carries no texture is not divided.

        Where an emitter's edge crosses a pixel, one sample may be darker than the mean emission. The difference is then
        negative, and clamping it would brighten the mean.
        """
        light = frame[self.target]
        if "emission" in self.optional and "emission" in frame:
            light = light - frame["emission"]
        return demodulate(light, texture_of(frame, self.target), self.options.albedo_floor) if self.textured else light

    def _remodulated(self, light: Tensor, frame: Frame) -> Tensor:
        image = light
        if self.textured:
            image = remodulate(light, texture_of(frame, self.target), self.options.albedo_floor)
        if "emission" in self.optional and "emission" in frame:
            image = image + frame["emission"]
        return image.clamp(min=0)


def wavelet_level(
    light: Tensor, variance: Tensor, level: int, edge: Edge, guides: Sequence[Tensor], sigma_l: float
) -> tuple[Tensor, Tensor]:
    """Filter light (N, C, H, W), and the variance (N, 1, H, W) of its luminance, by one level (section 4.3).

    level: 0 for the first; taps are 2^level px apart. edge and guides: as `edge_stopping` and `geometry_guides` make
    them. sigma_l: of the luminance's weight.
    """
    filtered = atrous_step(
        light, 2**level, edge, with_luminance(guides, brightness(light), variance, sigma_l), variance
    )
    assert filtered.variance is not None
    return filtered.values, filtered.variance


def luminance_scale(luminance: Tensor, variance: Tensor, sigma_l: float) -> Tensor:
    """Compute −1 / (σ_l √(ε + g₃ₓ₃(Var))) of Eq. 5, (N, 1, H, W), from luminance and its variance, (N, 1, H, W).

    g₃ₓ₃ is the kernel [1, 2, 1]/4 in both directions; the border repeats. ε follows the mean luminance of each image,
    so that the weights do not depend on the unit of light.
    """
    padded = F.pad(variance, (1, 1, 1, 1), mode="replicate")
    least = luminance.abs().mean((2, 3), keepdim=True).mul_(LUMINANCE_FLOOR).square_().clamp_(min=1e-36)
    return F.avg_pool2d(F.avg_pool2d(padded, 2, 1), 2, 1).add_(least).rsqrt_().mul_(-1 / sigma_l)


def geometry_guides(geometry: Geometry, sigma_z: float) -> tuple[Tensor, Tensor, Tensor]:
    """Make the guides of the weights of Eq. 3 and 4: normal, depth, and −1 / (σ_z fwidth(z))."""
    depth = geometry.depth.clamp(max=1e30)
    slope = geometry.depth_width.maximum(SLOPE_FLOOR * depth)
    return geometry.normal, depth, -1 / (sigma_z * slope)


def edge_stopping(sigma_n: float) -> Edge:
    """Make the edge-stopping function of Eq. 3 to 5, for `atrous_step`.

    w = max(0, n·n′)^σ_n · exp(−|Δz| / (σ_z fwidth(z) |q − p|) − |Δl| / (σ_l √(ε + g₃ₓ₃(Var))))

    Its guides are the normal; depth, and luminance if that counts; and the factors for the differences of these.
    """

    def edge(p: Sequence[Tensor], q: Sequence[Tensor], distance: float) -> tuple[Tensor, Tensor]:
        n, m = p[0].unbind(1), q[0].unbind(1)
        cosine = (n[0] * m[0]).addcmul_(n[1], m[1]).addcmul_(n[2], m[2])
        # A logarithm costs a third of seven squarings; the logarithm of the floor gives a weight of 0.
        same = cosine.clamp_(min=1e-38).log_().mul_(sigma_n)
        apart, toward_p, toward_q = (p[1] - q[1]).abs_().unbind(1), p[2].unbind(1), q[2].unbind(1)
        forth = torch.addcmul(same, apart[0], toward_p[0], value=1 / distance)
        back = same.addcmul_(apart[0], toward_q[0], value=1 / distance)
        if len(apart) > 1:
            forth.addcmul_(apart[1], toward_p[1])
            back.addcmul_(apart[1], toward_q[1])
        return forth.exp_().unsqueeze(1), back.exp_().unsqueeze(1)

    return edge


def with_luminance(guides: Sequence[Tensor], luminance: Tensor, variance: Tensor, sigma_l: float) -> list[Tensor]:
    """Add luminance (N, 1, H, W), with its variance, to the guides of `edge_stopping`."""
    normal, depth, scale = guides
    factors = torch.cat([scale, luminance_scale(luminance, variance, sigma_l)], 1)
    return [normal, torch.cat([depth, luminance], 1), factors]
