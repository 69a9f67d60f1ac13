"""Denoising each light component separately, and summing the results: a wrapper around any denoisers."""

import re
from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias

from nte.denoiser import Denoiser, Result, State, sanitised
from nte.errors import NteError
from nte.frames.channels import COMPONENTS
from nte.frames.frame import Frame
from nte.options import Allowed

EACH = "components"  # the value of `target` that stands for one denoiser per component
COMPOSITE = "composite"  # the name of a composition of different denoisers
_LIGHT = re.compile(r"(\w+)=(?:\[(.*?)\](?=,|$)|([^,]*))(?:,|$)")  # light=SPEC, or light=[SPEC] if SPEC has commas

# The option `target` of a filter that can denoise a single component.
Target: TypeAlias = Annotated[
    Literal["color", "visibility", "glossy", "indirect"], Allowed(f"one of color, {', '.join(COMPONENTS)}, {EACH}")
]


class Composition(Denoiser):
    """The sum color = emission + direct·visibility + glossy + indirect, with one denoiser for each noisy component.

    denoisers: component → a denoiser with that target, for each of COMPONENTS in that order; raises NteError otherwise.
    Extras: the components by their names. A frame without `emission` has none.
    """

    extras: tuple[str, ...] = COMPONENTS

    components = COMPONENTS

    def __init__(self, denoisers: Mapping[str, Denoiser]) -> None:
        if tuple(denoisers) != COMPONENTS or any(d.target != name for name, d in denoisers.items()):
            given = ", ".join(f"{name} → {d.target}" for name, d in denoisers.items())
            raise NteError(f"composition: expected a denoiser for each of {', '.join(COMPONENTS)}, found {given}")
        self.denoisers = dict(denoisers)
        needed = (name for denoiser in denoisers.values() for name in denoiser.needs)
        used = (name for denoiser in denoisers.values() for name in denoiser.optional)
        self.needs = tuple(dict.fromkeys(["direct", *needed]))
        self.optional = tuple(dict.fromkeys(["emission", *used]))
        self.wants = tuple(dict.fromkeys(name for denoiser in denoisers.values() for name in denoiser.wants))

    @sanitised
    def step(
        self, frame: Frame, state: Mapping[str, State] | None, extras: tuple[str, ...] = ()
    ) -> tuple[Result, Mapping[str, State]]:
        """Denoise every component and sum them; the state maps each component to its denoiser's state."""
        tensors = frame.torch()
        images, states = {}, {}
        for name, denoiser in self.denoisers.items():
            result, states[name] = denoiser.step(tensors, None if state is None else state[name])
            images[name] = result.image
        image = tensors["direct"] * images["visibility"] + images["glossy"] + images["indirect"]
        if "emission" in frame:
            image = image + tensors["emission"]
        return Result(image, {name: images[name] for name in extras}).like(frame), states


def lights_of(spec: str) -> dict[str, str]:
    """Read `composite:light=SPEC,light=[SPEC,with=commas],…` as a mapping from each of COMPONENTS to its SPEC.

    Raises NteError if a light is missing, unknown or given twice, and for what is no light=SPEC.
    """
    form = f"expected {COMPOSITE}:{','.join(f'{name}=SPEC' for name in COMPONENTS)}, with [SPEC] where SPEC has a comma"
    text, place = spec.partition(":")[2], 0
    found: dict[str, str] = {}
    while place < len(text):
        item = _LIGHT.match(text, place)
        if item is None or not (inner := item[2] or item[3]):
            raise NteError(f"'{spec}': '{text[place:]}' is no light=SPEC: {form}")
        if item[1] not in COMPONENTS:
            raise NteError(f"'{spec}': '{item[1]}' is no light: {form}")
        if item[1] in found:
            raise NteError(f"'{spec}': {item[1]} is given twice: {form}")
        found[item[1]] = inner
        place = item.end()
    if missing := [name for name in COMPONENTS if name not in found]:
        raise NteError(f"'{spec}': nothing denoises {', '.join(missing)}: {form}")
    return {name: found[name] for name in COMPONENTS}
