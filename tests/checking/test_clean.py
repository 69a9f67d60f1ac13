"""A reference is the same frames without noise, not another noisy image of them."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import check, describe
from nte.frames.clip import Clip
from tests.checking.test_late import SHOTS, noisy
from tests.checking.test_values import checked
from tests.synthetic import Pixels, write_clip


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


def blurred(image: Pixels, times: int) -> Pixels:
    """Each time the variance of the blur, in px², grows by a half along each axis."""
    for _ in range(times):
        for axis in (1, 2):
            image = (np.roll(image, 1, axis) + 2 * image + np.roll(image, -1, axis)) / 4
    return image.astype(np.float32)


@pytest.mark.parametrize("times", [2, 4])
@pytest.mark.parametrize("of", ["color", "reference"])
def test_a_reference_that_is_blurred_colour_is_noted(tmp_path: Path, of: str, times: int) -> None:
    """Blurred without noise, as by a wide pixel filter, it is not."""
    frames = [shot | {"color": noisy(shot["color"], i)} for i, shot in enumerate(SHOTS)]
    frames = [frame | {"reference": blurred(frame[of], times)} for frame in frames]
    told = [f for f in check(Clip(write_clip(tmp_path / "clip", frames))).findings if "follows the noise" in f.found]
    assert bool(told) == (of == "color")
    assert not any(f.fault for f in told)
