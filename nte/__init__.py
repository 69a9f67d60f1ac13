"""nte: neural temporal denoising of path-traced image sequences.

Everything is a denoiser: a filter, a run folder, an exported model, or an object of yours. It gets a frame, whose
channels are arrays (N, C, H, W), and what it returned as its state with the frame before:

>>> class Doubled(nte.Denoiser):
...     needs = ("color",)
...
...     def step(self, frame: nte.Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[nte.Result, object]:
...         return nte.Result(2 * frame["color"]), state
>>> frame = nte.Frame({"color": np.ones((1, 3, 4, 6), np.float32)})
>>> float(nte.Session(Doubled()).denoise(frame).max())
2.0

Which channels there are, with their components and units, is one table; what is wrong with input is an NteError:

>>> nte.CHANNELS["motion"].components, nte.CHANNELS["motion"].unit
(('X', 'Y'), 'px, to the previous frame')
>>> try:
...     nte.load_denoiser("tea")
... except nte.NteError as error:
...     print(error)
'tea' is no denoiser: expected ...

`import nte` is light. PyTorch, Mitsuba and ONNX Runtime are imported by the parts that use them, when they are used:
functions that need one of them are loaded when they are first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from nte.denoiser import Denoiser, Result, Session, denoise
from nte.errors import NteError, needs_extra
from nte.frames import CHANNELS, Clip, Frame
from nte.registry import load_denoiser
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
    )  # fmt: skip
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

# module → the extra that brings what it imports, and its names
_HOMES = {
    "nte.checking.report": ("eval", ("check",)),
    "nte.evaluation.evaluate": ("eval", ("evaluate",)),
    "nte.motion.correspondence": ("eval", ("find_motion",)),
    "nte.motion.geometric": ("eval", ("dual_motion", "frame_vectors", "scatter_forward_motion", "traditional_motion")),
    "nte.motion.reliable": (
        "eval", ("mirror_image", "reflection_covariance", "reflection_motion", "shadow_motion", "shadow_point"),
    ),
    "nte.motion.warp": ("eval", ("warp",)),
    "nte.runtime.export": ("train", ("export",)),
    "nte.training.loop": ("train", ("train",)),
}  # fmt: skip
_HOME = {name: (module, extra) for module, (extra, names) in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a name that needs more than the base install when it is first asked for."""
    if name == "render":  # a package that can be called: whoever imports a module of it sets this name to the package
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
