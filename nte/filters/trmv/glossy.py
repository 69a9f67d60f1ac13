"""Glossy reflections: stochastic vectors and a filter that grows with the lobe (Zeng et al. 2021, section 4.2).

The spatial filter follows Liu et al. 2019, «Cinematic Rendering in UE4 with Real-Time Ray Tracing and Denoising»: its
size is the footprint on the surface of the lobe from the virtual image of the reflected point.
"""

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from nte.filters.bilateral import ROUGHNESS, Edges, joint_bilateral
from nte.filters.noise import gaussian_noise
from nte.filters.scope import scope
from nte.filters.trmv.accumulation import Effect, History, accumulate
from nte.filters.trmv.fetch import fetch_within_edges
from nte.filters.trmv.inputs import RADIUS, FrameInputs
from nte.filters.trmv.options import TrmvOptions
from nte.filters.trmv.samples import TINY, believable, of_usable
from nte.frames.usable import mask_of
from nte.motion.geometric import Reprojection, traditional_motion
from nte.motion.warp import fetch_nearest, pixel_centres

WIDEST = 7.5  # px, largest deviation of the filter
WIDEST_DRAW = 15.0  # px, largest deviation of a lobe from which vectors are drawn; its filter is the widest
SCALE = 0.5  # ratio of the filter's deviation to the lobe's; least error on training clips without history
_FILL_RADIUS, _FILL_DEVIATION = 7, 3.5


class Lobes(NamedTuple):
    """Reflection vectors as distributions, for all pixels near which a path was reflected."""

    mean: Tensor  # (N, 2, H, W) px, to the previous frame
    specular: Tensor  # (N, 2, H, W) px, the mean over the neighbourhood, without the samples' own spread
    covariance: Tensor  # (N, 3, H, W) XX XY YY, px²
    glossy: Tensor  # (N, 1, H, W) bool: the pixel has a lobe, its own or its neighbours'


def denoise_glossy(
    inputs: FrameInputs, history: History | None, vectors: str, options: TrmvOptions, trust: Tensor | None = None
) -> Effect:
    """Denoise the light of all lobes but the diffuse one (N, 3, H, W).

    vectors: reliable, specular, traditional or none. `specular` uses one vector, that of the mirror direction's hit, as
    for pure reflections (the paper's comparison). Clips hold no such ray, so the mean over the lobe's footprint takes
    its place, which is the same on a mirror. trust (N, 1, H, W): of the history, in [0, 1].
    """
    frame = inputs.frame
    with scope("trmv/glossy/filter"):
        covariance = limit_spread(frame["reflection_covariance"])
        spread = spread_of(covariance, inputs.edges)
        usable = frame.get(mask_of("glossy"))
        current, known = of_usable(partial(filter_glossy, spread=spread, edges=inputs.edges), frame["glossy"], usable)
    with scope("trmv/glossy/vectors"):
        reprojection, fetcher = inputs.traditional, None
        if vectors in ("reliable", "specular"):
            lobes = gather_lobes(frame["reflection_motion"], covariance, inputs.edges)
            motion = draw(lobes, frame.index, frame["glossy"]) if vectors == "reliable" else lobes.specular
            reprojection = glossy_reprojection(motion, lobes.glossy, inputs)
            fetcher = fetch_within_edges(reprojection, inputs, rough=True) if vectors == "reliable" else None
    used = None if vectors == "none" else reprojection
    reach = deviation_of(spread)
    return accumulate("glossy", current, history, used, inputs, options, reach, trust, fetcher, known)


def gather_lobes(mean: Tensor, covariance: Tensor, edges: Edges) -> Lobes:
    """Gather the lobe of each pixel: its own, or, where its path went elsewhere, the mean of those around it.

    Filling in is not in the paper. mean (N, 2, H, W), px, and covariance (N, 3, H, W), px², are NaN where no path was
    reflected, which on glossy paint is about every other pixel. A mean that contradicts those around it is not used.
    """
    believed, mean = believable(mean)
    own = (believed > 0) & _finite(covariance)
    values = torch.where(own, torch.cat([mean, covariance], 1), 0.0)
    around, glossy = _mean_around(values, own, edges)
    filled = torch.where(own, values, around)
    return Lobes(filled[:, :2], around[:, :2], filled[:, 2:], glossy)


def spread_of(covariance: Tensor, edges: Edges) -> Tensor:
    """Compute the lobe's deviation (N, 1, H, W), px, averaged over both axes and the neighbourhood; 0: no lobe."""
    own = _finite(covariance)
    variance = torch.where(own, (covariance[:, :1] + covariance[:, 2:]) / 2, 0.0)
    return _mean_around(variance, own, edges)[0].clamp(min=0).sqrt()


def _finite(values: Tensor) -> Tensor:
    return (values.abs() < float("inf")).all(1, keepdim=True)


def _mean_around(values: Tensor, own: Tensor, edges: Edges) -> tuple[Tensor, Tensor]:
    """The mean, over the surface nearby, of values (N, C, H, W) where `own` is true, and whether there are any."""
    reached = joint_bilateral(torch.cat([own.float(), values], 1), edges, _FILL_RADIUS, _FILL_DEVIATION)
    known = reached[:, :1] > TINY
    return torch.where(known, reached[:, 1:] / reached[:, :1].clamp(min=TINY), 0.0), known


def limit_spread(covariance: Tensor) -> Tensor:
    """Shrink covariances (N, 3, H, W), XX XY YY, px², whose deviation exceeds WIDEST_DRAW px in any direction.

    Near the focus of a curved reflector covariances are unbounded, and vectors drawn from them would leave the image.
    """
    xx, xy, yy = covariance.chunk(3, 1)
    largest = (xx + yy) / 2 + torch.hypot((xx - yy) / 2, xy)
    return covariance * (WIDEST_DRAW**2 / largest.clamp(min=WIDEST_DRAW**2))


def filter_glossy(glossy: Tensor, spread: Tensor, edges: Edges) -> Tensor:
    """Filter glossy light (N, 3, H, W) by a joint bilateral as wide as the lobe's footprint `spread` (N, 1, H, W), px.

    A mirror is left as it is. The lobe, and so the filter, widens with roughness and with the reflected point's
    distance.
    """
    return joint_bilateral(glossy, edges, RADIUS, deviation_of(spread))


def deviation_of(spread: Tensor) -> Tensor:
    """Compute the filter's deviation, px, for lobes with the deviation `spread`, px."""
    return (SCALE * spread).clamp(max=WIDEST)


def draw(lobes: Lobes, frame: int, light: Tensor) -> Tensor:
    """Draw vectors (N, 2, H, W), px, from the lobes: sample(mean, Σ) of Eq. 5, with noise of pixel, frame and light.

    light (N, 3, H, W): any noisy image; a pixel's bits give it other noise in each sequence, wherever that is in the
    batch, and whatever other pixels show.
    """
    height, width = light.shape[-2:]
    keys = light.contiguous().view(torch.int32).sum(1, dtype=torch.int64)
    noise = torch.cat([gaussian_noise(height, width, frame, light.device, key) for key in keys])
    return lobes.mean + spread_noise(noise, lobes.covariance)


def spread_noise(noise: Tensor, covariance: Tensor) -> Tensor:
    """Turn normal noise (N, 2, H, W) of unit deviation into noise of the covariance (N, 3, H, W), XX XY YY."""
    first, second = noise.chunk(2, 1)
    xx, xy, yy = covariance.chunk(3, 1)
    # Cholesky: Σ = L Lᵀ.
    x = xx.clamp(min=0).sqrt()
    across = xy / x.clamp(min=1e-6)
    y = (yy - across.square()).clamp(min=0).sqrt()
    return torch.cat([x * first, across * first + y * second], 1)


def glossy_reprojection(motion: Tensor, glossy: Tensor, inputs: FrameInputs) -> Reprojection:
    """Find where each pixel's reflection was: by `motion` (N, 2, H, W), px, or by the traditional vector.

    The traditional vector is used where nothing is reflected. It is also used where the position x^R does not show the
    reflector, as judged by its roughness; this test is not in the paper. Only points near s^C, on the reflector,
    reflect the same light; otherwise light of other surfaces, black on diffuse ones, would be used as history.
    """
    vectors, used = traditional_motion(motion), glossy
    if inputs.before is not None:
        there = pixel_centres(motion) + vectors.motion
        same = (fetch_nearest(inputs.before.roughness, there) - inputs.gbuffer.roughness).abs() < ROUGHNESS
        reflector = same & (fetch_nearest(inputs.before.depth, there) > 0)
        used = glossy & (reflector | ~vectors.valid)
    return Reprojection(
        torch.where(used, vectors.motion, inputs.traditional.motion),
        torch.where(used, vectors.valid, inputs.traditional.valid),
        inputs.traditional.disoccluded,
    )
