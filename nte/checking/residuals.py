"""What is left of albedo, normals and reference when the frame before is fetched along vectors: means by region."""

from dataclasses import dataclass

from torch import Tensor

from nte.frames.frame import Frame
from nte.motion.geometric import Reprojection, traditional_motion
from nte.motion.warp import fetch_nearest, pixel_centres, warp

MOVING_PX = 1.0
CHANGING_ALBEDO = 0.02
COMPARED = ("albedo", "normal", "reference")


@dataclass
class Mean:
    """A mean over pixels that are added frame by frame."""

    total: float = 0.0
    count: int = 0

    def add(self, error: Tensor, where: Tensor) -> None:
        """Add error (1, 1, H, W) at the pixels of the mask `where`."""
        self.total += float(error[where].double().sum())
        self.count += int(where.sum())

    @property
    def value(self) -> float:
        """The mean; NaN without pixels."""
        return self.total / self.count if self.count else float("nan")


def visible_in_both(previous: Frame, current: Frame, vectors: Reprojection) -> Tensor:
    """Mark the pixels whose surface is visible in both frames, as a bool mask (1, 1, H, W).

    The vector is valid, the surface is not disoccluded, and all four pixels that are fetched show the same instance,
    if both frames have `instance`. vectors: the dual vectors of `current`.
    """
    visible = vectors.valid & ~vectors.disoccluded
    if "instance" in current and "instance" in previous:
        position = pixel_centres(current["motion"]) + vectors.motion
        for corner in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
            tap = position + position.new_tensor(corner).view(1, 2, 1, 1)
            visible = visible & (fetch_nearest(previous["instance"], tap) == current["instance"])
    return visible


def _difference(a: Tensor, b: Tensor) -> Tensor:
    return (a - b).abs().mean(1, keepdim=True)


def add_errors(errors: dict[tuple[str, str, str], Mean], previous: Frame, current: Frame, dual: Reprojection) -> None:
    """Add the differences to the frame before to errors (channel, vectors, region) → mean, a defaultdict."""
    traditional = traditional_motion(current["motion"])
    visible = visible_in_both(previous, current, dual)
    regions = {"visible": visible, "disoccluded": dual.disoccluded & dual.valid}
    for name in (name for name in COMPARED if name in current and name in previous):
        fetched = {
            "none": previous[name],
            "traditional": warp(previous[name], traditional.motion).image,
            "dual": warp(previous[name], dual.motion).image,
        }
        finite = (current[name].isfinite() & fetched["none"].isfinite()).all(1, keepdim=True)
        if name == "albedo":
            moving = traditional.motion.square().sum(1, keepdim=True) > MOVING_PX**2
            changes = _difference(current[name], previous[name]) > CHANGING_ALBEDO
            regions = {**regions, "changing": visible & moving & changes}
        for vectors, image in fetched.items():
            difference = _difference(current[name], image)
            for region, where in regions.items():
                errors[name, vectors, region].add(difference, where & finite & difference.isfinite())
