"""The models that come with nte are denoisers by name, and what a training can begin with."""

import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from nte import released
from nte.errors import NteError
from nte.frames.clip import Clip
from nte.info import describe
from nte.models.registry import make_network
from nte.registry import load_denoiser, parts_of, with_provider
from nte.runtime.export import export
from nte.runtime.session import OnnxDenoiser
from nte.session import Session
from nte.training.config import load_train_config
from nte.training.initial import begin_with, read_weights
from nte.training.run import load_run
from tests.shared import made_once
from tests.training.runs import ROOT


@pytest.fixture(scope="session")
def shelf(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of released models with one in it."""

    def fill(folder: Path) -> None:
        export(finished, folder / "tiny.onnx", progress=lambda line: None, weights=folder / "tiny.safetensors")

    return made_once(tmp_path_factory, "shelf", fill)


@pytest.fixture
def ours(shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same as the folder of the released models, in a working folder without any."""
    monkeypatch.setattr(released, "FOLDER", shelf)
    monkeypatch.chdir(tmp_path)
    return shelf


def test_a_name_is_the_file(ours: Path, noisy_disc: Path) -> None:
    by_name, by_file = load_denoiser("tiny:threads=1"), load_denoiser(f"{ours / 'tiny.onnx'}:threads=1")
    assert isinstance(by_name, OnnxDenoiser)
    assert by_name.options.threads == 1
    frame = next(iter(Clip(noisy_disc)))
    assert np.array_equal(Session(by_name).denoise(frame), Session(by_file).denoise(frame))
    assert describe(Path("tiny")) == describe(ours / "tiny.onnx")


def test_a_name_has_the_options_of_a_model(ours: Path) -> None:
    assert with_provider(["tiny"], "openvino") == [f"{ours / 'tiny.onnx'}:provider=openvino"]
    assert parts_of("estimate+tiny:threads=2") == [str(ours / "tiny.onnx")]
    with pytest.raises(NteError, match=r"unknown option 'alpha'"):
        load_denoiser("tiny:alpha=0.1")


def test_a_run_of_that_name_wins(ours: Path, finished: Path) -> None:
    shutil.copytree(finished, "tiny")
    assert not isinstance(load_denoiser("tiny"), OnnxDenoiser)
    assert read_weights(Path("tiny")).source == Path("tiny")


def test_another_folder_of_that_name_does_not(ours: Path) -> None:
    """Such as what somebody has denoised with it: nte denoise renders --out tiny."""
    Path("tiny").mkdir()
    assert isinstance(load_denoiser("tiny"), OnnxDenoiser)
    assert read_weights(Path("tiny")).source == ours / "tiny.safetensors"
    assert describe(Path("tiny")) == describe(ours / "tiny.onnx")


def test_who_mistypes_a_name_is_told(ours: Path) -> None:
    with pytest.raises(NteError, match=r"'tini' is no denoiser, did you mean tiny\?"):
        load_denoiser("tini")


def test_a_training_begins_with_it(ours: Path, finished: Path) -> None:
    network = load_run(finished)
    wanted = {name: value.clone() for name, value in network.state_dict().items()}
    for parameter in network.parameters():
        parameter.data.zero_()
    begin_with(network, read_weights(Path("tiny")))
    assert all(torch.equal(value, wanted[name]) for name, value in network.state_dict().items())
    with pytest.raises(NteError, match=r"init_from: .*tini does not exist"):
        read_weights(Path("tini"))


def test_weights_are_not_overwritten(ours: Path, finished: Path, tmp_path: Path) -> None:
    (tmp_path / "there.safetensors").touch()
    with pytest.raises(NteError, match=r"there\.safetensors: exists"):
        export(finished, tmp_path / "m.onnx", weights=tmp_path / "there.safetensors")
    assert not (tmp_path / "m.onnx").exists()


@pytest.mark.parametrize("name", released.names())
def test_each_that_ships_is_whole(name: str) -> None:
    """The file loads, the weights are those of its configuration, and a card says what it is."""
    assert load_denoiser(name).target == "color"
    config = load_train_config(ROOT / "configs" / f"{name}.yaml", [])
    network = make_network(config.network)
    count = len(network.state_dict())
    weights = read_weights(Path(name))
    assert begin_with(network, weights).endswith(f"{count} of {count} tensors fit")
    graph = onnx.load(str(released.FOLDER / f"{name}.onnx")).graph
    stored = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in graph.initializer}
    alike = [key for key, value in weights.tensors.items() if np.array_equal(stored.get(key), value)]
    assert len(alike) > 0.9 * count  # the exporter folds a few into others
    assert "**Limits.**" in (released.FOLDER / f"{name}.md").read_text("utf-8")


def test_what_is_denoised_with_by_default_ships() -> None:
    assert released.DEFAULT in released.names()
