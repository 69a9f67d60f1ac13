"""What the report says about how its numbers are computed, as titled lists of terms."""

from collections.abc import Mapping

from nte.evaluation.metric_table import METRICS, Row, settings_of
from nte.evaluation.metrics import GLOSSY, MOVING_PX, SHADOWED
from nte.viewer.recorder import BRIGHTENED

_REGIONS = (
    ("All", "The whole image."),
    (
        "Disoccluded",
        "Pixels whose surface was hidden in the previous frame: where the dual motion vector differs from the "
        "traditional one.",
    ),
    ("Moving", f"Pixels whose surface moved by more than {MOVING_PX} px on the screen since the previous frame."),
    ("Static", "All the others."),
    ("Shadowed", f"Pixels whose reference visibility is below {SHADOWED}: shadow and penumbra."),
    ("Glossy", f"Pixels where other lobes than the diffuse one give at least {100 * GLOSSY:.0f} % of the light."),
)


def how_it_is_computed(rows: list[Row], methods: Mapping[str, str] | None) -> list[Row]:
    """Explain metrics, regions, methods and settings. methods: title → spec, if the denoisers have titles."""
    sections = [
        {"title": "Metrics", "text": _procedure(rows), "terms": [[m.label, _reading(m.how, m.better)] for m in METRICS]}
    ]
    if methods:
        sections.append({"title": "Methods", "text": "", "terms": [list(pair) for pair in methods.items()]})
    settings = settings_of(rows)
    if settings:
        text = "What these denoisers chose by themselves, from what the clips say of their channels."
        terms = [[spec, "; ".join(found)] for spec, found in settings.items()]
        sections.append({"title": "Settings", "text": text, "terms": terms})
    text = (
        "SSIM and FLIP of a region are the mean of the whole image's map over it. A frame without any pixel of a "
        "region is left out of that region's means."
    )
    sections.append({"title": "Regions", "text": text, "terms": [list(pair) for pair in _REGIONS]})
    return sections


def _reading(how: str, better: str) -> str:
    return f"{how} {better.capitalize()} is better." if better else how


def _procedure(rows: list[Row]) -> str:
    lights = sorted({row["target"] for row in rows})
    first = min((row["scored_from"] for row in rows), default=1)
    parts = [
        "Every frame is compared with its reference after the display transform: radiance times the frame's exposure "
        "(as stored; or, for all frames of a clip, 0.18 over the log-average luminance of the first noisy frame that "
        "has light), x/(1+x), then the sRGB curve."
    ]
    if components := [light for light in lights if light != "color"]:
        parts.append(f"Light components (here: {', '.join(components)}) are compared with their own references.")
    parts += [
        f"Pictures of {light} light are {factor:.0f} times as bright as they are in the image; numbers are not."
        for light, factor in BRIGHTENED.items()
        if light in lights
    ]
    parts.append(
        "A number is computed for each frame, then averaged over the frames of a clip, then over the clips, each clip "
        "counting the same. Brackets are the 95 % interval of the mean over clips (bootstrap)."
    )
    if first:
        what = "The first frame of a clip is" if first == 1 else f"Frames before {first} are"
        why = "nothing can have a history there" if first == 1 else "there histories are still short"
        parts.append(f"{what} denoised but not scored: {why}.")
    parts.append("An output with a value that is not finite ends the evaluation; it gets no score.")
    return " ".join(parts)
