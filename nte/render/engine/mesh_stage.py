"""The stage of a family's scene: meshes whose vertices are written anew for every time.

Mitsuba 3.9 has no animated transforms, so vertices and the camera are written through mi.traverse.
"""

from contextlib import AbstractContextManager
from functools import partial

import numpy as np

from nte.render.engine.arrays import to_jit
from nte.render.engine.backend import is_scalar, load_mitsuba
from nte.render.engine.places import Triangles
from nte.render.engine.plugins import camera_sensor, environment, far_away, flat, make_mesh, path_integrator
from nte.render.engine.stage import HoldsScenery, Moment, Scenery, opened, update
from nte.render.engine.types import Integrator, MitsubaScene, Parameters
from nte.render.engine.xml.loading import forget_scene
from nte.render.world.scene import Scene


class MeshStage(HoldsScenery):
    """A scene of meshes as one Mitsuba scene; see `nte.render.engine.stage.Stage`.

    Every time computes all vertices from the tracks, so a frame does not depend on the frames before it.
    """

    def __init__(
        self, scene: Scene, width: int, height: int, max_depth: int, integrator: Integrator | None = None
    ) -> None:
        """Build the scene. width, height: pixels. max_depth: path segments. integrator: path tracing if None."""
        mi = load_mitsuba()
        forget_scene()
        self.scene = scene
        max_depth = max(max_depth, scene.least_depth)
        media = any(obj.medium is not None for obj in scene.objects)
        self._meshes = {f"object_{i:03d}": make_mesh(obj) for i, obj in enumerate(scene.objects)}
        mi_scene: MitsubaScene = mi.load_dict(
            {
                "type": "scene",
                "integrator": path_integrator(max_depth, media),
                "sensor": camera_sensor(scene.camera, width, height, media),
                **environment(scene),
                **self._meshes,
            }
        )
        self._triangles = Triangles(scene)
        self._scenery = Scenery(
            camera=scene.camera,
            width=width,
            height=height,
            mi_scene=mi_scene,
            sensor=mi_scene.sensors()[0],
            integrator=mi_scene.integrator() if integrator is None else integrator,
            beyond=mi.load_dict({"type": "path", "max_depth": max_depth - 1}),
            shapes=list(self._meshes.values()),
            places=self._triangles,
            containers=sum(obj.material.surface == "none" for obj in scene.objects),
            distant=far_away(mi_scene),
        )
        self._parameters: Parameters = mi.traverse(mi_scene)
        self._written = dict.fromkeys(self._meshes, np.empty(0, np.float32))  # as Mitsuba has them now
        self._time: float | None = None

    @property
    def _held(self) -> Scenery:
        return self._scenery

    def at(self, time: float) -> AbstractContextManager[Moment]:
        """Move every vertex and the camera to a time in frames, and hand out the moment that passes take.

        Raises RuntimeError where another moment of this stage is still open.
        """
        return opened(self._scenery, time, self._put)

    def _put(self, time: float) -> None:
        if time == self._time:
            return
        mi, self._time = load_mitsuba(), None
        own = np.asarray if is_scalar() else partial(to_jit, mi.Float)
        for number, (name, obj) in enumerate(zip(self._meshes, self.scene.objects, strict=True)):
            vertices = np.stack([flat(values) for values in self._triangles.vertices_of(number + 1, time)])
            # Unchanged vertices are not written again: where only the camera moves, that is four times as fast.
            if not np.array_equal(vertices, self._written[name]):
                self._written[name] = vertices
                # Mitsuba keeps normals that are written together with the positions; else it computes them anew.
                self._parameters[f"{name}.vertex_positions"] = own(vertices[0])
                self._parameters[f"{name}.vertex_normals"] = own(vertices[1])
            if obj.medium is not None and obj.medium.density is not None:
                grid = mi.TensorXf(obj.medium.density(time)[..., None])
                self._parameters[f"{name}.interior_medium.sigma_t.data"] = grid
        self._parameters["sensor.to_world"] = mi.ScalarTransform4f(self.scene.camera.track(time))
        update(self._scenery.mi_scene, self._parameters)
        self._time = time
