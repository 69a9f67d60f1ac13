"""Renders a sequence with Blender's Cycles, for nte import blender: 1 sample per pixel with every pass, and references.

    blender --background --python datasets/blender/render_sequence.py -- toys /tmp/toys
    python datasets/blender/render_sequence.py toys /tmp/toys     # where Blender is a Python module: pip install bpy
    nte import blender /tmp/toys/noisy --reference /tmp/toys/clean --out data/blender/toys

Frames that are there already are kept. The settings of `cycles` and `passes` are what nte needs of any scene; copy
them to your own. The scenes show what nte's own renderer does not have: Blender's light transport, its noise textures
and bump maps, its sky, its subdivision surfaces, and metals whose albedo is another pass. `toys` and `garden` are to
judge by; `crowd` is another scene for each --seed, to train on.
"""

import argparse
import math
import random
import sys
from pathlib import Path

import bpy
import mathutils


def cycles(width: int, height: int) -> None:
    """Settings of the renderer: nothing that clamps, denoises or filters across pixels."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.render.use_motion_blur = False  # vectors need it to be off
    scene.render.film_transparent = False
    scene.cycles.use_denoising = False
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0  # noise of neighbours stays independent
    scene.cycles.max_bounces = 6
    if hasattr(scene.render.image_settings, "media_type"):  # Blender 5
        scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.exr_codec = "ZIP"


def passes() -> None:
    """Switch on the passes that nte reads."""
    layer = bpy.context.view_layer
    names = (
        "z", "position", "normal", "vector", "object_index", "diffuse_color", "glossy_color", "transmission_color",
        "emit", "environment",
    )  # fmt: skip
    for name in names:
        setattr(layer, f"use_pass_{name}", True)


def render(out: Path, frames: int, spp: int) -> None:
    """Render the missing frames; each has noise of its own."""
    scene = bpy.context.scene
    scene.cycles.samples = spp
    out.mkdir(parents=True, exist_ok=True)
    for frame in range(1, frames + 1):
        path = out / f"{frame:04d}.exr"
        if path.exists():
            continue
        scene.frame_set(frame)
        scene.cycles.seed = 7919 * frame + spp
        scene.render.filepath = str(out / f"unfinished_{frame:04d}.exr")
        bpy.ops.render.render(write_still=True)
        Path(scene.render.filepath).rename(path)


def empty() -> None:
    """Start from a file without anything, the same in every version of Blender."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.world = bpy.data.worlds.new("world")
    bpy.context.scene.world.use_nodes = True


def material(name: str, rng: random.Random, metallic: float = 0.0, glass: float = 0.0, bump: bool = False):
    """A principled material: two colours mixed by noise, which changes the roughness too, with bumps if asked for."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    noise, ramp = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeValToRGB")
    noise.inputs["Scale"].default_value = rng.uniform(2, 9)
    for stop in ramp.color_ramp.elements:
        hue = rng.random()
        level, colour = rng.uniform(0.15, 0.8), [0.5 + 0.5 * math.cos(2 * math.pi * (hue + k / 3)) for k in range(3)]
        stop.color = (*[level * (0.5 + 0.5 * c) for c in colour], 1)
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.4, 0.6
    links.new(noise.outputs["Fac"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Metallic"].default_value = metallic
    shader.inputs["Transmission Weight"].default_value = glass
    rough = nodes.new("ShaderNodeMapRange")
    rough.inputs["To Min"].default_value, rough.inputs["To Max"].default_value = sorted(
        (rng.uniform(0.08, 0.6), rng.uniform(0.08, 0.6))
    )
    links.new(noise.outputs["Fac"], rough.inputs["Value"])
    links.new(rough.outputs["Result"], shader.inputs["Roughness"])
    if bump:
        bumps = nodes.new("ShaderNodeBump")
        bumps.inputs["Strength"].default_value = 0.4
        links.new(noise.outputs["Fac"], bumps.inputs["Height"])
        links.new(bumps.outputs["Normal"], shader.inputs["Normal"])
    return made


def added(what, number: int, look, smooth: bool = True, **where):
    """Add a primitive by its operator, with a material and a number for the object index pass."""
    what(**where)
    thing = bpy.context.object
    thing.data.materials.append(look)
    thing.pass_index = number
    if smooth:
        for face in thing.data.polygons:
            face.use_smooth = True
    return thing


def curves(action) -> list:
    """All curves of an action; Blender 5 keeps them in layers."""
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return [curve for bag in bags for curve in bag.fcurves]


def animated(thing, path: str, values, frames: int) -> None:
    """Set two keys, at the first and the last frame, with a straight line between and beyond them."""
    for frame, value in zip((1, frames), values, strict=True):
        setattr(thing, path, value)
        thing.keyframe_insert(path, frame=frame)
    for curve in curves(thing.animation_data.action):
        curve.extrapolation = "LINEAR"
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"


def camera(frames: int, start, end, target, lens: float) -> None:
    """A camera that moves on a straight line and looks at a point."""
    bpy.ops.object.empty_add(location=target)
    aim = bpy.context.object
    bpy.ops.object.camera_add(location=start)
    eye = bpy.context.object
    eye.data.lens = lens
    follow = eye.constraints.new("TRACK_TO")
    follow.target, follow.track_axis, follow.up_axis = aim, "TRACK_NEGATIVE_Z", "UP_Y"
    animated(eye, "location", (start, end), frames)
    bpy.context.scene.camera = eye


def area_light(power: float, size: float, place, target, colour=(1, 1, 1)) -> None:
    bpy.ops.object.light_add(type="AREA", location=place)
    lamp = bpy.context.object
    lamp.data.energy, lamp.data.size, lamp.data.color = power, size, colour
    way = [b - a for a, b in zip(place, target, strict=True)]
    lamp.rotation_mode = "QUATERNION"
    lamp.rotation_quaternion = mathutils.Vector(way).to_track_quat("-Z", "Y")


def toys(frames: int) -> None:
    """Toys on the floor of a room: monkeys that turn, a ball that rolls, a ring that swings; two lamps."""
    rng, ops = random.Random(3), bpy.ops.mesh
    plain = [material(f"wall {i}", rng, bump=i == 0) for i in range(4)]
    added(ops.primitive_plane_add, 1, plain[0], False, size=8)
    added(ops.primitive_plane_add, 2, plain[1], False, size=8, location=(0, 4, 2), rotation=(math.pi / 2, 0, 0))
    added(ops.primitive_plane_add, 3, plain[2], False, size=8, location=(-4, 0, 2), rotation=(0, math.pi / 2, 0))
    added(ops.primitive_plane_add, 4, plain[3], False, size=8, location=(4, 0, 2), rotation=(0, -math.pi / 2, 0))
    added(ops.primitive_plane_add, 5, plain[1], False, size=8, location=(0, 0, 3.4), rotation=(math.pi, 0, 0))
    for number, x in enumerate((-1.6, 0.0, 1.7)):
        look = material(f"monkey {number}", rng, metallic=float(number == 1), bump=number == 2)
        monkey = added(ops.primitive_monkey_add, 6 + number, look, size=1.1, location=(x, 1.0 + 0.4 * number, 0.8))
        monkey.modifiers.new("smooth", "SUBSURF").render_levels = 2
        animated(monkey, "rotation_euler", ((0, 0, -0.4 + x), (0, 0, 0.5 + x)), frames)
    ball = added(ops.primitive_uv_sphere_add, 9, material("ball", rng, glass=1.0), radius=0.35, location=(0, 0, 0.35))
    animated(ball, "location", ((-2.2, -0.3, 0.35), (1.4, -0.5, 0.35)), frames)
    ring = added(ops.primitive_torus_add, 10, material("ring", rng, 1.0), major_radius=0.5, minor_radius=0.13)
    animated(ring, "location", ((1.5, 0.2, 1.9), (-0.6, 0.4, 1.5)), frames)
    animated(ring, "rotation_euler", ((0.3, 0, 0), (1.7, 0.6, 0)), frames)
    for number in range(8):
        where = (rng.uniform(-2.6, 2.6), rng.uniform(1.4, 3.2), 0.25)
        turned = (0, 0, rng.uniform(0, 3))
        look = material(f"cube {number}", rng, bump=number % 3 == 0)
        added(ops.primitive_cube_add, 11 + number, look, False, size=0.5, location=where, rotation=turned)
    area_light(160, 0.8, (1.8, -1.0, 3.2), (0, 1, 0.5), (1, 0.85, 0.7))
    area_light(60, 0.25, (-3.2, 0.5, 2.6), (0, 1, 0.5), (0.7, 0.85, 1))
    camera(frames, (-1.3, -3.4, 1.6), (0.6, -3.2, 1.9), (0, 1.2, 0.9), 28)


def garden(frames: int) -> None:
    """Thin stalks and stones under a sky with a sun; two balls pass between them, and the camera walks by."""
    rng, ops = random.Random(5), bpy.ops.mesh
    sky = bpy.context.scene.world.node_tree.nodes.new("ShaderNodeTexSky")
    sky.sun_elevation, sky.sun_rotation = math.radians(32), math.radians(140)
    background = next(n for n in bpy.context.scene.world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Strength"].default_value = 0.15
    bpy.context.scene.world.node_tree.links.new(sky.outputs["Color"], background.inputs["Color"])
    added(ops.primitive_plane_add, 1, material("ground", rng, bump=True), False, size=60)
    greens = [material(f"stalk {i}", rng) for i in range(5)]
    for number in range(90):
        x, y, height = rng.uniform(-4, 4), rng.uniform(-0.5, 6), rng.uniform(0.4, 1.6)
        lean = (rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), 0)
        added(
            ops.primitive_cone_add, 100 + number, rng.choice(greens), vertices=6, radius1=0.05, radius2=0.004,
            depth=height, location=(x, y, height / 2), rotation=lean,
        )  # fmt: skip
    stones = [material(f"stone {i}", rng, bump=True) for i in range(3)]
    for number in range(12):
        where = (rng.uniform(-3, 3), rng.uniform(0, 5), 0.1)
        stone = added(
            ops.primitive_ico_sphere_add, 20 + number, rng.choice(stones), False, subdivisions=2,
            radius=rng.uniform(0.15, 0.5), location=where, rotation=[rng.uniform(0, 3) for _ in range(3)],
        )  # fmt: skip
        stone.scale = (1, rng.uniform(0.6, 1.2), rng.uniform(0.4, 0.8))
    for number, (a, b) in enumerate((((-3, 1.5, 0.5), (2.4, 1.8, 0.5)), ((2.5, 3, 0.8), (-1.5, 2.6, 1.1)))):
        look = material(f"ball {number}", rng, metallic=float(number))
        ball = added(ops.primitive_uv_sphere_add, 50 + number, look, radius=0.4, location=a)
        animated(ball, "location", (a, b), frames)
    camera(frames, (-1.2, -3.6, 1.1), (1.1, -3.3, 1.3), (0, 2, 0.6), 32)


def crowd(frames: int, seed: int) -> None:
    """Things of every kind in a room or under a sky, some of which move; another one for each seed."""
    rng, ops = random.Random(1000 + seed), bpy.ops.mesh
    extent = rng.uniform(2.0, 4.0)
    inside = rng.random() < 0.6
    looks = [
        material(
            f"look {i}", rng, metallic=float(rng.random() < 0.25), glass=float(rng.random() < 0.12),
            bump=rng.random() < 0.4,
        )
        for i in range(12)
    ]  # fmt: skip
    added(ops.primitive_plane_add, 1, looks[0], False, size=8 if inside else 60)
    if inside:
        for number, (place, turn) in enumerate(
            (((0, 4, 2), (1, 0, 0)), ((-4, 0, 2), (0, 1, 0)), ((4, 0, 2), (0, -1, 0)), ((0, 0, 3.6), (2, 0, 0)))
        ):
            look, angles = looks[1 + number % 3], [math.pi / 2 * t for t in turn]
            added(ops.primitive_plane_add, 2 + number, look, False, size=8, location=place, rotation=angles)
    kinds = (
        (ops.primitive_uv_sphere_add, "radius", 1.0), (ops.primitive_cube_add, "size", 1.6),
        (ops.primitive_monkey_add, "size", 2.0), (ops.primitive_cone_add, "radius1", 1.0),
        (ops.primitive_ico_sphere_add, "radius", 1.0), (ops.primitive_torus_add, "major_radius", 1.0),
        (ops.primitive_cylinder_add, "radius", 0.4),
    )  # fmt: skip
    for number in range(rng.randint(8, 24)):
        make, measure, factor = rng.choice(kinds)
        size = rng.uniform(0.12, 0.6)
        place = [rng.uniform(-extent, extent), rng.uniform(-0.5, 3.4), rng.uniform(0.1, 1.4)]
        turned = [rng.uniform(0, 6.3) for _ in range(3)]
        where = {"location": place, "rotation": turned, measure: size * factor}
        thing = added(make, 10 + number, rng.choice(looks[4:]), rng.random() < 0.7, **where)
        if make is ops.primitive_torus_add:
            thing.scale = (1, 1, rng.uniform(0.5, 1.5))
        if rng.random() < 0.4:
            animated(thing, "location", (place, [p + rng.uniform(-0.8, 0.8) for p in place]), frames)
        if rng.random() < 0.3:
            animated(thing, "rotation_euler", (turned, [t + rng.uniform(-1, 1) for t in turned]), frames)
    for _ in range(rng.randint(1, 4)):
        place = (rng.uniform(-3, 3), rng.uniform(-2, 3), rng.uniform(2.0, 3.4))
        tint = [rng.uniform(0.5, 1) for _ in range(3)]
        area_light(rng.uniform(30, 200), rng.uniform(0.05, 1.5), place, (0, 1, 0.5), tint)
    background = next(n for n in bpy.context.scene.world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*[rng.uniform(0.2, 1) for _ in range(3)], 1)
    background.inputs["Strength"].default_value = 0.0 if inside else rng.uniform(0.2, 1.5)
    start = [rng.uniform(-1.8, 1.8), rng.uniform(-3.7, -2.6), rng.uniform(0.8, 2.2)]
    end = start if rng.random() < 0.2 else [x + rng.uniform(-0.6, 0.6) for x in start]
    camera(frames, start, end, (rng.uniform(-0.6, 0.6), 1.2, rng.uniform(0.3, 1.1)), rng.uniform(20, 45))


def main() -> None:
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", choices=["toys", "garden", "crowd"])
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--size", default="320x180", help="WIDTHxHEIGHT")
    parser.add_argument("--spp", type=int, nargs="+", default=[1], help="a folder of noisy frames for each")
    parser.add_argument("--reference-spp", type=int, default=1024)
    parser.add_argument("--seed", type=int, default=0, help="of crowd")
    options = parser.parse_args(arguments)
    width, height = (int(n) for n in options.size.split("x"))
    empty()
    if options.scene == "crowd":
        crowd(options.frames, options.seed)
    else:
        {"toys": toys, "garden": garden}[options.scene](options.frames)
    cycles(width, height)
    passes()
    for spp in options.spp:
        render(options.out / ("noisy" if len(options.spp) == 1 else f"noisy_{spp}"), options.frames, spp)
    render(options.out / "clean", options.frames, options.reference_spp)


main()
