"""A comparison that trains its networks: once for each seed, kept, continued, and told if it fails."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte import NteError
from nte.cli import main
from nte.evaluation.comparison.read import read_comparison
from nte.evaluation.comparison.run import check_methods, run_comparison
from nte.training.clips import BrokenClipWarning
from nte.training.loop import train
from tests.synthetic import disc_frame, write_clip
from tests.training.runs import assert_same_run, interrupted_after, metrics

TRAINING = """
name: nobody reads it
data: {clips: [nowhere], frames: 2, crop: 16, batch: 2, any_start: true}
network: {kind: "tests.tiny_network:TinyNetwork"}
optimiser: {learning_rate: 1.0e-2}
phases: [{steps: 4}]
checkpoint_every: 2
validate_every: 4
"""
COMPARISON = """
train: [train]
seeds: [1, 2]
overrides: [log_every=1]
networks:
  wide: {config: tiny.yaml, overrides: [network.width=3]}
  "thin | one": {config: tiny.yaml, overrides: [network.width=1], seeds: [5]}
situations:
  - {name: discs, clips: ["test/*"], light: indirect, methods: {noisy: "noisy:target=indirect"},
     networks: [wide, "thin | one"]}
tables:
  - {name: discs, situation: discs, against: noisy, columns: [{metrics: [psnr], margins: [psnr]}]}
"""


def indirect_frames(seed: int, count: int = 3) -> list[dict[str, np.ndarray]]:
    """The disc, with indirect light and its reference."""
    rng = np.random.default_rng(seed)
    frames = [disc_frame(i, (25, 41), start=(10.0, 12.0), radius=6.0, rng=rng) for i in range(count)]
    for frame in frames:
        frame |= {"diffuse_albedo": frame["albedo"], "emission": 0 * frame["albedo"]}
        frame |= {"indirect": 0.3 * frame["color"], "reference_indirect": 0.3 * frame["reference"]}
    return frames


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two clips to train on, and two to compare on."""
    for seed, name in enumerate(("train/disc_000", "train/disc_001", "test/disc_000", "test/disc_001")):
        write_clip(tmp_path / "data" / name, indirect_frames(seed), exposure=0.5)
    return tmp_path / "data"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "tiny.yaml").write_text(TRAINING)
    path = tmp_path / "small.yaml"
    path.write_text(COMPARISON)
    return path


@pytest.fixture
def compare(config: Path, data: Path, tmp_path: Path) -> Callable[..., dict]:
    def run(out: str = "out", runs: str = "runs", **options: object) -> dict:
        return run_comparison(read_comparison(config), data, tmp_path / out, tmp_path / runs, progress=False, **options)

    return run


@pytest.mark.slow
def test_each_seed_is_trained_once_and_a_network_is_the_mean_over_its_seeds(
    compare: Callable[..., dict], tmp_path: Path
) -> None:
    summary = compare()
    (table,) = summary["tables"]
    assert summary["failures"] == []
    assert [row["label"] for row in table["rows"]] == ["noisy", "wide (2 seeds)", "thin | one (1 seed)"]
    noisy, wide, thin = (row["parts"][0] for row in table["rows"])
    rows = json.loads((tmp_path / "out/discs/metrics.json").read_text())["rows"]
    psnr = {(row["denoiser"], row["clip"]): row["psnr"] for row in rows if row["region"] == "all"}
    seeds = [[psnr[str(tmp_path / f"runs/wide_seed{s}"), f"disc_00{c}"] for c in (0, 1)] for s in (1, 2)]
    assert wide["metrics"]["psnr"] == pytest.approx(np.mean(seeds))
    assert wide["seeds"]["psnr"] == pytest.approx(np.mean(seeds, 1))
    assert seeds[0] != seeds[1]
    margin = wide["margins"]["psnr"]
    assert margin["mean"] == pytest.approx(wide["metrics"]["psnr"] - noisy["metrics"]["psnr"])
    assert margin["seeds"] == [2, 1]
    assert thin["margins"]["psnr"]["seeds"] == [1, 1]
    assert "thin \\| one" in (tmp_path / "out/tables.md").read_text()
    page = (tmp_path / "out/discs/index.html").read_text()
    assert "wide_seed1" in page
    assert "wide_seed2" not in page  # the page shows one seed of each
    assert "step 4: loss" in (tmp_path / "runs/wide_seed1.log").read_text()
    configured = (tmp_path / "runs/wide_seed2/config.yaml").read_text()
    assert "seed: 2" in configured
    assert "width: 3" in configured
    assert str(tmp_path / "data/train") in configured

    trained = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").rglob("*.safetensors")}
    assert len(trained) == 6
    assert compare() == summary
    assert {path: path.stat().st_mtime_ns for path in trained} == trained


@pytest.mark.slow
def test_a_training_that_was_stopped_goes_on(
    compare: Callable[..., dict], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with interrupted_after(3, monkeypatch), pytest.raises(KeyboardInterrupt):
        compare()
    assert [line["step"] for line in metrics(tmp_path / "runs/wide_seed1") if "loss" in line] == [1, 2, 3]
    assert not (tmp_path / "runs/wide_seed2").exists()
    compare()
    summary = compare("other", "undisturbed")
    assert_same_run(tmp_path / "runs/wide_seed1", tmp_path / "undisturbed/wide_seed1")
    assert not summary["failures"]


@pytest.mark.slow
def test_a_seed_that_failed_is_one_line_and_the_rest_goes_on(
    config: Path, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def failing(training, **options):
        if (training.name, training.seed) == ("wide_seed2", 2):
            raise NteError("step 3: the loss is nan: lower the learning rate")
        return train(training, **options)

    monkeypatch.setattr("nte.evaluation.comparison.networks.train", failing)
    command = ["compare", str(config), "--data", str(data), "--out", str(tmp_path / "out"), "--runs", str(tmp_path)]
    assert main(command) == 2
    said = capsys.readouterr().out
    line = "wide, seed 2 failed: step 3: the loss is nan: lower the learning rate"
    assert line in said.splitlines()
    assert "wide (1 of 2 seeds)" in said
    assert f"- {line}" in (tmp_path / "out/tables.md").read_text()
    assert json.loads((tmp_path / "out/summary.json").read_text())["failures"] == [
        {
            "method": "wide",
            "seed": 2,
            "situation": "",
            "what": "step 3: the loss is nan: lower the learning rate",
            "clip": None,
        }
    ]
    monkeypatch.setattr("nte.evaluation.comparison.networks.train", train)
    assert main(command) == 0  # once it trains, it takes part
    assert "wide (2 seeds)" in capsys.readouterr().out


def without_albedo(clip: Path, frames: int = 3) -> None:
    kept = [{k: v for k, v in frame.items() if k != "diffuse_albedo"} for frame in indirect_frames(3, frames)]
    write_clip(clip, kept, exposure=0.5)


@pytest.mark.parametrize(
    ("clips", "message"),
    [
        (
            ["train/disc_000", "train/disc_001"],
            "networks.wide: .*disc_000: training needs the channel 'diffuse_albedo'",
        ),
        (["test/disc_000", "test/disc_001"], "disc_000: wide: TinyNetwork needs diffuse_albedo, which is missing"),
    ],
)
def test_clips_without_a_channel_that_a_network_needs_are_named_before_any_work(
    compare: Callable[..., dict], data: Path, tmp_path: Path, clips: list[str], message: str
) -> None:
    for clip in clips:
        without_albedo(data / clip)
    with pytest.raises(NteError, match=message) as caught:
        compare()
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "runs").exists()
    assert not (tmp_path / "out").exists()


def test_a_folder_to_train_on_that_does_not_exist_is_named_before_any_work(
    compare: Callable[..., dict], config: Path, tmp_path: Path
) -> None:
    config.write_text(COMPARISON.replace("train: [train]", "train: [nowhere]"))
    with pytest.raises(NteError, match=r"networks.wide: .*nowhere: does not exist"):
        compare()
    assert not (tmp_path / "runs").exists()


def test_networks_learn_from_the_same_clips(
    compare: Callable[..., dict], config: Path, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(training, **options):
        raise NteError("not now")

    monkeypatch.setattr("nte.evaluation.comparison.networks.train", failing)
    write_clip(data / "train/disc_002", indirect_frames(5, 2), exposure=0.5)
    with pytest.warns(BrokenClipWarning, match="left out of training: .*disc_002: 2 frames: expected at least") as told:
        assert len(compare()["failures"]) == 3  # a clip that none can use is told once
    assert len([one for one in told if one.category is BrokenClipWarning]) == 1
    config.write_text(COMPARISON.replace("network.width=3]", "network.width=3, data.frames=1]"))
    fewer = r"networks.thin \| one would learn from fewer clips than networks.wide: left out of .*disc_002: 2 frames: "
    with pytest.raises(NteError, match=f"{fewer}.*: complete the clip, or take it away"):
        compare("other", "other_runs")
    assert not (tmp_path / "other_runs").exists()


def test_a_network_that_gives_lights_apart_is_shown_for_each_of_them(config: Path, tmp_path: Path) -> None:
    (tmp_path / "separated.yaml").write_text("base: tiny.yaml\nnetwork: {kind: separated, channels: [4, 4], scales: 2}")
    config.write_text(
        COMPARISON.replace("networks:\n  wide", "networks:\n  apart: {config: separated.yaml}\n  wide", 1)
        .replace("networks: [wide,", "networks: [apart, wide,")
        .replace("{metrics:", "{light: indirect, metrics:")
    )
    check_methods(read_comparison(config), tmp_path, tmp_path / "runs", "cpu")


@pytest.mark.slow
def test_a_composite_uses_the_run_of_each_seed(
    compare: Callable[..., dict], config: Path, data: Path, tmp_path: Path
) -> None:
    for clip in sorted(data.glob("test/*")):
        frames = indirect_frames(4)
        for frame in frames:
            frame |= {"direct": frame["color"], "visibility": frame["depth"] * 0 + 1, "glossy": 0 * frame["color"]}
        write_clip(clip, frames, exposure=0.5)
    config.write_text(
        COMPARISON.replace(
            'light: indirect, methods: {noisy: "noisy:target=indirect"},\n     networks: [wide, "thin | one"]',
            'methods: {noisy: noisy, all: "composite:visibility=noisy,glossy=noisy,indirect=[{wide}]"}',
        )
    )
    summary = compare()
    assert summary["failures"] == []
    _, composite = summary["tables"][0]["rows"]
    assert composite["label"] == "all (2 seeds)"
    assert [spec[-11:] for spec in composite["denoisers"]] == ["wide_seed1]", "wide_seed2]"]
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.npz")}
    assert len(kept) == 2
    with (tmp_path / "runs/wide_seed2/config.yaml").open("a") as file:
        file.write("# another file\n")
    compare()
    assert all(path.stat().st_mtime_ns > before for path, before in kept.items())  # the run's bytes count


@pytest.mark.slow
def test_two_processes_train_and_evaluate_what_one_does(compare: Callable[..., dict], tmp_path: Path) -> None:
    one, two = compare(), compare("two", "two_runs", jobs=2)
    for name in ("wide_seed1", "wide_seed2", "thin | one_seed5"):
        assert_same_run(tmp_path / "two_runs" / name, tmp_path / "runs" / name)
    for summary in (one, two):
        for row in summary["tables"][0]["rows"]:
            row.pop("denoisers")  # the folders of the runs
    assert two == one


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[wide,", "[white,",
         r"situations\[0\]\.networks: there is no network 'white', did you mean wide[?] expected one of wide, thin"),
        ("seeds: [1, 2]", "seeds: []", "networks.wide: 'seeds' is empty: expected at least one"),
        ("seeds: [5]", "seeds: []", r"networks.thin \| one: 'seeds' is empty"),
        ("seeds: [1, 2]", "seeds: [1, 2, 1]", "networks.wide: the seed 1 is given twice: expected each once"),
        ("seeds: [1, 2]", "seeds: [1, -2]", "networks.wide: the seed -2: expected 0 to 4294967295"),
        ("thin | one", "thin/one", "the title 'thin/one' cannot name a run's folder"),
        ("tiny.yaml, overrides: [network.width=3]", "gone.yaml", r"networks.wide: .*gone\.yaml: cannot be read"),
        ("network.width=3", "network.wide=3", "networks.wide: .*'network.wide': unknown key, did you mean width?"),
        ("network.width=3", "network.width=0", "networks.wide: .*network.width is 0, expected at least 1"),
        ("against: noisy, columns: [{metrics: [psnr], margins: [psnr]}]",
         "methods: [wide], columns: [{light: glossy, metrics: [psnr]}]",
         "table 'discs' is about glossy, but network 'wide' denoises 'indirect': set its network.target, or leave"),
        ('noisy: "noisy:target=indirect"', "noisy: noisy",
         "table 'discs' is about indirect, but method 'noisy' denoises 'color': give it that target, or leave it out"),
        ("{noisy: ", "{all: 'composite:visibility=svgff,glossy=svgf,indirect=[{wide}]', noisy: ",
         "situation 'discs', method 'all': composite, visibility: 'svgff' is no denoiser, did you mean svgf?"),
        ("{noisy: ", "{all: 'composite:visibility=svgf,glossy=[{wide}],indirect=svgf', noisy: ",
         r"method 'all': 'composite:.*glossy=\[{wide}\].*': '{wide}' denoises indirect, expected a denoiser of glossy"),
        ("{noisy: ", "{all: 'composite:glossy=svgf,indirect=[{wide}]', noisy: ", "nothing denoises visibility: exp"),
        ("network.width=3", "'phases=[{steps: 4, occlusion: 1.0}]'",
         r"networks.wide: 'phases\[0\].occlusion' is 1.0, but the network '.*' gives no 'disoccluded': set it to 0"),
        ("network.width=3", "loss.lights.glossy=1", "networks.wide: loss.lights has 'glossy', but the network "),
        ("network.width=3", "init_from=nowhere", "networks.wide: init_from: nowhere does not exist"),
        ("network.width=3", "seed=7", "networks.wide: 'seed=7' would be ignored: give the network 'seeds'; leave"),
        ("log_every=1", "resume=false", "networks.wide: 'resume=false' would be ignored"),
        ("network.width=3", "'data.clips=[a]'", r"'data.clips=\[a\]' would be ignored: 'train' names the clips"),
        ("{noisy: ", "{wide: ", "two methods are called 'wide'"),
        ("{noisy: ", "{all: 'composite:visibility=svgf,glossy=svgf,indirect={white}', noisy: ",
         r"situations\[0\]\.methods\.all: there is no network 'white', did you mean wide[?] expected one of "),
        ("{noisy: ", "{all: '{wide}{thin | one}', noisy: ",
         r"situations\[0\]\.methods\.all uses thin \| one and wide: expected one network"),
    ],
)  # fmt: skip
def test_faulty_networks_are_named_before_any_work(
    config: Path, data: Path, tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in COMPARISON
    config.write_text(COMPARISON.replace(old, new))
    with pytest.raises(NteError, match=message) as caught:
        check_methods(read_comparison(config), data, tmp_path / "runs", "cpu")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "runs").exists()
