"""Checkpoints that do not fit or are damaged are refused, by name and without a change."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from nte.errors import NteError
from nte.training.loop import train
from nte.training.run import load_run
from tests.training.runs import contents, copied, tiny_config


def damage(path: Path, change: Callable[[dict[str, torch.Tensor]], object]) -> None:
    state = load_file(path)
    change(state)
    save_file(state, path, metadata={"step": "8"})


WEIGHT = "denoiser.unet.encoders.0.0.weight"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.pop(WEIGHT), "does not fit the configuration: 'unet.encoders.0.0.weight' is nothing"),
        (lambda s: s.update({WEIGHT: torch.ones(2)}), r"'unet.encoders.0.0.weight' is \(2,\), expected"),
        (lambda s: s.update({"denoiser.more": torch.ones(2)}), "'more' has no place in the network"),
        (lambda s: s.pop("average.module.unet.encoders.0.0.bias"), "'module.unet.encoders.0.0.bias' is nothing"),
        (lambda s: [s.pop(name) for name in list(s) if name.startswith("optimiser.3.")], "no optimiser state of .* 3"),
        (lambda s: s.pop("random.torch"), "'random.torch' is missing"),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(
    finished: Path, tmp_path: Path, noisy_disc: Path, change: Callable[[dict[str, torch.Tensor]], object], message: str
) -> None:
    config = tiny_config(tmp_path, noisy_disc, "resume=true")
    run = copied(finished, tmp_path)
    damage(run / "checkpoint.safetensors", change)
    before = contents(run)
    with pytest.raises(NteError, match=r"checkpoint.safetensors: .*" + message):
        train(config, device="cpu")
    assert contents(run) == before


@pytest.mark.parametrize("damaged", [b"", b"not safetensors", None])
def test_a_damaged_checkpoint_is_refused(finished: Path, tmp_path: Path, damaged: bytes | None) -> None:
    (tmp_path / "config.yaml").write_bytes((finished / "config.yaml").read_bytes())
    with pytest.raises(NteError, match=r"checkpoint.safetensors: missing: .* not reached its first checkpoint"):
        load_run(tmp_path)
    whole = (finished / "checkpoint.safetensors").read_bytes()
    (tmp_path / "checkpoint.safetensors").write_bytes(whole[:-100] if damaged is None else damaged)
    with pytest.raises(NteError, match=r"checkpoint.safetensors: not a checkpoint of ours, or damaged") as error:
        load_run(tmp_path)
    assert "\n" not in str(error.value)
