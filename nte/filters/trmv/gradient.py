"""The temporal component of A-SVGF in place of reliable vectors: the paper's «temporal gradient» comparison."""

from torch import Tensor

from nte.filters.asvgf import change_of, stratify
from nte.filters.moments import brightness
from nte.filters.reproject import geometry_of
from nte.filters.scope import scope
from nte.frames.frame import Frame


def unchanged(frame: Frame, component: str, light: Tensor) -> Tensor:
    """Compute 1 − λ, (N, 1, H, W): how far the history of a component is trusted, so that α ← lerp(α, 1, λ).

    The gradients come from `gradient_<component>` (N, 2, H, W) where the frame has it, else from `gradient`, which
    covers all light. light (N, C, H, W): the component's noisy samples.
    """
    with scope(f"trmv/{component}/gradient"):
        own = frame.get(f"gradient_{component}")
        geometry = geometry_of(frame["depth"], frame["normal"])
        change = change_of(stratify(frame["gradient"] if own is None else own, brightness(light), geometry))
        return 1 - change[..., : light.shape[2], : light.shape[3]]
