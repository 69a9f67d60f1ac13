"""The lists that others take from the table of channels are what the table says."""

from nte.frames.channels import CHANNELS, COMPONENTS, GUIDES, TARGETS, VECTORS, channels_of, reference_of, width_of


def test_every_target_is_noisy_and_has_a_reference_of_the_same_kind_and_width() -> None:
    for name in TARGETS:
        noisy, reference = CHANNELS[name], CHANNELS[reference_of(name)]
        assert noisy.noisy
        assert not reference.noisy
        assert (noisy.kind, noisy.components) == (reference.kind, reference.components)
    assert set(TARGETS) == {name for name, row in CHANNELS.items() if row.noisy and reference_of(name) in CHANNELS}


def test_components_are_rendered_together_with_their_references() -> None:
    assert set(COMPONENTS) <= set(channels_of("components", noisy=True))
    assert {reference_of(name) for name in COMPONENTS} <= set(channels_of("components", noisy=False))
    assert set(channels_of("shutter", noisy=True)) == {name for name, row in CHANNELS.items() if row.group == "shutter"}


def test_vectors_and_guides() -> None:
    assert VECTORS == ("motion", "forward_motion", "shutter_motion")
    assert not any(CHANNELS[name].noisy for name in GUIDES)
    assert [width_of(name) for name in ("color", "depth", "motion", "reflection_covariance")] == [3, 1, 2, 3]
