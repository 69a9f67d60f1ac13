"""Frames with every channel that any denoiser reads: a slanted, coloured floor that moves through the image."""

import numpy as np
import numpy.typing as npt

from nte.frames.frame import Frame
from tests.filters.trmv_frames import directions
from tests.synthetic import smooth_texture

Pixels = npt.NDArray[np.float32]
VELOCITY = 1.25, -0.5  # px per frame, of the floor
TINT = np.array([0.9, 0.6, 0.3]).reshape(3, 1, 1)


def floor_frame(index: int, size: tuple[int, int] = (24, 36), batch: int = 1, scale: float = 1.0) -> Frame:
    """Frame `index`, the same in every batch element; `scale` multiplies all radiance.

    A floor whose distance grows from bottom to top, textured in colour; the noise is fresh in each frame, and
    repeats from call to call.
    """
    rng = np.random.default_rng(index)
    height, width = size
    y, x = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")

    def full(*values: float) -> Pixels:
        return np.broadcast_to(np.reshape(values, (-1, 1, 1)), (len(values), *size)).astype(np.float32)

    def noise() -> Pixels:
        return rng.uniform(0.5, 1.5, (1, *size))

    albedo = TINT * smooth_texture(x - VELOCITY[0] * index, y - VELOCITY[1] * index)
    normal = full(0, 0.8, 0.6)
    depth = full(1) * (4 + 2 * (1 - y / height))
    light, shadow = noise(), rng.random((1, *size)) < 0.3
    direction = directions(rng, normal[None])[0]
    gradient = np.full((2, *size), np.nan)
    gradient[:, 1::3, 1::3] = light[:, 1::3, 1::3]
    channels = {
        "color": 2 * albedo * light,
        "albedo": albedo,
        "normal": normal,
        "depth": depth,
        "position": np.stack([x, y, 0 * x]) * 0.1,
        "roughness": full(0.3),
        "motion": full(*(-v for v in VELOCITY)),
        "previous_forward_motion": full(*VELOCITY),
        "emission": full(0, 0, 0),
        "direct": albedo,
        "visibility": 1 - shadow,
        "indirect": albedo * noise(),
        "indirect_radiance": noise() * full(1, 1, 1),
        "indirect_direction": direction,
        "glossy": 0.2 * noise() * full(1, 1, 1),
        "shadow_motion": np.where(shadow, full(*(-v for v in VELOCITY)), np.nan),
        "reflection_motion": full(*(-v for v in VELOCITY)),
        "reflection_covariance": full(1, 0.2, 1),
        "gradient": gradient,
        "time": rng.random((1, *size)),
        "shutter_motion": full(*VELOCITY) * (x > width / 3),
        "shutter_depth": depth,
    }
    for name in ("color", "emission", "direct", "indirect", "indirect_radiance", "glossy"):
        channels[name] = scale * channels[name]
    batches = {name: np.repeat(values[None], batch, 0).astype(np.float32) for name, values in channels.items()}
    return Frame(batches, index)
