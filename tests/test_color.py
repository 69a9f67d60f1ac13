"""Light and colour against values that can be checked by hand."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nte.color import BLACK, compress, demodulate, display, divisor, luminance, per_sequence, remodulate, undisplay


def test_luminance_is_rec_709() -> None:
    rgb = torch.eye(3).view(3, 3, 1, 1)
    torch.testing.assert_close(luminance(rgb).flatten(), torch.tensor([0.2126, 0.7152, 0.0722]))
    assert luminance(torch.rand(2, 3, 4, 5)).shape == (2, 1, 4, 5)


def test_compression_is_log_of_one_plus_x() -> None:
    torch.testing.assert_close(compress(torch.tensor([0.0, 1.0, 99.0])), torch.tensor([1.0, 2.0, 100.0]).log())


def test_the_display_transform() -> None:
    # Exposed by 2: 0.5 → 1 → ½ after x/(1 + x) → sRGB 0.7354; and black, white and the linear toe.
    radiance = torch.tensor([0.5, 0.0, 1e9, 0.0005]).view(1, 1, 1, 4)
    shown = display(radiance, torch.tensor([2.0])).flatten()
    toe = 12.92 * 0.001 / 1.001
    torch.testing.assert_close(shown, torch.tensor([0.7353569, 0.0, 1.0, toe]), atol=1e-5, rtol=1e-4)
    assert display(-radiance, torch.ones(1)).max() == 0


def test_the_display_transform_can_be_inverted() -> None:
    radiance = torch.tensor([0.0, 1e-6, 1e-3, 0.5, 7.0, 1e3, 6e4]).view(1, 1, 1, 7).expand(1, 3, 1, 7)
    torch.testing.assert_close(undisplay(display(radiance, torch.ones(1))), radiance, rtol=2e-2, atol=0)
    torch.testing.assert_close(
        undisplay(display(radiance, torch.ones(1)))[..., :5], radiance[..., :5], rtol=1e-5, atol=0
    )
    assert undisplay(torch.ones(1, 3, 1, 1)).isfinite().all()


def test_the_display_transform_exposes_each_sequence_by_its_own() -> None:
    radiance = torch.rand(2, 3, 4, 5)
    both = display(radiance, torch.tensor([1.0, 3.0]))
    torch.testing.assert_close(both[1:], display(radiance[1:] * 3, torch.ones(1)))
    assert per_sequence(torch.ones(2)).shape == (2, 1, 1, 1)


@given(st.floats(0, 1e4, width=32), st.floats(0, 1, width=32))
def test_demodulation_is_undone_even_for_black_albedo(light: float, albedo: float) -> None:
    radiance, surface = torch.tensor([[[[light]]]]), torch.tensor([[[[albedo]]]])
    torch.testing.assert_close(remodulate(demodulate(radiance, surface), surface), radiance)


@pytest.mark.parametrize("transform", [compress, lambda x: display(x, torch.ones(1))])
def test_more_light_never_looks_darker(transform: object) -> None:
    ramp = torch.logspace(-6, 6, 500).view(1, 1, 1, -1)
    assert (transform(ramp).diff() > -1e-7).all()  # type: ignore[operator]


def test_a_black_albedo_is_not_divided_by() -> None:
    def of(*albedo: float) -> list[float]:
        return divisor(torch.tensor(albedo, dtype=torch.float32).view(1, 3, 1, 1), 0.01).flatten().tolist()

    assert of(0, 0, 0) == [1, 1, 1]
    assert of(0.9, 0, 0.3) == pytest.approx([0.9, 0.01, 0.3])  # a saturated colour is one
    assert of(0.004, 0.002, 0.02) == pytest.approx([0.01, 0.01, 0.02])
    steps = torch.linspace(0, 2 * BLACK, 2001).view(1, 1, 1, -1).expand(1, 3, 1, -1)
    change = divisor(steps, 0.01).diff()
    assert change.abs().max() < 1e-3  # no step that a textured surface would show
