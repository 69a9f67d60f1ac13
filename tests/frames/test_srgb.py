"""The sRGB curve: known values, its inverse, and its twin for tensors."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nte.color import display
from nte.frames.srgb import decode_srgb, encode_srgb


@pytest.mark.parametrize(("linear", "shown"), [(0, 0), (1, 1), (0.0031308, 0.04045), (0.5, 0.735357), (0.002, 0.02584)])
def test_known_values(linear: float, shown: float) -> None:
    assert encode_srgb(np.array(linear)) == pytest.approx(shown, abs=1e-5)
    assert decode_srgb(np.array(shown)) == pytest.approx(linear, abs=1e-5)


@given(st.floats(0, 1))
def test_decoding_undoes_encoding(value: float) -> None:
    assert decode_srgb(encode_srgb(np.array(value))) == pytest.approx(value, abs=1e-6)


@given(st.floats(0, 100, width=32))
def test_tensors_are_displayed_by_the_same_curve(radiance: float) -> None:
    image = torch.full((1, 3, 1, 1), radiance)
    shown = encode_srgb(np.float64(radiance / (1 + radiance)))
    assert display(image, torch.ones(1)).flatten().tolist() == pytest.approx([float(shown)] * 3, abs=1e-6)
