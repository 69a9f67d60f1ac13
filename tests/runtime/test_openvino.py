"""OpenVINO computes what ONNX Runtime does, frame after frame. Skipped without its package, which CI may leave out."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import onnx
import pytest

from nte.errors import NteError
from nte.runtime.placement import Placement, placement
from nte.runtime.providers import OnnxOptions
from nte.runtime.session import OnnxDenoiser
from nte.runtime.trial import trial_frames
from nte.session import Session
from tests.synthetic import random_frames

pytest.importorskip("openvino")
SIZE = (48, 64)


@pytest.fixture(scope="module")
def fast(model: Path) -> OnnxDenoiser:
    return OnnxDenoiser(model, OnnxOptions(provider="openvino", threads=1))


def test_it_agrees_with_the_cpu_over_a_sequence(model: Path, fast: OnnxDenoiser) -> None:
    plain, states, errors = OnnxDenoiser(model, OnnxOptions(threads=1)), [None, None], []
    assert (fast.needs, fast.extras, fast.info) == (plain.needs, plain.extras, plain.info)
    for frame in trial_frames((*plain.needs, *plain.optional), SIZE, 20):
        (ours, states[0]), (theirs, states[1]) = (
            denoiser.step(frame, state, plain.extras) for denoiser, state in zip((fast, plain), states, strict=True)
        )
        errors.append(np.abs(ours.image - theirs.image) / (np.abs(theirs.image) + 0.01))
        assert ours.extras.keys() == theirs.extras.keys()
        for name in ("disoccluded", "valid"):
            assert (ours.extras[name] != theirs.extras[name]).mean() < 1e-3
    assert np.quantile(errors, 0.999) < 1e-3


def test_it_takes_every_operator(model: Path) -> None:
    assert placement(model, "openvino") == Placement((), asked=True)


def test_states_branch_and_images_stay(fast: OnnxDenoiser) -> None:
    first, second, third = random_frames(3)
    _, state = fast.step(first, None)
    once, _ = fast.step(second, state)
    kept = once.image.copy()
    other, _ = fast.step(third, state)
    again, _ = fast.step(second, state)
    assert not np.array_equal(other.image, kept)
    np.testing.assert_array_equal(once.image, kept)
    np.testing.assert_array_equal(again.image, kept)


def test_two_threads_share_it(fast: OnnxDenoiser) -> None:
    ways = [random_frames(4), random_frames(4, size=(33, 17), batch=2)]

    def images(i: int) -> list[np.ndarray]:
        session = Session(fast)
        return [session.denoise(frame) for frame in ways[i]]

    alone = [images(0), images(1)]
    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(images, range(2)))
    np.testing.assert_equal(together, alone)


def test_a_damaged_file_is_one_line(model: Path, tmp_path: Path) -> None:
    for content in (b"", b"no model", model.read_bytes()[:-500]):
        (tmp_path / "damaged.onnx").write_bytes(content)
        with pytest.raises(NteError, match=r"damaged\.onnx: ") as error:
            OnnxDenoiser(tmp_path / "damaged.onnx", OnnxOptions(provider="openvino"))
        assert "\n" not in str(error.value)


def test_an_operator_that_it_lacks_is_named(model: Path, tmp_path: Path) -> None:
    """And not the operator behind it, which OpenVINO lists last, as it cannot tell what it would be given."""
    other = onnx.load(model)
    node = next(node for node in other.graph.node if node.op_type == "ReduceMin")
    node.op_type = "Abacus"
    del other.metadata_props[:]
    onnx.save(other, tmp_path / "m.onnx")
    with pytest.raises(NteError, match=r"m\.onnx: openvino cannot run it: .*Abacus"):
        OnnxDenoiser(tmp_path / "m.onnx", OnnxOptions(provider="openvino"))
