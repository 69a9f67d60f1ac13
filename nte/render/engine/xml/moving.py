"""The parameters of Mitsuba by which keyframes move or dim parts of an XML scene."""

from collections.abc import Mapping, Sequence

import numpy as np

from nte.errors import NteError
from nte.render.engine.backend import load_mitsuba
from nte.render.engine.types import MitsubaScene, Parameters, Shape, Struct
from nte.render.world.keyframes import Key
from nte.render.world.transforms import Floats, transform_points

_ROUND = ("Sphere", "Cylinder")  # stay round: unequal scales are refused
_SCALES = ("scale", "sun_scale", "sky_scale")
_EMISSION = tuple(f"{kind}.{form}" for kind in ("intensity", "irradiance", "radiance") for form in ("value", "data"))
_VERTICES = ("vertex_positions", "vertex_normals")


def place_of(name: str, keys: Sequence[Key], parameters: Parameters, shapes: Sequence[Shape]) -> dict[str, Floats]:
    """Find the parameters that place a shape or light, by name, with their values at rest.

    keys: its keyframes. parameters: the scene's parameters. Raises NteError for something that cannot be moved, or
    cannot be moved in this way.
    """
    known = {key.rpartition(".")[2]: key for key, _ in parameters.items() if key.rpartition(".")[0] == name}
    chosen = [known[kind] for kind in (*_VERTICES, "to_world", "position") if kind in known]
    if not chosen:
        raise NteError(f"'{name}' cannot be moved: Mitsuba has no parameter for its place")
    shape = next((shape for shape in shapes if shape.id() == name), None)
    if shape is not None and shape.class_name() in _ROUND and any(len({*key.scale}) > 1 for key in keys):
        raise NteError(f"'{name}' is a {shape.class_name().lower()}: expected the same scale along all axes")
    return {key: array_of(key, parameters[key]) for key in chosen}


def brightness_of(name: str, scene: MitsubaScene) -> tuple[Parameters, Mapping[str, Struct]]:
    """Find the parameters of a light, and the XML's values of those parameters that set its brightness.

    name: the id of a light or of a shape that is one. Raises NteError where there is no such light or parameter.
    """
    mi = load_mitsuba()
    for emitter in scene.emitters():
        shape = emitter.get_shape()
        if name in (emitter.id(), shape.id() if shape else None):
            parameters: Parameters = mi.traverse(emitter)
            # A projector has a scale and an irradiance. The numbers of an 8-bit texture are codes, not light.
            chosen = [key for key, _ in parameters.items() if key in _SCALES] or [
                key for key, value in parameters.items() if key in _EMISSION and not isinstance(value, mi.TensorXu8)
            ]
            if not chosen:
                raise NteError(
                    f"the brightness of '{name}' cannot change: expected a light with a scale, or a colour or a "
                    "texture of floating-point numbers (format: variant) as intensity, radiance or irradiance"
                )
            return parameters, {key: type(parameters[key])(parameters[key]) for key in chosen}
    raise NteError(f"'{name}' has a brightness, but sends out no light")


def array_of(name: str, value: Struct) -> Floats:
    """Return the value of a parameter as an array; a transform as 4×4, without Dr.Jit's axis of lanes."""
    is_transform = name.rpartition(".")[2] == "to_world"
    return np.array(value.matrix, float).reshape(4, 4) if is_transform else np.array(value, float)


def moved_by(matrix: Floats, name: str, value: Floats) -> Struct:
    """Return the value of a parameter after a 4×4 transform, as Mitsuba takes it."""
    mi = load_mitsuba()
    kind = name.rpartition(".")[2]
    if kind == "to_world":
        return mi.Transform4f(matrix @ value)
    if kind == "vertex_normals":
        turned = value.reshape(-1, 3) @ np.linalg.inv(matrix)[:3, :3]
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        return np.ascontiguousarray(turned / np.maximum(length, 1e-30), np.float32).ravel()
    moved = transform_points(matrix, value.reshape(-1, 3))
    if kind == "position":
        return mi.Point3f(moved[0])
    return np.ascontiguousarray(moved, np.float32).ravel()
