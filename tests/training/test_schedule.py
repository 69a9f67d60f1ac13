"""The schedule is a function of the step; a run may be extended wherever its past stays what it was."""

import math
from pathlib import Path

import pytest
import torch

from nte.errors import NteError
from nte.training.config import OptimiserConfig, PhaseConfig
from nte.training.loop import train
from nte.training.schedule import Schedule
from tests.training.runs import checkpoint, contents, copied, metrics, tiny_config

CONSTANT = ("optimiser.schedule=constant", "validate_every=99", "phases=[{steps: 2}, {steps: 2, occlusion: 0.5}]")


def test_phases_share_the_optimisers_cosine_unless_they_have_their_own() -> None:
    optimiser = OptimiserConfig(learning_rate=2.0, schedule="cosine", warmup_steps=2)
    own = PhaseConfig(steps=4, occlusion=0.5, schedule="cosine", learning_rate=0.25)
    phases = [PhaseConfig(steps=3), own, PhaseConfig(steps=5, occlusion=1.0)]
    schedule = Schedule(optimiser, phases, [3, 4, 5])
    shared = [2.0 * min(1, (i + 1) / 2) * (1 + math.cos(math.pi * i / 8)) / 2 for i in range(8)]
    alone = [0.25 * (1 + math.cos(math.pi * i / 4)) / 2 for i in range(4)]
    assert [schedule.at(i).learning_rate for i in range(12)] == pytest.approx([*shared[:3], *alone, *shared[3:]])
    assert [schedule.at(i).occlusion for i in range(12)] == [0.0] * 3 + [0.5] * 4 + [1.0] * 5
    assert schedule.last == 12


def test_a_difference_is_named_with_its_step() -> None:
    flat, phases = OptimiserConfig(learning_rate=2.0), [PhaseConfig(steps=3), PhaseConfig(steps=3, occlusion=0.5)]
    past = Schedule(flat, phases, [3, 3])
    longer = Schedule(flat, [*phases, PhaseConfig(steps=9, schedule="cosine")], [3, 3, 9])
    earlier = Schedule(flat, phases, [2, 3])
    assert past.difference(longer, 6) == ""
    assert past.difference(earlier, 2) == ""
    assert past.difference(earlier, 3) == "the occlusion of step 3 was 0 and would be 0.5"
    assert past.difference(earlier, 6) == "it ends after step 5, and 6 are done"
    cosine = OptimiserConfig(learning_rate=2.0, schedule="cosine")
    assert "the learning rate of step 2 was 2 and" in past.difference(Schedule(cosine, phases, [3, 3]), 6)
    # A cosine of its full length, cut after two steps, is the same as before.
    cut = Schedule(OptimiserConfig(learning_rate=2.0, schedule="cosine", steps=6), phases[:1], [2])
    assert Schedule(cosine, phases, [3, 3]).difference(cut, 2) == ""


def test_a_finished_run_that_is_extended_is_one_that_was_longer_from_the_start(
    tmp_path: Path, noisy_disc: Path
) -> None:
    whole = train(tiny_config(tmp_path, noisy_disc, *CONSTANT[:2], "phases=[{steps: 2}, {steps: 4, occlusion: 0.5}]",
                              "name=whole"), device="cpu")  # fmt: skip
    run = train(tiny_config(tmp_path, noisy_disc, *CONSTANT), device="cpu")
    more = *CONSTANT[:2], "phases=[{steps: 2}, {steps: 4, occlusion: 0.5}]", "resume=true"
    train(tiny_config(tmp_path, noisy_disc, *more), device="cpu")
    ours, theirs = checkpoint(run), checkpoint(whole)
    assert ours.keys() == theirs.keys()
    for name, value in ours.items():
        assert torch.equal(value, theirs[name]) if name != "step" else value == theirs[name] == "6"
    train(tiny_config(tmp_path, noisy_disc, *more), device="cpu")  # the run is the longer one now
    with pytest.raises(NteError, match=r"another schedule for the 6 steps that are done: it ends after step 4"):
        train(tiny_config(tmp_path, noisy_disc, *CONSTANT, "resume=true"), device="cpu")


def test_another_layout_of_the_weights_gives_the_same_training_and_resumes(tmp_path: Path, noisy_disc: Path) -> None:
    short = *CONSTANT[:2], "network.channels=[8, 8]"
    runs = []
    for name, more in (("plain", ()), ("whole", ("channels_last=true",)), ("halves", ("channels_last=true",))):
        if name == "halves":
            train(tiny_config(tmp_path, noisy_disc, *short, *more, f"name={name}", "phases=[{steps: 2}]"), device="cpu")
            more = *more, "resume=true"
        phases = f"name={name}", "phases=[{steps: 4}]"
        runs.append(checkpoint(train(tiny_config(tmp_path, noisy_disc, *short, *more, *phases), device="cpu")))
    plain, whole, halves = runs
    for name, value in plain.items():
        if name.startswith("denoiser."):
            torch.testing.assert_close(whole[name], value, atol=2e-3, rtol=1e-3)
            assert torch.equal(halves[name], whole[name])


def test_a_cosine_that_has_ended_is_extended_by_a_phase_with_a_schedule_of_its_own(
    finished: Path, tmp_path: Path, noisy_disc: Path
) -> None:
    run = copied(finished, tmp_path)
    before = contents(run)
    phases = "phases=[{steps: 4}, {steps: 4, occlusion: 0.5}, {steps: 2, occlusion: 0.5%s}]"
    message = (
        r"another schedule for the 8 steps that are done: the learning rate of step 2 was 0.0096194 and would be 0.00"
    )
    with pytest.raises(NteError, match=message):
        train(tiny_config(tmp_path, noisy_disc, phases % "", "resume=true"), device="cpu")
    assert contents(run) == before
    own = phases % ", schedule: cosine, learning_rate: 1e-3"
    train(tiny_config(tmp_path, noisy_disc, own, "resume=true"), device="cpu")
    assert checkpoint(run)["step"] == "10"
    rates = [line["learning_rate"] for line in metrics(run) if "loss" in line]
    assert rates[:8] == [line["learning_rate"] for line in metrics(finished) if "loss" in line]
    assert rates[8:] == pytest.approx([1e-3, 5e-4])
    with pytest.raises(NteError, match=r"'phases\[0\].learning_rate' needs 'phases\[0\].schedule': constant or cosine"):
        tiny_config(tmp_path, noisy_disc, "phases=[{steps: 4, learning_rate: 1e-3}]")
