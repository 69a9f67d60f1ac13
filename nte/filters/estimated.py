"""Any denoiser on frames without motion vectors, which are estimated from the images by patch search.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors».
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor

from nte.color import display, luminance, per_sequence, undisplay
from nte.denoiser import Denoiser, Filter, Result, State, require_size, sanitised
from nte.filters.blocks import restarts
from nte.frames.ahead import NEXT
from nte.frames.channels import GUIDES
from nte.frames.frame import Array, Frame
from nte.frames.scalars import sequence_exposure
from nte.frames.usable import mask_of
from nte.motion.correspondence import Known, find_motion, patch_error
from nte.motion.search import SEARCHES, Search, searches_for
from nte.motion.warp import inside, pixel_centres
from nte.options import Options

# The noise of the images, by which the search is chosen: a key of SEARCHES, or `auto` to measure it.
Noise: TypeAlias = Literal["auto", "clean", "moderate", "noisy", "strong"]
# Given vectors would contradict estimates, and without them nothing leads to the next frame.
_TOLD_BY_OTHERS = ("motion", "forward_motion", "previous_forward_motion", *NEXT)


def matched_grey(color: Tensor, exposure: Tensor) -> Tensor:
    """Compute the image that the search compares: displayed luminance (N, 1, H, W) in [0, 1].

    color (N, 3, H, W): radiance. exposure (N,): NaN, for a sequence without light so far, counts as 1.
    """
    return display(luminance(color), exposure.nan_to_num(1))


def shown_at(exposure: Tensor, grey: Tensor, was: Tensor) -> Tensor:
    """Convert displayed luminance (N, 1, H, W) to another exposure (N,) than it `was` displayed at, (N,).

    Two images can be compared in one exposure only. One whose exposure stays comes out bit for bit. NaN counts as 1.
    """
    ratio = exposure.nan_to_num(1) / was.nan_to_num(1)
    if (ratio == 1).all():
        return grey
    ratio = ratio.to(grey)
    return torch.where(per_sequence(ratio) == 1, grey, display(undisplay(grey), ratio))


def searchable(image: Tensor, frame: Frame, names: Sequence[str], previous: Tensor | None) -> Tensor:
    """Fill the bad pixels of the image (N, C, H, W) that a search compares, made from these channels of the frame.

    They keep their values in the previous such image, or, where a sequence starts (None: all do), take the mean of the
    usable pixels. Left black, they would repel all patches that touch them, and the vectors around would be wrong.
    """
    masks = [frame[mask_of(name)] for name in names if mask_of(name) in frame]
    if not masks or (known := torch.stack(masks).amin(0) > 0).all():
        return image
    mean = (image * known).sum((2, 3), keepdim=True) / known.sum((2, 3), keepdim=True).clamp(min=1)
    kept = mean if previous is None else torch.where(restarts(frame), mean, previous)
    return torch.where(known, image, kept)


class Seen(NamedTuple):
    """The image of a frame that a search compares."""

    image: Tensor  # (N, C, H, W) displayed luminance, or albedo and normal
    exposure: Tensor  # (N,), on the CPU: that of the display; NaN for a sequence without light so far


def look(
    frame: Frame, names: Sequence[str], seen: Seen | None, light: Tensor | None = None
) -> tuple[Seen, Tensor | None]:
    """Make the image of a frame that a search compares, and show the image `seen` before in the same exposure.

    frame: of tensors, with usable values only. names: GUIDES, or the channel of a light. light (N, 3, H, W): that
    channel, if it is to be seen otherwise than the frame gives it, such as demodulated. seen: None starts a sequence,
    and the second result is then None too. Raises NteError for a size that changes within a sequence.
    """
    if seen is not None:
        require_size(frame, seen.image)
    exposure = torch.from_numpy(sequence_exposure(frame, None if seen is None else seen.exposure))
    before = None if seen is None else seen.image
    if tuple(names) == GUIDES:
        image = torch.cat([frame[name] for name in GUIDES], 1)
    else:
        light = frame[names[0]] if light is None else light
        image = matched_grey(light, exposure.to(light))
        before = seen and shown_at(exposure, seen.image, seen.exposure)
    return Seen(searchable(image, frame, names, before), exposure), before


@dataclass(frozen=True)
class Chooser:
    """A function that chooses the search for images: the named one, or with `auto` the one for their measured noise.

    changes: fields of Search that replace those of the chosen one. Raises NteError for values that they cannot have.
    """

    noise: Noise = "auto"
    changes: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        replace(SEARCHES["clean"], **self.changes)

    def __call__(self, images: Tensor) -> list[Search]:
        """Choose the search for each of the images (N, C, H, W) of displayed values."""
        found = searches_for(images) if self.noise == "auto" else [SEARCHES[self.noise]] * len(images)
        return [replace(search, **self.changes) for search in found]


class Estimate(NamedTuple):
    """Motion estimated from the images, with its error."""

    motion: Tensor  # (N, 2, H, W) px, current → previous, finite; 0 where a sequence starts
    error: Tensor | None  # (N, 1, H, W) patch error of this motion, if asked for; 0 where a sequence starts
    valid: Tensor  # (N, 1, H, W) bool: the motion ends inside the previous frame; false where a sequence starts


@dataclass(frozen=True)
class EstimateOptions(Options, name="estimate"):
    """Options of the motion estimate.

    noise: of the images: `auto` (measured), `clean`, `moderate` (about 4 to 50 samples per pixel), `noisy` (1 sample)
    or `strong`. guides: search in `albedo` and `normal`, for frames where these have less noise than the image. known:
    keep the frames' own `motion` where it is finite, and let it guide the search around it.
    """

    noise: Noise = "auto"
    guides: bool = False
    known: bool = False


class Estimator:
    """A motion estimator that works frame by frame, from the images alone.

    errors: also return the patch error. device: where the search runs.
    """

    def __init__(self, options: EstimateOptions | None = None, *, device: str = "cpu", errors: bool = False) -> None:
        self.options = EstimateOptions() if options is None else options
        self.choose, self.device, self.errors = Chooser(self.options.noise), device, errors
        looks = GUIDES if self.options.guides else ()
        self.needs: tuple[str, ...] = ("color", *looks, *(("motion",) if self.options.known else ()))

    def step(self, frame: Frame, state: Seen | None) -> tuple[Estimate, Seen]:
        """Estimate the motion from the previous frame; the new state is the image that was searched.

        state: None starts a sequence. The frame must have usable values only, as within a denoiser's step
        (nte.frames.usable). Raises NteError for a size that changes within a sequence.
        """
        tensors = frame.torch(self.device)
        seen, before = look(tensors, GUIDES if self.options.guides else ("color",), state)
        image = seen.image
        if before is None:
            nothing = torch.zeros_like(image[:, :1])
            error = nothing if self.errors else None
            return Estimate(nothing.repeat(1, 2, 1, 1), error, nothing > 0), seen
        search = self.choose(image)
        motion = find_motion(image, before, search, self._known(tensors))
        error = patch_error(image, before, motion, search) if self.errors else None
        valid = inside(pixel_centres(motion) + motion)
        goes_on = ~restarts(tensors)
        motion, valid = motion * goes_on, valid & goes_on
        error = None if error is None else error * goes_on
        return Estimate(motion, error, valid), seen

    def _known(self, frame: Frame) -> Known | None:
        if not self.options.known:
            return None
        motion = frame["motion"]
        return Known(motion, torch.ones_like(motion[:, :1], dtype=torch.bool))  # what is not finite is searched


class EstimatedMotion(Filter[EstimateOptions]):
    """A denoiser that gets its `motion` from the images: `color` of this frame is searched in that of the previous one.

    denoiser: any; it receives the estimated vectors instead of given ones, and no others. device: where the search
    runs. Motion is 0 in the first frame of a sequence. Target, extras and components are those of the wrapped denoiser.
    """

    options_type = EstimateOptions

    def __init__(self, denoiser: Denoiser, options: EstimateOptions | None = None, *, device: str = "cpu") -> None:
        super().__init__(options, device=device)
        self.denoiser, self.estimator = denoiser, Estimator(self.options, device=device)
        self.device = None  # frames reach the wrapped denoiser without conversion
        self.target, self.extras, self.components = denoiser.target, denoiser.extras, denoiser.components
        wanted = (name for name in denoiser.needs if name not in _TOLD_BY_OTHERS)
        self.needs = tuple(dict.fromkeys([*self.estimator.needs, *wanted]))
        self.optional = tuple(name for name in denoiser.optional if name not in _TOLD_BY_OTHERS)
        self.wants = tuple(name for name in denoiser.wants if name not in _TOLD_BY_OTHERS)

    def settings(self, frame: Frame) -> str:
        """Return the settings of the wrapped denoiser for a frame like this one."""
        return self.denoiser.settings(frame)

    @sanitised
    def step(self, frame: Frame, state: State, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Estimate the motion, then run the wrapped denoiser; the state is its state and the searched image."""
        seen, inner = (None, None) if state is None else state
        found, seen = self.estimator.step(frame, seen)
        kept = {name: values for name, values in frame.channels.items() if name not in _TOLD_BY_OTHERS}
        color: Array = frame["color"]
        given = found.motion.cpu().numpy() if isinstance(color, np.ndarray) else found.motion.to(color.device)
        result, inner = self.denoiser.step(replace(frame, channels={**kept, "motion": given}), inner, extras)
        return result, (seen, inner)
