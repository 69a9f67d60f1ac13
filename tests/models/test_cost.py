"""What a network costs: numbers that can be computed by hand."""

from dataclasses import dataclass, field
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nte.errors import NteError
from nte.info import describe
from nte.models.cost import cost_of, macs_per_pixel, receptive_field
from nte.models.temporal import TemporalConfig, TemporalDenoiser
from nte.models.trainable import NetworkConfig, TrainableDenoiser
from nte.models.unet import UNet
from tests.models.lights import light_network


@dataclass
class StackConfig(NetworkConfig):
    """Sizes of the convolutions, one after the other."""

    kind: str = "stack"
    sizes: list[int] = field(default_factory=lambda: [3, 3, 5])


class Stack(TrainableDenoiser):
    """Convolutions of the color alone, along x."""

    Config = StackConfig
    needs = ("color",)

    def __init__(self, config: StackConfig) -> None:
        super().__init__(config)
        self.layers = nn.Sequential(
            *(nn.Sequential(nn.Conv2d(3, 3, (1, size), padding=(0, size // 2)), nn.ReLU()) for size in config.sizes)
        )

    def forward(self, color: Tensor) -> tuple[Tensor]:
        """(image,)."""
        return (2 * self.layers(color),)


class Levels(Stack):
    """A U-Net whose pooling is felt: its two levels have 2 and 3 features."""

    def __init__(self, config: StackConfig) -> None:
        super().__init__(config)
        self.layers = UNet(3, [2, 3])

    def forward(self, color: Tensor) -> tuple[Tensor]:
        """(image,)."""
        return (self.layers(color)[0],)


def test_a_stack_of_convolutions() -> None:
    found = cost_of(Stack(StackConfig()))
    assert found.parameters == 2 * (3 * 9 + 3) + 5 * 9 + 3
    assert found.macs == {"layers": (3 * 9 + 3 * 9 + 5 * 9, 0), "rest": (0, 3)}
    assert found.receptive_field == 1 + 2 + 2 + 4


@pytest.mark.parametrize("wide", [1, 3, 65])
def test_the_field_grows_with_the_kernel_also_beyond_the_first_image(wide: int) -> None:
    assert receptive_field(Stack(StackConfig(sizes=[wide, wide, wide]))) == 3 * wide - 2


def test_a_u_net_by_hand() -> None:
    found = macs_per_pixel(Levels(StackConfig()))["layers"][0]
    # Level 1 works on a quarter of the pixels; the decoder sees 3 features from below beside 2 of its own.
    assert found == 9 * (3 * 2 + 2 * 2) + 9 * (2 * 3 + 3 * 3) / 4 + 9 * (5 * 2 + 2 * 2)
    # To the left of pixel 32: 2 by the decoder, 2·2 by the coarse level, 2 by the encoder; to the right one more, since
    # the coarse pixel of pixel 34 covers 35 too.
    assert receptive_field(Levels(StackConfig())) == 8 + 1 + 9
    torch.manual_seed(0)
    image = torch.rand(1, 3, 32, 64, requires_grad=True)
    network = UNet(3, [2, 3]).requires_grad_(False)
    reached = set()
    for _ in range(20):  # other weights, other maxima: together they find what a pixel can depend on
        network.apply(lambda m: m.reset_parameters() if isinstance(m, nn.Conv2d) else None)
        noise = torch.rand(1, 3, 32, 64)
        (gradient,) = torch.autograd.grad(network(image * noise)[0][0, :, 16, 32].sum(), image)
        reached |= set((gradient != 0).any(1).any(1)[0].nonzero().flatten().tolist())
    assert reached <= set(range(24, 42))
    assert max(reached) - min(reached) + 1 > 13


def test_kernels_cost_their_taps() -> None:
    config = TemporalConfig(channels=[4, 6, 8])
    found = macs_per_pixel(TemporalDenoiser(config))
    spatial = 25 * 3 * (1 + 1 / 4 + 1 / 16)
    temporal = 25 * 4 + 3 + 3  # with the mask as a fourth component; masked before, and after
    assert found["kernels"] == (0, spatial + temporal)
    assert found["prediction"][0] > 9 * 13 * 4
    assert found["reprojection"][1] == pytest.approx(4 * 3, abs=4)


def test_half_resolution_costs_less_and_sees_more() -> None:
    costs = {front: cost_of(TemporalDenoiser(TemporalConfig(channels=[4, 6, 8], front=front))) for front in (1, 2)}
    assert costs[2].receptive_field > costs[1].receptive_field
    trunk = {front: cost.macs["prediction"][0] for front, cost in costs.items()}
    assert trunk[2] < trunk[1]


def test_a_network_sees_as_far_whatever_its_weights_are() -> None:
    """Trained ones drove the predicted weights into their clamp, which hid most of the field of `steady`."""
    network = TemporalDenoiser(TemporalConfig(channels=[4, 6, 8], front=2)).requires_grad_(False)
    before = receptive_field(network)
    for parameter in network.parameters():
        parameter.mul_(100)
    assert receptive_field(network) == before


def test_measuring_leaves_the_network_as_it_is() -> None:
    network = light_network("rae").requires_grad_(True)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    pooled = F.max_pool2d
    said = cost_of(network).lines()
    assert said[0].startswith(f"{sum(p.numel() for p in network.parameters()):,} parameters, ")
    assert [line.split(":")[0].strip() for line in said[1:]] == ["reading", "encoder", "decoder", "rest"]
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())
    assert all(parameter.requires_grad for parameter in network.parameters())
    assert F.max_pool2d is pooled


def test_info_describes_a_configuration_with_its_network(tmp_path: Path) -> None:
    path = tmp_path / "small.yaml"
    path.write_text(
        "name: small\ndata: {clips: [a]}\nphases: [{steps: 1}]\n"
        "network: {target: indirect, channels: [4, 6], scales: 1, inputs: [emission]}\n"
    )
    said = describe(path).splitlines()
    assert said[0] == f"training configuration {path}"
    assert said[1] == (
        "  network 'temporal' denoises 'indirect'; needs: indirect, diffuse_albedo, normal, depth, emission, motion"
    )
    assert said[2].endswith(" pixels")
    path.write_text("name: other\nclips: 3\n")  # another YAML
    with pytest.raises(NteError, match=r"small\.yaml: 'clips': unknown key"):
        describe(path)
