"""Checkpoints: named tensors with a step and a checksum, in safetensors; nothing is pickled."""

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn, uint8
from torch.optim import Optimizer

from nte.errors import NteError
from nte.files import write_whole

CHECKPOINT = "checkpoint.safetensors"  # the last checkpoint, from which a run is resumed
BEST = "best.safetensors"  # the weights alone, at the step with the best validation
PLAIN = "denoiser."  # before the names of weights that are no average


def write_checkpoint(folder: Path, step: int, state: Mapping[str, Tensor], name: str = CHECKPOINT) -> None:
    """Replace a run's checkpoint `name` by the state after `step` steps; the file is whole or absent.

    Raises NteError if it cannot be written.
    """
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in state.items()}
    # Not save_file, which has a temporary file of its own that a killed process leaves behind.
    content = save(tensors, metadata={"step": str(step), "sha256": checksum_of(step, tensors)})
    write_whole(folder / name, lambda path: path.write_bytes(content))


def read_checkpoint(folder: Path, name: str = CHECKPOINT) -> tuple[int, dict[str, Tensor]]:
    """Read a run's checkpoint as (step, tensors by name).

    Raises NteError if it is missing or damaged; a checksum also finds a single flipped bit.
    """
    path = folder / name
    if not path.is_file():
        raise NteError(
            f"{path}: missing: the run has not reached its first {'validation' if name == BEST else 'checkpoint'}"
        )
    try:
        with safe_open(path, framework="pt") as file:
            step, checksum = int(file.metadata()["step"]), file.metadata()["sha256"]
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise NteError(f"{path}: not a checkpoint of ours, or damaged: {error}") from error
    if step < 0 or checksum_of(step, tensors) != checksum:
        raise NteError(f"{path}: damaged: its checksum does not fit: restore a copy, or train again")
    return step, tensors


def checksum_of(step: int, tensors: Mapping[str, Tensor]) -> str:
    """Compute the SHA-256 of a step and of tensors on the CPU: their names, types, shapes and bytes."""
    digest = sha256(str(step).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {kind_of(tensor)}".encode())
        digest.update(tensor.contiguous().flatten().view(uint8).numpy().tobytes())
    return digest.hexdigest()


def module_state(prefix: str, module: nn.Module) -> dict[str, Tensor]:
    """Collect a module's parameters and buffers, with a prefix before their names."""
    return {prefix + name: tensor for name, tensor in module.state_dict().items()}


def weights_prefix(state: Mapping[str, Tensor]) -> str:
    """Return the prefix of the weights that are used after training: of their moving average if there is one."""
    return "average.module." if "average.n_averaged" in state else PLAIN


def load_module(module: nn.Module, state: Mapping[str, Tensor], prefix: str, source: Path) -> None:
    """Fill a module from the tensors in `state` whose names have the prefix.

    Raises NteError, naming `source`, for the first tensor that is missing, of another shape or type, not finite, or
    that the module does not have.
    """
    own = {name[len(prefix) :]: tensor for name, tensor in state.items() if name.startswith(prefix)}
    for name, tensor in module.state_dict().items():
        found, expected = (kind_of(t) for t in (own.get(name), tensor))
        if found != expected:
            raise NteError(f"{source}: does not fit the configuration: '{name}' is {found}, expected {expected}")
        if not own[name].isfinite().all():
            raise NteError(f"{source}: '{name}' has values that are not finite: the run has diverged, train it again")
    surplus = sorted(own.keys() - module.state_dict().keys())
    if surplus:
        raise NteError(f"{source}: does not fit the configuration: '{surplus[0]}' has no place in the network")
    module.load_state_dict(own)


def optimiser_state(optimiser: Optimizer) -> dict[str, Tensor]:
    """Collect the optimiser's tensors, named optimiser.INDEX.QUANTITY by the parameter's index."""
    states = optimiser.state_dict()["state"]
    return {f"optimiser.{i}.{key}": value for i, state in states.items() for key, value in state.items()}


def load_optimiser(optimiser: Optimizer, state: Mapping[str, Tensor], source: Path) -> None:
    """Fill an optimiser from the tensors of `optimiser_state`.

    Raises NteError, naming `source`, if a parameter's state is missing, of another shape or type, or not finite.
    """
    states: dict[int, dict[str, Tensor]] = {}
    for name, tensor in state.items():
        if name.startswith("optimiser."):
            _, index, key = name.split(".", 2)
            states.setdefault(int(index), {})[key] = tensor
    groups = optimiser.state_dict()["param_groups"]
    parameters = [parameter for group in optimiser.param_groups for parameter in group["params"]]
    for number, parameter in enumerate(parameters):
        if number not in states:
            raise NteError(f"{source}: does not fit the configuration: no optimiser state of parameter {number}")
        for key, tensor in states[number].items():
            if (tensor.ndim and kind_of(tensor) != kind_of(parameter)) or not tensor.isfinite().all():
                what = f"'{key}' of parameter {number} is {kind_of(tensor)}, expected finite {kind_of(parameter)}"
                raise NteError(f"{source}: does not fit the configuration: {what}")
    optimiser.load_state_dict({"state": states, "param_groups": groups})


def kind_of(tensor: Tensor | None) -> str:
    """Say a tensor's type and shape, such as float32 (32, 16)."""
    return "nothing" if tensor is None else f"{str(tensor.dtype).removeprefix('torch.')} {tuple(tensor.shape)}"
