"""A denoiser's state has memory of its own: what a caller does with its arrays afterwards changes no later frame."""

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nte import Denoiser, Frame
from nte.denoiser import Result
from nte.session import Session
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


def in_memory_of_its_own(frame: Frame, kind: str) -> Frame:
    copy = deepcopy(frame)
    return copy.torch() if kind == "PyTorch" else copy


def buffers(frame: Frame) -> list[Any]:
    """All arrays that a caller hands over."""
    about = frame.view, frame.projection, frame.exposure, frame.depth_scale
    return [*frame.channels.values(), *(array for array in about if array is not None)]


def approaching(index: int) -> Frame:
    """A floor that a camera approaches by more than depths of one surface differ, with matrices and scalars."""
    frame = floor_frame(index, (24, 36))
    view, projection = np.eye(4, dtype=np.float32)[None].repeat(2, 0)
    view[2, 3] = -1.5 * index
    projection[:, 2:] = [[0.5, 0], [0.5, 0], [1, -0.1], [1, 0]]
    exposure, scale = (np.array([value], np.float32) for value in (1 + index, 5 - index))
    depth = frame["depth"] + np.float32(1.5 * (2 - index))
    nearer = frame.with_channels(depth=depth, diffuse_albedo=np.float32(0.9) * frame["albedo"])
    return replace(nearer, view=view[None], projection=projection[None], exposure=exposure, depth_scale=scale)


@pytest.mark.parametrize("kind", ["NumPy", "PyTorch"])
@pytest.mark.parametrize("make_frame", [whole_frame, approaching])
def test_buffers_that_are_filled_again_change_nothing(
    denoiser: Denoiser, make_frame: Callable[[int], Frame], kind: str
) -> None:
    """As an engine does with its G-buffer: in every frame the same arrays have the next frame's values."""
    undisturbed, disturbed = Session(denoiser), Session(denoiser)
    names = (*denoiser.needs, *denoiser.optional)
    whole = [make_frame(index) for index in range(3)]
    frames = [replace(f, channels={name: f[name] for name in names if name in f}) for f in whole]
    reused = in_memory_of_its_own(frames[0], kind)
    for frame in frames:
        expected = undisturbed.step(in_memory_of_its_own(frame, kind), denoiser.extras)
        for buffer, values in zip(buffers(reused), buffers(in_memory_of_its_own(frame, kind)), strict=True):
            buffer[:] = values
        found = disturbed.step(replace(reused, index=frame.index), denoiser.extras)
        for ours, theirs in zip(arrays(found), arrays(expected), strict=True):
            np.testing.assert_array_equal(ours, theirs)
            ours[:] = 1  # nor do results that the caller writes to
        for buffer in buffers(reused):
            buffer[:] = 0
