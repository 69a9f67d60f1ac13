"""The command line: what it says, what it returns, and one line for every mistake."""

import errno
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import nte
from nte.cli import main
from nte.frames.clip import Clip, read_frame
from nte.frames.clip_files import frame_path
from nte.interrupt import InterruptFlag
from tests.synthetic import write_clip
from tests.training.runs import config_file

Told = Callable[..., str]


@pytest.fixture
def folder(tmp_path: Path, noisy_disc: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with a clip, some that are broken, and other things that a user may type."""
    monkeypatch.chdir(tmp_path)
    for name in ("clip", "gap", "truncated", "no_exr", "bad_json", "unfinished"):
        shutil.copytree(noisy_disc, tmp_path / name)
    (tmp_path / "gap" / "frame_0001.exr").unlink()
    frame = tmp_path / "truncated" / "frame_0001.exr"
    frame.write_bytes(frame.read_bytes()[:500])
    (tmp_path / "no_exr" / "frame_0001.exr").write_bytes(b"\x89PNG")
    (tmp_path / "bad_json" / "clip.json").write_text("{")
    (tmp_path / "unfinished" / "clip.json").unlink()
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("mine")
    (tmp_path / "bad.yaml").write_text("name: [")
    (tmp_path / "bad.onnx").write_bytes(b"no model")
    config_file(tmp_path, Path("clip"))
    return tmp_path


@pytest.fixture
def told(folder: Path, capfd: pytest.CaptureFixture[str]) -> Told:
    """Run a command that must fail, and return the one line that it says."""

    def run(*arguments: str) -> str:
        before = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
        assert main(arguments) == 2
        said = capfd.readouterr().err
        assert said.startswith("nte: ")
        assert said.endswith("\n")
        assert said.count("\n") == 1
        after = {path: path.stat().st_mtime_ns for path in before if path.exists()}
        assert after == before  # nothing is lost or overwritten
        return said

    return run


CLIP_ERRORS = {
    "gap": "gap/frame_0001.exr: missing; clip.json promises 4 frames: copy it there, or render or import",
    "truncated": "truncated/frame_0001.exr: the OpenEXR file is truncated or damaged",
    "no_exr": "no_exr/frame_0001.exr: not an OpenEXR file",
    "bad_json": "bad_json/clip.json: not readable as JSON",
    "nowhere": "nowhere: ",
    "empty": "empty: ",
    "file": "file: ",
}


@pytest.mark.parametrize("clip", CLIP_ERRORS)
@pytest.mark.parametrize(
    "command",
    ["denoise CLIP --denoiser noisy --out out", "check CLIP", "evaluate --clips CLIP --denoisers noisy --out out"],
)
def test_a_clip_that_cannot_be_used_is_named(told: Told, command: str, clip: str) -> None:
    assert CLIP_ERRORS[clip] in told(*command.replace("CLIP", clip).split())


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("denoise unfinished --denoiser noisy --out out", "unfinished: has frames but no clip.json"),
        ("denoise clip --denoiser nosy --out out", "'nosy' is no denoiser, did you mean noisy?"),
        ("denoise clip --denoiser taa:clmp=1 --out out", "unknown option 'clmp'"),
        ("denoise clip --denoiser bad.onnx --out out", "bad.onnx: not a readable ONNX model"),
        ("denoise clip --denoiser no.onnx --out out", "no.onnx: does not exist"),
        ("denoise clip --denoiser empty --out out", "'empty' is no run folder"),
        ("denoise clip --denoiser noisy --out clip --force", "clip: holds the noisy frames themselves"),
        ("denoise clip --denoiser noisy --out file", "file: cannot be made a folder"),
        ("denoise clip --denoiser noisy --out file/out", "cannot be made a folder"),
        ("denoise clip --denoiser noisy --out out --exposure 0", "exposure is 0.0, expected a positive number"),
        ("denoise clip --denoiser noisy --out out --exposure nan", "exposure is nan"),
        ("denoise clip --denoiser taa --out out --motion guess", "--motion guess: expected estimate, or estimate:key"),
        ("denoise clip --denoiser taa --out out --motion estimate:noise=loud", "noise is 'loud', expected one of auto"),
        (
            "denoise clip --denoiser taa --out out --motion estimate:nosie=auto",
            "unknown option 'nosie', did you mean noise?",
        ),
        ("denoise clip --denoiser taa --out out --device abacus", "--device abacus: "),
        (
            "denoise clip gap --denoiser noisy --out out",
            "clip: is a folder beside others: expected one folder, or the files of one sequence",
        ),
        ("denoise clip/frame_0000.exr clip/frame_0002.exr --denoiser noisy --out out", "frame 1 is missing"),
        (
            "info nowhere",
            "nowhere: expected a clip (with clip.json), an .onnx file or a released model, a run fo",
        ),
        ("info bad.onnx", "bad.onnx: not a readable ONNX model"),
        ("info gap", "gap/frame_0001.exr: missing"),
        ("export clip --out model.onnx", "clip: no run folder: config.yaml is missing"),
        ("export clip --out file", "file: exists: choose another name, or overwrite it with --force"),
        ("train nowhere.yaml", "nowhere.yaml: cannot be read: No such file"),
        ("train bad.yaml", "bad.yaml: not readable as YAML"),
        ("train tiny.yaml nope=1", "command line: 'nope': unknown key, expected one of name, "),
        ("train tiny.yaml seed=one", "command line: 'seed': 'one' is given, expected a whole number"),
        ("train tiny.yaml data.clips=[nowhere]", "nowhere: does not exist"),
        ("train tiny.yaml data.clips=[gap]", "gap/frame_0001.exr: missing"),
        (
            "train tiny.yaml data.frames=9",
            "clip: 4 frames: expected at least data.frames 9 + data.holdout 1, those kept",
        ),
        ("train tiny.yaml data.crop=64", "clip: 40x24 is smaller than data.crop 64"),
        ("train tiny.yaml runs=file", "cannot be made a folder"),
        ("train tiny.yaml data.clips=[truncated] --device cpu", "truncated/frame_0001.exr: the OpenEXR file is trunc"),
        ("train tiny.yaml --device abacus", "--device abacus: "),
        ("render nowhere.yaml --out out", "nowhere.yaml: cannot be read"),
        ("render bad.yaml --out out", "bad.yaml: not readable as YAML"),
        ("evaluate --clips clip --denoisers nosy --out out", "'nosy' is no denoiser"),
        ("evaluate --clips clip --denoisers noisy --out file", "file: cannot be made a folder"),
    ],
)
def test_a_mistake_is_told_in_one_line(told: Told, command: str, message: str) -> None:
    assert message in told(*command.split())


def test_missing_channels_are_named(told: Told, folder: Path) -> None:
    write_clip(folder / "bare", [{"color": read_frame(frame_path(folder / "clip", 0))["color"]}] * 3)
    assert "bare: Taa needs motion, which is missing; there is color" in told(
        "denoise", "bare", "--denoiser", "taa", "--out", "out"
    )
    assert "bare: training needs the channel 'albedo'" in told("train", "tiny.yaml", "data.clips=[bare]")


@pytest.mark.parametrize("arguments", [(), ("nope",), ("info",), ("denoise", "x"), ("denoise", "x", "--exposure", "y")])
def test_wrong_usage_is_status_2(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "error: " in line


@pytest.mark.parametrize("arguments", [("train",), ("import", "blender", "x")])
def test_changes_are_not_required(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(arguments)
    told = capsys.readouterr().err
    assert "are required: " in told
    assert "key=value" not in told


def test_options_and_overrides_of_train_mix(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Both overrides arrive: the second one is what is complained about.
    assert main(["train", "tiny.yaml", "seed=3", "--device", "cpu", "data.frames=none"]) == 2
    assert "data.frames" in capsys.readouterr().err


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, said in ((["--version"], nte.__version__), (["--help"], "denoise"), (["train", "--help"], "key=")):
        with pytest.raises(SystemExit) as left:
            main(arguments)
        assert left.value.code == 0
        assert said in capsys.readouterr().out


def test_denoise_and_force(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["denoise", "clip", "--denoiser", "taa", "--out", "out"]
    assert main(command) == 0
    assert capsys.readouterr().out == "4 frames in out\n"
    first = (folder / "out" / "frame_0003.exr").read_bytes()
    assert main([*command[:3], "noisy", *command[4:]]) == 2
    assert "out/frame_0000.exr: exists: " in capsys.readouterr().err
    assert (folder / "out" / "frame_0003.exr").read_bytes() == first
    assert main([*command[:3], "noisy", *command[4:], "--force", "--png", "--exposure", "2"]) == 0
    assert (folder / "out" / "frame_0003.exr").read_bytes() != first
    assert (folder / "out" / "frame_0003.png").exists()
    assert Clip(folder / "out").info["exposure"] == 2


def test_bad_pixels_are_told_once_and_the_work_is_done(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    frames = [read_frame(frame_path(folder / "clip", i)) for i in range(3)]
    for frame in frames:
        frame["color"][0, 3, 4:7] = float("nan")
    write_clip(folder / "bad", frames)
    assert main(["denoise", "bad", "--denoiser", "taa", "--out", "out"]) == 0
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("nte:")]
    assert lines == ["nte: warning: frame 0: bad pixels (non-finite, negative or absurd) are sanitised: 3 in color"]


def test_info_of_a_clip_and_a_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "clip"]) == 0
    said = capsys.readouterr().out
    assert "clip clip: 4 frames, 40x24" in said
    assert "motion: X, Y in px, to the previous frame" in said
    assert main(["train", "tiny.yaml", "phases=[{steps: 2}]", "--device", "cpu"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(folder / "runs" / "tiny")
    assert main(["info", "runs/tiny"]) == 0
    assert "run runs/tiny: 2 steps done; " in capsys.readouterr().out
    assert main(["denoise", "clip", "--denoiser", "runs/tiny", "--out", "out"]) == 0


@pytest.mark.slow
def test_train_export_and_denoise(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "tiny.yaml", "phases=[{steps: 2}]", "--device", "cpu"]) == 0
    assert main(["export", "runs/tiny", "--out", "new/model.onnx"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "new/model.onnx"
    exported = (folder / "new" / "model.onnx").read_bytes()
    assert main(["export", "runs/tiny", "--out", "new/model.onnx"]) == 2
    assert "new/model.onnx: exists: " in capsys.readouterr().err
    assert main(["export", "runs/tiny", "--out", "new/model.onnx", "--force"]) == 0
    assert (folder / "new" / "model.onnx").read_bytes() == exported
    assert main(["info", "new/model.onnx"]) == 0
    assert "needs: color, albedo, normal, depth, motion" in capsys.readouterr().out
    for spec, out in (("runs/tiny", "a"), ("new/model.onnx", "b")):
        assert main(["denoise", "clip", "--denoiser", spec, "--out", out]) == 0
    for ours, theirs in zip(Clip(folder / "a"), Clip(folder / "b"), strict=True):
        np.testing.assert_allclose(ours["color"], theirs["color"], rtol=5e-3, atol=1e-3)  # half floats


def test_interruption_is_130_and_faults_of_ours_keep_their_traceback(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def raising(error: BaseException) -> Callable[[object], None]:
        def run(_: object) -> None:
            raise error

        return run

    monkeypatch.setattr("nte.cli.info._info", raising(KeyboardInterrupt()))
    assert main(["info", "clip"]) == 130
    assert capsys.readouterr().err.startswith("nte: interrupted")
    monkeypatch.setattr("nte.cli.info._info", raising(RuntimeError("a bug")))
    with pytest.raises(RuntimeError, match="a bug"):
        main(["info", "clip"])


def test_what_the_system_refuses_is_one_line(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "File name too long" in told("info", "x" * 300)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("nte.cli.info._info", full)
    assert told("info", "clip") == "nte: No space left on device\n"


@pytest.mark.parametrize("on_ctrl_c", [signal.default_int_handler, signal.SIG_IGN], ids=["foreground", "background"])
def test_sigterm_is_an_interruption(
    on_ctrl_c: signal.Handlers, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def work(*_: object) -> None:
        with InterruptFlag() as interrupted:
            signal.raise_signal(signal.SIGTERM)
            assert interrupted()  # the step is finished first
        signal.raise_signal(signal.SIGTERM)
        raise AssertionError("went on")

    before, on_interrupt = signal.getsignal(signal.SIGTERM), signal.signal(signal.SIGINT, on_ctrl_c)
    monkeypatch.setattr("nte.cli.info._info", work)
    try:
        assert main(["info", "clip"]) == 130
    finally:
        signal.signal(signal.SIGINT, on_interrupt)
    assert capsys.readouterr().err == "nte: interrupted; every file is whole or absent\n"
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize("jobs", ["0", "-1", "two", "1.5"])
@pytest.mark.parametrize(
    "command",
    ["render r.yaml --out o", "evaluate --clips c --denoisers noisy --out o", "compare c.yaml --data d --out o"],
)
def test_a_number_of_processes_is_one_or_more(command: str, jobs: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*command.split(), "--jobs", jobs])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert f"argument --jobs: '{jobs}': expected a number of processes, 1 or more" in said
    assert len(said.splitlines()) == 1
