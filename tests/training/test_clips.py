"""Which clips a run learns from: broken ones are named and left out, unless they are too many; shares are kept."""

import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.frames.clip import Clip, read_frame, write_frame
from nte.frames.clip_files import frame_path
from nte.frames.exr_header import missing_end
from nte.training.clips import BrokenClipWarning, open_clips, open_weighted, require_clip, tell_missing
from nte.training.config import DataConfig
from nte.training.data import TrainingBatches
from nte.training.loop import train
from tests.synthetic import disc_clip
from tests.training.runs import tiny_config
from tests.training.test_data import CHANNELS

SMALL = {"size": (24, 24), "start": (10.0, 12.0), "radius": 6.0}


def folder_of(path: Path, count: int, frames: int = 3) -> Path:
    """A folder of small clips."""
    for i in range(count):
        disc_clip(path / f"disc_{i:03d}", frames=frames, seed=i, **SMALL)
    return path


def opened(folder: Path, config: DataConfig | None = None) -> list[Clip]:
    config = config or DataConfig(clips=["."], frames=2, crop=16)
    return open_clips([str(folder)], lambda clip: require_clip(clip, CHANNELS, config))


def cut_off(clip: Path, index: int = 1) -> None:
    path = frame_path(clip, index)
    path.write_bytes(path.read_bytes()[:-200])


def scramble(clip: Path) -> None:
    """Flip bytes among the pixels of a frame, so that its header and its length say nothing."""
    content = bytearray(frame_path(clip, 1).read_bytes())
    content[len(content) // 2 : len(content) // 2 + 400] = b"\x55" * 400
    frame_path(clip, 1).write_bytes(content)


def drop(name: str, clip: Path) -> None:
    for i in range(len(Clip(clip))):
        frame = read_frame(frame_path(clip, i))
        del frame[name]
        write_frame(frame_path(clip, i), frame)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (cut_off, "disc_002/frame_0001.exr: the OpenEXR file is truncated or damaged: its end is missing"),
        (lambda clip: frame_path(clip, 2).unlink(), "disc_002/frame_0002.exr: missing"),
        (lambda clip: (clip / "clip.json").write_text("{"), "disc_002/clip.json: not readable as JSON"),
        (lambda clip: frame_path(clip, 0).write_bytes(b""), "disc_002/frame_0000.exr: the file is empty"),
        (lambda clip: drop("reference", clip), "disc_002: training needs the channel 'reference'; the clip has"),
    ],
)
def test_one_broken_clip_among_many_is_named_and_the_rest_trains(tmp_path: Path, fault: Any, said: str) -> None:
    clips = folder_of(tmp_path / "clips", 4)
    fault(clips / "disc_002")
    with pytest.warns(BrokenClipWarning, match=f"^left out of training: .*{said}") as told:
        found = opened(clips)
    assert [clip.name for clip in found] == ["disc_000", "disc_001", "disc_003"]
    assert len(told) == 1
    assert "\n" not in str(told[0].message)


def test_many_broken_clips_are_a_mistake(tmp_path: Path) -> None:
    clips = folder_of(tmp_path / "clips", 4)
    for name in ("disc_001", "disc_003"):
        cut_off(clips / name)
    with pytest.raises(NteError, match=r"disc_001/frame_0001.exr: .* \(2 of 4 clips cannot be used\)$"):
        opened(clips)
    for name in ("disc_001", "disc_003"):
        shutil.rmtree(clips / name)
    with pytest.raises(NteError, match=r"disc_000: 3 frames: expected .* data.frames 9 .* \(2 of 2 clips cannot be"):
        opened(clips, DataConfig(clips=["."], frames=9))
    shutil.rmtree(clips / "disc_002")
    cut_off(clips / "disc_000")
    with pytest.raises(NteError, match=r"disc_000/frame_0001.exr: .*render or copy it again$"):
        opened(clips)
    with pytest.raises(NteError, match=r"nowhere: does not exist"):
        opened(tmp_path / "nowhere")


def test_every_length_of_a_cut_file_is_found(tmp_path: Path) -> None:
    whole = disc_clip(tmp_path / "clip", frames=1, size=(40, 24))  # three chunks of lines
    content, cut = frame_path(whole, 0).read_bytes(), tmp_path / "cut.exr"
    for length in (*range(0, len(content), 97), len(content) - 1):
        cut.write_bytes(content[:length])
        assert missing_end(cut), length
    assert missing_end(frame_path(whole, 0)) is None


def test_a_clip_whose_pixels_are_damaged_is_replaced_by_the_next_when_it_is_met(tmp_path: Path) -> None:
    clips = folder_of(tmp_path / "clips", 3)
    scramble(clips / "disc_001")
    config = DataConfig(clips=["."], frames=2, crop=16, batch=3)
    found = opened(clips, config)
    assert len(found) == 3
    first, again = (TrainingBatches(found, CHANNELS, config, 1, 0, 1) for _ in range(2))
    with pytest.warns(BrokenClipWarning, match="the next clip takes its place: .*disc_001") as told:
        batches = [first[number] for number in range(3)]
    assert len(told) == 1
    with pytest.warns(BrokenClipWarning, match="left out of training, .*disc_001"):
        later = again[2]
    for frames in batches:
        assert not isinstance(frames, NteError)
        assert frames[0]["color"].shape[0] == 3
    # The batch of a step is the same for a run that is resumed there.
    assert not isinstance(later, NteError)
    assert not isinstance(batches[2], NteError)
    assert torch.equal(later[1]["color"], batches[2][1]["color"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again[0]


def test_when_most_clips_turn_out_to_be_damaged_the_run_ends(tmp_path: Path) -> None:
    clips = folder_of(tmp_path / "clips", 3)
    scramble(clips / "disc_000")
    scramble(clips / "disc_002")
    config = DataConfig(clips=["."], frames=2, crop=16, batch=3)
    with pytest.warns(BrokenClipWarning):
        result = TrainingBatches(opened(clips, config), CHANNELS, config, 1, 0, 1)[0]
    assert isinstance(result, NteError)
    assert "the OpenEXR file is truncated" in str(result)


def test_an_optional_channel_is_used_in_batches_whose_clips_all_have_it(tmp_path: Path) -> None:
    clips = [Clip(disc_clip(tmp_path / f"disc_{i}", frames=3, **SMALL)) for i in range(4)]
    drop("instance", clips[1].folder)
    clips[1] = Clip(clips[1].folder)
    with pytest.warns(BrokenClipWarning, match="1 of 4 clips have no 'instance', for example .*disc_1: a batch with"):
        tell_missing(clips, ["instance"])
    config = DataConfig(clips=["."], frames=2, crop=16, batch=2)
    batches = TrainingBatches(clips, CHANNELS, config, 1, 0, 1, optional=["instance"])
    for number in range(2):
        batch = batches[number]
        assert not isinstance(batch, NteError)
        assert ("instance" in batch[0]) == (1 not in [sample.clip for sample in batches.samples(number)])
        assert {*CHANNELS} <= batch[0].keys()


def test_a_share_is_that_of_the_sequences(tmp_path: Path) -> None:
    folders = [folder_of(tmp_path / name, count) for name, count in (("a", 4), ("b", 1), ("c", 2))]
    config = DataConfig(clips=["."], frames=2, crop=16, batch=8)
    entries = [str(folders[0]), {"folder": str(folders[1]), "share": 0.6}, str(folders[2])]
    chosen = open_weighted(entries, lambda clip: require_clip(clip, CHANNELS, config))
    assert chosen.probabilities == pytest.approx([0.4 / 6] * 4 + [0.6] + [0.4 / 6] * 2)
    batches = TrainingBatches(chosen.clips, CHANNELS, config, 1, 0, 1, probabilities=chosen.probabilities)
    seen = np.bincount([sample.clip for n in range(100) for sample in batches.samples(n)], minlength=7)
    assert seen[4] / seen.sum() == pytest.approx(0.6, abs=0.06)
    assert (seen > 0).all()
    assert batches.samples(7) == batches.samples(7)
    assert open_weighted(entries[:1], lambda clip: None).probabilities is None


@pytest.mark.parametrize(
    ("clips", "message"),
    [
        ("[{folder: a, share: 1.5}]", r"'data.clips': the share of a is 1.5, expected a number in \(0, 1\]"),
        ("[{folder: a, share: often}]", "the share of a is 'often'"),
        ("[{folder: a}]", r"'data.clips' has {'folder': 'a'}, expected a folder, or {folder: data/x, share: 0.2}"),
        ("[7]", "'data.clips' has 7, expected a folder"),
        ("[{folder: a, share: 0.7}, {folder: b, share: 0.7}]", "its shares sum to 1.4, expected at most 1"),
        ("[{folder: a, share: 1}, b]", "its shares sum to 1, which leaves nothing to the folders without a share"),
    ],
)
def test_shares_that_are_none_are_one_line(tmp_path: Path, clips: str, message: str) -> None:
    with pytest.raises(NteError, match=message):
        tiny_config(tmp_path, tmp_path, f"data.clips={clips}")


def test_a_run_trains_without_its_broken_clip_and_resumes_as_the_same_run(tmp_path: Path) -> None:
    clips = folder_of(tmp_path / "clips", 3)
    cut_off(clips / "disc_001")
    short = "phases=[{steps: 1}]", "validate_every=1"
    for more in ((), ("resume=true",)):
        with pytest.warns(BrokenClipWarning, match="disc_001/frame_0001.exr"):
            run = train(tiny_config(tmp_path, clips, *short, *more), device="cpu")
    assert "disc_001" not in (run / "plan.json").read_text()
    disc_clip(clips / "disc_001", frames=3, seed=1, **SMALL)
    with pytest.raises(NteError, match="trained on other clips: 'disc_001' is new"):
        train(tiny_config(tmp_path, clips, *short, "resume=true"), device="cpu")
