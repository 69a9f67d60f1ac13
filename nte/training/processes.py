"""The processes of a training on their devices: one, or those that torchrun starts, which need each other."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING

import torch

from nte.errors import NteError, needs_extra

if TYPE_CHECKING:  # its import takes twice as long as that of PyTorch
    from lightning_fabric import Fabric

PATIENCE = 1800  # seconds that a process waits for the others: while the first one validates they wait for it


def launch(device: str, seed: int) -> "Fabric":
    """Start one process on one device; under torchrun one of its processes, on the device of its local rank.

    Raises NteError for a device that does not exist.
    """
    try:
        from lightning_fabric import Fabric
        from lightning_fabric.strategies import DDPStrategy
    except ImportError as error:
        raise needs_extra("train", "training", error) from error
    kind, _, index = device.partition(":")
    processes = int(os.environ.get("LOCAL_WORLD_SIZE", 1)) if "TORCHELASTIC_RUN_ID" in os.environ else 0
    devices: int | list[int] = processes or ([int(index)] if index.isdigit() else 1)
    try:
        # Fabric's own mixed precision would round the inputs to bfloat16, including every motion vector.
        fabric = Fabric(
            accelerator=kind,
            devices=devices,
            num_nodes=int(os.environ.get("GROUP_WORLD_SIZE", 1)),
            strategy=DDPStrategy(timeout=timedelta(seconds=PATIENCE)) if processes else "auto",
            precision="32-true",
        )
        fabric.launch()
    except (ValueError, RuntimeError, AssertionError) as error:
        raise NteError(f"--device {device}: {str(error).splitlines()[0]}") from error
    torch.use_deterministic_algorithms(fabric.device.type == "cpu")
    # It would also fill every new tensor with NaN, which took a tenth of a step.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    fabric.seed_everything(seed, verbose=False)
    return fabric


@contextmanager
def needing_each_other(fabric: "Fabric") -> Iterator[None]:
    """Raise NteError if another process of the training ends within the block, or does not answer for PATIENCE.

    Which one it was, a process cannot tell; torchrun can.
    """
    try:
        yield
    except RuntimeError as error:
        # Gloo has no class of errors: its messages begin with the file that they come from.
        if fabric.world_size == 1 or not (isinstance(error, torch.distributed.DistError) or "gloo" in str(error)):
            raise
        here = f"process {fabric.global_rank} of {fabric.world_size}, counted from 0"
        what = f"another one has ended, or has not answered for {PATIENCE} seconds"
        raise NteError(f"{here}: {what}: see which one torchrun names; continue with resume=true") from error
