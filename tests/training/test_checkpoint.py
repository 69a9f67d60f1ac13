"""Checkpoints that do not fit or are damaged are refused, by name and without a change."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from nte.errors import NteError
from nte.training.checkpoint import write_checkpoint
from nte.training.loop import train
from nte.training.run import load_run
from tests.training.runs import contents, copied, tiny_config


def damage(path: Path, change: Callable[[dict[str, torch.Tensor]], object]) -> None:
    state = load_file(path)
    change(state)
    write_checkpoint(path.parent, 8, state)  # with a checksum that fits


WEIGHT = "denoiser.prediction.trunk.encoders.0.0.weight"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda s: s.pop(WEIGHT),
            "does not fit the configuration: 'prediction.trunk.encoders.0.0.weight' is nothing",
        ),
        (
            lambda s: s.update({WEIGHT: torch.ones(2)}),
            r"'prediction.trunk.encoders.0.0.weight' is float32 \(2,\), expected",
        ),
        (
            lambda s: s.update({WEIGHT: s[WEIGHT].int()}),
            r"'prediction.trunk.encoders.0.0.weight' is int32 .*, expected float32",
        ),
        (
            lambda s: s[WEIGHT].view(-1)[3].fill_(torch.nan),
            "'prediction.trunk.encoders.0.0.weight' has values that are not finite",
        ),
        (lambda s: s["optimiser.3.exp_avg"].fill_(torch.inf), "'exp_avg' of parameter 3 is .* expected finite"),
        (lambda s: s.update({"denoiser.more": torch.ones(2)}), "'more' has no place in the network"),
        (
            lambda s: s.pop("average.module.prediction.trunk.encoders.0.0.bias"),
            "'module.prediction.trunk.encoders.0.0.bias' is nothing",
        ),
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


@pytest.mark.parametrize("place", [0.3, 0.6, 0.95])
def test_a_flipped_bit_is_found(finished: Path, tmp_path: Path, place: float) -> None:
    run = copied(finished, tmp_path)
    path = run / "checkpoint.safetensors"
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= 4
    path.write_bytes(content)
    with pytest.raises(NteError, match=r"safetensors: (damaged: its checksum does not fit|not a checkpoint)"):
        load_run(run)


@pytest.mark.parametrize("torn", ["{", '{"loss": 1}\n', "[3]\n", '{"step": "x"}\n', "\xff\xfe\n"])
def test_a_torn_line_of_the_log_is_dropped(finished: Path, tmp_path: Path, noisy_disc: Path, torn: str) -> None:
    run = copied(finished, tmp_path)
    log = run / "metrics.jsonl"
    whole = log.read_text()
    log.write_text(whole + torn)
    train(tiny_config(tmp_path, noisy_disc, "resume=true"), device="cpu")
    assert log.read_text() == whole


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
