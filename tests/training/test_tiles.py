"""Decoded clips: the same pixels from memory, from files, and from the clip itself; files whole or absent."""

import importlib.metadata
import os
import warnings
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nte.errors import NteError
from nte.frames.clip import Clip, read_frame, write_frame
from nte.frames.clip_files import frame_path
from nte.frames.reference import BadReferenceWarning
from nte.training.config import DataConfig
from nte.training.data import TrainingBatches, training_loader
from nte.training.tiles import TILE, ClipStore
from tests.synthetic import disc_frame, write_clip

CHANNELS = ("color", "albedo", "normal", "depth", "motion", "previous_forward_motion", "reference")
SIZE = 100, 141  # two tiles down, three across, none of them full


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """Three noisy frames with a value beyond half floats. Only to be read."""
    rng = np.random.default_rng(5)
    frames = [disc_frame(i, SIZE, rng=rng) for i in range(3)]
    frames[1]["color"][1, 70, 99] = 1e6
    return Clip(write_clip(tmp_path_factory.mktemp("clips") / "disc_000", frames))


@pytest.fixture(scope="module")
def stores(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> list[ClipStore]:
    return [ClipStore([clip], CHANNELS, folder) for folder in (None, tmp_path_factory.mktemp("cache"))]


@settings(deadline=None, max_examples=30)
@given(data=st.data())
def test_a_crop_is_that_of_the_clip(clip: Clip, stores: list[ClipStore], data: st.DataObject) -> None:
    slices = []
    for length in (3, *SIZE):
        start = data.draw(st.integers(0, length - 1))
        slices.append(slice(start, data.draw(st.integers(start + 1, length))))
    frames, rows, columns = slices
    for store in stores:
        found = store.get(0, 0).crop(frames, rows, columns)
        assert tuple(found) == CHANNELS
        for i in range(3)[frames]:
            expected = clip.frame(i, CHANNELS)
            for name in CHANNELS:
                np.testing.assert_array_equal(found[name][i - frames.start], expected[name][0][:, rows, columns])
                assert found[name].is_contiguous()


def test_what_is_cropped_can_be_changed_without_harm(stores: list[ClipStore]) -> None:
    whole = slice(0, 3), slice(0, TILE), slice(0, TILE)
    for store in stores:
        before = store.get(0, 0).crop(*whole)["color"].clone()
        store.get(0, 0).crop(*whole)["color"].zero_()
        assert torch.equal(store.get(0, 0).crop(*whole)["color"], before)


def test_files_are_made_once_and_only_what_is_read_is_in_memory(
    clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ClipStore([clip], CHANNELS, tmp_path).get(0, 0)
    (folder,) = tmp_path.iterdir()
    assert sorted(path.name for path in folder.iterdir()) == ["scalars.npy", "tiles.npy"]
    monkeypatch.setattr(Clip, "frame", lambda *_: pytest.fail("decoded again"))
    again = ClipStore([clip], CHANNELS, tmp_path).get(0, 0)
    assert isinstance(again.tiles, np.memmap)
    assert not again.tiles.flags.writeable


def test_a_clip_that_is_rendered_again_is_decoded_again(tmp_path: Path) -> None:
    clip = Clip(write_clip(tmp_path / "clip", [disc_frame(i) for i in range(2)]))
    everything = slice(0, 2), slice(0, 48), slice(0, 64)
    first = ClipStore([clip], CHANNELS, tmp_path / "cache").get(0, 0).crop(*everything)["color"]
    path = frame_path(clip.folder, 1)
    frame = read_frame(path)
    write_frame(path, frame | {"color": frame["color"] * 2})
    os.utime(path, ns=(1, 1))  # a clock that is coarse
    second = ClipStore([Clip(clip.folder)], CHANNELS, tmp_path / "cache").get(0, 0).crop(*everything)["color"]
    assert torch.equal(second[0], first[0])
    assert torch.equal(second[1], 2 * first[1])


@pytest.mark.parametrize(("prior", "folders"), [("", 1), ("noisy", 2)])
def test_what_another_denoiser_made_is_made_again_by_another_version_of_it(
    clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, prior: str, folders: int
) -> None:
    channels = (*CHANNELS, "prior") if prior else CHANNELS
    ClipStore([clip], channels, tmp_path, prior=prior).get(0, 0)
    installed = importlib.metadata.version
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "9.9" if name == "pyoidn" else installed(name))
    ClipStore([clip], channels, tmp_path, prior=prior).get(0, 0)
    assert len([*tmp_path.iterdir()]) == folders


def test_a_full_disk_is_one_line_and_leaves_nothing(
    clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(NteError, match=r"cannot be written: No space left on device: name another .* data.cache_dir"):
        ClipStore([clip], CHANNELS, tmp_path / "cache").get(0, 0)
    assert not list((tmp_path / "cache").iterdir())


@pytest.mark.parametrize("damage", ["tiles.npy", "scalars.npy"])
def test_a_damaged_file_is_named(clip: Clip, tmp_path: Path, damage: str) -> None:
    ClipStore([clip], CHANNELS, tmp_path).get(0, 0)
    (folder,) = tmp_path.iterdir()
    for content in (b"", b"nonsense", (folder / damage).read_bytes()[:-8]):
        (folder / damage).write_bytes(content)
        with pytest.raises(NteError, match=rf"{folder.name}: damaged.*: delete it, it will be made again"):
            ClipStore([clip], CHANNELS, tmp_path).get(0, 0)


def test_a_damaged_frame_leaves_nothing_in_the_cache(tmp_path: Path) -> None:
    clip = Clip(write_clip(tmp_path / "clip", [disc_frame(i) for i in range(3)]))
    path = frame_path(clip.folder, 2)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(NteError, match=r"frame_0002.exr: the OpenEXR file is truncated"):
        ClipStore([clip], CHANNELS, tmp_path / "cache").get(0, 0)
    assert not list((tmp_path / "cache").iterdir())


def make(clip: Clip, folder: Path) -> None:
    ClipStore([clip], CHANNELS, folder).get(0, 0)


@pytest.mark.slow
def test_processes_that_decode_the_same_clip_at_once(clip: Clip, tmp_path: Path, stores: list[ClipStore]) -> None:
    processes = [get_context("spawn").Process(target=make, args=(clip, tmp_path)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
        assert process.exitcode == 0
    (folder,) = tmp_path.iterdir()
    np.testing.assert_array_equal(np.load(folder / "tiles.npy"), stores[0].get(0, 0).tiles)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 1, 2])
def test_batches_are_the_same_from_memory_and_from_files_with_any_number_of_workers(
    clip: Clip, tmp_path: Path, workers: int
) -> None:
    choices = {"clips": ["."], "frames": 2, "crop": 48, "batch": 2, "any_start": True, "augment": True, "scatter": 0.5}
    memory = TrainingBatches([clip], CHANNELS, DataConfig(**choices), 1, 0, 1)  # type: ignore[arg-type]
    assert memory.store.folder is None
    config = DataConfig(**choices, workers=workers, cache_gb=0.0)  # type: ignore[arg-type]
    files = TrainingBatches([clip], CHANNELS, config, 1, 0, 1, tmp_path / "decoded")
    assert files.store.folder == tmp_path / "decoded"
    for step, batch in enumerate(training_loader(files, 0, 6)):
        for ours, theirs in zip(batch, memory[step], strict=True):
            assert ours.keys() == theirs.keys()
            assert all(ours[name].numpy().tobytes() == theirs[name].numpy().tobytes() for name in ours)


def test_memory_is_taken_only_where_all_clips_fit_for_every_worker(clip: Clip, tmp_path: Path) -> None:
    gigabytes = ClipStore([clip], CHANNELS).gigabytes(1)
    assert gigabytes * 2**30 == 128 * 192 * 3 * 17 * 4
    for workers, share, fits in ((0, 1.01, True), (1, 1.01, True), (2, 1.01, False), (2, 2.02, True), (0, 0.99, False)):
        config = DataConfig(clips=["."], frames=2, crop=16, workers=workers, cache_gb=share * gigabytes)
        store = TrainingBatches([clip], CHANNELS, config, 1, 0, 1, tmp_path).store
        assert (store.folder is None) == fits
    named = DataConfig(clips=["."], frames=2, crop=16, cache_dir=str(tmp_path / "mine"))
    assert TrainingBatches([clip], CHANNELS, named, 1, 0, 1, tmp_path).store.folder == tmp_path / "mine"


def with_bad_reference(folder: Path, pixels: int, value: float) -> Clip:
    frames = [disc_frame(i) for i in range(4)]
    frames[2]["reference"][1].flat[:pixels] = value
    return Clip(write_clip(folder / "clip", frames))


@pytest.mark.parametrize("value", [np.nan, np.inf, -20.0])
def test_bad_pixels_of_a_reference_are_told_once(tmp_path: Path, value: float) -> None:
    clip = with_bad_reference(tmp_path, 3, value)
    with pytest.warns(BadReferenceWarning, match=r"clip, frame 2: 3 pixels of 'reference' are NaN, inf") as told:
        ClipStore([clip], CHANNELS).get(0, 0)
    assert len(told) == 1


def test_too_many_bad_pixels_of_a_reference_are_an_error(tmp_path: Path) -> None:
    clip = with_bad_reference(tmp_path, 308, np.nan)
    message = r"clip, frame 2: 308 of 3072 pixels of 'reference' are NaN, infinite or negative: expected at most 10%"
    with pytest.raises(NteError, match=message):
        ClipStore([clip], CHANNELS).get(0, 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ClipStore([clip], ("color", "depth")).get(0, 0)  # nobody asked for it


def test_every_mean_of_seeds_takes_its_own_memory(tmp_path: Path) -> None:
    for seed in (1, 2, 3):
        write_frame(frame_path(tmp_path / "disc", 0, seed), {"color": disc_frame(0, (24, 40))["color"]})
    store = ClipStore([Clip(write_clip(tmp_path / "disc", [disc_frame(0, (24, 40))], seeds=4))], CHANNELS)
    # Each of four alone, four pairs of neighbours, four triples, and all together.
    assert [store.gigabytes(most) / store.gigabytes(1) for most in (1, 2, 3, 4, 9)] == [1, 2, 3, 13 / 4, 13 / 4]
