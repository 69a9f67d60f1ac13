"""A network that lies outside nte trains, resumes, is exported and runs without PyTorch, from its one file alone.

It differs from nte's own in all that could be taken for granted: target, channels, an optional one, what it carries, at
which resolution, extras and choices.
"""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from nte.denoiser import Denoiser
from nte.frames.clip import Clip
from nte.info import describe
from nte.registry import load_denoiser
from nte.session import Session
from nte.training.run import load_run
from tests.synthetic import disc_frame, write_clip
from tests.tiny_network import TinyNetwork
from tests.training.runs import ROOT, assert_same_run, interrupted_after, metrics

EXTRAS = ("torch", "mitsuba", "lightning_fabric", "safetensors", "onnx", "tensorboard")
CONFIG = """
name: tiny
data: {{clips: [{clip}], frames: 2, crop: 16, batch: 2, any_start: true, augment: true}}
network: {{kind: "tests.tiny_network:TinyNetwork", width: 3}}
loss: {{irradiance: 0.5}}
optimiser: {{learning_rate: 1.0e-2, ema: 0.9}}
phases: [{{steps: 6}}]
checkpoint_every: 3
validate_every: 3
log_every: 1
runs: {runs}
"""


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames of 41×25 with indirect light and its reference, but neither `reference` nor guides."""
    frames = []
    rng = np.random.default_rng(5)
    for i in range(4):
        seen = disc_frame(i, (25, 41), start=(10.0, 12.0), radius=6.0, rng=rng)
        seen |= {"diffuse_albedo": seen["albedo"], "indirect": 0.3 * seen["color"], "emission": 0.1 * seen["albedo"]}
        seen["reference_indirect"] = 0.3 * seen["reference"]
        frames.append({name: v for name, v in seen.items() if name not in ("albedo", "normal", "reference", "depth")})
    return write_clip(tmp_path_factory.mktemp("indirect") / "disc", frames)


def trained(folder: Path, clip: Path, *overrides: str, ends: int = 0) -> Path:
    """What `nte train` leaves, which ends with this exit status."""
    (folder / "tiny.yaml").write_text(CONFIG.format(clip=clip, runs=folder / "runs"))
    assert main(["train", str(folder / "tiny.yaml"), *overrides, "--device", "cpu"]) == ends
    return folder / "runs" / "tiny"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, clip: Path) -> Path:
    """A run that nothing disturbed. Only to be read."""
    return trained(tmp_path_factory.mktemp("second"), clip)


@pytest.fixture(scope="module")
def model(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `nte export` makes of it."""
    path = tmp_path_factory.mktemp("exported") / "tiny.onnx"
    assert main(["export", str(run), "--out", str(path)]) == 0
    return path


def images(denoiser: Denoiser, clip: Path, reset: int | None = None) -> np.ndarray:
    """The images of a clip; the sequence starts anew with frame `reset`."""
    session = Session(denoiser)
    marks = [None if reset is None else np.array([i == reset], np.float32) for i in range(len(Clip(clip)))]
    frames = (replace(frame, reset=mark) for frame, mark in zip(Clip(clip), marks, strict=True))
    return np.stack([session.denoise(frame)[0] for frame in frames])


def test_it_is_a_file_of_less_than_80_lines() -> None:
    assert len((ROOT / "tests" / "tiny_network.py").read_text().splitlines()) < 80


def test_it_trains_and_is_validated_on_its_own_target(run: Path, clip: Path) -> None:
    lines = metrics(run)
    assert [line["step"] for line in lines if "loss" in line] == list(range(1, 7))
    assert all({"spatial", "temporal", "irradiance"} <= line.keys() for line in lines if "loss" in line)
    assert [line["step"] for line in lines if "validation_psnr" in line] == [3, 6]
    # By hand, on the last frame, which was held out: the mean of log-L1 of exposed indirect light.
    denoiser = load_run(run)
    state = None
    for frame in Clip(clip):
        result, state = denoiser.step(frame, state)
    exposure = state.scalars.exposure[0]
    logs = [np.log1p(exposure * image) for image in (result.image, frame["reference_indirect"])]
    assert lines[-1]["validation_l1"] == pytest.approx(np.abs(logs[0] - logs[1]).mean(), rel=1e-4)


def test_a_run_that_stops_and_goes_on_is_the_same_run(
    run: Path, clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with interrupted_after(4, monkeypatch):
        trained(tmp_path, clip, ends=130)
    stopped = tmp_path / "runs" / "tiny"
    assert [line["step"] for line in metrics(stopped) if "loss" in line] == [1, 2, 3, 4]
    assert_same_run(trained(tmp_path, clip, "resume=true"), run)


def test_the_exported_graph_is_the_network(run: Path, model: Path, clip: Path) -> None:
    network, exported = load_run(run), load_denoiser(str(model))
    assert exported.needs == (*network.needs, "emission")  # a graph has no optional inputs
    assert (exported.target, exported.extras) == (network.target, network.extras)
    for reset in (None, 2):
        np.testing.assert_allclose(images(exported, clip, reset), images(network, clip, reset), rtol=1e-3, atol=1e-5)
    through, anew = images(exported, clip), images(exported, clip, reset=2)
    assert np.array_equal(through[:2], anew[:2])
    assert not np.allclose(through[2:], anew[2:], rtol=1e-2)
    frame, following = Clip(clip).frame(0), Clip(clip).frame(1)
    _, state = network.step(frame, None)
    forgot = {"features": 0 * state.tensors["features"]}
    others = [network.step(following, s)[0].image for s in (state, state._replace(tensors=state.tensors | forgot))]
    assert state.tensors["features"].shape == (1, 4, 13, 21)
    assert not np.array_equal(*others)  # what it remembers at half the size matters


def test_it_runs_without_pytorch(model: Path, clip: Path, tmp_path: Path) -> None:
    code = (
        f"import sys; sys.modules |= dict.fromkeys({EXTRAS!r}); import numpy, nte; "
        "results = nte.denoise(nte.load_denoiser(sys.argv[1]), nte.Clip(sys.argv[2])); "
        "numpy.save(sys.argv[3], [result.image[0] for result in results])"
    )
    command = [sys.executable, "-c", code, str(model), str(clip), str(tmp_path / "images.npy")]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}
    )
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(np.load(tmp_path / "images.npy"), images(load_denoiser(str(model)), clip), rtol=1e-4)


def test_clips_whose_noisy_target_cannot_be_shown_are_refused_before_training(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """Validation shows the noisy target beside the network's image: a network that does not take it needs it there."""
    monkeypatch.setattr(TinyNetwork, "target", "glossy")
    frames = [{name: v[0] for name, v in frame.numpy().channels.items()} for frame in Clip(clip)]
    bare = write_clip(
        tmp_path / "bare", [{**frame, "reference_glossy": frame["reference_indirect"]} for frame in frames]
    )
    (tmp_path / "tiny.yaml").write_text(CONFIG.format(clip=bare, runs=tmp_path / "runs"))
    assert main(["train", str(tmp_path / "tiny.yaml"), "loss.irradiance=0", "--device", "cpu"]) == 2
    assert "bare: validation needs the channel 'glossy'; the clip has" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_info_says_what_it_is(run: Path, model: Path) -> None:
    said = describe(run)
    assert "6 steps done" in said
    assert "network 'tests.tiny_network:TinyNetwork' denoises 'indirect'; needs: indirect, diffuse_albedo, mot" in said
    assert "alpha: weight of the current frame" in describe(model)


def test_what_does_not_fit_is_one_line(run: Path, clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "tiny.yaml").write_text(CONFIG.format(clip=clip, runs=tmp_path / "runs"))
    for override, said in (
        ("network.width=0", "network.width is 0, expected at least 1"),
        ("network.depth=1", "'network.depth': unknown key, did you mean width? expected one of kind, width"),
        ("network.kind=kpcn", "'kpcn', expected one of temporal, rae, separated, or package.module:Class"),
        ("network.kind=7", "'network.kind' is 7, expected one of temporal, rae, sep"),
        ("network.kind='nowhere.at_all:Network'", "there is no module 'nowhere': install it, or name its folder in"),
        ("network.kind='os.path:join'", "os.path has no TrainableDenoiser of that name"),
        ("phases=[{steps: 1, occlusion: 0.5}]", "'phases[0].occlusion' is 0.5, but the network 'tests.tiny_network"),
    ):
        assert main(["train", str(tmp_path / "tiny.yaml"), override, "--device", "cpu"]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert len(error.splitlines()) == 1
    assert not (tmp_path / "runs").exists()
