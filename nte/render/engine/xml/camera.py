"""The camera of an XML scene."""

import numpy as np

from nte.errors import NteError
from nte.render.engine.backend import load_mitsuba
from nte.render.engine.types import MitsubaScene, Parameters
from nte.render.engine.xml.moving import array_of
from nte.render.world.keyframes import Animation, camera_track
from nte.render.world.scene import Camera
from nte.render.world.transforms import still

_SENSORS = ("PerspectiveCamera", "ThinLensCamera")


def xml_camera(scene: MitsubaScene, animation: Animation) -> Camera:
    """Read the first sensor of an XML scene as a camera, on the animation's own track if it has one.

    Raises NteError for a scene without a sensor and for a sensor that nte cannot render with.
    """
    if not scene.sensors():
        raise NteError(f"{animation.xml}: has no sensor: expected a perspective or thinlens camera")
    sensor = scene.sensors()[0]
    if (kind := sensor.class_name()) not in _SENSORS:
        raise NteError(f"{animation.xml}: its sensor is a {kind}: expected a perspective or thinlens camera")
    values: Parameters = load_mitsuba().traverse(sensor)

    def number(name: str, otherwise: float = 0.0) -> float:
        return float(np.array(values[name]).ravel()[0]) if name in values else otherwise

    if number("principal_point_offset_x") or number("principal_point_offset_y"):
        raise NteError(f"{animation.xml}: its sensor has a principal point offset, which nte's cameras have not")
    matrix = array_of("to_world", values["to_world"])
    matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
    track = still(matrix)
    if animation.camera:
        # Many XML files have a camera that mirrors the image; keyframes keep the mirroring.
        mirror = np.diag([np.sign(np.linalg.det(matrix[:3, :3])), 1.0, 1.0, 1.0])
        moved = camera_track(animation.camera, animation.interpolation)
        track = lambda time: np.asarray(moved(time) @ mirror)  # noqa: E731
    lens = number("aperture_radius"), number("focus_distance", 1.0)
    return Camera(track, number("x_fov"), *lens, number("near_clip"), number("far_clip"))
