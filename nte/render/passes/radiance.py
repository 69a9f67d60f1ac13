"""The radiance of one frame, from the stage's integrator."""

from collections.abc import Iterator

import numpy as np

from nte.render.engine.backend import load_mitsuba
from nte.render.engine.stage import Moment
from nte.render.world.scene import Pixels
from nte.render.world.seeds import derive_seed

_SAMPLES = 1 << 26  # paths per launch: 64 M paths take less than 1 GB (measured: 15 M take 0.1 GB)


def radiance(moment: Moment, spp: int, seed: int) -> Pixels:
    """Render radiance (3, H, W), linear: the mean of `spp` jittered samples per pixel, box filter.

    The same seed gives the same bytes for any number of threads.
    """
    mi, scenery = load_mitsuba(), moment.scenery
    total = np.zeros((moment.height, moment.width, 3))
    for number, count in enumerate(launches(spp, moment.width * moment.height)):
        try:
            how = {"sensor": scenery.sensor, "integrator": scenery.integrator, "spp": count}
            image = mi.render(scenery.mi_scene, seed=derive_seed(seed, number), **how)
        except RuntimeError as error:  # Dr.Jit wraps Ctrl-C in it
            if isinstance(error.__cause__, KeyboardInterrupt):
                raise error.__cause__ from None
            raise
        total += count * np.array(image, np.float64)
    return np.ascontiguousarray((total / spp).transpose(2, 0, 1), np.float32)


def launches(spp: int, pixels: int, samples: int = _SAMPLES) -> Iterator[int]:
    """Split samples per pixel into as few renderings of at most `samples` paths as possible, each a power of four.

    A rendering's sample count must be a square, because its samples are stratified over the pixel, and a power of two,
    because only then does each pixel's sum stay within one thread: renderings with 100 spp differ in the last bit from
    run to run, those with 64 do not.
    """
    most = max(1, samples // pixels)
    while spp:
        count = 1
        while 4 * count <= min(spp, most):
            count *= 4
        yield count
        spp -= count
