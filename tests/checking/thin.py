"""Hundreds of thin parts before a sky, as seen by a camera that circles them: known in closed form, no texture."""

import numpy as np

from tests.synthetic import Pixels

SAMPLES = 4  # per axis in a pixel, for the albedo


def thin_frames(
    count: int, size: tuple[int, int], parts: int = 300, sky: float = 4.0, travel: float = 1.0, plate: float = 2.0
) -> list[dict[str, Pixels]]:
    """Frames (C, H, W): the sky moves by `sky` px a frame, parts by −`travel` to `travel` as their depth says, and one
    plate of 2 px by `plate`. Parts are tilted rods 0.4 to 2.5 px wide, of one colour each; the sky has albedo 0.
    """
    rng = np.random.default_rng(4)
    height, width = size
    centre = rng.uniform((0.1, 0.1), (0.9, 0.9), (parts, 2)) * (width, height)
    depth = rng.uniform(4, 8, parts)
    speed = np.stack([travel * (depth - 6) / 2, np.zeros(parts)], 1)
    angle = rng.uniform(0, np.pi, parts)
    length, thick = rng.uniform(0.1, 0.3, parts) * height, rng.uniform(0.4, 2.5, parts)
    color = rng.uniform(0.1, 0.9, (parts, 3))
    thick[0], depth[0], speed[0] = 2.0, 3.0, (plate, 0.0)
    order = np.argsort(-depth)
    turned = np.abs([[np.cos(angle), np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    reach = np.einsum("xap,ap->px", turned, np.stack([length, thick]) / 2) + 1  # half the size of what holds a part

    def around(place: Pixels, reach: Pixels, scale: int) -> tuple[tuple[slice, slice], Pixels, Pixels]:
        """The part of an image of `scale` samples a pixel within reach of a place; its x and y from there on, px."""
        ends = (np.stack([place - reach, place + reach]) * scale).astype(int).clip(0)
        columns, rows = (slice(*pair) for pair in ends.T)
        x, y = ((np.arange(size * scale) + 0.5) / scale for size in (width, height))
        return (rows, columns), x[columns] - place[0], (y[rows] - place[1])[:, None]

    frames = []
    for i in range(count):
        albedo = np.zeros((height * SAMPLES, width * SAMPLES, 3), np.float32)
        seen = np.zeros((height, width), np.int64)
        for part in order:
            for show, scale, value in ((albedo, SAMPLES, color[part]), (seen, 1, part + 1)):
                cut, dx, dy = around(centre[part] + i * speed[part], reach[part], scale)
                along = dx * np.cos(angle[part]) + dy * np.sin(angle[part])
                across = dy * np.cos(angle[part]) - dx * np.sin(angle[part])
                show[cut][(abs(along) < length[part] / 2) & (abs(across) < thick[part] / 2)] = value
        mean = albedo.reshape(height, SAMPLES, width, SAMPLES, 3).mean((1, 3)).transpose(2, 0, 1)
        speeds = np.concatenate([[(sky, 0.0)], speed])[seen].transpose(2, 0, 1)
        frames.append(
            {
                "color": mean + 0.5,
                "albedo": mean,
                "depth": np.concatenate([[0.0], depth])[seen][None],
                "instance": seen[None],
                "motion": -speeds,
            }
        )
    return [{name: np.ascontiguousarray(v, np.float32) for name, v in frame.items()} for frame in frames]
