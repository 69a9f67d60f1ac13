"""What an animated scene is: meshes with materials that move, area lights, and a camera. No Mitsuba here."""

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

    Faces turn counter-clockwise seen from outside. A faceted mesh has its own vertices on every face.
    """

    positions: Pixels
    normals: Pixels
    uv: Pixels
    faces: npt.NDArray[np.uint32]


@dataclass(frozen=True)
class Material:
    """How a surface looks: `color` (H, W, 3) is a periodic texture in [0, 1], linear; (1, 1, 3) is plain.

    It is the diffuse reflectance, the specular colour of a metal, and what glass lets through. roughness:
    perceptual, in [0, 1]; 1 for diffuse. Two surfaces are for what holds a medium: a `veil` reflects a twentieth of
    the light as diffuse does and lets the rest pass straight on, `none` cannot be seen at all.
    """

    color: Pixels
    surface: Surface = "diffuse"
    roughness: float = 1.0


@dataclass(frozen=True)
class Medium:
    """What fills a closed mesh and scatters light, in the directions of Henyey and Greenstein's lobe.

    extinction: per scene unit, where the density is 1. albedo: the share of it that is scattered, the rest is
    absorbed. anisotropy: mean cosine of scattering, from −1 to 1. density: time in frames → (Z, Y, X) float32 ≥ 0 at
    the middles of equal cells of the mesh's bounding box at rest, where it then must stay; 1 everywhere if None.
    """

    extinction: float
    albedo: Colour = (1.0, 1.0, 1.0)
    anisotropy: float = 0.0
    density: Callable[[float], Pixels] | None = None


@dataclass(frozen=True)
class SceneObject:
    """A rigid mesh on a track; an area light where `radiance` is given, filled where `medium` is.

    All that the renderer asks of its motion is `at(time)`.
    """

    mesh: Mesh
    material: Material
    track: Track
    radiance: Colour | None = None
    medium: Medium | None = None

    def at(self, time: float) -> tuple[Floats, Floats]:
        """World positions and normals (V, 3) of the vertices at a time in frames."""
        matrix = self.track(time)
        positions = transform_points(matrix, self.mesh.positions)
        return positions, transform_directions(matrix, self.mesh.normals)


@dataclass(frozen=True)
class DeformingObject:
    """A mesh whose vertices each go their own way; `mesh` gives faces and uv, and the vertices' number."""

    mesh: Mesh
    material: Material
    shape: Callable[[float], tuple[Floats, Floats]]  # time in frames → world positions and normals (V, 3)
    radiance: Colour | None = None
    medium: Medium | None = None

    def at(self, time: float) -> tuple[Floats, Floats]:
        """World positions and normals (V, 3) of the vertices at a time in frames."""
        return self.shape(time)


@dataclass(frozen=True)
class Camera:
    """On a track (camera → world, see look_at); fov: horizontal, degrees.

    aperture: radius of a thin lens in scene units, 0 is a pinhole; focus: depth at which it shows points sharply.
    """

    track: Track
    fov: float
    aperture: float = 0.0
    focus: float = 1.0
    near: float = NEAR  # clipping planes, scene units
    far: float = FAR

    def view(self, time: float) -> Floats:
        """4×4, world → camera, at a time in frames."""
        matrix = self.track(time)
        turn = matrix[:3, :3].T
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = turn, -turn @ matrix[:3, 3]
        return view

    def projection(self, width: int, height: int) -> Floats:
        """4×4, camera → [0, 1]² with y down; times the size it lands on pixel centres at +0.5.

        Equals mi.perspective_projection without its jitter; the camera's +x is to the left.
        """
        scale = 0.5 / np.tan(np.radians(self.fov) / 2)
        z = self.far / (self.far - self.near)
        down = -scale * width / height
        return np.array([[-scale, 0, 0.5, 0], [0, down, 0.5, 0], [0, 0, z, -self.near * z], [0, 0, 1, 0]])


@dataclass(frozen=True)
class Scene:
    """Objects and a camera. The instance number of objects[i] is i + 1.

    environment: radiance from infinitely far, linear: the same from everywhere, or (H, W, 3) with rows from
    straight up to straight down and columns from −z over +x, +z and −x (kit.sky makes one).
    least_depth: path segments without which the scene is not itself, where a recipe's `max_depth` asks for fewer;
    light in a medium bends many times.
    """

    objects: tuple[SceneObject | DeformingObject, ...]
    camera: Camera
    environment: Colour | Pixels | None = None
    least_depth: int = 0
