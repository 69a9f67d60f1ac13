"""«Spatiotemporal Variance-Guided Filtering for Motion Blur» (Oberberger et al. 2022) as a denoiser.

From one sample per pixel, at a random time of the open shutter, it reconstructs the blurred frame. Each stage is one
module, in the paper's order; nte.filters.motion_blur.options says which choices are the paper's.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from nte.denoiser import Filter, Result, require_size, sanitised
from nte.filters.motion_blur.composition import Cover, balanced, compose, plain_share, weighted_share
from nte.filters.motion_blur.first_stage import (
    COLUMNS,
    MOVING_MOTION,
    MOVING_WEIGHT,
    STATIC_COLOR,
    STATIC_WEIGHT,
    first_stage,
    normalise,
)
from nte.filters.motion_blur.history import add_history
from nte.filters.motion_blur.options import MotionBlurOptions
from nte.filters.motion_blur.prefilter import prefilter
from nte.filters.motion_blur.samples import (
    COLOR,
    MOVING,
    PixelList,
    Size,
    in_chunks,
    near_moving,
    open_share,
    read_samples,
    require_direction,
)
from nte.filters.motion_blur.second_stage import second_stage
from nte.filters.motion_blur.variance import MotionStatistics, estimate_variance
from nte.filters.scope import scope
from nte.frames.frame import Frame


@dataclass(frozen=True)
class MotionBlurState:
    """The first stage's buffers of the previous frame: rows of the filtered pixels, and colours of all pixels."""

    color: Tensor  # (N, 3, H, W)
    index: Tensor  # (K,) int64: row numbers of the filtered pixels
    values: Tensor  # (K, 10): their rows in the moving and the static buffer
    shutter: Tensor  # (N,): the open share of the previous frame, which their vectors span

    def rows(self, reset: Tensor | None, shutter: Tensor) -> Tensor:
        """Return the buffers of all pixels, (N·H·W, 10), with 0 in sequences that restart.

        shutter (N,): the open share that the vectors of the returned rows span.
        """
        batch = len(self.color)
        rows = self.color.new_zeros(batch * self.color[0, 0].numel(), COLUMNS)
        rows[:, STATIC_COLOR] = self.color.movedim(1, -1).reshape(-1, 3)
        rows[:, STATIC_WEIGHT] = 1
        rows[self.index] = self.values
        rows.view(batch, -1, COLUMNS)[..., MOVING_MOTION] *= (shutter / self.shutter)[:, None, None]
        if reset is not None:
            rows.view(batch, -1, COLUMNS)[reset > 0] = 0
        return rows


class MotionBlur(Filter[MotionBlurOptions]):
    """The filter for motion blur; the state is the first stage's output.

    Extras, each (N, 1, H, W): `factor`, moving over static in [0, 1]; `reprojected`, 1 where moving history was found;
    `length`, the mean motion near the pixel, px over the open shutter.
    """

    needs: tuple[str, ...] = ("color", "time", "shutter_motion", "shutter_depth")
    optional: tuple[str, ...] = ("motion",)
    extras = ("factor", "reprojected", "length")
    options_type = MotionBlurOptions

    @sanitised
    def step(
        self, frame: Frame, state: MotionBlurState | None, extras: tuple[str, ...] = ()
    ) -> tuple[Result, MotionBlurState]:
        """Reconstruct one blurred frame; a pixel with no moving sample within 15×15 pixels stays unchanged."""
        if state is not None:
            require_size(frame, state.color)
        shutter = open_share(frame, self.options.shutter)
        if state is None:
            require_direction(frame)
        with scope("motion_blur/samples"):
            rows, size = read_samples(frame)
            image = rows[:, COLOR]
            active = near_moving(rows[:, MOVING].view(size.batch, 1, size.height, size.width))
            pixels = PixelList.at(active.flatten().nonzero()[:, 0], size)
        maps = {name: rows.new_zeros(len(rows), 1) for name in extras}
        means = rows.new_zeros(0, COLUMNS)
        if len(pixels.index):
            estimate, cover, means, accepted = self._buffers(rows, pixels, state, frame, shutter)
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
        return Result(after_image, given), MotionBlurState(color, pixels.index, means, shutter)

    def _buffers(
        self, rows: Tensor, pixels: PixelList, state: MotionBlurState | None, frame: Frame, shutter: Tensor
    ) -> tuple[MotionStatistics, Cover, Tensor, Tensor]:
        """Steps 1 to 5: the estimate, the cover, the means (K, 10), and where moving history was accepted (K,)."""
        how = self.options
        with scope("motion_blur/variance"):
            estimate = estimate_variance(rows, pixels, how.depth, how.angle == "naive")
            reach = estimate.reach(how.beta_a, how.beta_l)
        with scope("motion_blur/prefilter"):
            filtered = rows
            if how.prefilter:
                moving = pixels.some(rows[pixels.index, MOVING] > 0)
                filtered = prefilter(rows, moving, frame.index, how.near, how.jitter)
        with scope("motion_blur/first stage"):
            sums = in_chunks(
                pixels, 25, lambda some, chunk: first_stage(filtered, some, reach[chunk], self.options.depth)
            )
            cover = self._cover(filtered, pixels, sums, estimate, reach)
        accepted = torch.zeros(len(sums), dtype=torch.bool, device=sums.device)
        with scope("motion_blur/temporal"):
            if how.history and state is not None:
                still, history = rows[pixels.index, MOVING] == 0, state.rows(frame.reset, shutter)
                of_each = shutter[pixels.index // (pixels.size.height * pixels.size.width)]
                added, accepted = add_history(sums, history, pixels, reach, of_each, how)
                # A static pixel keeps its colour.
                static = slice(STATIC_COLOR.start, STATIC_WEIGHT + 1)
                added[:, static] = torch.where(still[:, None], sums[:, static], added[:, static])
                sums = added
        return estimate, cover, normalise(sums), accepted

    def _cover(self, rows: Tensor, pixels: PixelList, sums: Tensor, estimate: MotionStatistics, reach: Tensor) -> Cover:
        if self.options.factor == "share":
            return Cover.parts(in_chunks(pixels, 15**2, lambda some, _: plain_share(rows, some, self.options.depth)))

        def work(some: PixelList, chunk: Tensor) -> Tensor:
            return weighted_share(rows, some, sums[chunk], estimate.some(chunk), reach[chunk], self.options.depth)

        cover = Cover.parts(in_chunks(pixels, 45, work))
        return cover._replace(factor=balanced(cover.factor, rows, pixels))

    def _finish(self, means: Tensor, pixels: PixelList, estimate: MotionStatistics, cover: Cover) -> Tensor:
        """Steps 6 and 7: the colours (K, 3)."""
        with scope("motion_blur/second stage"):
            _, height, width = pixels.size
            buffer = means.new_zeros(pixels.size.batch * height * width, MOVING_WEIGHT + 1)
            buffer[pixels.index] = means[:, : MOVING_WEIGHT + 1]
            moving = estimate.length > 0
            where, reach = pixels.some(moving), estimate.reach(self.options.beta_a, self.options.beta_l)[moving]
            if len(where.index):
                stretch = None if self.options.steps == "fixed" else self.options.stretch
                buffer = second_stage(buffer, where, estimate.some(moving), reach, stretch)
        with scope("motion_blur/composition"):
            return compose(torch.cat([buffer[pixels.index], means[:, MOVING_WEIGHT + 1 :]], 1), cover)


def _as_image(rows: Tensor, size: Size) -> Tensor:
    """The image (N, C, H, W) of rows (N·H·W, C)."""
    return rows.view(size.batch, size.height, size.width, -1).movedim(-1, 1).contiguous()
