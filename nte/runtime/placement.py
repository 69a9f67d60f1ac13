"""Which operators of a model a provider would leave to the CPU: it is asked where it is installed, else its list is."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

from omegaconf import OmegaConf

from nte.runtime.onnx_engine import session_for
from nte.runtime.onnx_file import operators_of
from nte.runtime.providers import PROVIDERS, OnnxOptions, installed, require_installed

_LISTS = Path(__file__).with_name("operators.yaml")


class Placement(NamedTuple):
    """What a provider does with a model."""

    refused: tuple[str, ...]  # kinds of operators that it takes nowhere in the model, in alphabetical order
    asked: bool  # the provider was asked; else its list says so, which knows no types and no sizes

    def said(self, provider: str) -> str:
        """Say it in a line."""
        source = "" if self.asked else "not installed; by its list it "
        does = f"refuses {', '.join(self.refused)}" if self.refused else "takes every operator"
        return f"{provider}: {source}{does}"


def placement(path: Path, provider: str) -> Placement | None:
    """Find the operators of the model at `path` that a provider refuses; None if it is not there and has no list.

    provider: one of PROVIDERS. ONNX Runtime computes refused operators on the CPU, so tensors travel there and back;
    OpenVINO does not run such a model at all. Raises NteError if an installed provider cannot load the model.
    """
    if provider not in installed():
        listed = _lists().get(provider)
        return None if listed is None else Placement(tuple(sorted(operators_of(path) - listed)), asked=False)
    require_installed(provider)
    if not PROVIDERS[provider].name:
        from nte.runtime.openvino_engine import refused_by_openvino

        return Placement(tuple(refused_by_openvino(path)), asked=True)
    parts = session_for(
        path, OnnxOptions.parse({"provider": provider}, provider), record=True
    ).get_provider_graph_assignment_info()
    taken, others = set[str](), set[str]()
    for part in parts:
        (taken if part.ep_name == PROVIDERS[provider].name else others).update(n.op_type for n in part.get_nodes())
    return Placement(tuple(sorted(others - taken)), asked=True)  # what computes sizes is on the CPU on purpose


@cache
def _lists() -> dict[str, frozenset[str]]:
    """Provider → the operators that its documentation lists."""
    read = OmegaConf.load(_LISTS)
    return {str(provider): frozenset(str(kinds).split()) for provider, kinds in read.items()}
