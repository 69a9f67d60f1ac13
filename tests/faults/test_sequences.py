"""Long sequences and several at once: nothing grows, drifts or slows down, and none knows of another."""

import gc
import resource
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from nte import Denoiser, Frame
from nte.session import Session
from tests.conftest import Rounds
from tests.everything import floor_frame

SIZE = 16, 20
CYCLE = 16  # frames of a still scene, whose noise then begins again
LIGHTS = ("color", "indirect", "indirect_radiance", "glossy")
VECTORS = ("motion", "previous_forward_motion", "shadow_motion", "reflection_motion", "shutter_motion")
pytestmark = pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")


def moving(denoiser: Denoiser, first: int, count: int) -> list[Frame]:
    return [chosen(denoiser, floor_frame(index, SIZE)) for index in range(first, first + count)]


def still(denoiser: Denoiser) -> list[Frame]:
    """Frames of a scene at rest, each with noise of its own."""
    frames = []
    for index in range(CYCLE):
        rng = np.random.default_rng(index)
        frame = floor_frame(0, SIZE)
        noisy = {name: frame[name] * rng.uniform(0.5, 1.5, (1, 1, *SIZE)).astype(np.float32) for name in LIGHTS}
        visibility = (rng.random((1, 1, *SIZE)) < 0.7).astype(np.float32)
        rest = {name: 0 * frame[name] for name in VECTORS}
        frames.append(
            chosen(denoiser, replace(frame.with_channels(**noisy, **rest, visibility=visibility), index=index))
        )
    return frames


def chosen(denoiser: Denoiser, frame: Frame) -> Frame:
    """The frame with the channels that a denoiser reads."""
    frame = frame.with_channels(diffuse_albedo=np.float32(0.9) * frame["albedo"])
    names = (*denoiser.needs, *denoiser.optional)
    return Frame({name: frame[name] for name in names if name in frame}, frame.index)


def images(denoiser: Denoiser, frames: Sequence[Frame]) -> list[npt.NDArray[np.float32]]:
    session = Session(denoiser)
    return [session.denoise(frame).copy() for frame in frames]


def test_sequences_side_by_side_are_those_one_after_the_other(make: Callable[[], Denoiser]) -> None:
    """In two threads with one denoiser, and in turns: bit for bit, as with a new denoiser for each."""
    denoiser = make()
    sequences = [moving(denoiser, 0, 5), moving(denoiser, 7, 5)]
    alone = [images(make(), frames) for frames in sequences]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda frames: images(denoiser, frames), sequences))
    sessions = [Session(denoiser) for _ in sequences]
    in_turns = [
        [s.denoise(f).copy() for s, f in zip(sessions, pair, strict=True)] for pair in zip(*sequences, strict=True)
    ]
    for ours, theirs, expected in zip(together, zip(*in_turns, strict=True), alone, strict=True):
        np.testing.assert_array_equal(ours, expected)
        np.testing.assert_array_equal(theirs, expected)


@pytest.mark.slow
def test_a_long_still_sequence_neither_drifts_nor_grows_nor_slows_down(
    make: Callable[[], Denoiser], rounds: Rounds
) -> None:
    denoiser = make()
    frames, tenth = still(denoiser), rounds("frames of long sequences", 160, 10_000) // 10
    session, means, seconds, memory = Session(denoiser), [], [], []
    for index in range(10 * tenth):
        frame = frames[index % CYCLE]
        start = time.process_time()  # not what other processes take
        image = session.denoise(Frame(frame.channels, index))
        seconds.append(time.process_time() - start)
        means.append(float(image.mean()))
        assert np.isfinite(image).all()
        if (index + 1) % tenth == 0:
            gc.collect()
            memory.append(resident())
    whole = tenth // CYCLE * CYCLE  # as often each frame's noise
    early, late = np.mean(means[2 * tenth :][:whole]), np.mean(means[-whole:])
    assert late == pytest.approx(early, rel=0.005)
    if tenth >= 1000:  # a short sequence costs less than what else a process and its machine do
        assert memory[-1] < 1.01 * memory[1]
        assert np.median(seconds[-tenth:]) < 1.5 * np.median(seconds[tenth : 2 * tenth])


def resident() -> int:
    """Bytes in memory now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
