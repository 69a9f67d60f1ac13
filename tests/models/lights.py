"""Networks of every kind and light, in small, and frames that have all of their channels."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from nte.evaluation.benchmark.frames import synthetic_frames
from nte.frames.channels import CHANNELS, REFERENCES
from nte.frames.frame import Frame
from nte.models.registry import make_network, network_type
from nte.models.trainable import TrainableDenoiser

ALL = {"moments": True, "history_length": True, "feature_history": 3, "feed_masks": True}
NETWORKS: dict[str, tuple[str, dict[str, Any]]] = {  # name → kind, settings
    "color": ("temporal", {}),
    "indirect": ("temporal", {"target": "indirect", "demodulate": True, "front": 2, **ALL}),
    "visibility": ("temporal", {"target": "visibility", "inputs": ["direct", "roughness"], **ALL}),
    "share alone": ("temporal", {"target": "visibility", "moments": True}),
    "glossy": ("temporal", {"target": "glossy", "motion": "traditional", "inputs": ["color", "motion", "gradient"]}),
    "one frame": ("temporal", {"target": "glossy", "scales": 1, "temporal": False, "feed_warped": False}),
    "warped only": ("temporal", {"target": "indirect", "temporal": False}),
    "mixing": ("temporal", {"finest": "mixing", "front": 2, "demodulate": True, **ALL}),
    "mixing share": ("temporal", {"finest": "mixing", "front": 2, "scales": 2, "target": "visibility"}),
    "on top": ("temporal", {"finest": "mixing", "front": 2, "demodulate": True, "prior": "noisy"}),
    "rae": ("rae", {"target": "indirect", "demodulate": True}),
    "separated": ("separated", {}),
    "rae share": ("rae", {"target": "visibility", "inputs": ["emission"]}),
}
OF_KERNELS = [name for name, (kind, _) in NETWORKS.items() if kind == "temporal"]


def light_network(name: str, seed: int = 0) -> TrainableDenoiser:
    """A row of NETWORKS with three narrow levels and weights that matter, in evaluation mode."""
    kind, choices = NETWORKS[name]
    torch.manual_seed(seed)
    network = make_network(network_type(kind).Config(kind=kind, **({"channels": [4, 6, 8]} | choices)))
    network = network.eval().requires_grad_(False)
    for parameter_name, parameter in network.named_parameters():
        if "heads" in parameter_name and parameter.ndim == 4:
            parameter.mul_(3)
    return network


def frames_of_all(count: int, size: tuple[int, int] = (24, 36)) -> list[Frame]:
    """A sequence with every channel that a denoiser may see: no reference, and nothing of the future."""
    seen = [name for name in CHANNELS if name not in REFERENCES and name != "forward_motion"]
    source = synthetic_frames(size, seen)
    return [source(index) for index in range(count)]


def images(network: TrainableDenoiser, frames: list[Frame]) -> list[np.ndarray]:
    """The images of a sequence, of which the network gets only the channels that it asks for."""
    made, state = [], None
    for frame in frames:
        asked = {name: frame[name] for name in (*network.needs, *network.optional) if name in frame}
        result, state = network.step(replace(frame, channels=asked), state)
        made.append(result.image)
    return made
