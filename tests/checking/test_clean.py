"""A reference is the same frames without noise, not another noisy image of them."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import describe
from tests.checking.test_values import checked
from tests.synthetic import Pixels


@pytest.mark.parametrize(("samples", "told"), [(1, True), (16, False)])
def test_a_reference_that_is_as_noisy_as_the_colour_is_noted(tmp_path: Path, samples: int, told: bool) -> None:
    """Other frames of the same renderer, in the place of the converged ones."""
    rng = np.random.default_rng(3)

    def noisy(frame: dict[str, Pixels], index: int) -> dict[str, Pixels]:
        truth = frame["reference"]
        color, reference = (truth * rng.gamma(n, 1 / n, truth.shape).astype(np.float32) for n in (1, samples))
        return {"color": color, "reference": reference}

    report = checked(tmp_path, noisy)
    assert report.verdict == "plausible"
    note = "note: reference: is about as noisy as color; expected the same frames without noise"
    assert (note in describe(report)) == told


def test_two_images_without_noise_are_not_called_noisy(tmp_path: Path) -> None:
    report = checked(tmp_path, lambda frame, index: {"color": frame["reference"] * 1.002})
    assert [finding for finding in report.findings if "noisy" in finding.found] == []
