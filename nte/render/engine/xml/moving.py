"""What moves or dims in an XML scene: the parameters of Mitsuba that keyframes change."""

from collections.abc import Mapping, Sequence

import numpy as np

from nte.errors import NteError
from nte.render.engine.backend import load_mitsuba
from nte.render.engine.types import MitsubaScene, Parameters, Shape, Struct
from nte.render.world.keyframes import Key
from nte.render.world.transforms import Floats, transform_points

_ROUND = ("Sphere", "Cylinder")  # stay so, whatever a transform says
_SCALES = ("scale", "sun_scale", "sky_scale")
_EMISSION = tuple(f"{kind}.{form}" for kind in ("intensity", "irradiance", "radiance") for form in ("value", "data"))
_VERTICES = ("vertex_positions", "vertex_normals")


def place_of(name: str, keys: Sequence[Key], parameters: Parameters, shapes: Sequence[Shape]) -> dict[str, Floats]:
    """Find the parameters that say where a shape or light is, by their names, with their values at rest.

    keys: its keyframes. parameters: of the scene. Raises NteError for what cannot be moved, or not like this.
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
    """Find the parameters of a light, a shape or not, and the values in the XML of those that say how bright it is.

    Raises NteError where there is none.
    """
    mi = load_mitsuba()
    for emitter in scene.emitters():
        shape = emitter.get_shape()
        if name in (emitter.id(), shape.id() if shape else None):
            parameters: Parameters = mi.traverse(emitter)
            # A projector has a scale and an irradiance; an 8-bit texture's numbers are codes, not light.
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
    """Return the value of a parameter; a transform's 4×4 without Dr.Jit's axis of lanes."""
    is_transform = name.rpartition(".")[2] == "to_world"
    return np.array(value.matrix, float).reshape(4, 4) if is_transform else np.array(value, float)


def moved_by(matrix: Floats, name: str, value: Floats) -> Struct:
    """Return the value of a parameter, as Mitsuba takes it, after a transform 4×4."""
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
