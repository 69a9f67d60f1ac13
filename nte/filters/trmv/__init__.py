"""TRMV: «Temporally Reliable Motion Vectors for Real-time Ray Tracing» (Zeng et al. 2021) as a denoiser.

Shadows, glossy reflections and diffuse indirect light are filtered apart, each with vectors of its own, and summed.
docs/trmv.md says which options are which of the paper's comparisons, and what is ours.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.profiler import record_function

from nte.denoiser import Denoiser, Result, check_size, sanitised
from nte.errors import NteError
from nte.filters.composition import COMPONENTS
from nte.filters.trmv.accumulation import Effect, Settings, Track
from nte.filters.trmv.cones import EQ_11, HALF_ANGLE, WEIGHTS
from nte.filters.trmv.glossy import denoise_glossy
from nte.filters.trmv.gradient import unchanged
from nte.filters.trmv.indirect import Cones, denoise_indirect
from nte.filters.trmv.inputs import Scene, Surface, prepare
from nte.filters.trmv.shadows import denoise_shadows
from nte.frames.frame import Frame

CHOICES = {
    "target": ("color", *COMPONENTS),
    "shadow": ("reliable", "gradient", "traditional", "none"),
    "glossy": ("reliable", "specular", "gradient", "traditional", "none"),
    "occlusion": ("dual", "gradient", "traditional", "none"),
    "indirect": ("cones", "colour"),
    "reshading": ("cosine", "paper"),
    "history": ("cleaned", "blended"),
    "neighbourhood": ("spaced", "adjacent"),
}
_GEOMETRY = ("normal", "depth", "roughness", "motion")
_VECTORS = {"visibility": "shadow", "glossy": "glossy", "indirect": "occlusion"}  # the option that chooses them


class State(NamedTuple):
    """What a sequence carries: the previous G-buffer, and each effect's history."""

    surface: Surface
    tracks: dict[str, Track]


class Trmv(Denoiser):
    """The whole system; every option is one of the paper's comparisons (docs/trmv.md).

    target: `color`, or one component, whose channels alone are then needed. shadow, glossy, occlusion: which
    vectors fetch history; `gradient`: traditional ones, with α raised as in A-SVGF where the light changed; `none`: the
    spatial filter alone. indirect: what is kept of indirect light. half_angle:
    of the cones, degrees. clamp: in standard deviations; `inf` leaves history as it is. The others: `Settings`.
    Raises NteError for what is not a choice.
    """

    def __init__(
        self, target: str = "color", shadow: str = "reliable", glossy: str = "reliable", occlusion: str = "dual",
        indirect: str = "cones", reshading: str = "cosine", half_angle: float = math.degrees(HALF_ANGLE),
        alpha: float = 0.1, warm_up: bool = True, clamp: float = 3.0, cleanup: bool = True,
        history: str = "cleaned", neighbourhood: str = "spaced", device: str = "cpu",
    ) -> None:  # fmt: skip
        chosen = {"target": target, "shadow": shadow, "glossy": glossy, "occlusion": occlusion, "indirect": indirect,
                  "reshading": reshading, "history": history, "neighbourhood": neighbourhood}  # fmt: skip
        for key, value in chosen.items():
            if value not in CHOICES[key]:
                raise NteError(f"trmv: {key} is '{value}', expected one of {', '.join(CHOICES[key])}")
        for key, number, most in (("alpha", alpha, 1), ("half_angle", half_angle, 90), ("clamp", clamp, math.inf)):
            if not 0 < number <= most:
                raise NteError(f"trmv: {key} is {number}, expected a number above 0, at most {most}")
        self.target, self.device, self.chosen = target, device, chosen
        self.cones = Cones(math.radians(half_angle), WEIGHTS if reshading == "cosine" else EQ_11)
        self.how = Settings(alpha, warm_up, clamp, cleanup, history == "cleaned", neighbourhood == "adjacent")
        self.components = COMPONENTS if target == "color" else ()
        shown = self.components or (target,)
        self.extras = ("disoccluded", *(f"{name}{what}" for name in shown for what in ("", "_alpha", "_vector")))
        self.needs, self.optional = self._channels()

    @sanitised
    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Denoise one frame.

        extras: `visibility`, `glossy`, `indirect`; of each, `<name>_vector` (N, 2, H, W) px, NaN where there is no
        history, and `<name>_alpha` (N, 1, H, W), the weight of the current frame; and `disoccluded`, 0 or 1.
        """
        if state is not None:
            check_size(frame, state.surface.depth)
        scene = prepare(frame, state.surface if state else None)
        effects = self._run(scene, state.tracks if state else {})
        with record_function("trmv/compose"):
            image = effects[self.target].image if self.target != "color" else (
                scene.frame["emission"] + scene.frame["direct"] * effects["visibility"].image
                + effects["glossy"].image + effects["indirect"].image
            )  # fmt: skip
        result = Result(image, self._extras(extras, effects, scene))
        return result, State(scene.surface, {name: effect.track for name, effect in effects.items()})

    def _run(self, scene: Scene, tracks: dict[str, Track]) -> dict[str, Effect]:
        """The effects that the target is made of."""
        cones = self.cones if self.chosen["indirect"] == "cones" else None
        found = {}
        for name in self.components or (self.target,):
            track, vectors, trust = tracks.get(name), self.chosen[_VECTORS[name]], None
            if vectors == "gradient":
                sample = "indirect_radiance" if name == "indirect" and cones else name
                vectors, trust = "traditional", unchanged(scene.frame, name, scene.frame[sample])
            if name == "visibility":
                found[name] = denoise_shadows(scene, track, vectors, self.how, trust)
            elif name == "glossy":
                found[name] = denoise_glossy(scene, track, vectors, self.how, trust)
            else:
                found[name] = denoise_indirect(scene, track, vectors, cones, self.how, trust)
        return found

    def _extras(self, names: tuple[str, ...], effects: dict[str, Effect], scene: Scene) -> dict[str, Tensor]:
        offered = {"disoccluded": scene.dual.disoccluded.float()}
        for name, effect in effects.items():
            motion = scene.traditional.motion if effect.vectors is None else effect.vectors.motion
            vector = torch.where(effect.alpha < 1, motion, float("nan"))
            offered |= {name: effect.image, f"{name}_alpha": effect.alpha, f"{name}_vector": vector}
        return {name: offered[name] for name in names}

    def _channels(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """(the channels that the chosen effects must have, those that they use if there)."""
        reliable = self.chosen["shadow"] == "reliable"
        moved = ("reflection_motion",) if self.chosen["glossy"] in ("reliable", "specular") else ()
        cones = ("indirect_radiance", "indirect_direction")
        needs = {
            "visibility": ("direct", "visibility", *(("position", "shadow_motion") if reliable else ())),
            # The covariance is the size of every variant's spatial filter.
            "glossy": ("glossy", "reflection_covariance", *moved),
            "indirect": ("albedo", *(cones if self.chosen["indirect"] == "cones" else ("indirect",))),
        }
        optional = {"visibility": ("geometric_normal",) if reliable else (), "indirect": ("diffuse_albedo",)}
        required, used = [*_GEOMETRY, *(("emission",) if self.components else ())], ["previous_forward_motion"]
        for name in self.components or (self.target,):
            required += needs[name]
            used += optional.get(name, ())
            if self.chosen[_VECTORS[name]] == "gradient":
                required.append("gradient")
                used.append(f"gradient_{name}")
        return tuple(dict.fromkeys(required)), tuple(used)
