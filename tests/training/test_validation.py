"""Validation looks at every family, at clips of its own where they are named, and keeps what was best."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.frames.clip import Clip
from nte.info import describe
from nte.registry import load_denoiser
from nte.training import loop
from nte.training.checkpoint import read_checkpoint
from nte.training.clips import BrokenClipWarning
from nte.training.loop import train
from nte.training.run import load_run
from nte.training.validation import ValidationSet, families, spread, validate
from tests.networks import small_network
from tests.synthetic import disc_clip, disc_frame, write_clip
from tests.training.runs import assert_same_run, checkpoint, copied, metrics, tiny_config
from tests.training.test_clips import scramble

SMALL = {"size": (24, 24), "start": (10.0, 12.0), "radius": 6.0}


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three families of different numbers of clips, one of them much brighter in one half. Only to be read."""
    folder = tmp_path_factory.mktemp("families")
    for name in ("apples_000", "apples_001", "apples_002", "pica_000", "rooms-7", "rooms-8"):
        disc_clip(folder / name, frames=3, seed=len(list(folder.iterdir())), **SMALL)
    return folder


def opened(folder: Path) -> list[Clip]:
    return [Clip(path) for path in sorted(folder.iterdir())]


def test_clips_are_spread_over_families(clips: Path) -> None:
    names = [[clip.name for clip in spread(opened(clips), count)] for count in (1, 3, 5, 9)]
    assert names[0] == ["apples_000"]
    assert names[1] == ["apples_000", "pica_000", "rooms-7"]
    assert names[2] == ["apples_000", "pica_000", "rooms-7", "apples_001", "rooms-8"]
    assert sorted(names[3]) == sorted(path.name for path in clips.iterdir())


def test_a_family_is_a_name_without_its_number_in_its_folder(clips: Path, tmp_path: Path) -> None:
    assert {name: len(found) for name, found in families(opened(clips)).items()} == {"apples": 3, "pica": 1, "rooms": 2}
    for folder in ("a", "b"):
        disc_clip(tmp_path / folder / "0001", frames=1, **SMALL)
    mixed = [Clip(tmp_path / folder / "0001") for folder in ("a", "b")]
    assert list(families(mixed)) == ["a/clips", "b/clips"]


def test_scores_by_family_and_their_mean(clips: Path) -> None:
    network = small_network()
    whole = validate(network, ValidationSet(opened(clips), 1)).scores
    alone = {
        name: validate(network, ValidationSet(found, 1)).scores["validation_psnr"]
        for name, found in families(opened(clips)).items()
    }
    assert {name: whole[f"validation_psnr/{name}"] for name in alone} == pytest.approx(alone)
    assert whole["validation_psnr"] == pytest.approx(np.mean(list(alone.values())))
    assert len(set(alone.values())) == 3


def test_which_frames_count(clips: Path) -> None:
    clip = opened(clips)[0]
    assert [ValidationSet([clip], frames).first(clip) for frames in (0, 1, 2, 9)] == [1, 2, 1, 0]
    one = Clip(disc_clip(clips.parent / "one_frame", frames=1, **SMALL))
    assert ValidationSet([one], 0).first(one) == 0
    network = small_network()
    # A fault in frame 1: seen where all but the first count, not where the last does.
    frames = [disc_frame(i, SMALL["size"], start=(10.0, 12.0), radius=6.0) for i in range(3)]  # type: ignore[arg-type]
    frames[1]["reference"] *= 3
    faulty = Clip(write_clip(clips.parent / "faulty", frames))
    plain = Clip(disc_clip(clips.parent / "plain", frames=3, **SMALL))
    for counted, same in ((1, True), (0, False), (2, False)):
        psnr = [validate(network, ValidationSet([c], counted)).psnr for c in (faulty, plain)]
        assert (psnr[0] == psnr[1]) == same


def test_bad_pixels_of_a_reference_do_not_count(tmp_path: Path) -> None:
    frames = [disc_frame(i, (24, 24), start=(10.0, 12.0), radius=6.0) for i in range(2)]
    network = small_network()
    for value in (np.nan, np.inf, -20.0):
        frames[1]["reference"][2, 3, 4] = value
        clip = Clip(write_clip(tmp_path / "bad", frames))
        scores = validate(network, ValidationSet([clip], 1)).scores
        assert all(np.isfinite(score) for score in scores.values())
        assert scores["validation_psnr"] > 10
    frames[1]["reference"][0, :10] = np.nan
    bad = Clip(write_clip(tmp_path / "bad", frames))
    told = r"bad, frame 1: 240 of 576 pixels of 'reference' are NaN, infinite or neg"
    with (
        pytest.warns(BrokenClipWarning, match=f"left out of validation: .*{told}"),
        pytest.raises(NteError, match=f"no clip to validate on: .*{told}"),
    ):
        validate(network, ValidationSet([bad], 1))


def test_a_damaged_clip_is_left_out_each_time_with_a_warning(clips: Path, tmp_path: Path) -> None:
    damaged = shutil.copytree(clips, tmp_path / "clips")
    for name in ("apples_001", "pica_000"):
        scramble(damaged / name)
    network = small_network()
    for _ in range(2):
        with pytest.warns(BrokenClipWarning, match="^left out of validation: .*apples_001/frame_0001.exr"):
            found = validate(network, ValidationSet(opened(damaged), 1))
        whole = [clip for clip in opened(clips) if clip.name not in ("apples_001", "pica_000")]
        assert found.scores == validate(network, ValidationSet(whole, 1)).scores


def test_a_run_with_a_damaged_clip_ends_and_resumes_as_the_same_run(tmp_path: Path) -> None:
    for i in range(3):
        disc_clip(tmp_path / "clips" / f"disc_{i:03d}", frames=3, seed=i, **SMALL)
    scramble(tmp_path / "clips" / "disc_001")
    short = tiny_config(tmp_path, tmp_path / "clips", "phases=[{steps: 2}]", "validate_every=1", "name=resumed")
    whole = tiny_config(tmp_path, tmp_path / "clips", "phases=[{steps: 4}]", "validate_every=1", "name=whole")
    for config in (short, whole):
        config.optimiser.schedule = "constant"
    with pytest.warns(BrokenClipWarning, match="left out of validation"):
        run = train(short, device="cpu")
    with pytest.warns(BrokenClipWarning, match="left out of validation"):
        undisturbed = train(whole, device="cpu")
    short.phases, short.resume = whole.phases, True
    with pytest.warns(BrokenClipWarning, match="left out of validation"):
        train(short, device="cpu")
    assert_same_run(run, undisturbed)
    assert [line["step"] for line in metrics(run) if "validation_psnr" in line] == [1, 2, 3, 4]


@pytest.mark.parametrize("step", [4, 8])
def test_a_validation_that_fails_leaves_the_checkpoint_of_its_step_and_is_made_up_for(
    finished: Path, tmp_path: Path, noisy_disc: Path, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    done: list[int] = []

    def failing(*args):
        done.append(4 * len(done) + 4)
        if done[-1] == step:
            raise MemoryError
        return validate(*args)

    monkeypatch.setattr(loop, "validate", failing)
    with pytest.raises(MemoryError):
        train(tiny_config(tmp_path, noisy_disc), device="cpu")
    monkeypatch.setattr(loop, "validate", validate)
    run = tmp_path / "runs" / "tiny"
    assert int(checkpoint(run)["step"]) == step  # type: ignore[call-overload]
    train(tiny_config(tmp_path, noisy_disc, "resume=true"), device="cpu")
    assert_same_run(run, finished)
    assert_same_best(run, finished)


def test_clips_of_their_own_are_validated_on_and_not_trained_on(
    finished: Path, tmp_path: Path, noisy_disc: Path, clips: Path
) -> None:
    run = train(tiny_config(tmp_path, noisy_disc, f"data.validation=[{clips}]", "validate_clips=4"), device="cpu")
    ours, theirs = checkpoint(run), checkpoint(finished)
    assert all(torch.equal(ours[name], theirs[name]) for name in ours if name != "step")
    validations = [line for line in metrics(run) if "validation_psnr" in line]
    assert [line["step"] for line in validations] == [4, 8]
    assert {name for name in validations[0] if "/" in name} == {
        f"validation_psnr/{family}" for family in ("apples", "pica", "rooms")
    }
    expected = validate(load_run(run), ValidationSet(spread(opened(clips), 4), 0)).psnr
    assert validations[-1]["validation_psnr"] == pytest.approx(expected)


def test_the_best_checkpoint_is_that_of_the_best_validation(tmp_path: Path, noisy_disc: Path) -> None:
    # A rate at which training gets worse in the end.
    choices = "validate_every=1", "phases=[{steps: 8}]", "optimiser.schedule=constant", "optimiser.learning_rate=0.3"
    run = train(tiny_config(tmp_path, noisy_disc, *choices), device="cpu")
    psnr = {line["step"]: line["validation_psnr"] for line in metrics(run) if "validation_psnr" in line}
    best = max(psnr, key=lambda step: psnr[step])
    step, state = read_checkpoint(run, "best.safetensors")
    assert step == best != 8
    assert state["psnr"].item() == psnr[best]
    loaded = load_run(run / "best.safetensors")
    assert validate(loaded, ValidationSet([Clip(noisy_disc)], 1)).psnr == pytest.approx(psnr[best])
    name = "prediction.trunk.encoders.0.0.weight"
    assert not torch.equal(loaded.state_dict()[name], load_run(run).state_dict()[name])
    assert f"best validation: {psnr[best]:.2f} dB after {best} steps, in {run / 'best.safetensors'}" in describe(run)
    typed = load_denoiser(str(run / "best.safetensors"))
    assert torch.equal(typed.state_dict()[name], loaded.state_dict()[name])  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_best_checkpoint_outlives_resuming(tmp_path: Path, noisy_disc: Path) -> None:
    choices = "validate_every=1", "optimiser.schedule=constant", "optimiser.learning_rate=0.3"
    whole = train(tiny_config(tmp_path, noisy_disc, *choices), device="cpu")
    (tmp_path / "other").mkdir()
    config = tiny_config(tmp_path / "other", noisy_disc, *choices, "resume=true")
    run = train(config, device="cpu")
    assert_same_best(run, whole)
    (run / "checkpoint.safetensors").unlink()  # from the beginning once more: nothing beats what is there
    train(config, device="cpu")
    assert_same_run(run, whole)
    assert_same_best(run, whole)


def assert_same_best(run: Path, expected: Path) -> None:
    (ours_step, ours), (step, theirs) = (read_checkpoint(folder, "best.safetensors") for folder in (run, expected))
    assert ours_step == step
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)


def test_a_damaged_best_checkpoint_is_named(finished: Path, tmp_path: Path) -> None:
    run = copied(finished, tmp_path)
    (run / "best.safetensors").write_bytes(b"nonsense")
    with pytest.raises(NteError, match=r"best.safetensors: not a checkpoint of ours, or damaged"):
        load_run(run / "best.safetensors")
    (run / "best.safetensors").unlink()
    with pytest.raises(NteError, match=r"best.safetensors: missing: the run has not reached its first validation"):
        load_denoiser(str(run / "best.safetensors"))
