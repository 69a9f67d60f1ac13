"""Mitsuba plugins for the parts of a scene of nte: integrator, sensor, lights, meshes, materials and media."""

import numpy as np
import numpy.typing as npt

from nte.render.engine.backend import load_mitsuba
from nte.render.engine.types import MitsubaScene, Plugin, Shape
from nte.render.world.scene import Camera, DeformingObject, Material, Medium, Mesh, Pixels, Scene, SceneObject

VEIL = 0.05  # the share of light that a veil reflects or swallows
_DISTANT = 1e5, 1e3  # the distance of a point at infinity: at least in scene units, and in sizes of the scene


def path_integrator(depth: int, media: bool) -> Plugin:
    """Describe Mitsuba's path tracer of `depth` path segments; with media, the path tracer that scatters in them."""
    if media:
        # By default Russian roulette starts at the fifth of some hundred segments, and leaves a few bright paths.
        return {"type": "volpath", "max_depth": depth, "rr_depth": depth}
    return {"type": "path", "max_depth": depth}


def camera_sensor(camera: Camera, width: int, height: int, media: bool) -> Plugin:
    """Describe the sensor of a camera, with a film of width × height pixels and the sampler that every clip uses."""
    lens = {"type": "thinlens", "aperture_radius": camera.aperture, "focus_distance": camera.focus}
    return {
        **(lens if camera.aperture else {"type": "perspective"}),
        "fov": camera.fov, "fov_axis": "x", "near_clip": camera.near, "far_clip": camera.far,
        # Stratified samples cost the same as independent ones and equal them at 1 spp, but references get half the
        # noise. In media they made one path in two million NaN; independent samples made none in ten million.
        "sampler": {"type": "independent" if media else "stratified"},
        # Only the box filter keeps the noise of neighbouring pixels independent, and repeats bit for bit.
        "film": {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb",
                 "component_format": "float32", "rfilter": {"type": "box"}},
    }  # fmt: skip


def environment(scene: Scene) -> dict[str, Plugin]:
    """Describe the light from infinitely far, keyed by its name; an empty dictionary if the scene has none."""
    given = scene.environment
    if given is None:
        return {}
    if isinstance(given, tuple):
        return {"environment": {"type": "constant", "radiance": {"type": "rgb", "value": list(given)}}}
    return {"environment": {"type": "envmap", "bitmap": load_mitsuba().Bitmap(np.ascontiguousarray(given, np.float32))}}


def make_mesh(obj: SceneObject | DeformingObject) -> Shape:
    """Make the Mitsuba mesh of an object at rest, with its material, light and medium."""
    mi = load_mitsuba()
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf(obj.material))
    if obj.radiance is not None:
        radiance = {"type": "rgb", "value": list(obj.radiance)}
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    if obj.medium is not None:
        properties["interior"] = mi.load_dict(medium(obj.medium, obj.mesh))
    made: Shape = mi.Mesh(
        "", len(obj.mesh.positions), len(obj.mesh.faces),
        has_vertex_normals=True, has_vertex_texcoords=True, props=properties,
    )  # fmt: skip
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = flat(obj.mesh.positions)
    parameters["vertex_normals"] = flat(obj.mesh.normals)
    parameters["vertex_texcoords"] = flat(obj.mesh.uv)
    parameters["faces"] = np.ascontiguousarray(obj.mesh.faces, np.uint32).ravel()
    parameters.update()
    return made


def medium(filling: Medium, mesh: Mesh) -> Plugin:
    """Describe the medium that fills a mesh; a varying density covers the mesh's bounding box."""
    mi = load_mitsuba()
    albedo = {"type": "rgb", "value": list(filling.albedo)}
    phase = {"type": "hg", "g": filling.anisotropy}
    if filling.density is None:
        return {"type": "homogeneous", "albedo": albedo, "sigma_t": filling.extinction, "phase": phase}
    low, high = mesh.positions.min(0).astype(float), mesh.positions.max(0).astype(float)
    box = mi.ScalarTransform4f().translate(low).scale(high - low)  # the grid fills the unit cube
    grid = {"type": "gridvolume", "grid": mi.VolumeGrid(filling.density(0)), "to_world": box}
    return {"type": "heterogeneous", "albedo": albedo, "sigma_t": grid, "scale": filling.extinction, "phase": phase,
            "has_spectral_extinction": False}  # fmt: skip


def bsdf(material: Material) -> Plugin:
    """Describe a material. Plain colours are textures too: fewer kinds of plugins let more scenes share kernels."""
    if material.surface == "none":
        return {"type": "null"}
    texture = _bitmap(material.color)
    diffuse = {"type": "diffuse", "reflectance": texture}
    if material.surface == "diffuse":
        return diffuse
    if material.surface == "veil":
        return {"type": "mask", "opacity": VEIL, "bsdf": diffuse}
    metallic = 1.0 if material.surface == "metal" else 0.0
    rough = {"type": "principled", "base_color": texture, "roughness": _number(material.roughness),
             "metallic": metallic}  # fmt: skip
    if material.surface == "glass":  # not `dielectric`, which has neither albedo nor roughness
        rough |= {"spec_trans": 1.0, "eta": 1.5}
    return rough


def _number(value: float | Pixels) -> float | Plugin:
    return value if isinstance(value, float | int) else _bitmap(value)


def _bitmap(texels: Pixels) -> Plugin:
    return {"type": "bitmap", "data": load_mitsuba().TensorXf(texels), "raw": True}


def flat(values: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
    """Return all values as one float32 array (N,), as Mitsuba's mesh parameters take them."""
    return np.ascontiguousarray(values, np.float32).ravel()


def far_away(scene: MitsubaScene) -> float:
    """Return the distance, in scene units, at which a point at infinity is put when it must be a point."""
    box = scene.bbox()
    least, sizes = _DISTANT
    return max(least, sizes * float(np.linalg.norm(np.subtract(box.max, box.min))) if box.valid() else 0)
