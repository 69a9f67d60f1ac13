"""Makes a clip small that is to be shown: python fewer_digits.py CLIP

Keeps the channels that a denoiser of color reads, and the reference. Motion is rounded to 1/64 pixel, depth and the
reference to 11 binary digits: EXR's compression takes rounded numbers for a third of the others.
"""

import sys
from pathlib import Path

import numpy as np

from nte.frames.clip import Clip, frame_path, read_frame, write_frame

KEPT = ("color", "albedo", "normal", "depth", "motion", "reference")


def rounded(name: str, values: np.ndarray) -> np.ndarray:
    """Round a channel (C, H, W)."""
    if name == "motion":
        return np.round(values * 64) / 64
    if name in ("depth", "reference"):
        mantissa, exponent = np.frexp(values)
        return np.ldexp(np.round(mantissa * 2**11) / 2**11, exponent).astype(np.float32)
    return values


def main() -> None:
    """Write every frame of the clip anew."""
    folder = Path(sys.argv[1])
    for index in range(len(Clip(folder))):
        path = frame_path(folder, index)
        stored = read_frame(path)
        write_frame(path, {name: rounded(name, stored[name]) for name in KEPT})


if __name__ == "__main__":
    main()
