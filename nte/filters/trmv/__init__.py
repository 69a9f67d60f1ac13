"""TRMV: «Temporally Reliable Motion Vectors for Real-time Ray Tracing» (Zeng et al. 2021) as a denoiser.

Shadows, glossy reflections and diffuse indirect light are filtered separately, each with its own vectors, and summed.
nte.filters.trmv.options has presets for the paper's comparisons, and marks what is not in the paper.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from nte.denoiser import Filter, Result, require_size, sanitised
from nte.filters.scope import scope
from nte.filters.trmv.accumulation import Effect, History
from nte.filters.trmv.cones import EQ_11, WEIGHTS
from nte.filters.trmv.glossy import denoise_glossy
from nte.filters.trmv.gradient import unchanged
from nte.filters.trmv.indirect import Cones, denoise_indirect
from nte.filters.trmv.inputs import FrameInputs, GBuffer, prepare
from nte.filters.trmv.options import TrmvOptions
from nte.filters.trmv.shadows import denoise_shadows
from nte.frames.channels import COMPONENTS
from nte.frames.frame import Frame

_GEOMETRY = ("normal", "depth", "roughness", "motion")


class TrmvState(NamedTuple):
    """The state of a sequence: the previous G-buffer, and the history of each effect."""

    gbuffer: GBuffer
    histories: dict[str, History]


class Trmv(Filter[TrmvOptions]):
    """The whole system of the paper. A frame without `emission` has none.

    Extras: `visibility`, `glossy` and `indirect`; for each, `<name>_vector` (N, 2, H, W), px, current → previous, NaN
    where there is no history, and `<name>_alpha` (N, 1, H, W), the weight of the current frame; and `disoccluded`, 0 or
    1.
    """

    options_type = TrmvOptions

    def __init__(self, options: TrmvOptions | None = None, *, device: str = "cpu") -> None:
        super().__init__(options, device=device)
        how = self.options
        self.target = how.target
        self.components = COMPONENTS if how.target == "color" else ()
        self.effects = self.components or (how.target,)
        self.extras = ("disoccluded", *(f"{name}{what}" for name in self.effects for what in ("", "_alpha", "_vector")))
        self.vectors = {"visibility": how.shadow, "glossy": how.glossy, "indirect": how.occlusion}
        weights = WEIGHTS if how.reshading == "cosine" else EQ_11
        self.cones = Cones(math.radians(how.half_angle), weights) if how.indirect == "cones" else None
        self.needs, self.optional = self._channels()

    @sanitised
    def step(self, frame: Frame, state: TrmvState | None, extras: tuple[str, ...] = ()) -> tuple[Result, TrmvState]:
        """Denoise `target` of one frame; the state is the G-buffer and the history of each effect."""
        if state is not None:
            require_size(frame, state.gbuffer.depth)
        inputs = prepare(frame, state.gbuffer if state else None)
        effects = self._run(inputs, state.histories if state else {})
        with scope("trmv/compose"):
            image = effects[self.target].image if self.target != "color" else _sum(frame, effects)
        own = image if self.target == "color" else image.clone()  # a light's history is the same image
        result = Result(own, self._shown(extras, effects, inputs))
        return result, TrmvState(inputs.gbuffer, {name: effect.history for name, effect in effects.items()})

    def _run(self, inputs: FrameInputs, histories: dict[str, History]) -> dict[str, Effect]:
        """The effects that make up the target."""
        found = {}
        for name in self.effects:
            history, vectors, trust = histories.get(name), self.vectors[name], None
            if vectors == "gradient":
                sample = "indirect_radiance" if name == "indirect" and self.cones else name
                vectors, trust = "traditional", unchanged(inputs.frame, name, inputs.frame[sample])
            if name == "visibility":
                found[name] = denoise_shadows(inputs, history, vectors, self.options, trust)
            elif name == "glossy":
                found[name] = denoise_glossy(inputs, history, vectors, self.options, trust)
            else:
                found[name] = denoise_indirect(inputs, history, vectors, self.cones, self.options, trust)
        return found

    def _shown(self, names: tuple[str, ...], effects: dict[str, Effect], inputs: FrameInputs) -> dict[str, Tensor]:
        """The extras with these names."""
        offered = {"disoccluded": inputs.dual.disoccluded.float()}
        for name, effect in effects.items():
            motion = inputs.traditional.motion if effect.vectors is None else effect.vectors.motion
            vector = torch.where(effect.alpha < 1, motion, float("nan"))
            offered |= {name: effect.image, f"{name}_alpha": effect.alpha, f"{name}_vector": vector}
        return {name: offered[name].clone() for name in names}

    def _channels(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The channels that the chosen effects need, and those that they use where a frame has them."""
        reliable = self.options.shadow == "reliable"
        moved = ("reflection_motion",) if self.options.glossy in ("reliable", "specular") else ()
        cones = ("indirect_radiance", "indirect_direction")
        needs = {
            "visibility": ("direct", "visibility", *(("position", "shadow_motion") if reliable else ())),
            # The covariance is the size of every variant's spatial filter.
            "glossy": ("glossy", "reflection_covariance", *moved),
            "indirect": ("albedo", *(cones if self.cones else ("indirect",))),
        }
        optional = {"visibility": ("geometric_normal",) if reliable else (), "indirect": ("diffuse_albedo",)}
        required, used = [*_GEOMETRY], [*(("emission",) if self.components else ()), "previous_forward_motion"]
        for name in self.effects:
            required += needs[name]
            used += optional.get(name, ())
            if self.vectors[name] == "gradient":
                required.append("gradient")
                used.append(f"gradient_{name}")
        return tuple(dict.fromkeys(required)), tuple(used)


def _sum(frame: Frame, effects: dict[str, Effect]) -> Tensor:
    """The colour: the light without noise, and the effects."""
    light: Tensor = frame["direct"] * effects["visibility"].image
    light = frame["emission"] + light if "emission" in frame else light
    return light + effects["glossy"].image + effects["indirect"].image
