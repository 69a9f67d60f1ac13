"""The numbers that each denoiser gave when they were last looked at, against a change that nobody notices.

python -m tests.faults.numbers    writes them anew, after a change that was meant; say in the commit what it was
"""

import json
from pathlib import Path

import numpy as np

from nte import Denoiser, released
from nte.denoiser import Noisy
from nte.filters.prior import OnTop
from nte.registry import load_denoiser
from tests.faults.conftest import FILTERS, maker
from tests.faults.test_sequences import images, moving
from tests.models.lights import NETWORKS

NUMBERS = Path(__file__).with_suffix(".json")
# OIDN's weights are its own: another release of it has other numbers.
NAMES = tuple(name for name in (*FILTERS, *NETWORKS) if "oidn" not in name)


def made(name: str) -> Denoiser:
    """A new denoiser; below a released model is the noisy image, and not OIDN's."""
    if name not in released.names():
        return maker(name)()
    whole = load_denoiser(name)
    assert isinstance(whole, OnTop)
    return OnTop(whole.top, Noisy())


def numbers(name: str) -> list[float]:
    """The means of the components of a sixth frame, and some of its pixels."""
    image = images(made(name), moving(made(name), 0, 6))[-1][0]
    pixels = image[:, 3::5, 2::6].ravel()
    return [float(f"{value:.6g}") for value in (*image.mean((1, 2), dtype=np.float64), *pixels)]


if __name__ == "__main__":
    lines = (f"{json.dumps(name)}: {json.dumps(numbers(name))}" for name in NAMES)
    NUMBERS.write_text("{\n" + ",\n".join(lines) + "\n}\n")
