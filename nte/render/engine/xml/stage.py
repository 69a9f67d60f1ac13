"""The stage of a user's own Mitsuba scene: an XML file as it is, with the parts that an animation moves.

Shapes of any kind stay Mitsuba's own, and so do instances of shapegroups. For each point, a frame needs to know only
which shape it is on; the keyframes of that shape carry the point to any other time. Vectorised variants only.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import TypeVar

from nte.errors import NteError
from nte.render.engine.backend import load_mitsuba
from nte.render.engine.plugins import camera_sensor, far_away, path_integrator
from nte.render.engine.stage import HoldsScenery, Moment, opened, update
from nte.render.engine.types import Integrator, Parameters
from nte.render.engine.xml.camera import xml_camera
from nte.render.engine.xml.levels import levels
from nte.render.engine.xml.loading import load_xml
from nte.render.engine.xml.moving import brightness_of, moved_by, place_of
from nte.render.engine.xml.rest import Rest
from nte.render.engine.xml.scenery import XmlScenery
from nte.render.world.keyframes import Animation, brightness_curve, moves, object_track
from nte.render.world.transforms import Track

_Value = TypeVar("_Value")


@dataclass(frozen=True)
class XmlObject:
    """A shape of the XML; `track` is the motion that keyframes add to its place there, None if it stays."""

    name: str
    track: Track | None = None


class XmlStage(HoldsScenery):
    """The XML scene of an animation; see `nte.render.engine.stage.Stage`.

    Film, sampler and integrator are nte's own, as for every clip.
    """

    def __init__(
        self,
        animation: Animation,
        width: int,
        height: int,
        max_depth: int,
        integrator: Integrator | None = None,
        start: float = 0,
        keep: bool = False,
    ) -> None:
        """Load the XML and check the names that the animation uses. Raises NteError for what cannot be rendered.

        width, height: pixels. max_depth: path segments. integrator: path tracing if None. start: the animation's frame
        that becomes frame 0. keep: keep the loaded scene for the next stage of the same XML, if no moment of this stage
        is ever opened.
        """
        mi = load_mitsuba()
        self._start = start
        mi_scene, self.media = load_xml(animation, keep)
        shapes = list(mi_scene.shapes())
        distant = far_away(mi_scene)
        self._parameters: Parameters = mi.traverse(mi_scene)
        tracks = {name: object_track(keys, animation.interpolation) for name, keys in animation.objects.items()}
        light_tracks = {name: object_track(keys, animation.interpolation) for name, keys in animation.lights.items()}
        _require_names(animation.xml, "objects", tracks, [shape.id() for shape in shapes])
        lights = [emitter.id() for emitter in mi_scene.emitters() if emitter.get_shape() is None]
        _require_names(animation.xml, "lights", light_tracks, lights)
        self.objects = tuple(XmlObject(shape.id(), self._from_start(tracks.get(shape.id()))) for shape in shapes)
        camera = xml_camera(mi_scene, animation)
        self._camera = replace(camera, track=_shifted(camera.track, start))
        keyed = animation.objects | animation.lights
        self._moved = {
            name: (place_of(name, keyed[name], self._parameters, shapes), _shifted(track, start))
            for name, track in (tracks | light_tracks).items()
            if moves(keyed[name])
        }
        curves = {name: brightness_curve(keys, animation.interpolation) for name, keys in keyed.items()}
        self._dimmed = [
            (*brightness_of(name, mi_scene), _shifted(curve, start)) for name, curve in curves.items() if curve
        ]
        self.is_lit = len(mi_scene.emitters()) > 0
        # Lights that are not shapes are numbered after the shapes.
        places = Rest([*(obj.track for obj in self.objects), *(self._from_start(light_tracks.get(n)) for n in lights)])
        sensor = mi.load_dict(camera_sensor(self._camera, width, height, self.media))
        self._view: Parameters = mi.traverse(sensor)
        path = mi.load_dict(path_integrator(max_depth, self.media))
        self._scenery = XmlScenery(
            camera=self._camera,
            width=width,
            height=height,
            mi_scene=mi_scene,
            sensor=sensor,
            integrator=path if integrator is None else integrator,
            beyond=mi.load_dict(path_integrator(max_depth - 1, False)),
            shapes=shapes,
            places=places,
            containers=sum(shape.interior_medium() is not None for shape in shapes),
            distant=distant,
            distant_lights=lights,
        )
        self._tracks: dict[str, Track] | None = None  # of the shapes that move as instances; None until known
        self._time: float | None = None

    @property
    def _held(self) -> XmlScenery:
        return self._scenery

    def at(self, time: float) -> AbstractContextManager[Moment]:
        """Move every animated shape and light, and the camera, to a time in frames, and hand out the moment for passes.

        Raises RuntimeError where another moment of this stage is still open.
        """
        return opened(self._scenery, time, self._put)

    def _put(self, time: float) -> None:
        if time == self._time:
            return
        mi, self._time = load_mitsuba(), None
        if self._tracks is None:
            self._tracks = self._divide()
        if self._scenery.levels:
            self._choose(time, self._tracks)
        for at_rest, track in self._moved.values():
            matrix = track(time)
            for name, value in at_rest.items():
                self._parameters[name] = moved_by(matrix, name, value)
        for parameters, in_xml, curve in self._dimmed:
            for name, value in in_xml.items():
                parameters[name] = value * curve(time)
            parameters.update()
        if self._moved or self._scenery.levels:
            update(self._scenery.mi_scene, self._parameters)
        self._view["to_world"] = mi.ScalarTransform4f(self._camera.track(time))
        self._view.update()
        self._time = time

    def _divide(self) -> dict[str, Track]:
        """Let shapes move as instances where they can, in one scene for each of two times; lights move as before.

        Returns the tracks of the shapes that now move as instances.
        """
        names = {obj.name for obj in self.objects}
        moving = [name for name in self._moved if name in names]
        self._scenery.levels += levels(self._scenery.mi_scene, self._scenery.shapes, moving, 2)
        return {name: self._moved.pop(name)[1] for name in moving} if self._scenery.levels else {}

    def _choose(self, time: float, tracks: Mapping[str, Track]) -> None:
        """Take the scene that is at this time already, or move the one that was used longest ago; put it last."""
        made = self._scenery.levels
        chosen = next((each for each in made if each.time == time), made[0])
        if chosen.time != time:
            chosen.move({name: track(time) for name, track in tracks.items()}, time)
        made.remove(chosen)
        made.append(chosen)
        self._scenery.mi_scene, self._parameters = chosen.scene, chosen.parameters

    def _from_start(self, track: Track | None) -> Track | None:
        return track and _shifted(track, self._start)


def _shifted(curve: Callable[[float], _Value], start: float) -> Callable[[float], _Value]:
    """A track or another curve in the clip's frames: the clip's frame 0 is the animation's frame `start`."""
    return lambda time: curve(time + start)


def _require_names(xml: str, what: str, given: Mapping[str, object], known: Sequence[str]) -> None:
    named = [name for name in known if name]
    for name in given:
        if named.count(name) != 1:
            found = "none" if name not in named else "several"
            listed = ", ".join(dict.fromkeys(named)) or "none that has an id"
            raise NteError(f"{xml}: {what} names '{name}', {found} of which is in the scene: there is {listed}")


def require_scene(animation: Animation, components: bool) -> None:
    """Raise NteError, before anything is rendered, for an XML scene that cannot be loaded or lacks what it must have.

    components: whether light components are asked for; they need a light, and no media.
    """
    stage = XmlStage(animation, 8, 8, 2, keep=True)  # rendering reuses the loaded scene: no extra cost
    media, lit = stage.media, stage.is_lit
    del stage  # so that the error's traceback does not keep it alive
    if components and media:
        raise NteError(f"{animation.xml}: light in its media has no components: expected components: false")
    if components and not lit:
        raise NteError(f"{animation.xml}: has no light: expected components: false")
