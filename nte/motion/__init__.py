"""Motion vectors as pure PyTorch functions: of surfaces, of what they show, and where images agree.

The modules are loaded when a function is first asked for, so that `import nte` needs no PyTorch.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "camera": ("motion_of", "move", "points_from_depth", "project"),
    "geometric": ("dual_motion", "frame_vectors", "scatter_forward_motion", "traditional_motion"),
    "reliable": ("mirror_image", "reflection_covariance", "reflection_motion", "shadow_motion", "shadow_point"),
    "warp": ("fetch_nearest", "inside", "pixel_centres", "warp"),
}
# `warp` is a module and a function in it; the module keeps the name.
_HOME = {name: module for module, names in _HOMES.items() for name in names if name not in _HOMES}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'nte.motion' has no attribute '{name}'")
    return getattr(import_module(f"nte.motion.{_HOME[name]}"), name)
