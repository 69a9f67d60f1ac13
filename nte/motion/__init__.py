"""Motion vectors as pure PyTorch functions: of surfaces, of shadows and reflections, and of matching images.

A module is loaded when one of its functions is first used, so that `import nte` needs no PyTorch.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "camera": ("motion_of", "move", "points_from_depth", "project"),
    "geometric": ("dual_motion", "frame_vectors", "scatter_forward_motion", "traditional_motion"),
    "reliable": ("mirror_image", "reflection_covariance", "reflection_motion", "shadow_motion", "shadow_point"),
    "warp": ("fetch_nearest", "inside", "pixel_centres", "warp"),
}
# `warp` names a module and a function in it; here it stays the module.
_HOME = {name: module for module, names in _HOMES.items() for name in names if name not in _HOMES}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'nte.motion' has no attribute '{name}'")
    return getattr(import_module(f"nte.motion.{_HOME[name]}"), name)
