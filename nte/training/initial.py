"""Weights that a run begins with, from another run: all that fit by name and shape, whatever the rest is."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from torch import Tensor, nn

from nte.errors import NteError
from nte.released import weights_path
from nte.training.checkpoint import CHECKPOINT, PLAIN, checksum_of, kind_of, read_checkpoint, weights_prefix
from nte.training.checkpoint import write_checkpoint as write

_NAMED = 8  # most tensors that a line names


class InitialWeights(NamedTuple):
    """The weights of a run or checkpoint, by their names in the network, and the digest that identifies them."""

    source: Path
    step: int
    tensors: Mapping[str, Tensor]
    digest: str


def read_weights(source: Path) -> InitialWeights:
    """Read the weights that a run, a checkpoint RUN/best.safetensors or a released model, by its name, uses.

    An existing run wins over a name. Raises NteError if there is no such checkpoint, or if it is damaged.
    """
    if not source.is_file() and not (source / CHECKPOINT).is_file():
        source = weights_path(str(source)) or source
    folder, name = (source.parent, source.name) if source.suffix == ".safetensors" else (source, CHECKPOINT)
    if not (folder / name).is_file():
        what = "has no checkpoint" if source.is_dir() else "does not exist"
        raise NteError(
            f"init_from: {source} {what}: expected a run folder, or a checkpoint such as RUN/best.safetensors"
        )
    step, state = read_checkpoint(folder, name)
    prefix = weights_prefix(state)
    tensors = {key[len(prefix) :]: value for key, value in state.items() if key.startswith(prefix)}
    return InitialWeights(source, step, tensors, checksum_of(0, tensors)[:16])


def write_weights(source: Path, out: Path) -> None:
    """Write the weights that a run, or a checkpoint, uses after training, alone: what another run can begin with.

    Raises NteError as `read_weights` does, and if the file cannot be written.
    """
    weights = read_weights(source)
    write(out.parent, weights.step, {PLAIN + name: t for name, t in weights.tensors.items()}, out.name)


def begin_with(network: nn.Module, weights: InitialWeights) -> str:
    """Copy the weights that fit the network by name, type and shape; say in a line which do not.

    Raises NteError if none fits, and if one of them is not finite.
    """
    own = network.state_dict()
    fits = {name: value for name, value in weights.tensors.items() if kind_of(value) == kind_of(own.get(name))}
    others = [
        f"{name} ({kind_of(weights.tensors.get(name))} there, {kind_of(value)} here)"
        for name, value in own.items()
        if name not in fits
    ]
    surplus = sorted(weights.tensors.keys() - own.keys())
    if not fits:
        raise NteError(
            f"init_from: {weights.source}: none of its {len(weights.tensors)} tensors fits the network by name and "
            f"shape; it differs in {_listed(others)}"
        )
    if bad := [name for name, value in fits.items() if not value.isfinite().all()]:
        raise NteError(f"init_from: {weights.source}: '{bad[0]}' has values that are not finite: that run has diverged")
    network.load_state_dict({**own, **fits})
    said = f"init_from {weights.source}: {len(fits)} of {len(own)} tensors fit"
    said += f"; new are {_listed(others)}" if others else ""
    return said + (f"; without a place here: {_listed(surplus)}" if surplus else "")


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more
