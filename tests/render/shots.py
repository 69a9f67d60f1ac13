"""Single passes of a stage at a time, for tests that need no other pass at that moment."""

import numpy as np

from nte.render.components.frame import references
from nte.render.engine.stage import Stage
from nte.render.passes.gbuffer import geometry, guides, surface
from nte.render.passes.radiance import radiance


def guides_at(stage: Stage, time: float) -> dict[str, np.ndarray]:
    with stage.at(time) as moment:
        return guides(moment)


def geometry_at(stage: Stage, time: float) -> dict[str, np.ndarray]:
    with stage.at(time) as moment:
        return geometry(moment)


def surface_at(stage: Stage, time: float) -> dict[str, np.ndarray]:
    with stage.at(time) as moment:
        return surface(moment)


def radiance_at(stage: Stage, time: float, spp: int, seed: int) -> np.ndarray:
    with stage.at(time) as moment:
        return radiance(moment, spp, seed)


def references_at(stage: Stage, time: float, spp: int, seeds: tuple[int, int]) -> dict[str, np.ndarray]:
    with stage.at(time) as moment:
        return references(moment, spp, seeds)
