"""A robot of thirteen parts that walks or waves: each part moves on the one that carries it."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import kit, shapes
from nte.render.scenes.family import Dice, one_of, switch
from nte.render.scenes.patterns import checker, dots, stripes
from nte.render.scenes.solids import block, capsule, cushion, merged, placed
from nte.render.world.scene import Scene, SceneObject
from nte.render.world.transforms import Floats, Track, attached, rotation, translation

_THIGH, _SHIN, _HIP = 0.42, 0.42, 0.14  # lengths, and the hip's offset from the middle
_ARM, _FOREARM, _SHOULDER = 0.34, 0.32, 0.3


@dataclass
class Parameters:
    """action: what the robot does. moving_camera: whether the camera circles it."""

    action: str = one_of("walk", "wave")
    moving_camera: bool = switch(False)


def make_robot(dice: Dice, parameters: Parameters) -> Scene:
    """Make the robot in a corner with a textured floor, a big soft light, and a small light that gives it a shadow."""
    floor = kit.textured(dice, kit.shades(dice.uniform(), 0.3, (0.8, 0.6, 0.4)), checker, dots)
    paper = kit.textured(dice, kit.shades(dice.uniform(), 0.35, (0.8, 0.65, 0.45)))
    side = dice.choice([-1, 1])
    objects = [
        kit.ground(14, 10, floor, texture_size=3.0),
        kit.wall((7, 2.4), (-7, 2.4), 5, paper),
        kit.panel(2.0, 2.0, 65.0, kit.aimed(kit.fixed((2.0 * side, 4.2, -2.5)), (0, 0.8, 0.3))),
        kit.panel(0.4, 0.4, 40.0, kit.aimed(kit.fixed((-3.2 * side, 3.4, -2.2)), (0, 0.8, 0.3)), (1, 0.85, 0.65)),
        *_robot(dice, parameters.action),
    ]
    way = 0.6 * dice.choice([-1, 1]) * parameters.moving_camera
    eye = kit.swaying((dice.uniform(-0.5, 0.5), 1.5, -3.3), (way, 0.1 * way, 0), 0.25)
    return Scene(tuple(objects), kit.camera(eye, kit.fixed((0, 0.85, 0.2)), 36))


def _robot(dice: Dice, action: str) -> list[SceneObject]:
    """Body, head, arms and legs. Angles turn about x; forward is −z of the body."""
    rate, reach, phase = dice.apart(0.3, 0.6), dice.uniform(0.5, 0.75), dice.uniform(0, 6)
    body = _walking(dice, rate, reach, phase) if action == "walk" else _on_the_spot(dice, rate)
    stride = reach if action == "walk" else 0.0
    tones = [kit.shades(dice.uniform(), 0.65, (0.85, 0.6, 0.3)) for _ in range(2)]
    paint, limbs = (kit.textured(dice, tone, checker, dots, stripes) for tone in tones)
    steel, metal = kit.plain(0.6, 0.08, 0.85), dice.uniform(0.2, 0.35)
    chest = cushion((0.46, 0.5, 0.28), 0.07, (0, 0.1, 0), 0.5)
    pelvis = cushion((0.36, 0.14, 0.24), 0.05, (0, -0.06, 0), 0.5)
    skull = cushion((0.28, 0.24, 0.24), 0.06, (0, 0.05, 0), 0.4)
    antenna = block((0.02, 0.14, 0.02), (0.08, 0.27, 0), 0.4)
    eyes = merged([placed(shapes.sphere(), translation((x, 0.18, -0.11)), 0.045) for x in (-0.07, 0.07)])
    head = attached(body, _joint((0, 0.62, 0), kit.UP, lambda time: 0.5 * np.sin(0.7 * rate * time + phase)))
    parts = [
        kit.thing(merged([chest, pelvis]), paint, body),
        kit.thing(merged([skull, antenna]), paint, head),
        kit.thing(eyes, steel, head, "metal", 0.15),
    ]
    for side in (-1, 1):
        swing = _wave(rate, side * stride, phase)
        hip = attached(body, _joint((side * _HIP, 0, 0), (1, 0, 0), swing))
        # The knee bends only backwards, most while the leg comes forward.
        bend = _wave(rate, -0.8 * side * stride, phase + 1.2, -0.6 * stride)
        knee = attached(hip, _joint((0, -_THIGH, 0), (1, 0, 0), bend))
        shoulder = attached(body, _joint((side * _SHOULDER, 0.52, 0), (1, 0, 0), _wave(rate, -side * stride, phase)))
        elbow = attached(shoulder, _joint((0, -_ARM, 0), (1, 0, 0), lambda time: 0.6))
        if action == "wave" and side == 1:
            shoulder = attached(body, _joint((_SHOULDER, 0.52, 0), (0, 0, 1), _wave(0.5 * rate, 0.25, phase, 2.3)))
            elbow = attached(shoulder, _joint((0, -_ARM, 0), (0, 0, 1), _wave(1.5 * rate, 0.7, phase, 0.3)))
        hand = cushion((0.1, 0.12, 0.06), 0.025, (0, -_FOREARM - 0.14, 0), 0.3)
        foot = cushion((0.15, 0.09, 0.28), 0.04, (0, -_SHIN - 0.07, -0.06), 0.3)
        parts += [
            kit.thing(capsule(_THIGH, 0.085), limbs, hip),
            kit.thing(capsule(_SHIN, 0.07), steel, knee, "metal", metal),
            kit.thing(foot, limbs, knee),
            kit.thing(capsule(_ARM, 0.07), limbs, shoulder),
            kit.thing(merged([capsule(_FOREARM, 0.055), hand]), steel, elbow, "metal", metal),
        ]
    return parts


def _joint(at: tuple[float, float, float], axis: tuple[float, float, float], angle: kit.Angle) -> Track:
    """A track that turns about an axis at a place of its parent."""
    return lambda time: translation(at) @ rotation(axis, angle(time))


def _wave(rate: float, reach: float, phase: float, middle: float = 0.0) -> kit.Angle:
    return lambda time: middle + reach * np.sin(rate * time + phase)


def _walking(dice: Dice, rate: float, reach: float, phase: float) -> Track:
    """A track across the view, half turned to it, that rises twice a step; feet hardly slide."""
    side = dice.choice([-1, 1])
    speed = 2 * (_THIGH + _SHIN) * np.sin(reach) * rate / np.pi * 0.7
    turn = rotation(kit.UP, -side * (np.pi / 2 - dice.uniform(0.1, 0.5)))

    def track(time: float) -> Floats:
        height = _THIGH + _SHIN + 0.03 - 0.04 * (1 - np.cos(2 * (rate * time + phase)))
        return translation((side * speed * (time - 4.5), height, 0.2)) @ turn

    return track


def _on_the_spot(dice: Dice, rate: float) -> Track:
    """A track that faces the camera, turns to and fro on the spot and leans along."""
    turn, height = dice.uniform(-0.4, 0.4), _THIGH + _SHIN + 0.07

    def track(time: float) -> Floats:
        sway = np.sin(rate * time)
        lean = translation((0, -height, 0)) @ rotation((0, 0, 1), 0.06 * sway) @ translation((0, height, 0))
        return translation((0, height, 0.2)) @ lean @ rotation(kit.UP, turn + 0.3 * sway)

    return track
