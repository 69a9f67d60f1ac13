"""An animated scene: meshes with materials that move, area lights, and a camera. Independent of Mitsuba."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from nte.render.world.transforms import Floats, Track, transform_directions, transform_points

Pixels = npt.NDArray[np.float32]
Colour = tuple[float, float, float]
Surface = Literal["diffuse", "glossy", "metal", "glass", "veil", "none"]

NEAR, FAR = 0.01, 1000.0  # clipping planes of the families' cameras, scene units


@dataclass(frozen=True)
class Mesh:
    """Triangles at rest: positions, unit normals (V, 3) and uv (V, 2) float32, faces (F, 3) uint32.

    Corners of a face run counter-clockwise seen from outside. In a faceted mesh every face has vertices of its own.
    """

    positions: Pixels
    normals: Pixels
    uv: Pixels
    faces: npt.NDArray[np.uint32]


@dataclass(frozen=True)
class Material:
    """The look of a surface: `color` (H, W, 3) is a periodic texture in [0, 1], linear; (1, 1, 3) is a plain colour.

    `color` is the diffuse reflectance, the specular colour of a metal, or the share of light that glass lets through.
    roughness: perceptual, in [0, 1]; 1 for diffuse; a periodic texture (H, W, 1) where it varies. Two surfaces are for
    meshes that hold a medium: a `veil` reflects a twentieth of the light as diffuse does and lets the rest pass
    straight on; `none` is invisible.
    """

    color: Pixels
    surface: Surface = "diffuse"
    roughness: float | Pixels = 1.0


@dataclass(frozen=True)
class Medium:
    """The filling of a closed mesh that scatters light, in the directions of the Henyey-Greenstein phase function.

    extinction: per scene unit, where the density is 1. albedo: the share of the extinction that is scattered; the rest
    is absorbed. anisotropy: mean cosine of scattering, from −1 to 1. density: maps a time in frames to (Z, Y, X)
    float32 ≥ 0 at the centres of equal cells of the mesh's bounding box at rest; None means 1 everywhere. A mesh with a
    density must stay at rest.
    """

    extinction: float
    albedo: Colour = (1.0, 1.0, 1.0)
    anisotropy: float = 0.0
    density: Callable[[float], Pixels] | None = None


@dataclass(frozen=True)
class SceneObject:
    """A rigid mesh on a track; an area light if `radiance` is given, filled if `medium` is given.

    The renderer reads its motion only through `at(time)`.
    """

    mesh: Mesh
    material: Material
    track: Track
    radiance: Colour | None = None
    medium: Medium | None = None

    def at(self, time: float) -> tuple[Floats, Floats]:
        """Return world positions and normals (V, 3) of the vertices at a time in frames."""
        matrix = self.track(time)
        positions = transform_points(matrix, self.mesh.positions)
        return positions, transform_directions(matrix, self.mesh.normals)


@dataclass(frozen=True)
class DeformingObject:
    """A mesh in which every vertex moves by itself; `mesh` gives faces, uv and the number of vertices."""

    mesh: Mesh
    material: Material
    shape: Callable[[float], tuple[Floats, Floats]]  # time in frames → world positions and normals (V, 3)
    radiance: Colour | None = None
    medium: Medium | None = None

    def at(self, time: float) -> tuple[Floats, Floats]:
        """Return world positions and normals (V, 3) of the vertices at a time in frames."""
        return self.shape(time)


@dataclass(frozen=True)
class Camera:
    """A camera on a track (camera → world, see look_at). fov: horizontal, degrees.

    aperture: radius of a thin lens in scene units; 0 is a pinhole. focus: depth at which points are sharp.
    """

    track: Track
    fov: float
    aperture: float = 0.0
    focus: float = 1.0
    near: float = NEAR  # clipping planes, scene units
    far: float = FAR

    def view(self, time: float) -> Floats:
        """Return the 4×4 matrix world → camera at a time in frames."""
        matrix = self.track(time)
        turn = matrix[:3, :3].T
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = turn, -turn @ matrix[:3, 3]
        return view

    def projection(self, width: int, height: int) -> Floats:
        """Return the 4×4 matrix camera → [0, 1]², with y down; times the image's size, pixel centres lie at +0.5.

        Equals mi.perspective_projection without its jitter. The camera's +x is to the left.
        """
        scale = 0.5 / np.tan(np.radians(self.fov) / 2)
        z = self.far / (self.far - self.near)
        down = -scale * width / height
        return np.array([[-scale, 0, 0.5, 0], [0, down, 0.5, 0], [0, 0, z, -self.near * z], [0, 0, 1, 0]])


@dataclass(frozen=True)
class Scene:
    """Objects and a camera. The instance number of objects[i] is i + 1.

    environment: radiance from infinitely far, linear: one colour for all directions, or (H, W, 3) with rows from
    straight up to straight down and columns from −z over +x, +z and −x (scenes.kit.sky makes one).
    least_depth: path segments that the scene needs at least; it replaces a smaller `max_depth` of a recipe. Light in a
    medium scatters many times.
    """

    objects: tuple[SceneObject | DeformingObject, ...]
    camera: Camera
    environment: Colour | Pixels | None = None
    least_depth: int = 0
