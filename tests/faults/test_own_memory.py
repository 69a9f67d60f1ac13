"""A denoiser's state has memory of its own: what a caller does with its arrays afterwards changes no later frame."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from nte import Denoiser, Frame
from nte.denoiser import Result, Session
from tests.everything import floor_frame

pytestmark = pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")


def whole_frame(index: int) -> Frame:
    """A frame whose values are all usable, so that nothing is copied to repair it, and differ from frame to frame.

    In a part of the image the floor comes nearer, by more than two depths of one surface differ, and the vectors of the
    previous frame say that it was uncovered.
    """
    frame = floor_frame(index, (24, 36))
    nearer = np.ones((1, 1, 24, 36), np.float32)
    nearer[..., 3 * index : 3 * index + 12, 5 * index : 5 * index + 15] = 0.4
    turned = np.roll(frame["normal"], index, 1)
    changed = {name: frame[name] * nearer for name in ("depth", "shutter_depth", "position", "roughness")}
    uncovered = frame["depth"] > changed["depth"]
    changed["previous_forward_motion"] = frame["previous_forward_motion"] + np.float32(4) * uncovered
    albedo = np.float32(0.9) * frame["albedo"]
    return frame.with_channels(**changed, normal=turned, geometric_normal=turned.copy(), diffuse_albedo=albedo)


def arrays(result: Result) -> Iterator[Any]:
    yield result.image
    yield from result.extras.values()


@pytest.mark.parametrize("kind", ["NumPy", "PyTorch"])
def test_buffers_that_are_filled_again_change_nothing(denoiser: Denoiser, kind: str) -> None:
    """As an engine does with its G-buffer: in every frame the same arrays have the next frame's values."""

    def copied(values: Any) -> Any:
        return torch.from_numpy(values.copy()) if kind == "PyTorch" else values.copy()

    undisturbed, disturbed = Session(denoiser), Session(denoiser)
    frames = [whole_frame(index) for index in range(3)]
    names = (*denoiser.needs, *denoiser.optional)
    buffers = {name: copied(frames[0][name]) for name in names if name in frames[0]}
    for frame in frames:
        given = {name: copied(frame[name]) for name in buffers}
        expected = undisturbed.step(Frame(given, frame.index), denoiser.extras)
        for name, buffer in buffers.items():
            buffer[:] = given[name]
        found = disturbed.step(Frame(dict(buffers), frame.index), denoiser.extras)
        for ours, theirs in zip(arrays(found), arrays(expected), strict=True):
            np.testing.assert_array_equal(ours, theirs)
            ours[:] = 1  # nor do results that the caller writes to
        for buffer in buffers.values():
            buffer[:] = 0
