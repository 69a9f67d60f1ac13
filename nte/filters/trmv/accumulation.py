"""Steps that all three effects share: fetch history, clamp it, blend, clean up (Zeng et al. 2021, section 5)."""

from typing import NamedTuple

import torch
from torch import Tensor

from nte.filters.bilateral import clean_up
from nte.filters.blocks import Moments, clamp_history, neighbourhood_moments
from nte.filters.moments import brightness
from nte.filters.scope import scope
from nte.filters.trmv.fetch import Fetcher, fetch_from_anything
from nte.filters.trmv.inputs import FrameInputs
from nte.filters.trmv.options import TrmvOptions
from nte.motion.geometric import Reprojection

NEIGHBOURHOOD = 5  # px across, of the clamp's neighbourhood
WIDEST = 5.0  # px, largest deviation of the clean-up filter
_APART = 4  # px between the pixels of the clamp's neighbourhood, where a filter of varying width is wide
_EPSILON = 1e-3  # of Eq. 8, in units of the frame's mean light, so that it means the same in scenes of any unit
_NOTHING = 1e6  # variance of a pixel without information, so that it weighs nothing as history
_PARTLY = 2.0  # variance from which history has been fetched in part from such pixels; that of any other is at most 1


class History(NamedTuple):
    """The history of an effect."""

    values: Tensor  # (N, C, H, W)
    variance: Tensor  # (N, 1, H, W) of the values, relative to a single frame's: how far they have converged


class Effect(NamedTuple):
    """The result of an effect."""

    image: Tensor  # (N, C, H, W)
    history: History
    alpha: Tensor  # (N, 1, H, W) weight of the current frame; 1 where there is no history
    vectors: Reprojection | None = None  # where history came from; None: none was used


class Weight(NamedTuple):
    """The weight of the current frame, (N, 1, H, W): by default, and as raised by doubts about history."""

    default: Tensor
    used: Tensor


class Blended(NamedTuple):
    """The current frame blended with its history, before the clean-up."""

    image: Tensor  # (N, C, H, W)
    variance: Tensor  # (N, 1, H, W) of the image, relative to a single frame's: α² + (1 − α)² v
    alpha: Tensor  # (N, 1, H, W) weight of the current frame
    deviation: Tensor  # (N, 1, H, W) px, of the clean-up filter


def accumulate(
    name: str, current: Tensor, history: History | None, vectors: Reprojection | None, inputs: FrameInputs,
    options: TrmvOptions, reach: float | Tensor, trust: Tensor | None = None, fetcher: Fetcher | None = None,
    known: Tensor | None = None,
) -> Effect:  # fmt: skip
    """Blend the current frame c̃ (N, C, H, W) with history, c = α c̃ + (1 − α) c* (Eq. 2), and clean up (section 5).

    name: of the effect, in profiles. vectors: where history lies; None uses the spatial filter alone. reach: deviation
    of that filter, px, see `limit`. trust: G of Eq. 4, (N, 1, H, W). fetcher: fetches history instead of plain bilinear
    fetching at the vectors' ends. known (N, 1, H, W), bool: where the current frame tells something; None: everywhere.
    """
    if vectors is None or history is None:
        return finish(name, start(current, options, known), vectors, inputs, options)
    with scope(f"trmv/{name}/temporal"):
        fetcher = fetcher or fetch_from_anything(vectors)
        past, (variance, valid) = fetcher(history.values), fetch_convergence(history, fetcher, inputs.frame.reset)
        surface = inputs.gbuffer.depth > 0
        clamped = limit(past, current, surface if known is None else surface & known, reach, options)
        clamped = torch.where(surface, clamped, past)  # the surfaces around a sky say nothing of it
        weight = weigh(variance, valid, options, trust, known)
        # Not lerp alone: invalid history must not leave any trace, not even rounding errors.
        image = torch.where(valid, torch.lerp(clamped, current, weight.used), current)
        deviation = clean_up_deviation(weight, past, clamped, valid, options, level_of(current))
        blended = Blended(image, blended_variance(weight, variance, known), weight.used, deviation)
    return finish(name, blended, vectors, inputs, options)


def start(current: Tensor, options: TrmvOptions, known: Tensor | None = None) -> Blended:
    """Make the blend of a frame without any history."""
    one = torch.ones_like(current[:, :1])
    return Blended(current, one * _own_variance(known), one, _first(options) * one)


def fetch_convergence(history: History, fetcher: Fetcher, reset: Tensor | None) -> tuple[Tensor, Tensor]:
    """Fetch the variance of the history at the ends of the vectors, and where it is valid, each (N, 1, H, W).

    It is valid where the fetcher finds the surface and the sequence does not restart (reset (N,) is not above 0).
    """
    valid = fetcher.valid if reset is None else fetcher.valid & ~(reset.view(-1, 1, 1, 1) > 0)
    return fetcher(history.variance), valid


def weigh(
    variance: Tensor, valid: Tensor, options: TrmvOptions, trust: Tensor | None = None, known: Tensor | None = None
) -> Weight:
    """Compute the weight α of the current frame, and the one used, α^V = 1 − G (1 − α) (Eq. 4) with trust G.

    variance v (N, 1, H, W): of history, relative to a single frame's. trust (N, 1, H, W): in [0, 1]. The weight is 1
    where history is not valid, and 0 where it is but nothing is `known` of the current frame.

    With `warm_up`, α is at least v / (1 + v), which gives the smallest variance of the blend: 1/2, 1/3, … for a history
    that began one, two, … frames ago, and more if it was doubted since. Without it, that holds only for history that
    is partly unknown.
    """
    least = variance / (1 + variance)
    if not options.warm_up:
        least = torch.where(variance > _PARTLY, least, 0.0)
    default = least.clamp(min=options.alpha)
    used = default if trust is None else 1 - trust * (1 - default)
    used = used if known is None else used * known
    return Weight(default, torch.where(valid, used, 1.0))


def limit(
    history: Tensor, current: Tensor, known: Tensor, reach: float | Tensor, options: TrmvOptions,
    rows: slice = slice(None),
) -> Tensor:  # fmt: skip
    """Clamp history (N, C, h, W) to μ ± clamp·σ of 5×5 pixels of the filtered current frame.

    known (N, 1, H, W), bool: the current frame's pixels that count. Sky and bad pixels would count as black, and
    history would be lost in a bad frame, and of small things before the sky. reach: deviation of the filter, px; a
    number, or one for each pixel (N, 1, H, W). rows: the rows of the current frame that the history covers. The 5×5
    pixels lie about `reach` apart, which is not in the paper: a filter makes neighbours alike, so the σ of adjacent
    pixels does not show how noisy all of them are together. Clamped to that, history would follow the noise of every
    frame, and a scene at rest would never converge. Option `neighbourhood=adjacent` takes 3×3 adjacent pixels.
    """
    if options.clamp == float("inf"):
        return history
    if options.neighbourhood == "adjacent":
        moments = neighbourhood_moments(current, known=known)
    elif not isinstance(reach, Tensor):
        moments = neighbourhood_moments(current, NEIGHBOURHOOD, spacing(reach), known)
    else:
        near, far = (neighbourhood_moments(current, NEIGHBOURHOOD, step, known) for step in (1, _APART))
        moments = Moments(*(torch.where(reach > _APART / 2, f, n) for f, n in zip(far, near, strict=True)))
    return clamp_history(history, Moments(*(m[:, :, rows] for m in moments)), options.clamp)


def spacing(reach: float) -> int:
    """Return the distance, in whole px, at which a filter with the deviation `reach` leaves pixels independent."""
    return max(1, round(reach))


def level_of(light: Tensor) -> Tensor:
    """Compute the mean luminance (N, 1, 1, 1) of light (N, 3, H, W); a share (N, 1, H, W), such as visibility, gives 1.

    It is never 0.
    """
    if light.shape[1] == 1:
        return torch.ones_like(light[:, :, :1, :1])
    return brightness(light).mean((2, 3), keepdim=True).clamp(min=1e-30)


def clean_up_deviation(
    weight: Weight, history: Tensor, clamped: Tensor, valid: Tensor, options: TrmvOptions, level: Tensor
) -> Tensor:
    """Compute min(w_A + w_C, 5), (N, 1, H, W), px, of Eqs. 7 and 8 from the luminance of history and clamped history.

    level (N, 1, 1, 1): of the frame's light, from `level_of`. Without history α^V is 1, so w_A is (1 − α)²: 0.81 px for
    the default α.
    """
    doubt = (weight.used - weight.default).square()
    before, after = (brightness(image) for image in (history, clamped))
    lost = (after - before).abs() / (before + _EPSILON * level)
    return torch.where(valid, (doubt + lost).clamp(max=WIDEST), _first(options))


def _first(options: TrmvOptions) -> float:
    """The clean-up's deviation, px, where there is no history: Eq. 7 with α^V = 1."""
    return (1 - options.alpha) ** 2


def blended_variance(weight: Weight, variance: Tensor, known: Tensor | None = None) -> Tensor:
    """Compute α² + (1 − α)² v, (N, 1, H, W), for a history of variance v and a frame of variance 1."""
    own = weight.used.square() * _own_variance(known)
    return own + (1 - weight.used).square() * variance


def _own_variance(known: Tensor | None) -> Tensor | float:
    """The variance of a single frame."""
    return 1.0 if known is None else torch.where(known, 1.0, _NOTHING)


def finish(
    name: str, blended: Blended, vectors: Reprojection | None, inputs: FrameInputs, options: TrmvOptions
) -> Effect:
    """Clean up, and choose what is remembered; without vectors the image is that of the spatial filter."""
    with scope(f"trmv/{name}/clean-up"):
        wanted = options.cleanup and vectors is not None
        image, spent = blended.image, options.history == "cleaned"
        cleaned = clean_up(image, inputs.edges, blended.deviation, in_place=spent) if wanted else image
    kept = cleaned if spent else image
    return Effect(cleaned, History(kept, blended.variance), blended.alpha, vectors)
