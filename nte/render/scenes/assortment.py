"""Random things of any shape and material: what a scene can hold where no subject asks for anything in particular."""

from collections.abc import Callable

import numpy as np
import trimesh

from nte.render.scenes import furniture, kit, shapes, solids
from nte.render.scenes.patterns import PATTERNS, palette, plain, random_texture
from nte.render.world.scene import Material, Mesh, Pixels, SceneObject
from nte.render.world.transforms import Floats, rotation, still, translation


def any_mesh(rng: np.random.Generator) -> Mesh:
    """Make a random mesh of about one unit in radius, with its centre near the origin: compact, thin or full of holes.

    A third of the meshes are stretched, and a fifth have bumps in their shading normals alone, as by a normal map.
    """
    mesh = _MESHES[rng.integers(len(_MESHES))](rng)
    middle, reach = mesh.positions.mean(0), np.abs(mesh.positions - mesh.positions.mean(0)).max()
    mesh = solids.placed(mesh, translation(-middle), 1.0)
    scale = np.full(3, 1 / reach) * (rng.uniform(0.35, 1.0, 3) if rng.uniform() < 1 / 3 else 1.0)
    x, y, z = (float(s) for s in scale)
    mesh = solids.placed(mesh, np.eye(4), (x, y, z), float(2.0 ** rng.uniform(-1, 2)))
    return bumpy(mesh, rng) if rng.uniform() < 0.2 else mesh


def bumpy(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """Return the mesh with shading normals that wave; what they show is as fine as the mesh's vertices allow."""
    waves = rng.normal(size=(3, 3)) * rng.uniform(6, 14)
    lean = np.cos(mesh.positions @ waves + rng.uniform(0, 6, 3)) * rng.uniform(0.1, 0.35)
    normals = mesh.normals + lean
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(mesh.positions, normals.astype(np.float32), mesh.uv, mesh.faces)


def any_material(rng: np.random.Generator) -> Material:
    """Make a random material: diffuse, glossy, metal or glass; plain or textured; roughness may vary over it too."""
    color = _colour(rng)
    kind = rng.choice(["diffuse", "glossy", "metal", "glass"], p=[0.5, 0.27, 0.17, 0.06])
    if kind == "diffuse":
        return Material(color)
    if kind == "glass":
        return Material(1 - 0.25 * color, "glass", rng.uniform(0.05, 0.25))
    roughness = _roughness(rng)
    if kind == "metal":
        return Material((0.35 + 0.6 * color).astype(np.float32), "metal", roughness)  # real metals reflect most light
    return Material(color, "glossy", roughness)


def _colour(rng: np.random.Generator) -> Pixels:
    """A texture: of the usual contrasts, of one colour, or of shades that hardly differ; at times nearly black."""
    texture = plain(rng) if rng.uniform() < 0.3 else random_texture(rng)
    if rng.uniform() < 0.25:
        texture = texture.mean((0, 1), keepdims=True) * np.float32(0.75) + texture * np.float32(0.25)
    if rng.uniform() < 0.5:  # most things are less colourful than a random palette
        grey = texture.mean(-1, keepdims=True)
        texture = grey + np.float32(rng.uniform(0.1, 0.5)) * (texture - grey)
    darker = np.float32(rng.uniform(0.05, 0.3) if rng.uniform() < 0.12 else 1.0)
    return np.asarray(texture * darker, np.float32)


def _roughness(rng: np.random.Generator) -> float | Pixels:
    """Perceptual roughness, log-uniform from 0.06 to 0.7; a texture of two values on a quarter of the surfaces."""
    low, high = np.sort(np.exp(rng.uniform(np.log(0.06), np.log(0.7), 2)))
    if rng.uniform() < 0.75:
        return float(low)
    pattern = PATTERNS[rng.integers(len(PATTERNS))](rng)[..., :1]
    return np.asarray(low + (high - low) * pattern, np.float32)


def any_ground(rng: np.random.Generator, width: float, depth: float) -> SceneObject:
    """Make a ground that faces up around the origin: flat or in waves, with the material of a floor."""
    size = float(rng.uniform(1.5, 6.0))
    if rng.uniform() < 0.6:
        mesh = shapes.rectangle((-width / 2, 0, depth / 2), (width, 0, 0), (0, 0, -depth), size)
    else:
        waves, phases = rng.normal(size=(3, 2)) * rng.uniform(0.8, 2.5), rng.uniform(0, 6, 3)
        height = rng.uniform(0.02, 0.12)

        def relief(x: Floats, z: Floats) -> Floats:
            return np.asarray(height * np.sin(np.stack([x, z], -1) @ waves.T + phases).sum(-1))

        mesh = solids.sheet(width, depth, relief, size)
    color = random_texture(rng) if rng.uniform() < 0.75 else plain(rng)
    if rng.uniform() < 0.35:
        return SceneObject(mesh, Material(color, "glossy", _roughness(rng)), still())
    return SceneObject(mesh, Material(color), still())


def tint(rng: np.random.Generator) -> tuple[float, float, float]:
    """Make the colour of a light: mostly near white, from warm to cold, and saturated at times."""
    if rng.uniform() < 0.2:
        r, g, b = palette(rng)[2] * 1.3
    else:
        r, g, b = 1 + rng.uniform(-0.35, 0.35) * np.array([1.0, 0.1, -1.0])
    return float(r), float(g), float(b)


def _lattice(rng: np.random.Generator) -> Mesh:
    """Crossing bars with gaps between them."""
    count, width = int(rng.integers(3, 8)), rng.uniform(0.03, 0.1)
    places = np.linspace(-1, 1, count)
    bars = [solids.block((width, 2.0, 0.05), (float(x), -1.0, 0.0)) for x in places]
    if rng.uniform() < 0.6:
        bars += [solids.block((2.0, width, 0.05), (0.0, float(y), 0.02)) for y in places]
    return solids.merged(bars)


def _stalks(rng: np.random.Generator) -> Mesh:
    """A bunch of thin stalks that lean to all sides."""
    stalk = solids.capsule(1.6, float(rng.uniform(0.015, 0.04)))
    leaning = [
        rotation((rng.normal(), 0.0, rng.normal()), rng.uniform(-0.5, 0.5))
        @ translation((*rng.uniform(-0.3, 0.3, 2), 0))
        for _ in range(rng.integers(5, 14))
    ]
    return solids.merged([solids.placed(stalk, matrix) for matrix in leaning])


def _leaves(rng: np.random.Generator) -> Mesh:
    """A cloud of small leaves that face everywhere."""
    leaves = []
    for _ in range(rng.integers(20, 70)):
        place, size = rng.normal(size=3) * 0.45, rng.uniform(0.1, 0.3)
        a, b = np.linalg.qr(rng.normal(size=(3, 3)))[0][:2] * size
        front = shapes.rectangle(place, a, 0.6 * b, 0.5)
        back = shapes.rectangle(place + 1e-3 * np.cross(b, a) / size**2, 0.6 * b, a, 0.5)
        leaves += [front, back]
    return solids.merged(leaves)


def _turned(rng: np.random.Generator) -> Mesh:
    """A turned piece: its profile is a random smooth line."""
    heights = np.linspace(-1, 1, 7)
    radii = np.concatenate([[0.0], rng.uniform(0.15, 0.7, 5), [0.0]])
    return solids.turned(np.stack([radii, heights], 1))


def _cloth(rng: np.random.Generator) -> Mesh:
    """A hanging cloth in folds, with a front and a back."""
    folds, depth = rng.uniform(3, 9), rng.uniform(0.05, 0.15)
    front = solids.sheet(2, 2, lambda x, z: depth * np.sin(folds * x + z), 1.0, cells=48)
    back = Mesh(front.positions - np.float32(2e-3) * front.normals, -front.normals, front.uv, front.faces[:, ::-1])
    return solids.placed(solids.merged([front, back]), rotation((1.0, 0.0, 0.0), np.pi / 2))


def _heap(rng: np.random.Generator) -> Mesh:
    """Boxes of several sizes on top of each other."""
    level, boxes = -1.0, []
    for _ in range(rng.integers(2, 6)):
        w, h, d = (float(x) for x in rng.uniform(0.25, 1.0, 3))
        turned = translation((*rng.uniform(-0.2, 0.2, 1), level, 0.0)) @ rotation(kit.UP, rng.uniform(0, 3))
        boxes.append(solids.placed(solids.block((w, h, d)), turned))
        level += h
    return solids.merged(boxes)


def _prism(rng: np.random.Generator) -> Mesh:
    """A prism or a pyramid stump with flat faces."""
    top = rng.uniform(0.1, 1.0)
    sides = int(rng.integers(3, 8))
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angles), np.zeros(sides), np.sin(angles)], 1)
    points = np.concatenate([ring - (0, 1, 0), top * ring + (0, 1, 0)])
    return shapes.faceted(trimesh.convex.convex_hull(points))


_MESHES: tuple[Callable[[np.random.Generator], Mesh], ...] = (
    lambda rng: shapes.sphere(), lambda rng: shapes.cylinder(), lambda rng: shapes.gem(), shapes.box, shapes.vase,
    shapes.torus, shapes.knot, shapes.boulder, _lattice, _stalks, _leaves, _turned, _cloth, _heap, _prism,
    lambda rng: furniture.chair(), lambda rng: furniture.books(rng, 0.8),
    lambda rng: solids.capsule(rng.uniform(0.5, 2.0), rng.uniform(0.1, 0.5)),
    lambda rng: solids.cushion((1.4, 0.7, 1.2), 0.25),
)  # fmt: skip
