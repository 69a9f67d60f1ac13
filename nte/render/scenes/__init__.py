"""Families of procedural scenes: name → a function that makes one scene from a random generator."""

from collections.abc import Callable

import numpy as np

from nte.render.scene import Scene
from nte.render.scenes.rooms import make_room

FAMILIES: dict[str, Callable[[np.random.Generator], Scene]] = {"rooms": make_room}
