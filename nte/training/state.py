"""The state of training, which a checkpoint holds: weights, their moving average, optimiser and random state."""

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from nte.errors import NteError
from nte.training.checkpoint import CHECKPOINT, load_module, load_optimiser, module_state, optimiser_state
from nte.training.run import RunFolder


class TrainingState:
    """The state of training as named tensors: weights, their moving average, optimiser and random state."""

    def __init__(self, denoiser: nn.Module, optimiser: torch.optim.Optimizer, average: AveragedModel | None) -> None:
        self.denoiser, self.optimiser, self.average = denoiser, optimiser, average

    def tensors(self) -> dict[str, Tensor]:
        """Collect weights, moving average, optimiser and random state, by name."""
        state = module_state("denoiser.", self.denoiser) | optimiser_state(self.optimiser)
        if self.average is not None:
            state |= module_state("average.", self.average)
        # Batches depend on (seed, step) alone; the generator is kept for layers that draw numbers.
        return state | {"random.torch": torch.get_rng_state()}

    def trained(self) -> dict[str, Tensor]:
        """Return the weights that are used after training: their moving average if there is one."""
        if self.average is None:
            return module_state("denoiser.", self.denoiser)
        return module_state("average.", self.average)

    def not_finite(self) -> str:
        """Name the first tensor of weights or optimiser with a value that is not finite; empty if there is none."""
        tensors = module_state("", self.denoiser) | optimiser_state(self.optimiser)
        return next((name for name, tensor in tensors.items() if not tensor.isfinite().all()), "")

    def resume(self, run: RunFolder, last: int) -> int:
        """Load the run's checkpoint and return the number of steps done; 0 without a checkpoint.

        Raises NteError for a checkpoint that does not fit, or of a step after the last.
        """
        loaded = run.load()
        if loaded is None:
            return 0
        step, state = loaded
        if step > last:
            raise NteError(f"{run.folder / CHECKPOINT}: is of step {step}, but the run ends after step {last}")
        load_module(self.denoiser, state, "denoiser.", run.folder / CHECKPOINT)
        if self.average is not None:
            load_module(self.average, state, "average.", run.folder / CHECKPOINT)
        load_optimiser(self.optimiser, state, run.folder / CHECKPOINT)
        if "random.torch" not in state:
            raise NteError(f"{run.folder / CHECKPOINT}: does not fit the configuration: 'random.torch' is missing")
        torch.set_rng_state(state["random.torch"])
        return step
