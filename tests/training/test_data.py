"""What a step trains on: a function of (seed, step), within what may be trained on."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.frames.clip import Clip
from nte.frames.clip_files import frame_path
from nte.frames.scalars import sequence_scalars
from nte.motion.geometric import scatter_forward_motion
from nte.training.batch import Batch, as_frames, collate
from nte.training.config import DataConfig
from nte.training.data import TrainingBatches, training_loader
from tests.synthetic import Pixels, disc_frame, write_clip

CHANNELS = ("color", "albedo", "motion", "previous_forward_motion", "depth", "reference")
SIZE = 12, 16


def numbered(clip: int, frame: int, seed: int = 0, size: tuple[int, int] = SIZE) -> dict[str, Pixels]:
    """A frame whose albedo says which clip, frame and seed it is, and whose depth gives its pixel."""
    channels = disc_frame(frame, size, start=(6.0, 6.0), radius=3.0)
    for component, value in enumerate((clip, frame, 0)):
        channels["albedo"][component] = value
    channels["color"][:] = 1 + seed
    channels["reference"][0], channels["reference"][1] = np.indices(size)
    return channels


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> list[Clip]:
    """Five clips of six frames, with two noise seeds and each its own shutter."""
    folder = tmp_path_factory.mktemp("numbered")
    for i in range(5):
        write_clip(folder / f"c{i}", [numbered(i, f) for f in range(6)], seeds=2, shutter=1 / (i + 1))
        write_clip(folder / f"c{i}" / "seed_01", [{"color": numbered(i, f, 1)["color"]} for f in range(6)])
        (folder / f"c{i}" / "seed_01" / "clip.json").unlink()
    return [Clip(folder / f"c{i}") for i in range(5)]


def steps(clips: list[Clip], seed: int = 1, rank: int = 0, world: int = 1, **choices: object) -> TrainingBatches:
    config = DataConfig(**({"clips": ["."], "frames": 3, "crop": 8, "batch": 2} | choices))  # type: ignore[arg-type]
    return TrainingBatches(clips, CHANNELS, config, seed, rank, world)


def same(a: Batch, b: Batch) -> bool:
    return all(
        x.keys() == y.keys() and all(torch.equal(x[k].nan_to_num(-9), y[k].nan_to_num(-9)) for k in x)
        for x, y in zip(a, b, strict=True)
    )


def clip_numbers(batch: Batch) -> list[int]:
    return [int(n) for n in batch[0]["albedo"][:, 0, 0, 0]]


RANDOM = {"any_start": True, "augment": True}


def test_a_batch_is_frames_of_sequences_side_by_side(clips: list[Clip]) -> None:
    batch = steps(clips)[0]
    assert len(batch) == 3
    assert {name: tuple(values.shape) for name, values in batch[0].items()} == {
        "color": (2, 3, 8, 8), "albedo": (2, 3, 8, 8), "reference": (2, 3, 8, 8), "motion": (2, 2, 8, 8),
        "depth": (2, 1, 8, 8), "previous_forward_motion": (2, 2, 8, 8), "exposure": (2,), "depth_scale": (2,),
        "shutter": (2,),
    }  # fmt: skip
    frames = list(as_frames(batch))
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert all("exposure" not in frame and frame.exposure is batch[0]["exposure"] for frame in frames)


def test_a_step_depends_on_seed_and_step_alone(clips: list[Clip]) -> None:
    one, other = steps(clips, **RANDOM), steps(clips, **RANDOM)
    later = one[7]
    for step in (0, 3):
        assert same(one[step], other[step])
    assert same(one[7], later)
    assert not same(one[7], one[8])
    assert not same(one[7], steps(clips, seed=2, **RANDOM)[7])


def test_every_frame_of_a_sequence_has_one_crop_one_start_one_clip_and_one_seed(clips: list[Clip]) -> None:
    for step in range(12):
        batch = steps(clips, any_start=True)[step]
        for n in range(2):
            clip, start, _ = batch[0]["albedo"][n, :, 0, 0].tolist()
            corner = batch[0]["reference"][n, :2, 0, 0]
            for i, frame in enumerate(batch):
                assert frame["albedo"][n, :2, 3, 3].tolist() == [clip, start + i]
                assert torch.equal(frame["reference"][n, :2, 0, 0], corner)
                assert frame["color"][n, 0, 0, 0] == batch[0]["color"][n, 0, 0, 0]


def test_both_seeds_all_starts_and_all_corners_occur_but_never_a_held_out_frame(clips: list[Clip]) -> None:
    data = steps(clips, any_start=True, holdout=2)
    seeds, starts, rows, columns = set(), set(), set(), set()
    for step in range(150):
        for frame in data[step]:
            assert frame["albedo"][:, 1].max() < 6 - 2
        first = data[step][0]
        seeds |= set(first["color"][:, 0, 0, 0].tolist())
        starts |= set(first["albedo"][:, 1, 0, 0].tolist())
        rows |= set(first["reference"][:, 0, 0, 0].tolist())
        columns |= set(first["reference"][:, 1, 0, 0].tolist())
    assert seeds == {1, 2}
    assert starts == {0, 1}
    assert rows == set(range(12 - 8 + 1))
    assert columns == set(range(16 - 8 + 1))


def test_without_any_start_sequences_start_at_the_first_frame(clips: list[Clip]) -> None:
    data = steps(clips)
    assert all((data[step][0]["albedo"][:, 1] == 0).all() for step in range(5))


def test_an_epoch_visits_every_clip_once_in_a_new_order(clips: list[Clip]) -> None:
    data = steps(clips, batch=1)
    assert data.epoch == 5
    orders = [[clip_numbers(data[epoch * 5 + i])[0] for i in range(5)] for epoch in range(4)]
    assert all(sorted(order) == list(range(5)) for order in orders)
    assert len({tuple(order) for order in orders}) > 1


def test_the_last_step_of_an_epoch_is_filled_up(clips: list[Clip]) -> None:
    data = steps(clips, batch=2)
    assert data.epoch == 3
    visited = [n for step in range(3) for n in clip_numbers(data[step])]
    assert visited[:5] == [*dict.fromkeys(visited)]
    assert len(visited) == 6


def test_processes_share_a_step_without_overlap(clips: list[Clip]) -> None:
    ranks = [steps(clips, rank=rank, world=2) for rank in range(2)]
    assert ranks[0].epoch == 2
    shares = [clip_numbers(data[0]) for data in ranks]
    assert len({*shares[0], *shares[1]}) == 4
    both = [n for step in range(2) for data in ranks for n in clip_numbers(data[step])]
    assert set(both) == set(range(5))


def test_the_scalars_of_a_sequence_are_those_of_its_clip(clips: list[Clip]) -> None:
    batch = steps(clips)[0]
    first = clips[clip_numbers(batch)[0]].frame(0)
    assert batch[0]["depth_scale"][0] == np.median(first["depth"])
    for frame in as_frames(batch):
        np.testing.assert_allclose(frame.shutter, [1 / (number + 1) for number in clip_numbers(batch)])
    assert all(frame["exposure"] is batch[0]["exposure"] for frame in batch)


def test_clips_with_backward_vectors_only_are_scattered_as_in_inference(tmp_path: Path) -> None:
    frames = [disc_frame(i, (24, 40), start=(10.0, 12.0), radius=6.0) for i in range(4)]
    bare = [{k: v for k, v in frame.items() if k != "forward_motion"} for frame in frames]
    clips = [Clip(write_clip(tmp_path / name, content)) for name, content in (("bare", bare), ("full", frames))]
    data = steps(clips, crop=24, batch=2, holdout=1)
    batch = data[0]
    order = [sample.clip for sample in data.samples(0)]
    columns = [sample.columns for sample in data.samples(0)]
    for n, clip in enumerate(order):
        for i in range(3):
            frame = clips[clip].frame(i)
            expected = (
                frame["previous_forward_motion"]
                if clip == 1
                else scatter_forward_motion(*(torch.from_numpy(frame[c]) for c in ("motion", "depth"))).numpy()
            )
            found = batch[i]["previous_forward_motion"][n].numpy()
            np.testing.assert_array_equal(found, expected[0][:, :, columns[n]])
    assert batch[1]["previous_forward_motion"][order.index(0)].isnan().any()  # the hole behind the disc


def test_scattering_at_random_changes_the_chosen_share_of_sequences_and_nothing_else(clips: list[Clip]) -> None:
    plain, mixed, always = (steps(clips, scatter=share, batch=5) for share in (0.0, 0.5, 1.0))
    scattered = []
    for step in range(12):
        ours, theirs = mixed[step], plain[step]
        assert ours[0].keys() == theirs[0].keys()
        assert sorted(clip_numbers(ours)) == sorted(clip_numbers(theirs))
        scattered += [sample.scattered for sample in mixed.samples(step)]
    assert 0.3 < np.mean(scattered) < 0.7
    assert all(sample.scattered for sample in always.samples(3))
    batch, samples = always[3], always.samples(3)
    for n, sample in enumerate(samples):
        frame = clips[sample.clip].frame(sample.frames.start + 1, seeds=sample.seeds)
        expected = scatter_forward_motion(*(torch.from_numpy(frame[c]) for c in ("motion", "depth")))
        np.testing.assert_array_equal(
            batch[1]["previous_forward_motion"][n], expected[0][:, sample.rows, sample.columns]
        )


def test_networks_without_dual_vectors_scatter_nothing(clips: list[Clip]) -> None:
    channels = tuple(name for name in CHANNELS if name != "previous_forward_motion")
    config = DataConfig(clips=["."], frames=3, crop=8, batch=2, scatter=1.0)
    assert "previous_forward_motion" not in TrainingBatches(clips, channels, config, 1, 0, 1)[0][0]


def test_what_a_step_saw_can_be_named(clips: list[Clip]) -> None:
    data = steps(clips, any_start=True)
    batch, said = data[7], data.describe([7])
    for number, start in zip(clip_numbers(batch), batch[0]["albedo"][:, 1, 0, 0].tolist(), strict=True):
        assert f"c{number} frames {int(start)} to {int(start) + 2}" in said


def test_collate_keeps_order() -> None:
    sequences = [{"color": torch.full((2, 3, 1, 1), n), "exposure": torch.tensor([n])} for n in (1.0, 2.0)]
    for frame in collate(sequences):
        assert frame["color"][:, 0, 0, 0].tolist() == [1, 2]
        assert frame["exposure"].tolist() == [1, 2]


@pytest.mark.slow
def test_worker_processes_give_the_same_batches(clips: list[Clip]) -> None:
    here = list(training_loader(steps(clips, **RANDOM), 3, 9))
    there = list(training_loader(steps(clips, workers=2, **RANDOM), 3, 9))
    assert len(here) == len(there) == 6
    assert all(same(a, b) for a, b in zip(here, there, strict=True))


AFTER_A_VALIDATION = """
import sys
from nte import load_denoiser
from nte.session import Session
from nte.frames.clip import Clip
from nte.training.config import DataConfig
from nte.training.data import TrainingBatches, training_loader
from tests.training.test_data import CHANNELS, same

def steps(clip, workers):
    config = DataConfig(clips=["."], frames=3, crop=8, batch=1, workers=workers)
    return TrainingBatches([clip], (*CHANNELS, "prior"), config, 1, 0, 1, prior="oidn:quality=fast")

if __name__ == "__main__":
    clip = Clip(sys.argv[1])
    Session(load_denoiser("oidn:quality=fast")).denoise(clip.frame(0))
    here, there = (list(training_loader(steps(clip, workers), 0, 2)) for workers in (0, 1))
    assert all(same(a, b) for a, b in zip(here, there, strict=True))
    print(*sorted(here[0][0]))
"""


@pytest.mark.slow
def test_workers_make_a_prior_also_where_this_process_has_made_one(clips: list[Clip], tmp_path: Path) -> None:
    """As a validation does before the loader of a resumed run. OIDN hangs in a fork of a process that has used it."""
    pytest.importorskip("pyoidn")
    script = tmp_path / "after_a_validation.py"
    script.write_text(AFTER_A_VALIDATION)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, script, clips[0].folder]
    said = subprocess.run(command, env=environment, timeout=240, capture_output=True, text=True, check=False)
    assert "prior" in said.stdout.split(), said.stderr


@pytest.mark.slow
def test_a_damaged_frame_met_by_a_worker_is_still_one_line(tmp_path: Path) -> None:
    clip = Clip(write_clip(tmp_path / "clip", [numbered(0, f) for f in range(4)]))
    data = steps([clip], workers=2, batch=1)
    path = frame_path(clip.folder, 2)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(NteError) as error:
        list(training_loader(data, 0, 1))
    assert "frame_0002.exr: the OpenEXR file is truncated" in str(error.value)
    assert "\n" not in str(error.value)


def test_what_cannot_be_trained_on(clips: list[Clip], tmp_path: Path) -> None:
    for choices, message in (
        ({"frames": 6}, r"c0: 6 frames: expected at least data.frames 6 \+ data.holdout 1, those kept for validation"),
        ({"crop": 13}, r"c0: 16x12 is smaller than data.crop 13"),
        ({"crop": 0, "augment": True}, r"c0: 16x12 .* data.crop"),
    ):
        with pytest.raises(NteError, match=message):
            steps(clips, **choices)
    bare = Clip(write_clip(tmp_path / "bare", [{"color": np.ones((3, 12, 16), np.float32)}] * 6))
    with pytest.raises(NteError, match=r"bare: training needs the channel 'albedo'; the clip has color"):
        steps([bare])
    large = Clip(write_clip(tmp_path / "large", [numbered(9, f, size=(16, 16)) for f in range(6)]))
    with pytest.raises(NteError, match=r"large: 16x16, but .*c0 has 16x12: set data.crop"):
        steps([clips[0], large], crop=0)
    assert steps(clips, crop=0)[0][0]["color"].shape == (2, 3, 12, 16)
    assert steps([clips[0], large], crop=0, batch=1)[1][0]["color"].shape[0] == 1


def test_averaged_noise_seeds_are_a_frame_with_as_many_samples(clips: list[Clip]) -> None:
    data = steps(clips, average=8, batch=5)
    counts = []
    for number in range(6):
        batch, samples = data[number], data.samples(number)
        for n, sample in enumerate(samples):
            counts.append(len(sample.seeds))
            for i in range(3):
                frame = clips[sample.clip].frame(sample.frames.start + i, CHANNELS, sample.seeds)
                for name in CHANNELS:
                    expected = frame[name][0][:, sample.rows, sample.columns]
                    np.testing.assert_array_equal(batch[i][name][n], expected)
            exposure, _ = sequence_scalars(clips[sample.clip].frame(0, ("color", "depth"), sample.seeds))
            np.testing.assert_allclose(batch[0]["exposure"][n], exposure[0])
    assert {*counts} == {1, 2}  # of two seeds


def test_what_is_not_configured_draws_nothing(clips: list[Clip]) -> None:
    plain, more = (
        steps(clips, batch=1, **(RANDOM | more)) for more in ({}, {"rotate": True, "radiance": 2.0, "exposure": 1.0})
    )
    for ours, theirs in zip(plain.samples(3), more.samples(3), strict=True):
        assert (ours.clip, ours.seeds, ours.frames, ours.rows) == (
            theirs.clip,
            theirs.seeds,
            theirs.frames,
            theirs.rows,
        )
        assert (ours.augmentation.light, ours.augmentation.exposed, ours.augmentation.rotation) == (1, 1, None)
        assert theirs.augmentation.rotation is not None
        assert ours.augmentation.colours == theirs.augmentation.colours
    exposed = [plain[3][0], more[3][0]]
    lit = [frame["reference"] * frame["exposure"].view(-1, 1, 1, 1) for frame in exposed]
    factors = torch.tensor([sample.augmentation.exposed for sample in more.samples(3)]).view(-1, 1, 1, 1)
    torch.testing.assert_close(lit[1], lit[0] * factors)
