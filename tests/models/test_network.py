"""What the network is made of: heads, sizes, configurations that make none."""

import pytest
import torch
import torch.nn.functional as F

from nte.errors import NteError
from nte.models.temporal import TemporalConfig, TemporalDenoiser
from nte.models.unet import ConvBlock, UNet
from tests.networks import small_network


def test_the_papers_heads_have_51_26_and_26_channels() -> None:
    network = TemporalDenoiser(TemporalConfig())
    assert [head.out_channels for head in network.prediction.heads.heads] == [51, 26, 26]
    assert [head.in_channels for head in network.prediction.heads.heads] == [32, 48, 64]
    assert network.prediction.trunk.encoders[0][0].in_channels == 3 + 3 + 3 + 3 + 1


def test_without_time_the_finest_head_has_25_channels_and_nothing_is_carried_but_depth() -> None:
    network = small_network(temporal=False, feed_warped=False)
    assert [head.out_channels for head in network.prediction.heads.heads] == [25, 26, 26]
    assert list(network.recurrent) == ["previous_depth"]
    assert network.extras == ("disoccluded", "valid")
    assert network.prediction.trunk.encoders[0][0].in_channels == 3 + 3 + 3 + 1


def test_predicted_weights_are_positive_and_alpha_is_one_too() -> None:
    network = small_network()
    kernels, remembered = network.prediction(torch.randn(2, 13, 16, 24))
    assert remembered is None
    for scale, (spatial, alpha, temporal, _) in enumerate(kernels):
        size = 2, 1, 16 >> scale, 24 >> scale
        assert alpha.shape == size
        assert ((alpha > 0) & (alpha < 1)).all()
        assert spatial.shape == (2, 25, *size[2:])
        assert ((spatial > 0) & spatial.isfinite()).all()
        if scale == 0:
            assert ((temporal > 0) & temporal.isfinite()).all()
        else:
            assert temporal is None


@pytest.mark.parametrize("front", [2, 4])
def test_a_front_works_at_a_fraction_of_the_resolution_and_predicts_at_all(front: int) -> None:
    network = small_network(front=front)
    seen: list[tuple[int, ...]] = []
    network.prediction.trunk.encoders[0].register_forward_hook(lambda _, __, made: seen.append(tuple(made.shape[2:])))
    kernels, _ = network.prediction(torch.rand(1, 13, 32, 32))
    assert seen == [(32 // front, 32 // front)]
    assert [tuple(scale.spatial.shape) for scale in kernels] == [(1, 25, 32 >> k, 32 >> k) for k in range(3)]


def test_a_stride_is_a_convolution_of_unshuffled_pixels() -> None:
    torch.manual_seed(0)
    features, strided = torch.rand(2, 5, 12, 20), ConvBlock(5, 4, 2)[0]
    # Places within 2×2 pixels from the kernel's rows and columns to its inputs, as a pixel-unshuffle has them.
    weight = strided.weight.view(4, 5, 3, 2, 3, 2).permute(0, 1, 3, 5, 2, 4).reshape(4, 20, 3, 3)
    expected = F.conv2d(F.pixel_unshuffle(features, 2), weight, strided.bias, padding=1)
    torch.testing.assert_close(strided(features), expected)


def test_the_decoder_returns_every_level_finest_first() -> None:
    levels = UNet(5, [4, 6, 8])(torch.rand(2, 5, 16, 8))
    assert [tuple(level.shape) for level in levels] == [(2, 4, 16, 8), (2, 6, 8, 4), (2, 8, 4, 2)]


@pytest.mark.parametrize("choices", [{"scales": 1, "front": 2}, {"scales": 1}, {"scales": 3, "channels": [4, 4, 4]}])
def test_configurations_that_make_a_network(choices: dict[str, object]) -> None:
    small_network(**choices)


@pytest.mark.parametrize(
    ("choices", "named"),
    [
        ({"downsample": "median"}, "downsample is 'median', did you mean mean[?] expected one of max, mean"),
        ({"motion": "optical"}, "network.motion is 'optical'"),
        ({"front": 3}, "network.front is 3"),
        ({"kernel_size": 4}, "kernel_size .* must be odd"),
        ({"kernel_size": -1}, "kernel_size .* must be odd"),
        ({"head_size": 2}, "head_size must be odd"),
        ({"head_size": -1}, "head_size must be odd"),
        ({"scales": 0}, "network.scales is 0"),
        ({"scales": 4}, "network.scales is 4: network.channels has 3 levels"),
        ({"channels": []}, "network.channels"),
        ({"channels": [4, 0, 4]}, "network.channels"),
    ],
)
def test_configurations_that_make_none(choices: dict[str, object], named: str) -> None:
    with pytest.raises(NteError, match=named):
        small_network(**choices)
