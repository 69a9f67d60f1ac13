"""Test vectors are plain files with which any program can check its port of a model."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from nte.cli import main
from nte.errors import NteError
from nte.models.temporal import TemporalDenoiser
from nte.released import model_path
from nte.runtime.vectors import write_vectors


@pytest.fixture(scope="module")
def vectors(model: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("vectors") / "new" / "folder"
    write_vectors(model, folder)
    return folder


def read(folder: Path, entry: dict[str, Any]) -> np.ndarray:
    return np.fromfile(folder / entry["file"], "<f4").reshape(entry["shape"])


def test_a_port_that_keeps_its_state_gets_the_outputs(model: Path, vectors: Path) -> None:
    """What a program does that knows nothing but the page: the state follows the rule in the metadata."""
    index = json.loads((vectors / "vectors.json").read_text("utf-8"))
    assert index["model"] == "model.onnx"
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    rule = json.loads(session.get_modelmeta().custom_metadata_map["nte"])["state"]
    names, outputs = {i.name for i in session.get_inputs()}, [o.name for o in session.get_outputs()]
    state: dict[str, np.ndarray] = {}
    exposures: list[float] = []
    for number, frame in enumerate(index["frames"]):
        given = {name: read(vectors, entry) for name, entry in frame["inputs"].items()}
        assert set(given) == names
        assert given["reset"] == (number == 0)
        state = state or {name: np.zeros_like(given[name]) for name in rule}
        for name, values in state.items():
            np.testing.assert_allclose(given[name], values, rtol=1e-3, atol=1e-5)
        made = dict(zip(outputs, session.run(outputs, given | state), strict=True))
        expected = {name: read(vectors, entry) for name, entry in frame["outputs"].items()}
        assert set(expected) == set(outputs)
        for name, values in expected.items():
            assert (np.abs(made[name] - values) <= index["tolerance"] * (np.abs(values) + 0.01)).all(), name
        state = {name: (given | made)[source] for name, source in rule.items()}
        exposures.append(float(given["exposure"][0]))
    assert exposures == [exposures[0], exposures[0], 4 * exposures[0], 4 * exposures[0]]
    assert np.isnan(given["previous_forward_motion"]).all()


def test_a_released_model_is_copied_with_vectors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Who ports it has neither a run nor PyTorch; the image of the denoiser below it is an input."""
    out, folder = tmp_path / "steady.onnx", tmp_path / "vectors"
    assert main(["export", "steady", "--out", str(out), "--vectors", str(folder)]) == 0
    assert f"test vectors of 4 frames are in {folder}" in capsys.readouterr().out
    released = model_path("steady")
    assert released is not None
    assert out.read_bytes() == released.read_bytes()
    index = json.loads((folder / "vectors.json").read_text("utf-8"))
    assert index["model"] == "steady.onnx"
    assert [frame["inputs"]["prior"]["shape"] for frame in index["frames"]] == [[1, 3, 40, 48]] * 4
    assert all(np.isfinite(read(folder, frame["outputs"]["image"])).all() for frame in index["frames"])
    out.unlink()
    assert main(["export", "steady", "--out", str(out), "--vectors", str(folder)]) == 2
    assert f"{folder / 'vectors.json'}: exists" in capsys.readouterr().err
    assert not out.exists()
    assert main(["export", "steady", "--out", str(out), "--weights", str(tmp_path / "w.safetensors")]) == 2
    assert "steady: is exported already, and --weights are a run's: give the run" in capsys.readouterr().err


def test_the_vectors_see_what_a_port_may_get_wrong(model: Path, vectors: Path) -> None:
    index = json.loads((vectors / "vectors.json").read_text("utf-8"))
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    frame = index["frames"][2]
    given = {name: read(vectors, entry) for name, entry in frame["inputs"].items()}
    expected = read(vectors, frame["outputs"]["image"])

    def differs(**wrong: np.ndarray) -> bool:
        (image,) = session.run(["image"], given | wrong)
        return bool((np.abs(image - expected) > index["tolerance"] * (np.abs(expected) + 0.01)).any())

    assert not differs()
    for name, values in given.items():
        assert differs(**{name: 1 - values if name == "reset" else values * np.float32(0.9)}), name
    assert differs(motion=given["motion"][:, ::-1].copy())
    assert differs(history=np.zeros_like(given["history"]))


def test_at_a_reset_the_state_may_be_anything(model: Path, vectors: Path) -> None:
    index = json.loads((vectors / "vectors.json").read_text("utf-8"))
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    rule = json.loads(session.get_modelmeta().custom_metadata_map["nte"])["state"]
    given = {name: read(vectors, entry) for name, entry in index["frames"][0]["inputs"].items()}
    expected = session.run(None, given)
    for anything in (np.nan, np.inf, -1e30):
        state = {name: np.full_like(given[name], anything) for name in (*rule, "previous_forward_motion")}
        for ours, theirs in zip(session.run(None, given | state), expected, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    large = {name: np.full_like(given[name], 1e3) for name in rule}
    assert not np.array_equal(session.run(None, given | large | {"reset": 0 * given["reset"]})[0], expected[0])


def test_files_are_raw_and_as_long_as_their_shapes(vectors: Path) -> None:
    index = json.loads((vectors / "vectors.json").read_text("utf-8"))
    for number, frame in enumerate(index["frames"]):
        for name, entry in (frame["inputs"] | frame["outputs"]).items():
            assert entry["file"] == f"{number}/{name}.f32"
            assert (vectors / entry["file"]).stat().st_size == 4 * np.prod(entry["shape"])
    assert index["frames"][0]["inputs"]["color"]["shape"] == [1, 3, 40, 48]


def test_the_same_model_gives_the_same_files(model: Path, vectors: Path, tmp_path: Path) -> None:
    write_vectors(model, tmp_path)
    files = sorted(path.relative_to(vectors) for path in vectors.rglob("*") if path.is_file())
    assert len(files) > 60
    for file in files:
        assert (tmp_path / file).read_bytes() == (vectors / file).read_bytes(), file


def test_a_folder_in_the_way_is_one_line(model: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(NteError, match="file: cannot be made a folder"):
        write_vectors(model, tmp_path / "file")
    (tmp_path / "2").write_text("")
    with pytest.raises(NteError, match="2: cannot be made a folder"):
        write_vectors(model, tmp_path)
    assert not (tmp_path / "vectors.json").exists()


@pytest.mark.slow
def test_the_command_writes_them_beside_a_model(
    network: TemporalDenoiser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("nte.training.run.load_run", lambda run: network)
    model, folder = tmp_path / "mine.onnx", tmp_path / "vectors"
    command = ["export", "run", "--out", str(model), "--vectors", str(folder)]
    assert main(command) == 0
    assert json.loads((folder / "vectors.json").read_text("utf-8"))["model"] == "mine.onnx"
    assert f"test vectors of 4 frames are in {folder}" in capsys.readouterr().out
    model.unlink()
    assert main(command) == 2
    assert "vectors.json: exists: choose another folder, or overwrite it with --force" in capsys.readouterr().err
    assert not model.exists()
    assert main([*command, "--force"]) == 0
