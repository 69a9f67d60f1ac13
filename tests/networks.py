"""Small networks whose weights are random, but not small: what they predict matters in every pixel."""

import torch

from nte.models.temporal import TemporalConfig, TemporalDenoiser


def small_network(seed: int = 0, **choices: object) -> TemporalDenoiser:
    """A network of three narrow levels with the given configuration, in evaluation mode."""
    config = TemporalConfig(**({"channels": [4, 6, 8]} | choices))  # type: ignore[arg-type]
    torch.manual_seed(seed)
    network = TemporalDenoiser(config).eval().requires_grad_(False)
    for head in network.prediction.heads.heads:
        head.weight.mul_(3)
    return network
