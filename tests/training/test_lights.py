"""Networks of every kind train on lights of every kind, and a run that stops and goes on is the same run."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from nte.frames.channels import reference_of
from nte.frames.clip import Clip, write_frame
from nte.frames.clip_files import frame_path
from nte.training.run import load_run
from tests.synthetic import Pixels, disc_frame, write_clip
from tests.training.runs import assert_same_run, interrupted_after, metrics

CONFIG = """
name: lights
data: {{clips: [{clip}], frames: 3, crop: 16, batch: 2, augment: true}}
network: {network}
loss: {loss}
optimiser: {{learning_rate: 1.0e-2, ema: 0.9}}
phases: [{{steps: 6}}]
checkpoint_every: 2
validate_every: 3
log_every: 1
runs: {runs}
"""
NETWORKS = {
    "rae": ("{kind: rae, target: indirect, channels: [4, 6]}", "{occlusion: 0.0}"),
    "visibility": (
        "{target: visibility, channels: [4, 6], scales: 2, inputs: [direct], moments: true, feature_history: 2}",
        "{occlusion: 1.0}",
    ),
    "glossy": ("{target: glossy, channels: [4], scales: 1, temporal: false}", "{space: display}"),
    "separated": ("{kind: separated, channels: [4, 6], scales: 2}", "{lights: {visibility: 0.5, indirect: 1.0}}"),
}


def lit_frame(index: int, rng: np.random.Generator) -> dict[str, Pixels]:
    """A frame of the disc with light components, noisy and as references."""
    seen = disc_frame(index, (25, 41), start=(10.0, 12.0), radius=6.0, rng=rng)
    shade = seen["depth"] / 5
    clean = {"visibility": shade, "glossy": 0.2 * seen["reference"], "indirect": 0.5 * seen["albedo"]}
    noise = rng.exponential(size=(1, 25, 41))
    seen |= {name: (values * noise).astype(np.float32) for name, values in clean.items()}
    seen |= {reference_of(name): values.astype(np.float32) for name, values in clean.items()}
    seen["visibility"] = (rng.random((1, 25, 41)) < shade).astype(np.float32)
    seen |= {"diffuse_albedo": seen["albedo"], "emission": 0.1 * seen["albedo"], "direct": 1.2 * seen["albedo"]}
    return seen


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames of 41×25 with every light component. Only to be read."""
    rng = np.random.default_rng(6)
    return write_clip(tmp_path_factory.mktemp("lit") / "disc", [lit_frame(index, rng) for index in range(4)])


def configured(folder: Path, clip: Path, name: str) -> Path:
    network, loss = NETWORKS[name]
    path = folder / "lights.yaml"
    path.write_text(CONFIG.format(clip=clip, runs=folder / "runs", network=network, loss=loss))
    return path


def trained(folder: Path, clip: Path, name: str, *overrides: str, ends: int = 0) -> Path:
    assert main(["train", str(configured(folder, clip, name)), *overrides, "--device", "cpu"]) == ends
    return folder / "runs" / "lights"


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_a_run_that_stops_and_goes_on_is_the_same_run(
    name: str, clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "whole").mkdir()
    whole = trained(tmp_path / "whole", clip, name)
    with interrupted_after(4, monkeypatch):
        trained(tmp_path, clip, name, ends=130)
    stopped = tmp_path / "runs" / "lights"
    losses = [line for line in metrics(stopped) if "loss" in line]
    assert [line["step"] for line in losses] == [1, 2, 3, 4]
    assert (set(losses[0]) & {"visibility", "glossy", "indirect"}) == (
        {"visibility", "indirect"} if name == "separated" else set()
    )
    assert_same_run(trained(tmp_path, clip, name, "resume=true"), whole)
    network = load_run(whole)
    frame = Clip(clip).frame(1)
    assert np.isfinite(network.step(frame, None)[0].image).all()


def test_what_a_clip_or_a_network_lacks_is_one_line(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = [{name: v[0] for name, v in frame.numpy().channels.items()} for frame in Clip(clip)]

    def lacking(*names: str) -> Path:
        folder = tmp_path / f"no_{names[0]}"
        return write_clip(folder, [{n: v for n, v in frame.items() if n not in names} for frame in frames])

    groups = "; nte render writes it in groups that set components"
    for name, there, override, said in (
        ("rae", lacking("reference_indirect"), (), f"needs the channel 'reference_indirect'; the clip has .*{groups}$"),
        ("rae", lacking("diffuse_albedo"), (), f"needs the channel 'diffuse_albedo'; the clip has .*{groups}$"),
        ("visibility", lacking("direct"), (), f"no_direct: training needs the channel 'direct'; .*{groups}$"),
        ("rae", clip, ("network.inputs=[time]",), "needs the channel 'time'; .* in groups that set shutter$"),
        ("rae", clip, ("network.inputs=[colour]",), "has 'colour', did you mean color[?] expected one of color, "),
        ("separated", lacking("reference_visibility"), (), "needs the channel 'reference_visibility'; "),
        ("rae", clip, ("loss.lights={indirect: 1}",), "loss.lights has 'indirect', but the network 'rae' does not giv"),
        ("rae", clip, ("loss.lights={shadow: 1}",), "loss.lights has 'shadow: 1.0', expected weights from 0 of some o"),
        ("rae", clip, ("loss.occlusion=1", "phases=[{steps: 1, occlusion: 1}]"), "network 'rae' gives no 'disocclude"),
    ):
        assert main(["train", str(configured(tmp_path, there, name)), *override, "--device", "cpu"]) == 2
        error = capsys.readouterr().err
        assert len(error.splitlines()) == 1
        assert re.search(said, error.strip())
    dark = tmp_path / "dark"  # write_clip takes its size from color
    shutil.copytree(clip, dark)
    for index, frame in enumerate(frames):
        write_frame(frame_path(dark, index), {n: v for n, v in frame.items() if n != "color"})
    assert main(["train", str(configured(tmp_path, dark, "rae")), "--device", "cpu"]) == 2
    assert "no channel 'color' to measure the exposure of: set 'exposure' in its clip.json" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
