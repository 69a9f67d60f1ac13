"""Files by their names: what a channel map or model names lies in its folder; frames, in the source; no pipes."""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from onnx import TensorProto, helper

from nte import load_denoiser
from nte.cli import main
from nte.errors import NteError
from nte.frames.clip import Clip
from tests.importing.producers import engine, scene

WAYS: dict[str, Callable[[Path, Path], str]] = {  # folder, and a file outside it → the name that leads there
    "above": lambda folder, file: f"../{file.parent.name}/{file.name}",
    "absolute": lambda folder, file: str(file),
    "link": lambda folder, file: link(folder / "mine.json", file),
    "folder of links": lambda folder, file: f"{link(folder / 'mine', file.parent)}/{file.name}",
}


def link(path: Path, target: Path) -> str:
    path.symlink_to(target)
    return path.name


@pytest.fixture
def shot(tmp_path: Path) -> Path:
    """A folder as somebody sends it: frames in engine/, map.yaml and cameras.json. Beside it lie files of one's own."""
    folder, own = tmp_path / "shot", tmp_path / "own"
    folder.mkdir()
    own.mkdir()
    engine(folder, scene(2))
    for path in (folder / "cameras.json", folder / "map.yaml"):
        shutil.copy(path, own)
    return folder


def change(map_path: Path, **values: object) -> None:
    map_path.write_text(yaml.safe_dump(yaml.safe_load(map_path.read_text()) | values))


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The only line that is said of a command, which ends with status 2."""
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("nte: ")
    return line


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("key", ["cameras", "base"])
@pytest.mark.parametrize(
    "words", ["import exr FRAMES --map MAP --out OUT", "denoise FRAMES --denoiser noisy --map MAP --out OUT"]
)
def test_a_map_leads_nowhere_else(
    words: str, key: str, way: str, shot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, file = shot / "map.yaml", {"cameras": "cameras.json", "base": "map.yaml"}[key]
    name = WAYS[way](shot, shot.parent / "own" / file)
    change(path, **{key: name})
    places = {"FRAMES": shot / "engine", "MAP": path, "OUT": tmp_path / "out"}
    line = refused([str(places.get(word, word)) for word in words.split()], capsys)
    assert f"{path}: '{key}' is '{name}', which leads out of {shot}: expected a file in that folder" in line
    assert not (tmp_path / "out").exists()


def test_a_map_does_not_take_what_lies_in_the_current_folder(
    shot: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(shot.parent / "own")
    (shot / "cameras.json").unlink()
    line = refused(["import", "exr", str(shot / "engine"), "--map", str(shot / "map.yaml"), "--out", "out"], capsys)
    assert f"{shot / 'cameras.json'}: cannot be read: No such file" in line


def test_who_types_a_path_may_name_any_and_a_map_those_in_its_folder(shot: Path, tmp_path: Path) -> None:
    words = ["import", "exr", str(shot / "engine"), "--map", str(shot / "map.yaml"), "--out"]
    (shot / "linked").symlink_to(shot / "cameras.json")
    for number, name in enumerate(("cameras.json", "engine/../cameras.json", "linked")):
        change(shot / "map.yaml", cameras=name)
        assert main([*words, str(tmp_path / f"clip {number}")]) == 0
    (shot / "cameras.json").unlink()
    assert main([*words, str(tmp_path / "clip"), f"cameras={shot.parent / 'own' / 'cameras.json'}"]) == 0
    assert len(Clip(tmp_path / "clip").info["cameras"]) == 2


@pytest.mark.parametrize("pattern", ["../own/shot.#.exr", "OWN/shot.#.exr", "linked/shot.#.exr"])
def test_a_pattern_finds_what_lies_below_the_source_alone(
    pattern: str, shot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = shot.parent / "own"
    for path in (shot / "engine").iterdir():
        shutil.copy(path, own)
    (shot / "engine" / "linked").symlink_to(own)
    pattern = pattern.replace("OWN", str(own))
    channels = yaml.safe_load((shot / "map.yaml").read_text())["channels"]
    channels["albedo"] = {"layer": "basecolor", "file": pattern}
    change(shot / "map.yaml", channels=channels)
    words = ["import", "exr", str(shot / "engine"), "--map", str(shot / "map.yaml"), "--out", str(tmp_path / "clip")]
    assert f"no file fits '{pattern}', where 'channels.albedo.file' expects the frames" in refused(words, capsys)


@pytest.mark.parametrize("provider", ["cpu", "openvino"])
@pytest.mark.parametrize("way", WAYS)
def test_a_model_reads_no_weights_elsewhere(way: str, provider: str, tmp_path: Path) -> None:
    pytest.importorskip("openvino" if provider == "openvino" else "onnxruntime")
    own, folder = tmp_path / "own" / "weights", tmp_path / "model"
    own.parent.mkdir()
    folder.mkdir()
    own.write_bytes(np.ones(4, np.float32).tobytes())
    weights = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[4], data_location=TensorProto.EXTERNAL)
    weights.external_data.add(key="location", value=WAYS[way](folder, own))
    x, y = (helper.make_tensor_value_info(name, TensorProto.FLOAT, [4]) for name in "xy")
    graph = helper.make_graph([helper.make_node("Add", ["x", "w"], ["y"])], "sum", [x], [y], [weights])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    (folder / "model.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(NteError, match=r"model\.onnx: .*(External data|outside the base directory)"):
        load_denoiser(f"{folder / 'model.onnx'}:provider={provider}")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes with names")
@pytest.mark.parametrize("words", [["denoise", "pipe.exr", "--out", "out"], ["info", "pipe.yaml"], ["info", "clip"]])
def test_a_pipe_that_nobody_writes_to_is_refused(
    words: list[str], noisy_disc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    shutil.copytree(noisy_disc, "clip")
    Path("clip", "frame_0000.exr").unlink()
    for name in ("pipe.exr", "pipe.yaml", "clip/frame_0000.exr"):
        os.mkfifo(name)
    assert main(words) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert re.match(r"nte: \S+: is a pipe, expected a file|nte: \S*frame_0000.exr: missing", line)
