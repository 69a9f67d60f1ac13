"""The sRGB curve, IEC 61966-2-1, in NumPy; nte.color has the same one for tensors, with these constants."""

import numpy as np
import numpy.typing as npt

DARK, SLOPE = 0.0031308, 12.92  # linear light up to which the curve is a line, and how steep the line is
GAIN, OFFSET, POWER = 1.055, 0.055, 2.4
_DARK_ENCODED = 0.04045

Values = npt.NDArray[np.floating]


def encode_srgb(linear: Values) -> Values:
    """Encode linear values of at least 0 as they are displayed, [0, 1] as [0, 1]."""
    curve = GAIN * np.maximum(linear, DARK) ** (1 / POWER) - OFFSET
    return np.where(linear <= DARK, SLOPE * linear, curve)


def decode_srgb(encoded: Values) -> Values:
    """Decode values in [0, 1], as displayed, to linear ones."""
    return np.where(encoded <= _DARK_ENCODED, encoded / SLOPE, ((encoded + OFFSET) / GAIN) ** POWER)
