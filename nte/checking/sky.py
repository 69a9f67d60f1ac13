"""A check that vectors of the sky are those of the camera's turn: nothing else moves what is infinitely far.

Renderers often leave them 0, as nothing was hit there; then history is fetched from beside the clouds.
"""

from collections.abc import Iterator, Sequence
from statistics import median
from typing import NamedTuple

from nte.checking.values import Finding
from nte.frames.frame import Frame
from nte.motion.camera import motion_of, points_from_depth

ENOUGH = 100  # least number of pixels of sky
APART_PX, APART = 1.0, 0.5  # least distance from the true vectors that is told: pixels, share of their length


class SkyMotion(NamedTuple):
    """Medians over a frame's sky, in pixels: lengths of the vectors given and of the true ones, and their distance."""

    given: float
    true: float
    apart: float


def sky_motion(previous: Frame, current: Frame) -> SkyMotion | None:
    """Compare the sky's `motion` with the turn of the camera; None without cameras, depth or enough sky.

    previous, current: consecutive PyTorch frames of batch 1 with motion. Sky is where depth is 0.
    """
    cameras = current.view, current.projection, previous.view, previous.projection
    if "depth" not in current or any(matrix is None for matrix in cameras):
        return None
    view, projection, view_then, projection_then = (matrix.double() for matrix in cameras if matrix is not None)
    nowhere = (0 * current["depth"]).double()
    true = motion_of(points_from_depth(nowhere, view, projection), view_then, projection_then, nowhere > 0)
    sky = (current["depth"] == 0) & current["motion"].isfinite().all(1, keepdim=True) & true.isfinite().all(1, True)
    if int(sky.sum()) < ENOUGH:
        return None
    given, true = (vectors[0, :, sky[0, 0]] for vectors in (current["motion"].double(), true))
    return SkyMotion(*(float(vectors.norm(dim=0).median()) for vectors in (given, true, given - true)))


def judge_sky(frames: Sequence[SkyMotion]) -> Iterator[Finding]:
    """Yield a note if the vectors of the sky are not those of the camera's turn."""
    if not frames:
        return
    given, true, apart = (median(frame[i] for frame in frames) for i in range(3))
    if apart > max(APART_PX, APART * true):
        found = f"about {given:.2g} px long in the sky, which the turning camera moves by {true:.3g} px"
        yield Finding("motion", found, "vectors of points at infinity (in a channel map, unknown: sky)", False)
