"""Weights of another run: those that fit are taken, the others are named, and a run that began so stays that run."""

from pathlib import Path

import pytest
import torch
from torch import nn

from nte.errors import NteError
from nte.training.checkpoint import module_state, write_checkpoint
from nte.training.initial import begin_with, read_weights
from nte.training.loop import train
from nte.training.run import load_run
from tests.networks import small_network
from tests.tiny_network import TinyConfig, TinyNetwork
from tests.training.runs import checkpoint, tiny_config


def saved(folder: Path, network: nn.Module) -> Path:
    """A folder with a checkpoint of a network's weights, and with a moving average that differs."""
    folder.mkdir()
    average = {f"average.module.{name}": 2 * value for name, value in network.state_dict().items()}
    write_checkpoint(folder, 3, module_state("denoiser.", network) | average | {"average.n_averaged": torch.tensor(3)})
    return folder


def test_what_is_used_after_training_is_taken(tmp_path: Path) -> None:
    source, network = small_network(1), small_network(2)
    weights = read_weights(saved(tmp_path / "run", source))
    count = len(source.state_dict())
    assert begin_with(network, weights) == f"init_from {tmp_path / 'run'}: {count} of {count} tensors fit"
    for name, value in network.state_dict().items():
        assert torch.equal(value, 2 * source.state_dict()[name])


def test_a_network_with_more_inputs_takes_all_but_the_first_convolution(tmp_path: Path) -> None:
    source, network = small_network(1), small_network(2, feed_masks=True, scales=2)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    said = begin_with(network, read_weights(saved(tmp_path / "run", source)))
    (first,) = (name for name, value in before.items() if value.shape != source.state_dict()[name].shape)
    shapes = [f"float32 {tuple(n.state_dict()[first].shape)}" for n in (source, network)]
    count = len(network.state_dict())
    surplus = sorted(source.state_dict().keys() - network.state_dict().keys())
    assert said == (
        f"init_from {tmp_path / 'run'}: {count - 1} of {count} tensors fit; new are {first} ({shapes[0]} there, "
        f"{shapes[1]} here); without a place here: {', '.join(surplus)}"
    )
    for name, value in network.state_dict().items():
        assert torch.equal(value, before[name] if name == first else 2 * source.state_dict()[name])


def test_weights_of_which_nothing_fits_are_refused(tmp_path: Path) -> None:
    weights = read_weights(saved(tmp_path / "run", TinyNetwork(TinyConfig())))
    with pytest.raises(
        NteError, match=r"run: none of its 6 tensors fits the network by name and shape; .* more$"
    ) as error:
        begin_with(small_network(), weights)
    assert "\n" not in str(error.value)


def test_what_is_no_checkpoint_and_what_has_diverged(tmp_path: Path, finished: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(NteError, match=r"init_from: .*empty has no checkpoint: expected a run folder, or a checkpoint"):
        read_weights(tmp_path / "empty")
    with pytest.raises(NteError, match=r"init_from: .*nowhere does not exist"):
        read_weights(tmp_path / "nowhere")
    assert read_weights(finished / "best.safetensors").tensors.keys() == read_weights(finished).tensors.keys()
    network = small_network()
    name, value = list(network.state_dict().items())[-1]
    value.view(-1)[0] = torch.nan
    with pytest.raises(NteError, match=f"run: '{name}' has values that are not finite: that run has diverged"):
        begin_with(small_network(), read_weights(saved(tmp_path / "run", network)))


def test_a_run_begins_with_another_and_resumes_only_with_the_same(
    finished: Path, tmp_path: Path, noisy_disc: Path, capsys: pytest.CaptureFixture
) -> None:
    source = tmp_path / "source"
    source.mkdir()
    (source / "best.safetensors").write_bytes((finished / "best.safetensors").read_bytes())
    short = f"init_from={source / 'best.safetensors'}", "optimiser.learning_rate=0", "phases=[{steps: 1}]"
    run = train(tiny_config(tmp_path, noisy_disc, *short), device="cpu")
    assert f"init_from {source / 'best.safetensors'}: " in capsys.readouterr().out
    began = load_run(finished / "best.safetensors").state_dict()
    for name, value in load_run(run).state_dict().items():
        assert torch.equal(value, began[name])
    before = checkpoint(run)
    train(tiny_config(tmp_path, noisy_disc, *short, "resume=true"), device="cpu")
    assert "init_from" not in capsys.readouterr().out
    assert all(torch.equal(value, before[name]) for name, value in checkpoint(run).items() if name != "step")
    other = {name: 2 * value for name, value in module_state("denoiser.", load_run(finished)).items()}
    write_checkpoint(source, 8, other, "best.safetensors")
    with pytest.raises(NteError, match="tiny: init_from has other weights now than those that the run began with"):
        train(tiny_config(tmp_path, noisy_disc, *short, "resume=true"), device="cpu")
    with pytest.raises(NteError, match=r"another configuration: 'init_from' is .* there and  here"):
        train(tiny_config(tmp_path, noisy_disc, *short[1:], "resume=true"), device="cpu")
