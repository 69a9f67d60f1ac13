"""Somebody else's Mitsuba scene: an XML file as it is, with what an animation moves in it (render/animation.py).

Shapes stay Mitsuba's, of any kind, and instances of shapegroups as well: what a frame needs to know of a point is
which shape it is on, and that shape's keyframes carry it to any other time. Vectorised variants only.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from nte.errors import NteError
from nte.render.engine.arrays import to_jit
from nte.render.engine.backend import load_drjit, load_mitsuba, undisturbed
from nte.render.engine.mesh_stage import (
    Stage,
    camera_sensor,
    far_away,
    key_of,
    numbers_by_key,
    path_integrator,
    shape_key,
    update,
)
from nte.render.engine.places import Indices
from nte.render.engine.xml.levels import Levels, levels
from nte.render.engine.xml.loading import load_xml
from nte.render.engine.xml.rest import Rest
from nte.render.passes.unshadowed import unshadowed_integrator
from nte.render.world.keyframes import Animation, Key, brightness_curve, camera_track, moves, object_track
from nte.render.world.scene import Camera, Scene
from nte.render.world.transforms import Floats, Track, still, transform_points

_SENSORS = ("PerspectiveCamera", "ThinLensCamera")
_ROUND = ("Sphere", "Cylinder")  # stay so, whatever a transform says
_SCALES = ("scale", "sun_scale", "sky_scale")
_EMISSION = tuple(f"{kind}.{form}" for kind in ("intensity", "irradiance", "radiance") for form in ("value", "data"))
_VERTICES = ("vertex_positions", "vertex_normals")


@dataclass(frozen=True)
class OwnObject:
    """A shape of the XML; `track` is what its keyframes add to its place there, None if it stays."""

    name: str
    track: Track | None = None


class OwnStage(Stage):
    """The XML scene of an animation. Its film, sampler and integrator are nte's, as for every clip."""

    def __init__(
        self,
        animation: Animation,
        width: int,
        height: int,
        max_depth: int,
        unshadowed: bool = False,
        start: float = 0,
        keep: bool = False,
    ) -> None:
        """keep: the loaded scene for the next stage of the same XML, if this one is never set to a time."""
        self.width, self.height, self.start = width, height, start
        self.mi_scene: Any
        self.mi_scene, self.media = load_xml(animation, keep)
        self.shapes = list(self.mi_scene.shapes())
        self.distant = far_away(self.mi_scene)
        self._parameters = load_mitsuba().traverse(self.mi_scene)
        tracks = {name: object_track(keys, animation.interpolation) for name, keys in animation.objects.items()}
        lights = {name: object_track(keys, animation.interpolation) for name, keys in animation.lights.items()}
        _check_names(animation.xml, "objects", tracks, [shape.id() for shape in self.shapes])
        emitters = [emitter.id() for emitter in self.mi_scene.emitters() if emitter.get_shape() is None]
        _check_names(animation.xml, "lights", lights, emitters)
        # Not a family's objects: nobody but this stage asks them where they are.
        objects: Any = tuple(OwnObject(shape.id(), self._from_start(tracks.get(shape.id()))) for shape in self.shapes)
        camera = _camera(self.mi_scene, animation)
        camera = replace(camera, track=self._from_start(camera.track))
        self.scene = Scene(objects, camera)
        self._lights = emitters
        light_tracks = [self._from_start(lights.get(name)) for name in emitters]
        self.places = self._rest = Rest([*(obj.track for obj in objects), *light_tracks])
        keyed = animation.objects | animation.lights
        self._moved = {
            name: self._movable(name, keyed[name], track)
            for name, track in (tracks | lights).items()
            if moves(keyed[name])
        }
        self._levels: list[Levels] | None = None  # until it is set to a time
        self._time: float | None = None
        curves = {name: brightness_curve(keys, animation.interpolation) for name, keys in keyed.items()}
        self._dimmed = [self._emission(name, self._from_start(curve)) for name, curve in curves.items() if curve]
        self.sensor = load_mitsuba().load_dict(camera_sensor(camera, width, height, self.media))
        self._view = load_mitsuba().traverse(self.sensor)
        path = load_mitsuba().load_dict(path_integrator(max_depth, self.media))
        self.beyond = load_mitsuba().load_dict(path_integrator(max_depth - 1, False))
        self.integrator = unshadowed_integrator() if unshadowed else path
        self.containers = sum(shape.interior_medium() is not None for shape in self.shapes)

    def set_time(self, time: float) -> None:
        """Put every shape and light that moves, and the camera, where they are at a time in frames."""
        if time == self._time:
            return
        mi = load_mitsuba()
        self._time = self._rest.time = time
        if self._levels is None:
            self._divide()
        if self._levels:
            self._choose(time)
        for at_rest, track in self._moved.values():
            matrix = track(time)
            for name, value in at_rest.items():
                self._parameters[name] = _at(matrix, name, value)
        for parameters, in_xml, curve in self._dimmed:
            for name, value in in_xml.items():
                parameters[name] = value * curve(time)
            parameters.update()
        if self._moved or self._levels:
            update(self.mi_scene, self._parameters)
        self._view["to_world"] = mi.ScalarTransform4f(self.scene.camera.track(time))
        self._view.update()

    def _divide(self) -> None:
        """Let shapes move as instances, in a scene for each of two times, where they can; lights move as they did."""
        names = {shape.id() for shape in self.shapes}
        moving = [name for name in self._moved if name in names]
        self._levels = levels(self.mi_scene, self.shapes, moving, 2)
        self._tracks = {name: self._moved.pop(name)[1] for name in moving} if self._levels else {}

    def _choose(self, time: float) -> None:
        """Take the scene that is at this time, or move the one that was used longest ago: it comes to the end."""
        assert self._levels
        chosen = next((made for made in self._levels if made.time == time), self._levels[0])
        if chosen.time != time:
            chosen.move({name: track(time) for name, track in self._tracks.items()}, time)
        self._levels.remove(chosen)
        self._levels.append(chosen)
        self.mi_scene, self._parameters = chosen.scene, chosen.parameters

    @cached_property
    def instances(self) -> Indices:
        """As of any stage; instances that move a shape have its number."""
        shapes = list(self.shapes)
        for made in self._levels or []:
            shapes += made.moving.values()
        number = {name: index + 1 for index, name in enumerate(shape.id() for shape in self.shapes)}
        moved = [number[name] for made in self._levels or [] for name in made.moving]
        return numbers_by_key([key_of(shape) for shape in shapes], [*range(1, 1 + len(self.shapes)), *moved])

    def frozen(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Traced in every frame: not every plugin that an XML may name tells Dr.Jit all that it holds."""
        return undisturbed()(partial(function, self))

    def met(self, hit: Any, ray: Any) -> list[Any]:
        """What a ray meets: the key of the shape, or of the instance of which it is a part, and its place."""
        mi, dr = load_mitsuba(), load_drjit()
        si = self._rest.interaction(hit, ray)
        instance = dr.reinterpret_array(mi.UInt32, hit.instance)
        level = self._levels[-1].still if self._levels else None
        still = dr.opaque(mi.UInt32, 0 if level is None else key_of(level))
        key = dr.select((instance != 0) & (instance != still), instance, shape_key(si.shape))
        return [dr.select(hit.is_valid(), key, 0), *self._rest.columns_of(hit, ray, si)]

    def carried(self, hit: Any) -> Any:
        """As of any stage: each time has instances of its own, and those of another time stand elsewhere."""
        if not self._levels:
            return hit
        mi, dr, here = load_mitsuba(), load_drjit(), [key_of(instance) for instance in self._levels[-1].instances()]
        keys = [key_of(instance) for made in self._levels for instance in made.instances()]
        table = to_jit(mi.UInt32, numbers_by_key(keys, here * len(self._levels)))
        carried = mi.PreliminaryIntersection3f(hit)
        key = dr.gather(mi.UInt32, table, dr.reinterpret_array(mi.UInt32, hit.instance))
        carried.instance = dr.reinterpret_array(mi.ShapePtr, key)
        return carried

    def albedo(self, si: Any, hit: Any) -> Any:
        """Diffuse reflectance, or what a metal or glass does to light that it turns (3,).

        A BSDF without a diffuse lobe is asked for one direction of its own choice: the weight is Fresnel's
        reflectance, and 1 where it either reflects or transmits.
        """
        mi, dr, bsdf = load_mitsuba(), load_drjit(), si.bsdf()
        lobes = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.DiffuseTransmission
        other = hit & ~mi.has_flag(bsdf.flags(), lobes)
        context = mi.BSDFContext(mi.TransportMode.Importance)  # radiance would be scaled by η² in glass
        _, weight = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), other)
        return dr.select(other, dr.clip(weight, 0, 1), bsdf.eval_diffuse_reflectance(si, hit))

    def roughness(self, si: Any, hit: Any) -> Any:
        """Perceptual roughness in [0, 1]: √α where there is one, 0 of mirrors and clear glass, 1 of what is diffuse."""
        mi, dr, bsdf = load_mitsuba(), load_drjit(), si.bsdf()
        smooth = hit & ~mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse | mi.BSDFFlags.Glossy)
        found = dr.select(smooth, mi.Float(0), 1)
        # With two of them, as of brushed metal, α is their geometric mean.
        for names, power in ((("alpha_u", "alpha_v"), 0.25), (("alpha",), 0.5), (("roughness",), 1.0)):
            known, value = hit, mi.Float(1)
            for name in names:
                known = known & bsdf.has_attribute(name, hit)
                value = value * bsdf.eval_attribute_1(name, si, known)
            found = dr.select(known, value**power, found)
        return found

    def _instance_of(self, emitter: Any) -> int:
        """Lights that are no shapes are numbered after the shapes."""
        if emitter.get_shape():
            return super()._instance_of(emitter)
        return 1 + len(self.shapes) + self._lights.index(emitter.id())

    def _from_start(self, track: Callable[[float], Any] | None) -> Any:
        """The track, or another curve, as the clip's frames see it, whose frame 0 is the animation's frame `start`."""
        return track and (lambda time: track(time + self.start))

    def _movable(self, name: str, keys: Sequence[Key], track: Track) -> tuple[Mapping[str, Any], Track]:
        """The parameters of a shape or light that say where it is, by their names, with their values at rest."""
        known = {key.rpartition(".")[2]: key for key in dict(self._parameters) if key.rpartition(".")[0] == name}
        chosen = [known[kind] for kind in (*_VERTICES, "to_world", "position") if kind in known]
        if not chosen:
            raise NteError(f"'{name}' cannot be moved: Mitsuba has no parameter for its place")
        shape = next((shape for shape in self.shapes if shape.id() == name), None)
        if shape is not None and shape.class_name() in _ROUND and any(len({*key.scale}) > 1 for key in keys):
            raise NteError(f"'{name}' is a {shape.class_name().lower()}: expected the same scale along all axes")
        values = {key: _array(key, self._parameters[key]) for key in chosen}
        return values, self._from_start(track)

    def _emission(self, name: str, curve: Callable[[float], float]) -> tuple[Any, Mapping[str, Any], Any]:
        """The parameters of a light, a shape or not, and the values in the XML of those that say how bright it is."""
        mi = load_mitsuba()
        for emitter in self.mi_scene.emitters():
            if name in (emitter.id(), emitter.get_shape() and emitter.get_shape().id()):
                parameters = mi.traverse(emitter)
                # A projector has a scale and an irradiance; an 8-bit texture's numbers are codes, not light.
                chosen = [key for key, _ in parameters.items() if key in _SCALES] or [
                    key for key, value in parameters.items() if key in _EMISSION and not isinstance(value, mi.TensorXu8)
                ]
                if not chosen:
                    raise NteError(
                        f"the brightness of '{name}' cannot change: expected a light with a scale, or a colour or a "
                        "texture of floating-point numbers (format: variant) as intensity, radiance or irradiance"
                    )
                return parameters, {key: type(parameters[key])(parameters[key]) for key in chosen}, curve
        raise NteError(f"'{name}' has a brightness, but sends out no light")


def _check_names(xml: str, what: str, given: Mapping[str, Any], known: Sequence[str]) -> None:
    named = [name for name in known if name]
    for name in given:
        if named.count(name) != 1:
            found = "none" if name not in named else "several"
            listed = ", ".join(dict.fromkeys(named)) or "none that has an id"
            raise NteError(f"{xml}: {what} names '{name}', {found} of which is in the scene: there is {listed}")


def _camera(scene: Any, animation: Animation) -> Camera:
    """The first sensor of the XML, or its lens on the animation's own track."""
    if not scene.sensors():
        raise NteError(f"{animation.xml}: has no sensor: expected a perspective or thinlens camera")
    sensor = scene.sensors()[0]
    if (kind := sensor.class_name()) not in _SENSORS:
        raise NteError(f"{animation.xml}: its sensor is a {kind}: expected a perspective or thinlens camera")
    values = load_mitsuba().traverse(sensor)

    def number(name: str, otherwise: float = 0.0) -> float:
        return float(np.array(values[name]).ravel()[0]) if name in values else otherwise

    if number("principal_point_offset_x") or number("principal_point_offset_y"):
        raise NteError(f"{animation.xml}: its sensor has a principal point offset, which nte's cameras have not")
    matrix = _array("to_world", values["to_world"])
    matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
    track = still(matrix)
    if animation.camera:
        # Many an XML has a camera that mirrors; it stays so.
        mirror = np.diag([np.sign(np.linalg.det(matrix[:3, :3])), 1.0, 1.0, 1.0])
        moved = camera_track(animation.camera, animation.interpolation)
        track = lambda time: np.asarray(moved(time) @ mirror)  # noqa: E731
    lens = number("aperture_radius"), number("focus_distance", 1.0)
    return Camera(track, number("x_fov"), *lens, number("near_clip"), number("far_clip"))


def _array(name: str, value: Any) -> Floats:
    """The value of a parameter; a transform's 4×4 without Dr.Jit's axis of lanes."""
    is_transform = name.rpartition(".")[2] == "to_world"
    return np.array(value.matrix, float).reshape(4, 4) if is_transform else np.array(value, float)


def _at(matrix: Floats, name: str, value: Floats) -> Any:
    """The value of a parameter after the transform 4×4."""
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


def check_scene(animation: Animation, components: bool) -> None:
    """Raise NteError, before anything is rendered, for what the XML does not load or have; for components: lights."""
    stage = OwnStage(animation, 8, 8, 2, keep=True)  # which is all that loading costs: rendering goes on with it
    media, lights = stage.media, len(stage.mi_scene.emitters())
    del stage  # not kept by the error's traceback
    if components and media:
        raise NteError(f"{animation.xml}: light in its media has no components: expected components: false")
    if components and not lights:
        raise NteError(f"{animation.xml}: has no light: expected components: false")
