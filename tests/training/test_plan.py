"""Going on with a run means the same steps on the same data; anything else is refused, with the reason."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from safetensors.torch import load_file

from nte.errors import NteError
from nte.training.checkpoint import write_checkpoint
from nte.training.loop import train
from nte.writers import only_writer
from tests.synthetic import disc_clip, disc_frame, write_clip
from tests.training.runs import assert_same_run, contents, copied, tiny_config

EPOCHS = ("phases=[{epochs: 2}, {epochs: 1, occlusion: 0.5}]", "data.batch=1")


def clip_folder(folder: Path, count: int) -> Path:
    """A folder of small clips."""
    for i in range(count):
        disc_clip(folder / f"disc_{i:03d}", frames=3, seed=i, size=(24, 24), start=(10.0, 12.0), radius=6.0)
    return folder


def refused(folder: Path, clips: Path, message: str, *overrides: str) -> None:
    """Resuming is refused with this message, in one line, and nothing of the run is changed."""
    run = folder / "runs" / "tiny"
    before = contents(run)
    with pytest.raises(NteError, match=message) as error:
        train(tiny_config(folder, clips, "resume=true", *overrides), device="cpu")
    assert "\n" not in str(error.value)
    assert contents(run) == before


def test_epochs_become_steps_that_the_run_keeps(tmp_path: Path) -> None:
    run = train(tiny_config(tmp_path, clip_folder(tmp_path / "clips", 3), *EPOCHS), device="cpu")
    assert json.loads((run / "plan.json").read_text())["steps"] == [6, 3]


def test_other_clips_are_refused_and_named(tmp_path: Path) -> None:
    clips = clip_folder(tmp_path / "clips", 2)
    train(tiny_config(tmp_path, clips, *EPOCHS), device="cpu")
    train(tiny_config(tmp_path, clips, "resume=true", *EPOCHS), device="cpu")
    clip_folder(tmp_path / "clips", 3)
    refused(tmp_path, clips, r"trained on other clips: 'disc_002' is new in data.clips: restore it, or", *EPOCHS)
    shutil.rmtree(clips / "disc_002")
    (clips / "disc_001").rename(tmp_path / "away")
    refused(tmp_path, clips, r"trained on other clips: 'disc_001' is missing in data.clips", *EPOCHS)
    disc_clip(clips / "disc_001", frames=4, size=(24, 24), start=(10.0, 12.0), radius=6.0)
    refused(tmp_path, clips, r"trained on other clips: 'disc_001' has another clip.json in data.clips", *EPOCHS)


def test_other_frames_are_refused_and_a_copy_of_the_same_is_not(
    finished: Path, tmp_path: Path, noisy_disc: Path
) -> None:
    run, data = copied(finished, tmp_path), tmp_path / "data" / noisy_disc.name
    shutil.copytree(noisy_disc, data, copy_function=shutil.copyfile)  # with new times, as from another machine
    text = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(text.replace(str(noisy_disc), str(data)))
    train(tiny_config(tmp_path, data, "resume=true"), device="cpu")
    disc_clip(data, seed=9, size=(24, 40), start=(10.0, 12.0), radius=6.0)
    refused(tmp_path, data, r"trained on other clips: 'disc' has other frames in data.clips: restore it, or")
    change_plan(run, lambda plan: [clip.pop() for key in ("clips", "validation") for clip in plan[key]])
    train(tiny_config(tmp_path, data, "resume=true"), device="cpu")  # from when plans had no digests of frames


def test_the_same_clips_elsewhere_are_the_same(tmp_path: Path) -> None:
    clips = clip_folder(tmp_path / "clips", 2)
    run = train(tiny_config(tmp_path, clips, *EPOCHS), device="cpu")
    finished = Path(shutil.copytree(run, tmp_path / "copy"))
    clips.rename(tmp_path / "moved")
    text = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(text.replace(str(clips), str(tmp_path / "moved")))
    train(tiny_config(tmp_path, tmp_path / "moved", "resume=true", *EPOCHS), device="cpu")
    assert_same_run(run, finished)


def change_plan(run: Path, change: Callable[[dict[str, Any]], object]) -> None:
    plan = json.loads((run / "plan.json").read_text())
    change(plan)
    (run / "plan.json").write_text(json.dumps(plan))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.update(processes=2), "trained by 2 processes, and here are 1, which changes what a step is"),
        (lambda p: p.update(steps=[4, 5]), r"the learning rate of step 2 was 0.00969846 and would be 0.0096194"),
        (lambda p: p.update(init="0123"), "init_from has other weights now than those that the run began with"),
        (lambda p: p.update(init=7), r"plan.json: not a plan of ours, or damaged: another type"),
        (lambda p: p["validation"].clear(), "'disc' is new in data.validation"),
        (lambda p: p.pop("clips"), r"plan.json: not a plan of ours, or damaged: 'clips'"),
        (lambda p: p.update(clips=[["a"]]), r"plan.json: not a plan of ours, or damaged: "),
        (lambda p: p["clips"][0].append("0123"), r"plan.json: not a plan of ours, or damaged: another type"),
        (lambda p: p.update(clips=[[1, 2]]), r"plan.json: not a plan of ours, or damaged: "),
        (lambda p: p.update(processes="2"), r"plan.json: not a plan of ours, or damaged: another type"),
    ],
)
def test_another_plan_is_refused(
    finished: Path, tmp_path: Path, noisy_disc: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    run = copied(finished, tmp_path)
    change_plan(run, change)
    refused(tmp_path, noisy_disc, message)


def test_a_run_without_a_plan_is_refused(finished: Path, tmp_path: Path, noisy_disc: Path) -> None:
    (copied(finished, tmp_path) / "plan.json").unlink()
    refused(tmp_path, noisy_disc, r"nobody knows what the run was trained on: start .* anew with --force \(in nte")


def test_a_checkpoint_beyond_the_last_step_is_refused(finished: Path, tmp_path: Path, noisy_disc: Path) -> None:
    run = copied(finished, tmp_path)
    write_checkpoint(run, 9, load_file(run / "checkpoint.safetensors"))
    refused(tmp_path, noisy_disc, r"checkpoint.safetensors: is of step 9, but the run ends after step 8")


def test_a_second_training_in_one_folder_is_refused(finished: Path, tmp_path: Path, noisy_disc: Path) -> None:
    run = copied(finished, tmp_path)
    before = contents(run)
    for overrides, force in ((("resume=true",), False), ((), True), ((), False)):
        with only_writer(run), pytest.raises(NteError, match="tiny: another process is writing to it"):
            train(tiny_config(tmp_path, noisy_disc, *overrides), force, device="cpu")
    assert contents(run) == before
    train(tiny_config(tmp_path, noisy_disc, "resume=true"), device="cpu")  # nobody is inside any more
    assert_same_run(run, finished)


def test_no_folder_is_made_before_data_and_configuration_are_checked(tmp_path: Path, noisy_disc: Path) -> None:
    bare = write_clip(tmp_path / "bare", [{"color": disc_frame(0, (24, 40))["color"]}] * 4)
    for clip, override in (
        (tmp_path / "nowhere", "seed=1"), (bare, "seed=1"), (noisy_disc, "data.frames=4"), (noisy_disc, "data.crop=99"),
        (noisy_disc, f"data.validation=[{bare}]"), (noisy_disc, f"data.validation=[{tmp_path / 'nowhere'}]"),
        (noisy_disc, "network.scales=9"), (noisy_disc, "loss.space=srgb"),
    ):  # fmt: skip
        with pytest.raises(NteError):
            train(tiny_config(tmp_path, clip, override), device="cpu")
        assert not (tmp_path / "runs").exists(), override


def test_decoded_clips_in_files_give_the_same_run_and_do_not_stay(
    finished: Path, tmp_path: Path, noisy_disc: Path
) -> None:
    run = train(tiny_config(tmp_path, noisy_disc, "data.cache_gb=0"), device="cpu")
    assert_same_run(run, finished)
    assert not (run / "decoded").exists()
    kept = tmp_path / "kept"
    again = train(tiny_config(tmp_path, noisy_disc, f"data.cache_dir={kept}", "name=again"), device="cpu")
    assert_same_run(again, finished)
    assert [path.name[:5] for path in kept.iterdir()] == ["disc_"]
