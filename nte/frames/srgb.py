"""The sRGB curve, IEC 61966-2-1, in NumPy; nte.color has it for tensors, with the same constants."""

import numpy as np
import numpy.typing as npt

DARK, SLOPE = 0.0031308, 12.92  # the curve is a line up to this linear value, with this slope
GAIN, OFFSET, POWER = 1.055, 0.055, 2.4
_DARK_ENCODED = 0.04045

Values = npt.NDArray[np.floating]


def encode_srgb(linear: Values) -> Values:
    """Encode linear values of at least 0 with the sRGB curve, which maps [0, 1] to [0, 1]; any shape."""
    curve = GAIN * np.maximum(linear, DARK) ** (1 / POWER) - OFFSET
    return np.where(linear <= DARK, SLOPE * linear, curve)


def decode_srgb(encoded: Values) -> Values:
    """Decode sRGB values in [0, 1] to linear ones in [0, 1]; any shape."""
    return np.where(encoded <= _DARK_ENCODED, encoded / SLOPE, ((encoded + OFFSET) / GAIN) ** POWER)
