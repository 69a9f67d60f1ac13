"""The noise-free channels of what each pixel sees, with its motion to the previous and the next frame.

There are two kinds. The channels of `geometry` (depth, position, instance, motion) belong to the one point at the
pixel's centre, because averages across an edge mean nothing. The channels of `surface` (albedo, normal, roughness,
emission) are means over the pixel and over the lens, like the colour that they guide.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from nte.render.engine.stage import Moment, Timeless
from nte.render.passes.hits import Hits, points_at
from nte.render.passes.projection import pixel_positions
from nte.render.passes.rays import Mirrors, Surfaces, trace_centres, trace_surfaces
from nte.render.world.scene import Pixels
from nte.render.world.transforms import Floats

SAMPLES = 16  # per pixel, for the channels that are means
LENS_SAMPLES = 64  # likewise through a lens, where an object out of focus appears as that many copies


def guides(moment: Moment, places: Floats | None = None, mirrors: Mirrors = "colour") -> dict[str, Pixels]:
    """Render the channels of what each pixel sees (C, H, W): those of `surface` and `geometry`."""
    return {**surface(moment, places, mirrors), **geometry(moment)}


def geometry(moment: Moment, hits: Hits | None = None) -> dict[str, Pixels]:
    """Render depth, position, instance, motion and forward_motion (C, H, W).

    motion leads to where the same surface point was seen one frame earlier, forward_motion to where it will be seen
    one frame later: pixels, x to the right, y down, object and camera motion together, without jitter. A miss is a
    point at infinity, which only the camera's rotation moves. hits: the hits of the rays through the pixel centres at
    this moment; traced if None.
    """
    hits, time = trace_centres(moment) if hits is None else hits, moment.time
    hit = hits.instance > 0
    times = (time - 1, time, time + 1)
    points = np.stack([points_at(moment, hits, then) for then in times])
    before, here, after = project_rows(moment, hit, points, times)
    now, view = points[1], moment.camera.view(time)
    return {
        "depth": to_image(moment, np.where(hit, now @ view[2, :3] + view[2, 3], 0)),
        "position": to_image(moment, np.where(hit[:, None], now, 0)),
        "instance": to_image(moment, hits.instance),
        "motion": to_image(moment, before - here),
        "forward_motion": to_image(moment, after - here),
    }


def surface(moment: Moment, places: Floats | None = None, mirrors: Mirrors = "colour") -> dict[str, Pixels]:
    """Render albedo, normal, roughness and emission (C, H, W): means over 16 samples in each pixel, 64 through a lens.

    albedo: diffuse reflectance, or a metal's specular colour, in [0, 1]. normal: shading normal, world, facing
    the camera, unit length. Samples that miss have albedo 0 and do not count for normal and roughness. A pixel in
    which all samples miss has normal 0 and roughness 1. places: others than those of `pattern`, see
    rays.trace_surfaces; few of them alias as the guides of many renderers do. mirrors: albedo of metal and glass.
    """
    places = pattern(moment) if places is None else places
    return surface_of(moment, trace_surfaces(moment, places, mirrors), places.shape[-2])


def surface_of(timeless: Timeless, seen: Surfaces, samples: int) -> dict[str, Pixels]:
    """Turn the sums over the samples of a pixel into the channels of `surface`.

    Sums of the diffuse lobe give two more channels. diffuse_albedo: ∫ f_d cos θ dω of the diffuse lobe f_d, in [0, 1].
    geometric_normal: the normal of the surface without normal maps and interpolation, world, facing the camera, unit
    length.
    """
    channels = {
        "albedo": to_image(timeless, np.clip(seen.albedo / samples, 0, 1)),
        "normal": to_image(timeless, _unit(seen.normal)),
        "roughness": to_image(timeless, np.where(seen.hit > 0, seen.roughness / np.maximum(seen.hit, 1), 1)),
        "emission": to_image(timeless, seen.emission / samples),
    }
    if seen.diffuse_albedo is not None and seen.geometric_normal is not None:
        channels["diffuse_albedo"] = to_image(timeless, np.clip(seen.diffuse_albedo / samples, 0, 1))
        channels["geometric_normal"] = to_image(timeless, _unit(seen.geometric_normal))
    return channels


def _unit(rows: Floats) -> Floats:
    """Rows (P, 3), scaled to length 1; 0 stays 0."""
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(np.divide(rows, length, where=length > 0, out=np.zeros_like(rows)))


def project_rows(timeless: Timeless, hit: npt.NDArray[np.bool_], points: Floats, times: Sequence[float]) -> Floats:
    """Project `points` (T, P, 3) to pixel positions (T, P, 2), as the camera sees them at `times` in frames.

    Where `hit` (P,) is false, a point is a direction: a point at infinity. Points behind the camera are put far outside
    the image, so motion vectors are always finite.
    """
    behind = -2.0 * max(timeless.height, timeless.width)
    positions = (pixel_positions(timeless, then, time, hit) for then, time in zip(points, times, strict=True))
    return np.stack([np.nan_to_num(position, nan=behind) for position in positions])


def pattern(timeless: Timeless) -> Floats:
    """Return sample positions (S, 4) in a pixel and on the lens: a Hammersley set, the same in every pixel and frame.

    All x differ and all y differ, so an edge of any slope is averaged finely, and the guides do not flicker.
    """
    count = LENS_SAMPLES if timeless.camera.aperture else SAMPLES
    index = np.arange(count)
    return np.stack([(index + 0.5) / count, *(_mirrored(index, base, count) for base in (2, 3, 5))], axis=1)


def _mirrored(index: npt.NDArray[np.int64], base: int, count: int) -> Floats:
    """The radical inverse (N,) of whole numbers below `count`, in [0, 1), at the middles of its steps."""
    total, scale, rest = np.zeros(len(index)), 1.0, index.copy()
    while scale * count > 1:
        scale /= base
        total += rest % base * scale
        rest //= base
    return np.asarray(total + scale / 2)


def to_image(timeless: Timeless, rows: npt.NDArray[np.generic]) -> Pixels:
    """Turn one row per pixel, (P,) or (P, C), into an image (C, H, W) float32."""
    return np.ascontiguousarray(rows.reshape(timeless.height, timeless.width, -1).transpose(2, 0, 1), np.float32)
