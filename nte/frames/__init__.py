"""Frames, their channels and the clips that hold them: the lowest layer of nte, in NumPy."""

from nte.frames.channels import CHANNELS, Channel
from nte.frames.clip import Clip
from nte.frames.frame import Array, Frame

__all__ = ["CHANNELS", "Array", "Channel", "Clip", "Frame"]
