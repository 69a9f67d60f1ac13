"""«Spatiotemporal Variance-Guided Filtering for Motion Blur» (Oberberger et al. 2022) as a denoiser.

One sample per pixel at a random time of the open shutter becomes the blurred frame. One file a stage, in the paper's
order. docs/motion_blur.md says which options are which of the paper's comparisons, and what is ours.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.profiler import record_function

from nte.denoiser import Denoiser, Result, check_size, sanitised
from nte.errors import NteError
from nte.filters.motion_blur.composition import Cover, balanced, compose, plain_share, weighted_share
from nte.filters.motion_blur.first_stage import (
    COLUMNS,
    MOVING_WEIGHT,
    STATIC_COLOR,
    STATIC_WEIGHT,
    first_stage,
    normalise,
)
from nte.filters.motion_blur.history import Reprojection, add_history
from nte.filters.motion_blur.prefilter import prefilter
from nte.filters.motion_blur.samples import (
    COLOR,
    MOVING,
    Pixels,
    Size,
    check_direction,
    in_chunks,
    near_moving,
    open_share,
    read_samples,
)
from nte.filters.motion_blur.second_stage import second_stage
from nte.filters.motion_blur.variance import Estimate, estimate_variance
from nte.frames.frame import Frame

CHOICES = {"steps": ("scaled", "fixed"), "angle": ("relative", "naive"), "factor": ("weighted", "share"),
           "static": ("place", "reprojected"), "fetch": ("tent", "kernel")}  # fmt: skip
EXTRAS = ("factor", "reprojected", "length")
# The paper's steps and constants, as options; the defaults are what docs/motion_blur.md measures to be better.
PAPER = ("prefilter=true,near=2.5,jitter=1.5,beta_a=1,beta_l=10,stretch=1,weight=1,fetch=kernel,static=reprojected,"
         "factor=share")  # fmt: skip


@dataclass(frozen=True)
class State:
    """The first stage's buffers of the previous frame: rows of the pixels that were filtered, colours of all."""

    color: Tensor  # (N, 3, H, W)
    index: Tensor  # (K,) row numbers
    values: Tensor  # (K, 10)

    def rows(self, reset: Tensor | None) -> Tensor:
        """(N·H·W, 10); nothing in sequences that restart."""
        batch = len(self.color)
        rows = self.color.new_zeros(batch * self.color[0, 0].numel(), COLUMNS)
        rows[:, STATIC_COLOR] = self.color.movedim(1, -1).reshape(-1, 3)
        rows[:, STATIC_WEIGHT] = 1
        rows[self.index] = self.values
        if reset is not None:
            rows.view(batch, -1, COLUMNS)[reset > 0] = 0
        return rows


class MotionBlur(Denoiser):
    """The whole filter; the state is the first stage's output.

    prefilter, history: whether those steps run. steps: of the second stage, `fixed` as in the original à-trous
    transform. stretch: of its scaled steps. iterations: of the reprojection, 1 or more. accept, drop: ‖δ‖ below and
    above which it ends, px. fetch: history between pixels, or through the first stage's 5×5 `kernel`. static: where
    history of what does not move is fetched. weight: of history, where the current frame has 1. angle: `naive` averages
    directions in [0°, 360°). factor: of the composition, the share of moving samples, of all or weighted by the way
    they take. beta_a, beta_l: β of the weight. near, jitter: px, of the pre-filter. depth: share of the depth from
    which something is behind. shutter: its open share of the frame, in (0, 1]; 0: as each
    frame says (`Frame.shutter`, which clips have), 1 where it says nothing. PAPER: the paper's values.
    Raises NteError for what is not a choice or out of range.
    """

    extras: tuple[str, ...] = EXTRAS

    needs: tuple[str, ...] = ("color", "time", "shutter_motion", "shutter_depth")
    optional: tuple[str, ...] = ("motion",)
    target = "color"

    def __init__(
        self, prefilter: bool = False, history: bool = True, steps: str = "scaled", iterations: int = 2,
        angle: str = "relative", factor: str = "weighted", static: str = "place", fetch: str = "tent",
        beta_a: float = 0.0, beta_l: float = 0.0, stretch: float = 0.5, near: float = 0.5, jitter: float = 0.5,
        weight: float = 0.5, accept: float = 0.5, drop: float = 8.0, depth: float = 0.05, shutter: float = 0.0,
        device: str = "cpu",
    ) -> None:  # fmt: skip
        chosen = {"steps": steps, "angle": angle, "factor": factor, "static": static, "fetch": fetch}
        for key, value in chosen.items():
            if value not in CHOICES[key]:
                raise NteError(f"motion_blur: {key} is '{value}', expected one of {', '.join(CHOICES[key])}")
        numbers = {"beta_a": beta_a, "beta_l": beta_l, "depth": depth, "weight": weight, "near": near,
                   "jitter": jitter, "stretch": stretch}  # fmt: skip
        for key, number in numbers.items():
            if not 0 <= number < float("inf"):
                raise NteError(f"motion_blur: {key} is {number}, expected a number of 0 or more")
        if iterations < 1:
            raise NteError(f"motion_blur: iterations is {iterations}, expected 1 or more")
        if not 0 < accept <= drop:
            raise NteError(f"motion_blur: accept is {accept} and drop {drop}, expected 0 < accept <= drop, px")
        if shutter and not 0 < shutter <= 1:
            raise NteError(f"motion_blur: shutter is {shutter}, expected the open share of the frame, in (0, 1]")
        self.chosen, self.prefilter, self.history, self.device = chosen, prefilter, history, device
        self.beta_a, self.beta_l, self.depth = beta_a, beta_l, depth
        self.near, self.jitter, self.stretch = near, jitter, stretch
        self.shutter = shutter
        self.reprojection = Reprojection(
            iterations, accept, drop, tent=fetch == "tent", in_place=static == "place", weight=weight
        )

    @sanitised
    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Reconstruct one blurred frame; a pixel without a moving sample within 15×15 passes through.

        extras: `factor` (N, 1, H, W), moving over static in [0, 1]; `reprojected`, 1 where moving history was found;
        `length`, the mean motion near the pixel, px.
        """
        if state is not None:
            check_size(frame, state.color)
        tensors = frame.torch(self.device)
        shutter = open_share(tensors, self.shutter)
        if state is None:
            check_direction(tensors)
        with record_function("motion_blur/samples"):
            rows, size = read_samples(tensors)
            image = rows[:, COLOR]
            active = near_moving(rows[:, MOVING].view(size.batch, 1, size.height, size.width))
            pixels = Pixels.at(active.flatten().nonzero()[:, 0], size)
        maps = {name: rows.new_zeros(len(rows), 1) for name in extras}
        means = rows.new_zeros(0, COLUMNS)
        if len(pixels.index):
            estimate, cover, means, accepted = self._buffers(rows, pixels, state, tensors, shutter)
            composed = self._finish(means, pixels, estimate, cover)
            found = {"factor": cover.factor, "reprojected": accepted.float(), "length": estimate.length}
            for name, values in maps.items():
                values[pixels.index] = found[name][:, None]
            after = image.clone()
            after[pixels.index] = composed
        else:
            after = image
        after_image, color = _as_image(after, size), _as_image(image, size)
        given = {name: _as_image(values, size) for name, values in maps.items()}
        return Result(after_image, given).like(frame), State(color, pixels.index, means)

    def _buffers(
        self, rows: Tensor, pixels: Pixels, state: State | None, frame: Frame, shutter: Tensor
    ) -> tuple[Estimate, Cover, Tensor, Tensor]:
        """Steps 1 to 5: the estimate, the cover, the means (K, 10), and where moving history was accepted (K,)."""
        with record_function("motion_blur/variance"):
            estimate = estimate_variance(rows, pixels, self.depth, self.chosen["angle"] == "naive")
            reach = estimate.reach(self.beta_a, self.beta_l)
        with record_function("motion_blur/prefilter"):
            filtered = rows
            if self.prefilter:
                moving = pixels.some(rows[pixels.index, MOVING] > 0)
                filtered = prefilter(rows, moving, frame.index, self.near, self.jitter)
        with record_function("motion_blur/first stage"):
            sums = in_chunks(pixels, 25, lambda some, chunk: first_stage(filtered, some, reach[chunk], self.depth))
            cover = self._cover(filtered, pixels, sums, estimate, reach)
        accepted = torch.zeros(len(sums), dtype=torch.bool, device=sums.device)
        with record_function("motion_blur/temporal"):
            if self.history and state is not None:
                still, history = rows[pixels.index, MOVING] == 0, state.rows(frame.reset)
                of_each = shutter[pixels.index // (pixels.size.height * pixels.size.width)]
                added, accepted = add_history(sums, history, pixels, reach, of_each, self.reprojection)
                # A static pixel keeps its colour.
                static = slice(STATIC_COLOR.start, STATIC_WEIGHT + 1)
                added[:, static] = torch.where(still[:, None], sums[:, static], added[:, static])
                sums = added
        return estimate, cover, normalise(sums), accepted

    def _cover(self, rows: Tensor, pixels: Pixels, sums: Tensor, estimate: Estimate, reach: Tensor) -> Cover:
        if self.chosen["factor"] == "share":
            return Cover.parts(in_chunks(pixels, 15**2, lambda some, _: plain_share(rows, some, self.depth)))

        def work(some: Pixels, chunk: Tensor) -> Tensor:
            return weighted_share(rows, some, sums[chunk], estimate.some(chunk), reach[chunk], self.depth)

        cover = Cover.parts(in_chunks(pixels, 45, work))
        return cover._replace(factor=balanced(cover.factor, rows, pixels))

    def _finish(self, means: Tensor, pixels: Pixels, estimate: Estimate, cover: Cover) -> Tensor:
        """Steps 6 and 7: colours (K, 3)."""
        with record_function("motion_blur/second stage"):
            _, height, width = pixels.size
            buffer = means.new_zeros(pixels.size.batch * height * width, MOVING_WEIGHT + 1)
            buffer[pixels.index] = means[:, : MOVING_WEIGHT + 1]
            moving = estimate.length > 0
            where, reach = pixels.some(moving), estimate.reach(self.beta_a, self.beta_l)[moving]
            if len(where.index):
                stretch = None if self.chosen["steps"] == "fixed" else self.stretch
                buffer = second_stage(buffer, where, estimate.some(moving), reach, stretch)
        with record_function("motion_blur/composition"):
            return compose(torch.cat([buffer[pixels.index], means[:, MOVING_WEIGHT + 1 :]], 1), cover)


def _as_image(rows: Tensor, size: Size) -> Tensor:
    """(N, C, H, W) of rows (N·H·W, C)."""
    return rows.view(size.batch, size.height, size.width, -1).movedim(-1, 1).contiguous()
