"""A scene in Mitsuba: built once for a clip, and rendered at one time after another.

    with stage.at(3) as moment:
        image = radiance(moment, spp=1, seed=0)

There are two stages: `mesh_stage.MeshStage` for a family's meshes and `xml.stage.XmlStage` for a Mitsuba XML file.
Passes take the moment that a stage hands out, so they cannot run at a wrong time. Their kernels take the moment's
scenery, which holds no time, so a kernel that was recorded at one moment can be replayed at others.
"""

import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from nte.render.engine.backend import load_drjit, undisturbed
from nte.render.engine.keys import key_of, key_of_emitter, numbers_by_key, shape_key
from nte.render.engine.places import Indices, Places
from nte.render.engine.types import (
    Emitter,
    Hit,
    Integrator,
    Interaction,
    Lanes,
    MitsubaScene,
    Parameters,
    Ray,
    Sensor,
    Shape,
)
from nte.render.world.scene import Camera

Arrays = ParamSpec("Arrays")
Result = TypeVar("Result")


class Timeless(Protocol):
    """The properties that are the same or known at all times; every Stage, Moment and Scenery has them."""

    @property
    def camera(self) -> Camera:
        """Return the camera, with its track over all times."""

    @property
    def width(self) -> int:
        """Return the width of images, pixels."""

    @property
    def height(self) -> int:
        """Return the height of images, pixels."""

    @property
    def places(self) -> Places:
        """Return the object that knows where places on surfaces are at any time."""

    @property
    def distant(self) -> float:
        """Return the distance, in scene units, at which a point at infinity is put when it must be a point."""


class Stage(Timeless, Protocol):
    """A scene that can be rendered at any time, at one time after another."""

    def at(self, time: float) -> AbstractContextManager["Moment"]:
        """Move the scene to a time in frames, and hand out the moment that passes take.

        Raises RuntimeError where another moment of this stage is still open.
        """


class HoldsScenery(ABC):
    """The base of stages and moments: the constants of the scenery that they hold, as `Timeless` declares them."""

    @property
    @abstractmethod
    def _held(self) -> "Scenery": ...

    @property
    def camera(self) -> Camera:
        """Return the camera, with its track over all times."""
        return self._held.camera

    @property
    def width(self) -> int:
        """Return the width of images, pixels."""
        return self._held.width

    @property
    def height(self) -> int:
        """Return the height of images, pixels."""
        return self._held.height

    @property
    def places(self) -> Places:
        """Return the object that knows where places on surfaces are at any time."""
        return self._held.places

    @property
    def distant(self) -> float:
        """Return the distance, in scene units, at which a point at infinity is put when it must be a point."""
        return self._held.distant


class Moment(HoldsScenery):
    """A stage at one time in frames, handed out by `Stage.at`. Raises RuntimeError if it is used after its block."""

    def __init__(self, scenery: "Scenery", time: float) -> None:
        self.time = time
        self._scenery: Scenery | None = scenery

    @property
    def scenery(self) -> "Scenery":
        """Return what kernels read, as it is at this time. Do not keep it past the block."""
        if self._scenery is None:
            raise RuntimeError(f"the moment at time {self.time} is over: use it within its `with stage.at(…)` block")
        return self._scenery

    @property
    def _held(self) -> "Scenery":
        return self.scenery

    def frozen(self, function: Callable[Concatenate["Scenery", Arrays], Result]) -> Callable[Arrays, Result]:
        """Return `function`, of the scenery and of Dr.Jit arrays, as a kernel for this moment: see Scenery.frozen."""

        def kernel(*arrays: Arrays.args, **named: Arrays.kwargs) -> Result:
            return self.scenery.frozen(function)(*arrays, **named)  # of this moment only: kept past it, it raises

        return kernel

    def end(self) -> None:
        """Let go of the stage: any later use of this moment raises RuntimeError."""
        self._scenery = None


@dataclass(eq=False, kw_only=True)
class Scenery:
    """The data that the kernels of passes read: a Mitsuba scene as it is now, and constants."""

    camera: Camera
    width: int
    height: int
    mi_scene: MitsubaScene
    sensor: Sensor
    integrator: Integrator
    beyond: Integrator  # gives the light beyond the first hit to light components (nte.render.components)
    shapes: Sequence[Shape]  # in the order of instance numbers, which begin at 1
    places: Places
    containers: int  # number of convex invisible objects; the noise-free channels look past them
    distant: float  # distance, in scene units, at which a point at infinity is put when it must be a point
    open_at: float | None = None  # time of the moment that is open now
    _frozen: dict[Callable[..., object], "_Frozen"] = field(default_factory=dict)

    def frozen(self, function: Callable[Concatenate["Scenery", Arrays], Result]) -> Callable[Arrays, Result]:
        """Return `function(scenery, *arrays)` as a kernel that is traced once and replayed from then on.

        Use it for work that every frame of a clip repeats. For a path through a room, Dr.Jit takes 27 ms to trace the
        function and find its kernel, and 0.6 ms to replay it. Whatever varies from frame to frame must be in the
        Mitsuba scene, or in `arrays`: Dr.Jit arrays that own their memory (see to_jit). The results are queued, not
        waited for. `function` must not read the values of any array.
        """
        if function not in self._frozen:
            scenery = weakref.proxy(self)  # no reference cycle, so a clip's scene is freed with its stage
            traced: Callable[..., Result] = function

            def again(scene: MitsubaScene, sensor: Sensor, beyond: Integrator, *arrays: Lanes) -> Result:
                return traced(scenery, *arrays)

            # Dr.Jit 1.5.0 cannot see all of the state of `thinlens`, so frames through it are traced.
            self._frozen[function] = load_drjit().freeze(again, enabled=not self.camera.aperture)
        return undisturbed()(partial(self._replay, function))

    def _replay(self, function: Callable[..., object], *arrays: Lanes) -> Lanes:
        frozen, scene = self._frozen[function], (self.mi_scene, self.sensor, self.beyond)
        try:
            return frozen(*scene, *arrays)
        except RuntimeError:
            # Dr.Jit also visits the plugins of other scenes in the process, and refuses to record what only they have,
            # a medium for instance. Then every frame is traced. An error in the function itself appears again there.
            frozen.enabled = False
            return frozen(*scene, *arrays)

    @cached_property
    def instances(self) -> Indices:
        """Return the table from keys of shapes (shape_key) to instance numbers: index in `shapes` + 1."""
        return numbers_by_key([key_of(shape) for shape in self.shapes], range(1, 1 + len(self.shapes)))

    @cached_property
    def lights(self) -> Indices:
        """Return the table from keys of emitters (emitter_key) to the instance numbers of their shapes, 0 if none."""
        emitters = self.mi_scene.emitters()
        return numbers_by_key([key_of_emitter(emitter) for emitter in emitters], map(self.instance_of, emitters))

    def instance_of(self, emitter: Emitter) -> int:
        """Return the instance number of a light's shape; 0 if it has none."""
        shape = emitter.get_shape()
        return int(self.instances[key_of(shape)]) if shape else 0

    def met(self, hit: Hit, ray: Ray) -> list[Lanes]:
        """Return what a ray meets: the shape's key, and its place there; `hits.to_hits` makes rows of both."""
        return [shape_key(hit.shape), *self.places.columns(hit, ray)]

    def carried(self, hit: Hit) -> Hit:
        """Return a hit of rays that were traced at another time, as if they were traced now."""
        return hit

    def albedo(self, si: Interaction, hit: Lanes) -> Lanes:
        """Return the colour (3,) for the guides; `principled` returns a metal's colour as diffuse. Vectorised only."""
        return si.bsdf().eval_diffuse_reflectance(si, hit)

    def roughness(self, si: Interaction, hit: Lanes) -> Lanes:
        """Return perceptual roughness in [0, 1]; 1 where the BSDF has none. Vectorised variants only."""
        return self.attribute("roughness", si, hit, 1)

    def attribute(self, name: str, si: Interaction, hit: Lanes, otherwise: float) -> Lanes:
        """Return a number of the BSDF by its name; `otherwise` where it has none. Vectorised variants only."""
        bsdf = si.bsdf()
        known = bsdf.has_attribute(name, hit)
        return load_drjit().select(known, bsdf.eval_attribute_1(name, si, hit & known), otherwise)


class _Frozen(Protocol):
    """A function that Dr.Jit has frozen."""

    enabled: bool

    def __call__(self, *arrays: Lanes) -> Lanes: ...


@contextmanager
def opened(scenery: Scenery, time: float, put: Callable[[float], None]) -> Iterator[Moment]:
    """Hand out the moment at a time in frames, after `put` has moved the scenery there; stages build `at` from it.

    Raises RuntimeError where another moment of the scenery is still open.
    """
    if scenery.open_at is not None:
        raise RuntimeError(
            f"the stage cannot be at time {time}: its moment at time {scenery.open_at} is still open; leave that first"
        )
    scenery.open_at = time
    moment = Moment(scenery, time)
    try:
        put(time)
        yield moment
    finally:
        scenery.open_at = None
        moment.end()


def update(scene: MitsubaScene, parameters: Parameters) -> None:
    """Apply changed parameters to a Mitsuba scene."""
    parameters.update()
    for emitter in scene.emitters():
        if not emitter.get_shape():
            # Mitsuba 3.9.1 leaves distant lights with the scene's previous extent: the last bits of their points differ
            emitter.set_scene(scene)
