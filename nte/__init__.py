"""nte: neural temporal denoising of path-traced image sequences.

The names below load nothing heavy by themselves: PyTorch, Mitsuba and ONNX Runtime are imported by the
parts that use them, when they are used.
"""

from nte.denoiser import Denoiser, Noisy, Result, Session, denoise
from nte.errors import NteError
from nte.frames import CHANNELS, Clip, Frame
from nte.registry import load_denoiser
from nte.version import __version__

__all__ = [
    "CHANNELS",
    "Clip",
    "Denoiser",
    "Frame",
    "Noisy",
    "NteError",
    "Result",
    "Session",
    "__version__",
    "denoise",
    "load_denoiser",
]
