"""What `make demo` must have reached. Not collected by `make test`: run it with `make acceptance` afterwards."""

import json
import math
from pathlib import Path

import pytest

from nte.checking import CheckReport, check
from nte.checking.residuals import Mean
from nte.frames.clip import Clip
from nte.frames.clip_files import find_clips

DATA, MODEL = Path("data/quickstart"), "demo/quickstart.onnx"
BASELINES = ("noisy", "taa:clamp=none", "taa", "taa:clamp=clip")


@pytest.fixture(scope="module")
def reports() -> list[CheckReport]:
    return [check(Clip(folder)) for folder in find_clips([DATA])]


def pooled(means: list[Mean]) -> float:
    return sum(m.total for m in means) / sum(m.count for m in means)


def test_every_clip_passes_the_check(reports: list[CheckReport]) -> None:
    assert [r.reason for r in reports if r.verdict != "plausible"] == []


def test_motion_explains_the_albedo_five_times_better(reports: list[CheckReport]) -> None:
    errors = {v: [r.errors["albedo", v, "changing"] for r in reports] for v in ("none", "traditional")}
    unwarped, warped = (pooled(means) for means in errors.values())
    print(
        f"\nalbedo error on {sum(mean.count for mean in errors['none'])} pixels of {len(reports)} clips: "
        f"unwarped {unwarped:.4f}, warped {warped:.4f}: {unwarped / warped:.1f} times smaller"
    )
    assert unwarped / warped >= 5


def test_dual_vectors_serve_disoccluded_pixels_better(reports: list[CheckReport]) -> None:
    error = {
        vectors: pooled([r.errors["reference", vectors, "disoccluded"] for r in reports])
        for vectors in ("none", "traditional", "dual")
    }
    share = sum(r.disoccluded for r in reports) / len(reports)
    print(f"\nreference error in disoccluded pixels ({share:.1%} of all): {error}")
    assert error["dual"] < error["traditional"]


def test_the_exported_model_beats_every_baseline() -> None:
    metrics = json.loads(Path("demo/report/metrics.json").read_text())
    clips = {row["clip"]: row["frames"] for row in metrics["rows"] if row["region"] == "all"}
    assert len(clips) >= 4
    assert min(clips.values()) >= 11  # 12 frames, the first one is not scored
    ours = metrics["means"][MODEL]
    for baseline in BASELINES:
        theirs = metrics["means"][baseline]
        assert ours["psnr"] > theirs["psnr"]
        assert ours["ssim"] > theirs["ssim"]
        assert ours["flip"] < theirs["flip"]
        assert ours["temporal_l1"] < theirs["temporal_l1"]


def test_training_hardly_waited_for_data() -> None:
    lines = [json.loads(line) for line in Path("runs/quickstart/metrics.jsonl").read_text().splitlines()]
    first, *windows = [line for line in lines if "loader_wait" in line]  # of equally many steps
    seconds = math.fsum(line["seconds_per_step"] for line in windows)
    share = math.fsum(line["loader_wait"] * line["seconds_per_step"] for line in windows) / seconds
    # Clips are decoded in the first steps; how long that is in a training of some minutes says nothing of longer ones.
    print(f"\nwaiting for data: {share:.1%}, and {first['loader_wait']:.1%} of the steps in which clips are decoded")
    assert share < 0.05


def test_the_denoised_clip_is_a_clip() -> None:
    source, denoised = Clip(DATA / "test" / "rooms_000"), Clip("demo/denoised")
    assert len(denoised) == len(source)
    assert set(source.channels) <= {*denoised.channels}
