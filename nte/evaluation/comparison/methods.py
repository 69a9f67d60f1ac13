"""The methods of a comparison before anything is trained: each loads, gives what is shown, and fits the clips."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from nte.denoiser import Denoiser
from nte.errors import NteError
from nte.evaluation.comparison.planned import Planned
from nte.evaluation.comparison.schema import Comparison, Plot, Table
from nte.evaluation.units import require_scorable
from nte.frames.clip import Clip
from nte.registry import load_denoiser
from nte.training.clips import require_frames

Methods: TypeAlias = dict[tuple[str, str], Denoiser]  # (situation, title) → denoiser


def load_methods(comparison: Comparison, runs: Mapping[str, str], device: str) -> Methods:
    """Load the denoisers of all situations. runs: title of each network → the folder of a run, trained or not.

    Raises NteError for a denoiser that does not load, and for one that gives no light of a table or plot that shows it.
    """
    loaded: dict[str, Denoiser] = {}
    found = {}
    for situation in comparison.situations:
        networks = situation.runs
        for title in situation.titles:
            network = networks.get(title)
            run = "" if network is None else runs[network]
            spec = situation.with_run(title, run)
            try:
                if spec not in loaded:
                    loaded[spec] = load_denoiser(spec, device)
            except NteError as error:
                what = str(error).replace(run, f"{{{network}}}") if run else error
                raise NteError(f"situation '{situation.name}', method '{title}': {what}") from error
            found[situation.name, title] = loaded[spec]
    _require_lights(comparison, found)
    return found


def _require_lights(comparison: Comparison, methods: Methods) -> None:
    shown: list[tuple[str, Table | Plot, list[str]]]
    shown = [(f"table '{t.name}'", t, [part.light for part in t.columns]) for t in comparison.tables]
    shown += [(f"plot '{p.name}'", p, [p.light]) for p in comparison.plots]
    for where, entry, named in shown:
        situation = comparison.situation(entry.situation)
        lights = sorted({light or situation.light for light in named})
        for title in entry.methods or situation.titles:
            denoiser = methods[situation.name, title]
            if not {denoiser.target, *denoiser.components} & {*lights}:
                trained = title in situation.networks
                raise NteError(
                    f"{where} is about {', '.join(lights)}, but {'network' if trained else 'method'} '{title}' "
                    f"denoises '{denoiser.target}': {'set its network.target' if trained else 'give it that target'}, "
                    "or leave it out"
                )


def require_fitting(planned: Sequence[Planned], methods: Methods) -> None:
    """Raise NteError for a clip with a file that is cut off, and for one that lacks a channel or reference."""
    for plan in planned:
        situation = plan.situation
        assert situation.first is not None
        specs = {situation.methods.get(t, t): methods[situation.name, t] for t in situation.titles}
        for label, folder in plan.clips.items():
            clip = Clip(folder)
            require_frames(clip)
            require_scorable(label, clip, specs, situation.first)
