"""Frames: named arrays that belong together, NumPy or PyTorch alike."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.frames.frame import Frame
from tests.synthetic import random_frames


def zeros(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


def test_size_batch_channels_and_hits() -> None:
    frame = Frame({"color": zeros(2, 3, 4, 5), "depth": zeros(2, 1, 4, 5)}, index=7)
    frame["depth"][0, 0, 1, 2] = 3
    assert (frame.size, frame.batch, frame.index) == ((4, 5), 2, 7)
    assert "color" in frame
    assert "albedo" not in frame
    assert frame.get("albedo") is None
    assert frame.hit.sum() == 1
    assert frame.hit.shape == (2, 1, 4, 5)


def test_channels_are_added_to_a_new_frame() -> None:
    frame = Frame({"color": zeros(1, 3, 4, 5)}, index=7, exposure=np.ones(1, np.float32))
    more = frame.with_channels(albedo=zeros(1, 3, 4, 5))
    assert set(more.channels) == {"color", "albedo"}
    assert set(frame.channels) == {"color"}
    assert (more.index, more.exposure) == (7, frame.exposure)


def test_there_and_back_between_numpy_and_pytorch() -> None:
    frame = replace(random_frames(1)[0], exposure=np.array([2.0], np.float32), reset=np.array([1.0], np.float32))
    tensors = frame.torch()
    assert all(isinstance(tensor, torch.Tensor) for tensor in (*tensors.channels.values(), tensors.exposure))
    assert tensors.depth_scale is None
    back = tensors.numpy()
    for name, values in frame.channels.items():
        np.testing.assert_array_equal(back[name], values)
    assert (back.exposure, back.reset) == (2, 1)
    assert frame.numpy() is frame


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "array",
    [
        zeros(1, 3, 4, 5)[..., ::-1],
        zeros(1, 4, 5, 3).transpose(0, 3, 1, 2),
        np.broadcast_to(np.float32(1), (1, 3, 4, 5)),
        zeros(1, 3, 4, 5).astype(np.float64),
        zeros(1, 3, 4, 5).astype(">f4"),
        zeros(1, 3, 4, 5).astype(np.uint16),
    ],
    ids=["flipped", "transposed", "read-only", "double", "big-endian", "uint16"],
)
def test_arrays_as_engines_have_them_become_tensors(array: np.ndarray) -> None:
    tensor = Frame({"color": array}).torch()["color"]
    assert tensor.dtype == torch.float32
    np.testing.assert_array_equal(tensor.numpy(), array)


def test_what_does_not_belong_together_is_named() -> None:
    for channels, message in (
        ({"color": zeros(3, 4, 5)}, r"frame 7: color \(3, 4, 5\): expected an array \(N, C, H, W\)"),
        ({"color": [[1]]}, "frame 7: color"),
        ({"color": zeros(1, 3, 4, 5), "depth": zeros(1, 1, 4, 6)}, "frame 7: channels differ in batch or size: color"),
        ({"color": zeros(1, 3, 4, 5), "depth": zeros(2, 1, 4, 5)}, "frame 7: channels differ"),
        ({"color": zeros(1, 3, 4, 5), "depth": torch.zeros(1, 1, 4, 5)}, "all NumPy or all PyTorch: color ndarray"),
    ):
        with pytest.raises(NteError, match=message):
            Frame(channels, 7)
    with pytest.raises(NteError, match="frame 7: channel 'albedo' is missing; it has color"):
        Frame({"color": zeros(1, 3, 4, 5)}, 7)["albedo"]
    with pytest.raises(NteError, match="frame 7: it has no channels"):
        _ = Frame({}, 7).size
