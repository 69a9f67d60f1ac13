"""The trial of an exported graph: random frames with everything that a denoiser must cope with."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nte.denoiser import Denoiser
from nte.errors import NteError
from nte.frames.channels import CHANNELS, Channel, Kind, width_of
from nte.frames.frame import Frame
from nte.frames.scalars import sequence_scalars
from nte.recurrence import FORWARD

Numbers = npt.NDArray[np.number]
CHECK_FRAMES = 20


def difference(exported: Denoiser, expected: Denoiser, size: tuple[int, int]) -> tuple[float, float]:
    """Compare an exported model with what it should be over a recurrent sequence of random frames, (height, width).

    Returns the 99.9th percentile and the maximum of |a − b| / (|b| + 0.01), where b is the expected image. Raises
    NteError where that is not finite.
    """
    state, ours = None, None
    errors = []
    for frame in trial_frames((*exported.needs, *exported.optional), size, CHECK_FRAMES):
        target, ours = expected.step(frame, ours)
        if not np.isfinite(target.image).all():
            raise NteError(
                f"not exported: in frame {frame.index} of a test with bad light and unknown vectors, the network's "
                "own image is NaN or infinite: its forward must make its inputs usable (nte.frames.usable), and "
                "its weights must be finite"
            )
        found, state = exported.step(frame, state)
        errors.append(np.abs(found.image - target.image) / (np.abs(target.image) + 0.01))
    every = np.concatenate([e.ravel() for e in errors])
    return float(np.quantile(every, 0.999)), float(every.max())


def trial_frames(
    names: Iterable[str], size: tuple[int, int], frames: int, batch: int = 2, seed: int = 0
) -> Iterator[Frame]:
    """Make random frames (NumPy) with these channels, and with those from which exposure and vectors are computed.

    They have all that a graph must cope with: motion across borders, disocclusions, surfaces that hide each other, sky,
    bad pixels. In the third frame, and in every fourth from there, the exposure becomes four times as large; in the
    next one the first sequence does not know its previous_forward_motion; then the exposure falls back.
    size: (height, width). batch: number of sequences.
    """
    rng = np.random.default_rng(seed)
    rows = [CHANNELS[name] for name in dict.fromkeys(("color", "depth", "motion", *names))]
    first: list[Kind] = ["radiance", "motion"]  # depth and ids stay the same: the scene moves only by its vectors
    rows.sort(key=lambda row: (row.kind not in first, row.storage == "derived"))
    still = {row.name: _values(row, rng, batch, size) for row in rows if row.kind in ("depth", "id")}
    exposure: Numbers | None = None
    for index in range(frames):
        made = dict(still)
        for row in rows:
            if row.name == FORWARD:
                made[row.name] = _against(made["motion"], rng)
                made[row.name][: index % 4 == 3] = np.nan
            elif row.name not in still:
                made[row.name] = _values(row, rng, batch, size)
        frame = Frame({name: values.astype(np.float32) for name, values in made.items()}, index)
        exposure = sequence_scalars(frame)[0] if exposure is None else exposure
        yield replace(frame, exposure=exposure * np.float32(4 if index % 4 > 1 else 1))


def _values(row: Channel, rng: np.random.Generator, batch: int, size: tuple[int, int]) -> Numbers:
    """Random values (N, C, H, W) of a channel, without structure; light and vectors have some bad values."""
    shape = batch, width_of(row.name), *size
    match row.kind:
        case "radiance":
            light = rng.exponential(1.0, shape).astype(np.float32) * rng.random((batch, 1, 1, 1), np.float32) * 10
            light[rng.random(shape) < 1e-3] = rng.choice([np.nan, np.inf, -1.0])
            return light
        case "motion":
            motion = rng.normal(0, 2, (batch, 2, 1, 1)) + rng.normal(0, 0.2, shape)
            motion[rng.random((batch, *size))[:, None].repeat(2, 1) < 1e-3] = rng.choice([np.nan, 1e20])
            return motion
        case "depth":
            # Few distances, so that many surfaces are equally near; each hides the next, of which it is apart by 15 %.
            return np.where(rng.random(shape) < 0.05, 0, 2 * 1.15 ** rng.integers(0, 8, shape))
        case "direction" | "point":
            return rng.uniform(-0.6, 0.6, shape)
        case "id":
            return rng.integers(0, 4, shape)
        case _:
            return rng.random(shape)


def _against(motion: Numbers, rng: np.random.Generator) -> Numbers:
    """A previous_forward_motion that fits a motion: a tenth of the pixels is hidden by others, some are unknown."""
    batch, _, *size = motion.shape
    forward = -motion + np.where(rng.random((batch, 1, *size)) < 0.1, 6.0, 0.0)
    forward[rng.random((batch, *size))[:, None].repeat(2, 1) < 0.02] = np.nan
    return forward
