"""Families of procedural scenes, by the names that recipes use."""

from typing import Any

from nte.render.scenes.families.indoors import dining, pinkroom, restaurant, rooms, temple
from nte.render.scenes.families.outdoors import cloud, ocean
from nte.render.scenes.families.studies import (
    apples,
    fence,
    jumble,
    limits,
    motion_blur,
    penumbra,
    pica,
    robot,
    spheres,
    subsurface,
)
from nte.render.scenes.family import Family

FAMILIES: dict[str, Family[Any]] = {
    "rooms": Family(rooms.Parameters, rooms.make_room),
    "fence": Family(fence.Parameters, fence.make_fence),
    "pica": Family(pica.Parameters, pica.make_pica),
    "temple": Family(temple.Parameters, temple.make_temple),
    "restaurant": Family(restaurant.Parameters, restaurant.make_restaurant),
    "apples": Family(apples.Parameters, apples.make_apples),
    "pinkroom": Family(pinkroom.Parameters, pinkroom.make_pinkroom),
    "robot": Family(robot.Parameters, robot.make_robot),
    "penumbra": Family(penumbra.Parameters, penumbra.make_penumbra),
    "dining": Family(dining.Parameters, dining.make_dining),
    "spheres": Family(spheres.Parameters, spheres.make_spheres),
    "motion_blur": Family(motion_blur.Parameters, motion_blur.make_motion_blur),
    "limits": Family(limits.Parameters, limits.make_limits),
    "ocean": Family(ocean.Parameters, ocean.make_ocean),
    "cloud": Family(cloud.Parameters, cloud.make_cloud, media=True),
    "jumble": Family(jumble.Parameters, jumble.make_jumble),
    "subsurface": Family(subsurface.Parameters, subsurface.make_subsurface, media=True),
}
