"""The table of networks: what `network.kind` in a training configuration means. A new network is a new row."""

from importlib import import_module
from typing import Any

from nte.errors import NteError
from nte.frames.channels import CHANNELS, TARGETS
from nte.models.trainable import NetworkConfig, TrainableDenoiser
from nte.recurrence import FORWARD, SCALARS

DEFAULT = "temporal"  # the kind of a configuration that names none
# kind → module:class; modules are imported on demand
KINDS = {"temporal": "nte.models.temporal:TemporalDenoiser"}


def network_type(kind: Any) -> type[TrainableDenoiser]:
    """Return the class that `kind` names: a row of KINDS, or package.module:Class for a network in another package.

    Raises NteError if there is no such class, or if it is not a TrainableDenoiser.
    """
    known = f"expected {', '.join(KINDS)}, or package.module:Class"
    place = KINDS.get(kind, kind) if isinstance(kind, str) else ""
    module, colon, name = place.partition(":")
    if not (colon and module and name):
        raise NteError(f"'network.kind' is {kind!r}, {known}")
    try:
        found = getattr(import_module(module), name, None)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise  # the module exists, but an import inside it fails
        way = "install it, or name its folder in PYTHONPATH"
        raise NteError(f"'network.kind' is '{kind}': there is no module '{error.name}': {way}") from error
    if not (isinstance(found, type) and issubclass(found, TrainableDenoiser)):
        raise NteError(f"'network.kind' is '{kind}': {module} has no TrainableDenoiser of that name; {known}")
    return found


def make_network(config: NetworkConfig) -> TrainableDenoiser:
    """Make the network that the configuration describes, with new weights.

    Raises NteError for settings that make no network, and for a network whose declarations contradict each other.
    """
    network = network_type(config.kind)(config)
    channels = {*network.needs, *network.optional}
    for name in channels:
        if name not in CHANNELS:
            raise NteError(f"network '{config.kind}' takes the channel '{name}', which is not in the table of channels")
    if network.target not in TARGETS:
        raise NteError(f"network '{config.kind}' has the target '{network.target}', expected {', '.join(TARGETS)}")
    for name in network.inputs:
        if name not in {*channels, FORWARD, *SCALARS, *network.recurrent}:
            taken = ", ".join(sorted({*channels, *SCALARS, *network.recurrent}))
            raise NteError(f"network '{config.kind}': its forward takes '{name}', expected some of {taken}")
    return network
