"""No denoiser's results change in silence."""

import json

import numpy as np
import pytest

from tests.faults.numbers import NAMES, NUMBERS, numbers

pytestmark = pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")
EXPECTED = json.loads(NUMBERS.read_text())


@pytest.mark.parametrize("name", NAMES)
def test_a_denoiser_gives_the_numbers_that_it_gave(name: str) -> None:
    np.testing.assert_allclose(numbers(name), EXPECTED[name], rtol=2e-3, atol=2e-4)


def test_each_has_its_own_numbers() -> None:
    assert EXPECTED.keys() == {*NAMES}
    assert len({tuple(values) for values in EXPECTED.values()}) > len(NAMES) - 6
