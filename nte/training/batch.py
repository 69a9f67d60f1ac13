"""Training batches: several sequences, frame by frame, in plain tensors."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame

Batch = list[dict[str, Tensor]]  # per frame: channels (N, C, H, W), and exposure, depth_scale and shutter (N,)


def collate(sequences: Sequence[dict[str, Tensor]]) -> Batch:
    """Join sequences to a batch: a list of frames, with channels (N, C, H, W) and scalars (N,).

    sequences: channels (F, C, H, W) and scalars (1,) by name. A channel that one of them lacks is left out.
    """
    shared = {k: v for k, v in sequences[0].items() if all(k in s for s in sequences)}
    scalars = {k: torch.cat([s[k] for s in sequences]) for k, v in shared.items() if v.ndim == 1}
    images = {k: torch.stack([s[k] for s in sequences], 1) for k, v in shared.items() if v.ndim == 4}
    count = len(next(iter(images.values())))
    return [{name: values[i] for name, values in images.items()} | scalars for i in range(count)]


def as_frames(batch: Batch) -> Iterator[Frame]:
    """Yield the frames of a batch, for a denoiser to step through."""
    for index, values in enumerate(batch):
        channels = {name: value for name, value in values.items() if name in CHANNELS}
        exposure, depth_scale, shutter = (values.get(name) for name in ("exposure", "depth_scale", "shutter"))
        yield Frame(channels, index, exposure=exposure, depth_scale=depth_scale, shutter=shutter)
