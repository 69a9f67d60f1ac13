"""nte: neural temporal denoising of path-traced image sequences.

A filter, a run folder, an exported model and your own object are all denoisers. A denoiser's `step` takes a frame,
whose channels are arrays (N, C, H, W), and the state that it returned for the previous frame:

>>> class Doubled(nte.Denoiser):
...     needs = ("color",)
...
...     def step(self, frame: nte.Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[nte.Result, object]:
...         return nte.Result(2 * frame["color"]), state
>>> frame = nte.Frame({"color": np.ones((1, 3, 4, 6), np.float32)})
>>> float(nte.Session(Doubled()).denoise(frame).max())
2.0

One table lists all channels with their components and units. Wrong input raises an NteError:

>>> nte.CHANNELS["motion"].components, nte.CHANNELS["motion"].unit
(('X', 'Y'), 'px, to the previous frame')
>>> try:
...     nte.load_denoiser("tea")
... except nte.NteError as error:
...     print(error)
'tea' is no denoiser, did you mean taa? expected ...

`import nte` is light: functions that need PyTorch, Mitsuba or ONNX Runtime are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from nte.denoiser import Denoiser, Result
from nte.errors import NteError, needs_extra
from nte.frames import CHANNELS, Clip, Frame
from nte.registry import load_denoiser
from nte.session import Session, denoise
from nte.version import __version__

if TYPE_CHECKING:
    from nte.checking.report import check
    from nte.evaluation.evaluate import evaluate
    from nte.motion.correspondence import find_motion
    from nte.motion.geometric import dual_motion, frame_vectors, scatter_forward_motion, traditional_motion
    from nte.motion.reliable import (
        mirror_image,
        reflection_covariance,
        reflection_motion,
        shadow_motion,
        shadow_point,
    )
    from nte.motion.warp import warp
    from nte.render.recipes.clips import render_recipe as render
    from nte.runtime.export import export
    from nte.training.loop import train

__all__ = [
    "CHANNELS", "Clip", "Denoiser", "Frame", "NteError", "Result", "Session", "__version__", "check", "denoise",
    "dual_motion", "evaluate", "export", "find_motion", "frame_vectors", "load_denoiser", "mirror_image",
    "reflection_covariance", "reflection_motion", "render", "scatter_forward_motion", "shadow_motion", "shadow_point",
    "traditional_motion", "train", "warp",
]  # fmt: skip

# module → the extra that installs its imports, and the names that it provides
_HOMES = {
    "nte.checking.report": ("eval", ("check",)),
    "nte.evaluation.evaluate": ("eval", ("evaluate",)),
    "nte.motion.correspondence": ("eval", ("find_motion",)),
    "nte.motion.geometric": ("eval", ("dual_motion", "frame_vectors", "scatter_forward_motion", "traditional_motion")),
    "nte.motion.reliable": (
        "eval",
        ("mirror_image", "reflection_covariance", "reflection_motion", "shadow_motion", "shadow_point"),
    ),
    "nte.motion.warp": ("eval", ("warp",)),
    "nte.runtime.export": ("train", ("export",)),
    "nte.training.loop": ("train", ("train",)),
}
_HOME = {name: (module, extra) for module, (extra, names) in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a name that needs more than the base install when it is first used."""
    if name == "render":  # a callable package: importing one of its modules sets this name to the package anyway
        return import_module("nte.render")
    if name not in _HOME:
        raise AttributeError(f"module 'nte' has no attribute '{name}'")
    module, extra = _HOME[name]
    try:
        return getattr(import_module(module), name)
    except ImportError as error:
        raise ImportError(str(needs_extra(extra, f"nte.{name}", error)), name=error.name) from error


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
