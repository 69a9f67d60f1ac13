"""A run in this process: what it leaves behind, repeats, continues and refuses."""

import json
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.frames.clip import read_frame
from nte.frames.reference import BadReferenceWarning
from nte.training.config import OptimiserConfig
from nte.training.loop import train
from nte.training.losses import SequenceLoss, Unrolled
from nte.training.run import load_run
from nte.training.schedule import learning_rate
from tests.synthetic import write_clip
from tests.training.runs import TIMINGS, assert_same_run, checkpoint, contents, copied, metrics, tiny_config


def test_a_run_folder_says_everything_about_its_run(finished: Path, noisy_disc: Path) -> None:
    names = sorted(re.sub("tfevents.*", "tfevents", path.name) for path in finished.iterdir())
    assert names == [
        "best.safetensors", "checkpoint.safetensors", "config.yaml", "events.out.tfevents", "metrics.jsonl",
        "plan.json", "versions.json",
    ]  # fmt: skip
    plan = json.loads((finished / "plan.json").read_text())
    assert (plan["processes"], plan["steps"], [clip[0] for clip in plan["clips"]]) == (1, [4, 4], ["disc"])
    versions = json.loads((finished / "versions.json").read_text())
    assert versions["torch"] == version("torch")
    assert {"pyoidn", "onnxruntime", "openvino"} <= versions.keys()
    assert str(noisy_disc) in (finished / "config.yaml").read_text()
    assert checkpoint(finished)["step"] == "8"


def test_the_log_has_losses_validation_and_what_training_costs(finished: Path) -> None:
    lines = [json.loads(line) for line in (finished / "metrics.jsonl").read_text().splitlines()]
    steps = [line for line in lines if "loss" in line]
    assert [line["step"] for line in steps] == list(range(1, 9))
    for line in steps:
        assert {"loss", "spatial", "temporal", "learning_rate", *TIMINGS} <= line.keys()
        assert ("occlusion" in line) == (line["step"] > 4)
        assert 0 <= line["loader_wait"] <= 1
    assert [line["step"] for line in lines if "validation_psnr" in line] == [4, 8]
    schedule = OptimiserConfig(learning_rate=1e-2, schedule="cosine")
    assert [line["learning_rate"] for line in steps] == [learning_rate(schedule, step, 8) for step in range(8)]


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(
    finished: Path, tmp_path: Path, noisy_disc: Path
) -> None:
    assert_same_run(train(tiny_config(tmp_path, noisy_disc), device="cpu"), finished)
    other = train(tiny_config(tmp_path, noisy_disc, "seed=2", "name=other"), device="cpu")
    name = "denoiser.prediction.trunk.encoders.0.0.weight"
    assert not torch.equal(checkpoint(other)[name], checkpoint(finished)[name])


@pytest.mark.slow
def test_training_learns(tmp_path: Path, noisy_disc: Path) -> None:
    # Noise that is wanted: kernels that average, as they do in the beginning, are the wrong ones.
    frames = [read_frame(noisy_disc / f"frame_{i:04d}.exr") for i in range(4)]
    clip = write_clip(tmp_path / "clip", [frame | {"reference": frame["color"]} for frame in frames])
    errors = []
    for steps in (1, 60):
        config = tiny_config(tmp_path, clip, f"phases=[{{steps: {steps}}}]", f"name=run{steps}", "optimiser.ema=0")
        errors.append(metrics(train(config, device="cpu"))[-1]["validation_l1"])
    assert errors[1] < 0.5 * errors[0]


def test_a_loaded_run_is_its_moving_average(finished: Path, tmp_path: Path, noisy_disc: Path) -> None:
    state = checkpoint(finished)
    name = "prediction.trunk.encoders.0.0.weight"
    loaded = load_run(finished)
    assert torch.equal(loaded.state_dict()[name], state[f"average.module.{name}"])
    assert not torch.equal(state[f"average.module.{name}"], state[f"denoiser.{name}"])
    assert not any(parameter.requires_grad for parameter in loaded.parameters())
    plain = train(tiny_config(tmp_path, noisy_disc, "optimiser.ema=0", "phases=[{steps: 1}]"), device="cpu")
    assert torch.equal(load_run(plain).state_dict()[name], checkpoint(plain)[f"denoiser.{name}"])


def test_a_finished_run_can_be_resumed_without_a_change_wherever_it_lies(
    finished: Path, tmp_path: Path, noisy_disc: Path
) -> None:
    run = copied(finished, tmp_path)
    train(tiny_config(tmp_path, noisy_disc, "resume=true"), device="cpu")
    assert_same_run(run, finished)


def test_a_run_whose_configuration_names_no_kind_of_network_is_of_the_first_kind(
    finished: Path, tmp_path: Path, noisy_disc: Path
) -> None:
    run = copied(finished, tmp_path)
    said = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(said.replace("  kind: temporal\n", ""))
    assert (run / "config.yaml").read_text() != said
    assert torch.equal(
        load_run(run).state_dict()["prediction.heads.heads.0.bias"], load_run(finished).prediction.heads.heads[0].bias
    )
    train(tiny_config(tmp_path, noisy_disc, "resume=true"), device="cpu")
    assert_same_run(run, finished)


def test_the_moving_average_by_hand(tmp_path: Path, noisy_disc: Path) -> None:
    name = "prediction.trunk.encoders.0.0.weight"
    weights, averages = [], []
    for steps in (1, 2):
        choices = f"phases=[{{steps: {steps}}}]", f"name=run{steps}", "optimiser.schedule=constant"
        state = checkpoint(train(tiny_config(tmp_path, noisy_disc, *choices), device="cpu"))
        weights.append(state[f"denoiser.{name}"])
        averages.append(state[f"average.module.{name}"])
    assert torch.equal(averages[0], weights[0])
    torch.testing.assert_close(averages[1], 0.9 * weights[0] + 0.1 * weights[1])


def test_bfloat16_trains(tmp_path: Path, noisy_disc: Path) -> None:
    run = train(tiny_config(tmp_path, noisy_disc, "precision=bf16-mixed", "phases=[{steps: 2}]"), device="cpu")
    weights = checkpoint(run)["denoiser.prediction.trunk.encoders.0.0.weight"]
    assert weights.dtype == torch.float32
    assert weights.isfinite().all()


def test_what_exists_is_not_touched(finished: Path, tmp_path: Path, noisy_disc: Path) -> None:
    run = copied(finished, tmp_path)
    before = contents(run)
    with pytest.raises(NteError, match="tiny: exists: continue it with resume=true, or overwrite it with --force"):
        train(tiny_config(tmp_path, noisy_disc), device="cpu")
    for override, message in (
        (
            "seed=3",
            "another configuration: 'seed' is 1 there and 3 here; "
            r"give the run another name \(in nte compare: use another --runs\), or restore the value",
        ),
        ("network.channels=[4,6]", r"'network.channels' is \[4, 4\] there and \[4, 6\] here"),
        (
            "phases=[{steps: 9}]",
            "another schedule for the 8 steps that are done: the learning rate of step 2 was 0.0096194 and would be "
            "0.00969846; keep 'phases'",
        ),
    ):
        with pytest.raises(NteError, match=message):
            train(tiny_config(tmp_path, noisy_disc, "resume=true", override), device="cpu")
    (run / "notes.txt").write_text("mine")
    with pytest.raises(NteError, match=r"notes.txt: not a file of a run: .* nothing was overwritten"):
        train(tiny_config(tmp_path, noisy_disc), force=True, device="cpu")
    (run / "notes.txt").unlink()
    assert contents(run) == before
    (run / "config.yaml").unlink()
    with pytest.raises(
        NteError, match=r"tiny: config.yaml is missing, so nobody knows how the run was made: restore it"
    ):
        train(tiny_config(tmp_path, noisy_disc, "resume=true"), device="cpu")
    assert contents(run) == {name: content for name, content in before.items() if name != "config.yaml"}


def test_how_a_run_is_watched_may_change_when_it_is_resumed(finished: Path, tmp_path: Path, noisy_disc: Path) -> None:
    copied(finished, tmp_path)
    changed = ("resume=true", "log_every=1", "validate_every=3", "data.workers=1", "data.cache_gb=0.5")
    assert_same_run(train(tiny_config(tmp_path, noisy_disc, *changed), device="cpu"), finished)


def test_force_starts_anew_even_over_what_a_killed_process_left(
    finished: Path, tmp_path: Path, noisy_disc: Path
) -> None:
    run = copied(finished, tmp_path)
    (run / ".checkpoint.safetensors.0123abcd.tmp").write_bytes(b"half a checkpoint")
    assert_same_run(train(tiny_config(tmp_path, noisy_disc), force=True, device="cpu"), finished)
    assert not list(run.glob(".*"))


def test_resume_cleans_up_and_begins_what_had_hardly_begun(finished: Path, tmp_path: Path, noisy_disc: Path) -> None:
    run = tmp_path / "runs" / "tiny"
    run.mkdir(parents=True)
    (run / "versions.json").write_text("{}")
    (run / ".config.yaml.0123abcd.tmp").write_text("name: ti")
    train(tiny_config(tmp_path, noisy_disc, "resume=true"), device="cpu")
    assert_same_run(run, finished)
    assert not list(run.glob(".*"))


def test_resume_forgets_what_was_logged_after_the_checkpoint(finished: Path, tmp_path: Path, noisy_disc: Path) -> None:
    run = copied(finished, tmp_path)
    with (run / "metrics.jsonl").open("a") as file:
        file.write('{"step": 9, "loss": 1}\n{"step": 10, "lo')
    train(tiny_config(tmp_path, noisy_disc, "resume=true"), device="cpu")
    assert metrics(run) == metrics(finished)


def test_what_is_no_run_and_what_cannot_be_written(tmp_path: Path, noisy_disc: Path) -> None:
    with pytest.raises(NteError, match=r"config.yaml is missing"):
        load_run(tmp_path)
    (tmp_path / "runs").write_text("a file in the way")
    with pytest.raises(NteError, match=r"runs.*: cannot be made a folder"):
        train(tiny_config(tmp_path, noisy_disc), device="cpu")


@pytest.mark.slow
def test_a_wrong_configuration_is_told_before_what_takes_seconds_is_imported(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("sead: 1\n")
    code = (
        "import sys, nte\n"
        "try: nte.train(sys.argv[1])\n"
        "except nte.NteError as error: print(error)\n"
        "print(sys.modules.keys() & {'torch', 'lightning_fabric', 'torchmetrics', 'torch._dynamo'})"
    )
    said = subprocess.run([sys.executable, "-c", code, tmp_path / "c.yaml"], capture_output=True, text=True).stdout
    assert "'sead'" in said.splitlines()[0]
    assert said.splitlines()[1] == "{'torch'}"


def test_bad_pixels_of_the_reference_are_left_out(tmp_path: Path, noisy_disc: Path) -> None:
    frames = [read_frame(noisy_disc / f"frame_{i:04d}.exr") for i in range(4)]
    for frame, value in zip(frames, (np.nan, np.inf, -20.0, np.nan), strict=True):
        frame["reference"][1, 12, 20] = value
    clip = write_clip(tmp_path / "clip", frames)
    with pytest.warns(BadReferenceWarning, match=r"clip, frame 0: 1 pixels of 'reference'"):
        run = train(tiny_config(tmp_path, clip, "data.crop=24"), device="cpu")
    assert all(np.isfinite(value) for line in metrics(run) for value in line.values())


def test_clips_with_backward_vectors_only_train_and_validate(tmp_path: Path, noisy_disc: Path) -> None:
    frames = [read_frame(noisy_disc / f"frame_{i:04d}.exr") for i in range(4)]
    for frame in frames:
        del frame["forward_motion"]
    clip = write_clip(tmp_path / "bare", frames)
    run = train(tiny_config(tmp_path, clip, "data.batch=1"), device="cpu")
    assert [line["step"] for line in metrics(run) if "validation_psnr" in line] == [4, 8]
    # It is the training of a clip that has forward vectors, with all of them scattered; with its own it is another one.
    choices = {"scattered": "data.scatter=1", "stored": "data.scatter=0"}
    ours, scattered, stored = (
        checkpoint(folder)["denoiser.prediction.heads.heads.0.weight"]
        for folder in (
            run,
            *(
                train(tiny_config(tmp_path, noisy_disc, "data.batch=1", choice, f"name={name}"), device="cpu")
                for name, choice in choices.items()
            ),
        )
    )
    assert torch.equal(ours, scattered)
    assert not torch.equal(ours, stored)


def test_a_loss_that_is_not_finite_stops_before_the_checkpoint_and_names_the_clip(
    tmp_path: Path, noisy_disc: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = SequenceLoss.forward

    def forward(self: SequenceLoss, *arguments: Any) -> Unrolled:
        unrolled = whole(self, *arguments)
        return unrolled._replace(loss=unrolled.loss * torch.nan)

    monkeypatch.setattr(SequenceLoss, "forward", forward)
    with pytest.raises(NteError, match=r"step 0: the loss is nan: .*disc frames \d to \d, .*disc frames \d to \d$"):
        train(tiny_config(tmp_path, noisy_disc), device="cpu")
    assert not (tmp_path / "runs" / "tiny" / "checkpoint.safetensors").exists()


def test_a_gradient_that_is_not_finite_stops_before_the_checkpoint(
    tmp_path: Path, noisy_disc: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = SequenceLoss.forward

    def forward(self: SequenceLoss, *arguments: Any) -> Unrolled:
        unrolled = whole(self, *arguments)
        bad = (0 * next(self.parameters()).sum()).sqrt()  # the slope of a root at zero
        return unrolled._replace(loss=unrolled.loss + bad)

    monkeypatch.setattr(SequenceLoss, "forward", forward)
    for clip_norm in (0, 1):
        overrides = f"optimiser.clip_norm={clip_norm}", "checkpoint_every=1", f"name=run{clip_norm}"
        with pytest.raises(NteError, match="step 0: the gradient is not finite"):
            train(tiny_config(tmp_path, noisy_disc, *overrides), device="cpu")
    assert not list(tmp_path.glob("runs/*/checkpoint*"))


def test_a_divergence_keeps_the_last_good_state_and_says_so(
    tmp_path: Path, noisy_disc: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loss and its gradient are finite to the end, but the third step gives weights that are not."""
    update = torch.optim.AdamW.step

    def step(self: torch.optim.AdamW, closure: None = None) -> None:
        update(self)
        steps.append(len(steps))
        if len(steps) == 3:
            self.param_groups[0]["params"][0].data.view(-1)[0] = torch.inf

    steps: list[int] = []
    monkeypatch.setattr(torch.optim.AdamW, "step", step)
    watched = "checkpoint_every=1", "validate_every=9"
    message = (
        r"step 2: '.*weight' is not finite: the checkpoint keeps the state after step 2: resume it "
        r"with phases of a lower learning rate, or look at the data: .*disc frames"
    )
    with pytest.raises(NteError, match=message):
        train(tiny_config(tmp_path, noisy_disc, "optimiser.schedule=constant", *watched), device="cpu")
    run = tmp_path / "runs" / "tiny"
    assert checkpoint(run)["step"] == "2"
    assert all(value.isfinite().all() for value in load_run(run).state_dict().values())
    monkeypatch.undo()
    lower = "phases=[{steps: 2}, {steps: 2, schedule: constant, learning_rate: 1e-4}]", "resume=true"
    train(tiny_config(tmp_path, noisy_disc, "optimiser.schedule=constant", *watched, *lower), device="cpu")
    assert checkpoint(run)["step"] == "4"
    assert [line["learning_rate"] for line in metrics(run) if "loss" in line] == [1e-2, 1e-2, 1e-4, 1e-4]


@pytest.mark.parametrize("device", ["cuda", "abacus", "cuda:7"])
def test_a_device_that_is_not_there(tmp_path: Path, noisy_disc: Path, device: str) -> None:
    if torch.cuda.is_available():
        pytest.skip("it is there")
    with pytest.raises(NteError, match=f"--device {device}: "):
        train(tiny_config(tmp_path, noisy_disc), device=device)


def test_the_learning_rate_is_a_function_of_the_step() -> None:
    cosine = OptimiserConfig(learning_rate=2.0, schedule="cosine", warmup_steps=4)
    rates = [learning_rate(cosine, step, 100) for step in range(100)]
    assert rates[:2] == pytest.approx([0.5, 1.0], rel=1e-2)
    assert rates[50] == pytest.approx(1.0)
    assert rates[99] < 0.001
    assert learning_rate(OptimiserConfig(learning_rate=2.0), 99, 100) == 2.0
