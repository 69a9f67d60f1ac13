"""Motion blur: frames in which every sample has a shutter time of its own.

The open shutter of frame i is centred on time i: sample time t in [0, 1] is scene time i + shutter (t − ½). The
noise-free channels, cameras and motion vectors of the clip belong to time i, so they describe the sharp frame at
mid-shutter. They stay the same when blur is switched on or the shutter is opened further.

Mitsuba has no animated transforms. Therefore the shutter is cut into SUBFRAMES strata with a random time in each, and
the scene is set to these times one after another. A sub-frame traces only the pixels that have its time.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.camera_rays import past_containers, sample_camera_ray
from nte.render.engine.stage import Moment, Stage, Timeless
from nte.render.engine.types import Sampler
from nte.render.passes.gbuffer import project_rows, to_image
from nte.render.passes.hits import Hits, points_at, to_hits
from nte.render.passes.radiance import radiance
from nte.render.passes.rays import trace_centres
from nte.render.world.scene import Pixels
from nte.render.world.seeds import derive_generator, derive_seed
from nte.render.world.transforms import Floats

# A power of four: one for each pixel of an 8×8 block. For motion up to 64 px, nothing moves by more than a pixel within
# a stratum, and the pixel's own box filter hides that.
SUBFRAMES = 64
_LEVELS = 3  # of blocks of 2×2, 4×4 and 8×8 pixels


def blurred(
    stage: Stage, time: float, shutter: float, reference_spp: int, keys: Sequence[int], halves: Sequence[int]
) -> tuple[list[dict[str, Pixels]], list[Pixels]]:
    """Render the noisy channels of each seed, and the halves (3, H, W) of the reference, at a time in frames.

    color (3, H, W): one path per pixel, at the pixel's own time. time (1, H, W): that time, in [0, 1] over the open
    shutter, exact in half floats. shutter_motion (2, H, W): pixels, forward in time, from where the surface that this
    very sample hit is seen when the shutter opens to where it is seen when the shutter closes. shutter_depth (1, H, W):
    depth of the hit along the view axis, as the camera stands at the sample's time; 0 = miss.

    shutter: the open share of the frame, in [0, 1]. keys: one seed for each set of noisy channels. halves: one seed for
    each half. The halves share the sub-frames with the noisy channels: each has reference_spp / (2 · SUBFRAMES) samples
    in every sub-frame. Vectorised variants only.
    """
    size = stage.height, stage.width
    times = _times(derive_generator("shutter times", *keys))
    order = [_strata(*size, derive_generator("shutter order", key)).ravel() for key in keys]
    rows = np.zeros((len(keys), size[0] * size[1], 8 + stage.places.width))
    sums = np.zeros((len(halves), 3, *size))
    for number, now in enumerate(times):
        here = time + shutter * (now - 0.5)
        with stage.at(here) as moment:
            for row, mine, key in zip(rows, order, keys, strict=True):
                pixels = np.flatnonzero(mine == number)
                if len(pixels):
                    row[pixels] = _trace(moment, pixels, derive_seed(key, number))
            for total, key in zip(sums, halves, strict=True):
                total += radiance(moment, reference_spp // (2 * SUBFRAMES), derive_seed(key, number))
    noisy = [
        {
            "color": to_image(stage, row[:, :3]),
            "time": to_image(stage, times[mine]),
            "shutter_motion": _over_shutter(stage, _hits(row), time, shutter),
            "shutter_depth": to_image(stage, row[:, 3]),
        }
        for row, mine in zip(rows, order, strict=True)
    ]
    return noisy, [np.asarray(total / SUBFRAMES, np.float32) for total in sums]


def centre_motion(moment: Moment, shutter: float) -> Pixels:
    """Render shutter_motion (2, H, W), pixels, of the sharp frame: that of the surface at the pixel's centre.

    shutter: the open share of the frame, in [0, 1].
    """
    return _over_shutter(moment, trace_centres(moment), moment.time, shutter)


def _times(rng: np.random.Generator) -> Floats:
    """A random time in each stratum of [0, 1], in order.

    Rounded to half floats, so that the stored times are the traced ones.
    """
    return ((np.arange(SUBFRAMES) + rng.random(SUBFRAMES)) / SUBFRAMES).astype(np.float16).astype(np.float64)


def _strata(height: int, width: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """The stratum (H, W) of each pixel's time: each stratum once in every 8×8 pixels.

    The strata are nested: the four pixels of a 2×2 block lie in different quarters of the shutter, the sixteen pixels
    of a 4×4 block in different sixteenths, in random order. So few neighbours cover the shutter evenly, without a
    pattern that a filter could exploit.
    """
    y, x = np.indices((height, width))
    stratum = np.zeros((height, width), np.int64)
    for level in range(_LEVELS):
        side = 2 << level
        blocks = -(-height // side), -(-width // side)
        # For every block and every stratum so far, a random order of the block's four quadrants.
        quarters = rng.permuted(np.tile(np.arange(4), (*blocks, 4**level, 1)), axis=-1)
        quadrant = (y >> level) % 2 * 2 + (x >> level) % 2
        stratum = 4 * stratum + quarters[y // side, x // side, stratum, quadrant]
    return stratum


def _trace(moment: Moment, pixels: npt.NDArray[np.int64], seed: int) -> Floats:
    """Trace one path through a random point of each of `pixels` (P,).

    Rows (P, 8 + W): radiance (3), depth along the view axis, and the first hit as `_hits` reads it.
    """
    mi, dr, scenery = load_mitsuba(), load_drjit(), moment.scenery
    sampler: Sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), len(pixels))
    ray = sample_camera_ray(scenery, mi.UInt32(pixels.astype(np.uint32)), sampler)
    seen = past_containers(scenery, mi.Ray3f(ray))  # a copy, which it moves
    first = scenery.mi_scene.ray_intersect_preliminary(seen, coherent=True)
    colour, *_ = scenery.integrator.sample(scenery.mi_scene, sampler, mi.RayDifferential3f(ray))
    point = dr.select(first.is_valid(), seen(first.t), 0)
    met = scenery.met(first, seen)
    dr.eval(colour, point, met, ray.d)
    hits, view = to_hits(moment, met, ray.d), moment.camera.view(moment.time)
    depth = np.where(hits.instance > 0, np.array(point, float).T @ view[2, :3] + view[2, 3], 0)
    columns = [np.array(colour, float).T, depth, hits.instance, hits.place, hits.direction]
    return np.column_stack(columns)


def _hits(rows: Floats) -> Hits:
    """The first hits of `_trace`'s rows."""
    return Hits(rows[:, 4].astype(np.int64), rows[:, 5:-3], rows[:, -3:])


def _over_shutter(timeless: Timeless, hits: Hits, time: float, shutter: float) -> Pixels:
    """Vectors (2, H, W) of `hits`, one per pixel, from their place in the image at opening to that at closing."""
    ends = time - shutter / 2, time + shutter / 2
    points = np.stack([points_at(timeless, hits, end) for end in ends])
    opening, closing = project_rows(timeless, hits.instance > 0, points, ends)
    return to_image(timeless, closing - opening)
