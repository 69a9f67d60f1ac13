"""Options of TRMV, and the presets that make the comparisons of the paper's section 6."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

from nte.filters.trmv.cones import HALF_ANGLE
from nte.options import Allowed, Options

ShadowVectors: TypeAlias = Literal["reliable", "gradient", "traditional", "none"]
GlossyVectors: TypeAlias = Literal["reliable", "specular", "gradient", "traditional", "none"]
OcclusionVectors: TypeAlias = Literal["dual", "gradient", "traditional", "none"]

_NO_CLAMP = {"clamp": math.inf, "cleanup": False}
_TAA_CLAMP = {"clamp": 1.0, "neighbourhood": "adjacent", "cleanup": False}
_COLOURS = {"indirect": "colour"}
_TRADITIONAL = {"shadow": "traditional", "glossy": "traditional", "occlusion": "traditional", **_COLOURS}


def _positive(most: float) -> Allowed:
    limit = f", at most {most}" if most < math.inf else ""
    return Allowed(f"a number above 0{limit}", lambda x: 0 < x <= most)


@dataclass(frozen=True)
class TrmvOptions(Options, name="trmv"):
    """Options of TRMV; the presets make comparisons of the paper.

    target: `color`, or one component, which needs only its own channels. shadow, glossy, occlusion: the vectors that
    fetch history; `gradient`: traditional ones, with α raised as in A-SVGF where the light changed; `none`: the spatial
    filter alone. indirect: whether indirect light is kept as cones or as a colour. reshading: weights of the cones,
    `paper` as in Eq. 11, or `cosine`, which keeps a white environment white (not in the paper). half_angle: of the
    cones, degrees; 30 in the paper. alpha: least weight of the current frame. warm_up: a running mean until alpha is
    reached (not in the paper); false: alpha from the second frame on. clamp: history within μ ± clamp·σ of the current
    neighbourhood; `inf` leaves it as it is. cleanup: whether the 9×9 filter runs. history: the cleaned output, or the
    blended one. neighbourhood: of the clamp: `spaced`, 5×5 pixels that lie apart (not in the paper), or `adjacent`, 3×3
    pixels as in TAA.
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"half_angle": 30.0, "reshading": "paper", "warm_up": False},
        "traditional": {**_TRADITIONAL, **_NO_CLAMP},
        "traditional_clamp": {**_TRADITIONAL, **_TAA_CLAMP},
        "gradient": {"shadow": "gradient", "glossy": "gradient", "occlusion": "gradient", **_COLOURS, **_NO_CLAMP},
        "specular": {**_TRADITIONAL, "glossy": "specular", **_NO_CLAMP},
        "specular_clamp": {**_TRADITIONAL, "glossy": "specular", **_TAA_CLAMP},
        "dual_colours": {"occlusion": "dual", **_COLOURS},
    }

    target: Literal["color", "visibility", "glossy", "indirect"] = "color"
    shadow: ShadowVectors = "reliable"
    glossy: GlossyVectors = "reliable"
    occlusion: OcclusionVectors = "dual"
    indirect: Literal["cones", "colour"] = "cones"
    reshading: Literal["cosine", "paper"] = "cosine"
    half_angle: Annotated[float, _positive(90)] = math.degrees(HALF_ANGLE)
    alpha: Annotated[float, _positive(1)] = 0.1
    warm_up: bool = True
    clamp: Annotated[float, _positive(math.inf)] = 3.0
    cleanup: bool = True
    history: Literal["cleaned", "blended"] = "cleaned"
    neighbourhood: Literal["spaced", "adjacent"] = "spaced"
