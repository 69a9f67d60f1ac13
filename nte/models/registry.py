"""The table of networks: what `network.kind` in a training configuration means. A new network is a new row."""

from inspect import Parameter, signature
from typing import Any

from nte.elsewhere import class_elsewhere, is_elsewhere
from nte.errors import NteError, expected_one_of
from nte.frames.channels import CHANNELS, TARGETS
from nte.models.trainable import NetworkConfig, TrainableDenoiser
from nte.recurrence import FORWARD, MEASURED, SCALARS

DEFAULT = "temporal"  # the kind of a configuration that names none
# kind → module:class; modules are imported on demand
KINDS = {
    "temporal": "nte.models.temporal:TemporalDenoiser",
    "rae": "nte.models.rae:RecurrentAutoencoder",
    "separated": "nte.models.separated:SeparatedDenoiser",
}


def network_type(kind: Any) -> type[TrainableDenoiser]:
    """Return the class that `kind` names: a row of KINDS, or package.module:Class for a network in another package.

    Raises NteError if there is no such class, or if it is not a TrainableDenoiser.
    """
    place = KINDS.get(kind, kind) if isinstance(kind, str) else ""
    if not is_elsewhere(place):
        raise NteError(f"'network.kind' is {kind!r}{expected_one_of(kind, KINDS)}, or package.module:Class")
    found = class_elsewhere(place, TrainableDenoiser, f"'network.kind' is '{kind}'")
    name = found.__name__
    if not issubclass(getattr(found, "Config", object), NetworkConfig):
        raise NteError(f"'network.kind' is '{kind}': {name} has no Config, expected a dataclass based on NetworkConfig")
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
        instead = expected_one_of(network.target, TARGETS)
        raise NteError(f"network '{config.kind}' has the target '{network.target}'{instead}")
    for name in network.inputs:
        if name not in {*channels, FORWARD, *SCALARS, *network.recurrent}:
            taken = sorted({*channels, *SCALARS, *network.recurrent})
            raise NteError(f"network '{config.kind}': its forward takes '{name}'{expected_one_of(name, taken)}")
    for parameter in signature(network.forward).parameters.values():
        if parameter.kind not in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.VAR_POSITIONAL):
            raise NteError(
                f"network '{config.kind}': its forward takes '{parameter}' in a way that export cannot give "
                "it: expected plain parameters"
            )
    if FORWARD in network.inputs and not {"motion", "depth"} <= {*network.needs}:
        raise NteError(
            f"network '{config.kind}': its forward takes '{FORWARD}', which is made of motion and depth: "
            "expected both in needs"
        )
    for name, channel in MEASURED.items():
        if name in network.inputs and channel not in channels:
            raise NteError(
                f"network '{config.kind}': its forward takes '{name}', which is measured from {channel} where it is "
                f"not given: expected {channel} in optional"
            )
    for name, tensor in network.recurrent.items():
        if name in {*CHANNELS, *SCALARS}:
            raise NteError(f"network '{config.kind}' carries '{name}', which is an input already: give it another name")
        if tensor.source in {*CHANNELS, *SCALARS} and tensor.source not in network.inputs:
            raise NteError(f"network '{config.kind}' carries '{tensor.source}' on, which its forward does not take")
        if tensor.scale < 1 or tensor.components < 0 or (tensor.components == 0) != (tensor.source in SCALARS):
            raise NteError(
                f"network '{config.kind}' carries '{name}' as {tensor}, expected components and scale from 1, and 0 "
                f"components only for {', '.join(SCALARS)}"
            )
    if both := [name for name in network.outputs if name in network.inputs]:
        raise NteError(f"network '{config.kind}' takes and gives '{both[0]}': give what it gives another name")
    return network
