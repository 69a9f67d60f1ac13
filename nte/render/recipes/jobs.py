"""What the rendering of a clip asks of the process that does it, for `nte.jobs`.

The unit is a clip. Its scene is built and its kernels are compiled once, and everything that it depends on is in its
plan. An interrupted clip keeps its whole frames, so a lost worker costs a frame and not a clip. Two workers that are
given the same clip write the same bytes, each frame whole.
"""

from nte.jobs import Kind
from nte.render.engine.backend import load_mitsuba, share_cores
from nte.version import versions_of


def _versions() -> dict[str, str]:
    """What the bytes of a frame depend on besides nte."""
    return {**versions_of("mitsuba", "drjit", "numpy"), "Mitsuba's variant": str(load_mitsuba().variant())}


RENDERING = Kind("render", share_cores, _versions)
