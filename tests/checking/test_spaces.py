"""Normals and positions of a moving camera's space change alike; in the world, what stands still keeps them."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nte.checking import check
from nte.checking.spaces import changed_alike
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from tests.checking.room import camera
from tests.checking.test_geometry import Change, checked, in_view
from tests.synthetic import Pixels, smooth_texture, write_clip

ROTATION = "one rotation takes those of a frame to those of the next, as in the space of a moving camera"
RIGID = "one rigid motion takes those of a frame to those of the next, as in the space of a moving camera"


def all_in_view(f: dict[str, Pixels], i: int) -> dict[str, Pixels]:
    place, axes = camera(i)
    position = np.einsum("ij,jhw->ihw", axes, f["position"] - place.reshape(3, 1, 1))
    return in_view(f, i) | {"position": np.where(f["depth"] > 0, position, 0)}


@pytest.mark.parametrize(
    ("change", "without", "told"),
    [
        (in_view, ("position",), [("normal", ROTATION)]),
        (in_view, ("position", "depth", "instance"), [("normal", ROTATION)]),
        (all_in_view, (), [("normal", ROTATION), ("position", RIGID)]),
        (all_in_view, ("normal",), [("position", RIGID)]),
        (lambda f, i: all_in_view(f, 0), (), []),  # another world, which stands still
    ],
)
def test_the_space_of_a_moving_camera_is_noted(
    tmp_path: Path, change: Change, without: tuple[str, ...], told: list[tuple[str, str]]
) -> None:
    report = checked(tmp_path, change, without)
    assert report.verdict == "plausible"
    assert [(f.channel, f.found) for f in report.findings if "takes those" in f.found] == told


def test_a_frame_that_differs_by_itself_says_nothing(tmp_path: Path) -> None:
    """Noise in the normals, and one frame in another space than the rest: no motion of a camera explains it."""
    rng = np.random.default_rng(0)
    noisy = checked(tmp_path / "a", lambda f, i: {"normal": f["normal"] + 0.1 * rng.normal(size=f["normal"].shape)})
    once = checked(tmp_path / "b", lambda f, i: in_view(f, i) if i == 3 else {}, ("position",))
    for report in (noisy, once):
        assert not any("takes those" in f.found for f in report.findings)


def test_jitter_is_no_motion(tmp_path: Path) -> None:
    """A camera passes along a wall and samples each frame elsewhere in the pixel, as for temporal antialiasing.

    Its vectors are without the jitter, and all positions shift by as much.
    """
    frames = []
    for i, (dx, dy) in enumerate([(0.0, -0.17), (-0.25, 0.17), (0.25, -0.39), (-0.38, -0.06), (0.12, 0.28)]):
        y, x = np.mgrid[:64, :96] + 0.5
        x, y = x + 3 * i + dx, y + dy
        texture = smooth_texture(2 * x, 2 * y)
        position = np.stack([0.02 * x, -0.02 * y, 0 * x + 2])
        frame = {"color": texture, "albedo": texture, "position": position, "motion": np.stack([0 * x + 3, 0 * x])}
        frames.append({name: values.astype(np.float32) for name, values in frame.items()})
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert not any("takes those" in f.found for f in report.findings)


@pytest.mark.parametrize("known", [True, False])
def test_cameras_that_stand_still_have_no_moving_space(known: bool) -> None:
    """A ball rolls past: all that is seen turns as one body."""
    frames = []
    for i in range(2):
        y, x = (np.mgrid[:64, :96] + 0.5 - np.reshape([32, 40 + 3 * i], (2, 1, 1))) / 24
        inside = x**2 + y**2 < 1
        normal = np.stack([x, y, -np.sqrt(np.maximum(1 - x**2 - y**2, 0))])
        turned = np.stack([normal[0] + 0.1 * i * normal[2], normal[1], normal[2] - 0.1 * i * normal[0]])
        channels = {"normal": turned * inside, "motion": np.stack([-3.0 * inside, 0 * x])}
        camera = torch.eye(4)[None] if known else None
        shown = {name: torch.tensor(np.float32(values))[None] for name, values in channels.items()}
        frames.append(Frame(shown, i, view=camera, projection=camera))
    seen = (frames[1]["normal"] != 0).any(1, keepdim=True)
    assert changed_alike(*frames, seen) == ({} if known else {"normal": True})
