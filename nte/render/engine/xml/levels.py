"""A scene of two levels: everything that stands still as one part, and every moving shape as a part of its own.

Mitsuba (3.9.1) rebuilds its acceleration structure over all triangles whenever anything moves. Below a level of
instances it rebuilds several times faster, and moving a shape takes a transform instead of new vertices. Several scenes
can share all shapes: one scene for the time of a frame and one for the time before, so each frame moves only one.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from nte.render.engine.backend import load_mitsuba
from nte.render.engine.types import MitsubaScene, Parameters, Plugin, Shape
from nte.render.world.transforms import Floats

_SOLIDS = ("Sphere", "Cylinder", "Disk", "Rectangle")
_STILL, _MOVING = "nte_still", "nte_moving"


@dataclass
class Levels:
    """One Mitsuba scene over shared shapes, as it is at one time."""

    scene: MitsubaScene
    still: Shape | None  # the instance of everything that stands still; None if nothing does
    moving: Mapping[str, Shape]  # the instances of the moving shapes, by the names of the shapes
    parameters: Parameters  # mi.traverse of the scene
    time: float | None = None

    def instances(self) -> list[Shape]:
        """Return all instances, in an order that is the same in every scene over the same shapes."""
        return [*self.moving.values(), *([] if self.still is None else [self.still])]

    def move(self, transforms: Mapping[str, Floats], time: float) -> None:
        """Move the moving shapes from their places in the XML by 4×4 transforms; costs one rebuild."""
        mi = load_mitsuba()
        for name, instance in self.moving.items():
            parameters = mi.traverse(instance)
            parameters["to_world"] = mi.Transform4f(transforms[name])
            parameters.update()
        self.scene.parameters_changed(["to_world"])
        self.time = time


def can_be_grouped(shape: Shape) -> bool:
    """Say whether a shape may be part of a shapegroup: no light, sensor, border of a medium or instance."""
    usual = shape.is_mesh() or shape.class_name() in _SOLIDS
    media = shape.interior_medium() is not None or shape.exterior_medium() is not None
    return usual and not media and not shape.is_emitter() and not shape.is_sensor()


def levels(scene: MitsubaScene, shapes: Sequence[Shape], moving: Iterable[str], count: int) -> list[Levels]:
    """Make `count` scenes of two levels out of one scene.

    shapes: the scene's shapes. moving: names of shapes. Returns an empty list if a moving shape cannot be grouped, or
    if the XML has instances of its own, which Mitsuba (3.9.1) refuses to take into a second scene. Lights, and shapes
    that stand still and cannot be grouped, stay where they are.
    """
    moving = set(moving)
    free = [shape for shape in shapes if not can_be_grouped(shape)]
    if not moving or any(shape.id() in moving or shape.class_name() == "Instance" for shape in free):
        return []
    return [_levels(scene, shapes, moving) for _ in range(count)]


def _levels(scene: MitsubaScene, shapes: Sequence[Shape], moving: set[str]) -> Levels:
    mi = load_mitsuba()
    names = [shape.id() for shape in shapes]
    still = [shape for shape in shapes if can_be_grouped(shape) and shape.id() not in moving]
    parts: Plugin = {"type": "scene", "integrator": {"type": "path"}}
    parts |= {f"sensor_{i}": sensor for i, sensor in enumerate(scene.sensors())}
    parts |= {f"light_{i}": light for i, light in enumerate(scene.emitters()) if light.get_shape() is None}
    parts |= {f"free_{i}": shape for i, shape in enumerate(shapes) if not can_be_grouped(shape)}
    groups = {_STILL: still} if still else {}
    groups |= {f"{_MOVING}_{i}": [shape] for i, shape in enumerate(shapes) if shape.id() in moving}
    for name, members in groups.items():
        parts[f"{name}_group"] = {"type": "shapegroup"} | {f"part_{i}": shape for i, shape in enumerate(members)}
        parts[name] = {"type": "instance", "group": {"type": "ref", "id": f"{name}_group"}}
    lights = [light.id() for light in scene.emitters()]
    made = mi.load_dict(parts, parallel=False, optimize=False)
    # load_dict has renamed the plugins after their keys in the dictionary; restore their names.
    for thing, name in zip([*shapes, *scene.emitters()], [*names, *lights], strict=True):
        thing.set_id(name)
    by_name = {shape.id(): shape for shape in made.shapes()}
    instances = {name: by_name[f"{_MOVING}_{i}"] for i, name in enumerate(names) if name in moving}
    return Levels(made, by_name.get(_STILL), instances, mi.traverse(made))
