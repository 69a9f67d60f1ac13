"""A scene in Mitsuba's hands: built once for a clip, then moved from time to time.

Mitsuba 3.9 has no animated transforms, so vertices and the camera are written through mi.traverse.
"""

import weakref
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from nte.render.engine.arrays import to_jit
from nte.render.engine.backend import is_scalar, load_drjit, load_mitsuba, undisturbed
from nte.render.engine.places import Indices, Places, Triangles
from nte.render.engine.xml.loading import forget_scene
from nte.render.passes.unshadowed import unshadowed_integrator
from nte.render.world.scene import Camera, DeformingObject, Material, Medium, Mesh, Scene, SceneObject

_DISTANT = 1e5, 1e3  # scene units, at least, and times the scene's size
VEIL = 0.05  # the share of light that a veil reflects or swallows


class Stage:
    """One Mitsuba scene for a clip; `set_time` before anything is rendered.

    Every set_time takes all vertices from the tracks, so a frame does not depend on the frames before it.
    """

    def __init__(self, scene: Scene, width: int, height: int, max_depth: int, unshadowed: bool = False) -> None:
        mi = load_mitsuba()
        forget_scene()
        self.scene, self.width, self.height = scene, width, height
        max_depth = max(max_depth, scene.least_depth)
        media = any(obj.medium is not None for obj in scene.objects)
        self.meshes = {f"object_{i:03d}": _mesh(mi, obj) for i, obj in enumerate(scene.objects)}
        self.mi_scene: Any = mi.load_dict({
            "type": "scene",
            "integrator": path_integrator(max_depth, media),
            "sensor": camera_sensor(scene.camera, width, height, media),
            **_environment(mi, scene),
            **self.meshes,
        })  # fmt: skip
        self.integrator: Any = unshadowed_integrator() if unshadowed else self.mi_scene.integrator()
        self.sensor: Any = self.mi_scene.sensors()[0]
        # What light components see beyond the first hit (nte.render.components.frame).
        self.beyond: Any = mi.load_dict({"type": "path", "max_depth": max_depth - 1})
        # Convex objects that cannot be seen; the channels without noise look past them.
        self.containers = sum(obj.material.surface == "none" for obj in scene.objects)
        self.shapes: list[Any] = list(self.meshes.values())  # in the order of scene.objects
        self._written = dict.fromkeys(self.meshes, np.empty(0, np.float32))  # positions and normals as they are set
        self._triangles = Triangles(scene)
        self.places: Places = self._triangles
        self.distant = far_away(self.mi_scene)
        self._parameters: Any = mi.traverse(self.mi_scene)
        self._frozen: dict[Callable[..., Any], Any] = {}

    def set_time(self, time: float) -> None:
        """Put every vertex and the camera where they are at a time in frames."""
        mi = load_mitsuba()
        own = np.asarray if is_scalar() else partial(to_jit, mi.Float)
        for number, (name, obj) in enumerate(zip(self.meshes, self.scene.objects, strict=True)):
            vertices = np.stack([_flat(values) for values in self._triangles.vertices_of(number + 1, time)])
            # What is there already is not written again: where only the camera moves, that is four times as fast.
            if not np.array_equal(vertices, self._written[name]):
                self._written[name] = vertices
                # Given together with the positions, the normals are kept instead of computed anew.
                self._parameters[f"{name}.vertex_positions"] = own(vertices[0])
                self._parameters[f"{name}.vertex_normals"] = own(vertices[1])
            if obj.medium is not None and obj.medium.density is not None:
                grid = mi.TensorXf(obj.medium.density(time)[..., None])
                self._parameters[f"{name}.interior_medium.sigma_t.data"] = grid
        self._parameters["sensor.to_world"] = mi.ScalarTransform4f(self.scene.camera.track(time))
        update(self.mi_scene, self._parameters)

    def frozen(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """`function(self, *arrays)`, traced once and from then on replayed: for what every frame of a clip does again.

        For a path through a room Dr.Jit takes 27 ms to trace it and find its kernel, 0.6 ms to replay it. Whatever
        varies from frame to frame must be in the scene, or in `arrays`: Dr.Jit arrays, in memory of their own (see
        to_jit). What `function` gives is queued, not waited for. It must not ask for any array's values.
        """
        if function not in self._frozen:
            stage = weakref.proxy(self)  # no cycle: a clip's scene goes with its stage

            def again(scene: Any, sensor: Any, beyond: Any, *arrays: Any) -> Any:
                return function(stage, *arrays)

            # Of `thinlens`, Dr.Jit 1.5.0 is not told all that it holds.
            self._frozen[function] = load_drjit().freeze(again, enabled=not self.scene.camera.aperture)
        return undisturbed()(partial(self._replay, function))

    def _replay(self, function: Callable[..., Any], *arrays: Any) -> Any:
        frozen, scene = self._frozen[function], (self.mi_scene, self.sensor, self.beyond)
        try:
            return frozen(*scene, *arrays)
        except RuntimeError:
            # Dr.Jit calls what other scenes in the process have too, and does not record what it finds only there, a
            # medium for instance. Then every frame is traced; what is wrong with the function itself is told there.
            frozen.enabled = False
            return frozen(*scene, *arrays)

    @cached_property
    def instances(self) -> Indices:
        """Table from keys of shapes (shape_key) to instance numbers: index in scene.objects + 1."""
        return numbers_by_key([key_of(shape) for shape in self.shapes], range(1, 1 + len(self.shapes)))

    @cached_property
    def lights(self) -> Indices:
        """Table from keys of emitters (emitter_key) to the instance numbers of their shapes; 0 for those without."""
        mi, emitters = load_mitsuba(), self.mi_scene.emitters()
        keys = [int(emitter_key(mi.EmitterPtr(emitter))[0]) for emitter in emitters]
        return numbers_by_key(keys, [self._instance_of(emitter) for emitter in emitters])

    def _instance_of(self, emitter: Any) -> int:
        shape = emitter.get_shape()
        return int(self.instances[key_of(shape)]) if shape else 0

    def met(self, hit: Any, ray: Any) -> list[Any]:
        """What a ray meets: the shape's key, and its place there (rays.to_hits makes rows of it)."""
        return [shape_key(hit.shape), *self.places.columns(hit, ray)]

    def carried(self, hit: Any) -> Any:
        """PreliminaryIntersection3f of rays that were traced at another time, as if traced at the present one."""
        return hit

    def albedo(self, si: Any, hit: Any) -> Any:
        """The colour (3,) that the guides show: `principled` gives a metal's as diffuse. Vectorised variants only."""
        return si.bsdf().eval_diffuse_reflectance(si, hit)

    def roughness(self, si: Any, hit: Any) -> Any:
        """Perceptual roughness in [0, 1]; 1 where the BSDF has none. Vectorised variants only."""
        bsdf = si.bsdf()
        known = bsdf.has_attribute("roughness", hit)
        return load_drjit().select(known, bsdf.eval_attribute_1("roughness", si, hit & known), 1)


def far_away(scene: Any) -> float:
    """How far away, in scene units, a point at infinity is put when it has to be a point."""
    box = scene.bbox()
    least, sizes = _DISTANT
    return max(least, sizes * float(np.linalg.norm(np.subtract(box.max, box.min))) if box.valid() else 0)


def update(scene: Any, parameters: Any) -> None:
    """Make a Mitsuba scene take its changed parameters."""
    parameters.update()
    for emitter in scene.emitters():
        if not emitter.get_shape():
            # Distant light keeps the extent that the scene had before (3.9.1), on which its points' last bits depend.
            emitter.set_scene(scene)


def shape_key(shape: Any) -> Any:
    """A whole number per shape: Dr.Jit's registry id, which is 1-based, in no fixed order; 0 for none."""
    if is_scalar():
        return int(shape.id().rsplit("_", 1)[1]) + 1 if shape else 0
    return load_drjit().reinterpret_array(load_mitsuba().UInt32, shape)


def emitter_key(emitter: Any) -> Any:
    """The same per emitter. Vectorised variants only."""
    return load_drjit().reinterpret_array(load_mitsuba().UInt32, emitter)


def key_of(shape: Any) -> int:
    """The shape_key of one shape."""
    return int(shape_key(shape) if is_scalar() else shape_key(load_mitsuba().ShapePtr(shape))[0])


def numbers_by_key(keys: Sequence[int], numbers: Iterable[int]) -> Indices:
    """Table from keys of shapes or emitters to numbers; 0 for all other keys."""
    table = np.zeros(max(keys, default=0) + 1, np.int64)
    table[[*keys]] = [*numbers]
    return table


def path_integrator(depth: int, media: bool) -> dict[str, Any]:
    """Mitsuba's path tracer; where there are media, the one that scatters in them."""
    if media:
        # By default Russian roulette starts at the fifth of some hundred turns, and leaves a few bright paths.
        return {"type": "volpath", "max_depth": depth, "rr_depth": depth}
    return {"type": "path", "max_depth": depth}


def camera_sensor(camera: Camera, width: int, height: int, media: bool) -> dict[str, Any]:
    """The sensor of a camera, with the film and the sampler of every clip."""
    lens = {"type": "thinlens", "aperture_radius": camera.aperture, "focus_distance": camera.focus}
    return {
        **(lens if camera.aperture else {"type": "perspective"}),
        "fov": camera.fov, "fov_axis": "x", "near_clip": camera.near, "far_clip": camera.far,
        # As dear as independent samples, and the same as them at 1 spp, but references have half the noise. In media,
        # whose noise is another, stratified ones made one path in two million NaN, independent ones none in ten.
        "sampler": {"type": "independent" if media else "stratified"},
        # Only the box filter keeps the noise of neighbouring pixels independent, and repeats bit for bit.
        "film": {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb",
                 "component_format": "float32", "rfilter": {"type": "box"}},
    }  # fmt: skip


def _environment(mi: Any, scene: Scene) -> dict[str, Any]:
    given = scene.environment
    if given is None:
        return {}
    if isinstance(given, tuple):
        return {"environment": {"type": "constant", "radiance": {"type": "rgb", "value": list(given)}}}
    return {"environment": {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(given, np.float32))}}


def _mesh(mi: Any, obj: SceneObject | DeformingObject) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_bsdf(mi, obj.material))
    if obj.radiance is not None:
        radiance = {"type": "rgb", "value": list(obj.radiance)}
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    if obj.medium is not None:
        properties["interior"] = mi.load_dict(_medium(mi, obj.medium, obj.mesh))
    mesh = mi.Mesh(
        "", len(obj.mesh.positions), len(obj.mesh.faces),
        has_vertex_normals=True, has_vertex_texcoords=True, props=properties,
    )  # fmt: skip
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = _flat(obj.mesh.positions)
    parameters["vertex_normals"] = _flat(obj.mesh.normals)
    parameters["vertex_texcoords"] = _flat(obj.mesh.uv)
    parameters["faces"] = np.ascontiguousarray(obj.mesh.faces, np.uint32).ravel()
    parameters.update()
    return mesh


def _medium(mi: Any, medium: Medium, mesh: Mesh) -> dict[str, Any]:
    albedo = {"type": "rgb", "value": list(medium.albedo)}
    phase = {"type": "hg", "g": medium.anisotropy}
    if medium.density is None:
        return {"type": "homogeneous", "albedo": albedo, "sigma_t": medium.extinction, "phase": phase}
    low, high = mesh.positions.min(0).astype(float), mesh.positions.max(0).astype(float)
    box = mi.ScalarTransform4f().translate(low).scale(high - low)  # the grid fills the unit cube
    grid = {"type": "gridvolume", "grid": mi.VolumeGrid(medium.density(0)), "to_world": box}
    return {"type": "heterogeneous", "albedo": albedo, "sigma_t": grid, "scale": medium.extinction, "phase": phase,
            "has_spectral_extinction": False}  # fmt: skip


def _bsdf(mi: Any, material: Material) -> dict[str, Any]:
    """Plain colours are textures too: fewer kinds of plugins, and kernels are shared between scenes."""
    if material.surface == "none":
        return {"type": "null"}
    texture = {"type": "bitmap", "data": mi.TensorXf(material.color), "raw": True}
    diffuse = {"type": "diffuse", "reflectance": texture}
    if material.surface == "diffuse":
        return diffuse
    if material.surface == "veil":
        return {"type": "mask", "opacity": VEIL, "bsdf": diffuse}
    metallic = 1.0 if material.surface == "metal" else 0.0
    bsdf = {"type": "principled", "base_color": texture, "roughness": material.roughness, "metallic": metallic}
    if material.surface == "glass":  # not `dielectric`, which has neither an albedo nor a roughness to show
        bsdf |= {"spec_trans": 1.0, "eta": 1.5}
    return bsdf


def _flat(values: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32).ravel()
