"""The samples of a blurred frame as rows, and lists of the pixels to be filtered.

Every step runs on a list of pixels, so that the work is proportional to the moving area. It gathers neighbours from
rows (N·H·W, C), channels last, so that one fetch is one contiguous read.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.errors import NteError
from nte.frames.frame import Frame

MOVING_PX = 0.5  # a sample that moves further than this over the open shutter is moving (step 1)
WINDOW = 7  # radius of the 15×15 pixels in which a moving sample makes a pixel worth filtering
_FEWEST = 64  # least number of pixels that can prove which way vectors point
_BATCH = 1 << 19  # taps evaluated at once, limited by the cache and a few megabytes

# Columns of the rows of samples.
COLOR, MOTION, TIME, DEPTH, MOVING = slice(0, 3), slice(3, 5), 5, 6, 7


class Size(NamedTuple):
    """Size of a batch of images: N, H and W."""

    batch: int
    height: int
    width: int


@dataclass(frozen=True)
class PixelList:
    """A list of K pixels anywhere in the batch: row number, and column x and line y in the pixel's image."""

    index: Tensor  # (K,) int64: n·H·W + y·W + x
    x: Tensor
    y: Tensor
    size: Size

    @staticmethod
    def at(index: Tensor, size: Size) -> "PixelList":
        """Make the list of the pixels with these row numbers."""
        place = index % (size.height * size.width)
        return PixelList(index, place % size.width, place // size.width, size)

    def centres(self) -> Tensor:
        """Return x and y of the pixels' centres, (K, 1, 2), px."""
        return torch.stack([self.x, self.y], 1)[:, None].float() + 0.5

    def chunks(self, taps: int) -> list[Tensor]:
        """Split the positions in this list into chunks, for which `taps` taps per pixel can be evaluated at once."""
        return list(torch.split(torch.arange(len(self.index), device=self.index.device), max(1, _BATCH // taps)))

    def some(self, which: Tensor) -> "PixelList":
        """Return the pixels at these positions of the list, or where a mask is true."""
        return PixelList(self.index[which], self.x[which], self.y[which], self.size)


def in_chunks(pixels: PixelList, taps: int, work: Callable[[PixelList, Tensor], Tensor]) -> Tensor:
    """Run `work` on the list, chunk by chunk, and join the rows that it returns to (K, C).

    work: gets some of the pixels and their positions in the list. taps: number of taps per pixel, which sets the chunk
    size.
    """
    return torch.cat([work(pixels.some(chunk), chunk) for chunk in pixels.chunks(taps)])


def read_samples(frame: Frame) -> tuple[Tensor, Size]:
    """Read a frame's samples as rows (N·H·W, 8): colour, vector, time, depth, moving (0 or 1).

    A vector that is not finite becomes 0, and one that is longer than the image's diagonal is cut to that length. A
    time that is not finite becomes mid-shutter. The depth of the sky is infinite. Raises NteError for times outside
    [0, 1].
    """
    size = Size(frame.batch, *frame.size)
    time, motion, depth = frame["time"], frame["shutter_motion"], frame["shutter_depth"]
    _require_time(time, frame.index)
    motion = torch.where(motion.isfinite().all(1, keepdim=True), motion, 0)
    length = motion.square().sum(1, keepdim=True).sqrt()
    longest = (size.height**2 + size.width**2) ** 0.5
    motion = motion * (longest / length.clamp(min=longest))
    seen = depth.isfinite() & (depth > 0)
    columns = [
        frame["color"],
        motion,
        torch.where(time.isfinite(), time, 0.5),
        torch.where(seen, depth, float("inf")),
        (length > MOVING_PX).float(),
    ]
    return torch.cat(columns, 1).movedim(1, -1).reshape(-1, 8), size


def open_share(frame: Frame, given: float) -> Tensor:
    """Return the open share (N,) of the frame, which `shutter_motion` spans.

    It is `given` if that is above 0, else the frame's own, else 1. Raises NteError for a share outside (0, 1].
    """
    if given or frame.shutter is None:
        return torch.full((frame.batch,), given or 1.0, device=frame["time"].device)
    wrong = ~((frame.shutter > 0) & (frame.shutter <= 1))
    if wrong.any():
        found = ", ".join(f"{float(share):g}" for share in frame.shutter[wrong])
        raise NteError(
            f"frame {frame.index}: shutter is {found}, expected the open share of the frame, in (0, 1]; vectors that "
            "point backward in time have to be negated"
        )
    share: Tensor = frame.shutter
    return share.expand(frame.batch)


def require_direction(frame: Frame) -> None:
    """Raise NteError if `shutter_motion` points backward in time, as far as `motion` can prove it.

    Both are vectors of one surface. `motion` leads to the previous frame, so forward vectors point away from it. An
    object that bounces within this frame is an exception, so the check requires agreement of most moving pixels.
    """
    motion = frame.get("motion")
    if motion is None:
        return
    forward = frame["shutter_motion"]
    clear = (forward.norm(dim=1) > 1) & (motion.norm(dim=1) > 1)  # NaN is not
    agree = (torch.nn.functional.cosine_similarity(forward, motion, 1) > 0.7)[clear]
    if len(agree) >= _FEWEST and agree.float().mean() > 0.9:
        raise NteError(
            f"frame {frame.index}: shutter_motion points to the previous frame, as motion does, in {int(agree.sum())} "
            "pixels: expected px forward in time; negate it"
        )


def _require_time(time: Tensor, index: int) -> None:
    wrong = (time < 0) | (time > 1)
    if wrong.any():
        low, high = float(time[wrong].min()), float(time[wrong].max())
        raise NteError(
            f"frame {index}: time is {low:g} to {high:g} in {int(wrong.sum())} pixels, expected the share of the open "
            "shutter that has passed, in [0, 1]"
        )


def near_moving(moving: Tensor) -> Tensor:
    """Mark the pixels (N, 1, H, W), bool, with a moving sample within 15×15 pixels; moving (N, 1, H, W) is 0 or 1."""
    side = 2 * WINDOW + 1
    across = F.max_pool2d(moving, (1, side), 1, (0, WINDOW))
    return F.max_pool2d(across, (side, 1), 1, (WINDOW, 0)) > 0


def square(radius: int, device: torch.device) -> Tensor:
    """Return the offsets x, y, (1, T, 2) int64, of the (2·radius + 1)² pixels around a pixel."""
    steps = torch.arange(-radius, radius + 1, device=device)
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    return torch.stack([x.flatten(), y.flatten()], 1)[None]


def gather(rows: Tensor, pixels: PixelList, offsets: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Gather the rows (K, T, C) at whole-pixel offsets (1 or K, T, 2) from the pixels.

    Also returns the centres (K, T, 2) of the gathered pixels, px, and which of them lie in the image (K, T); outside,
    the values are those of the nearest border pixel.
    """
    x, y = pixels.x[:, None] + offsets[..., 0], pixels.y[:, None] + offsets[..., 1]
    _, height, width = pixels.size
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    start = (pixels.index - pixels.y * width - pixels.x)[:, None]
    index = start + y.clamp(0, height - 1) * width + x.clamp(0, width - 1)
    values = rows.index_select(0, index.flatten()).view(*index.shape, -1)
    return values, torch.stack([x, y], -1).float() + 0.5, inside
