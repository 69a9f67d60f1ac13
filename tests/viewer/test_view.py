"""nte view: what it records of clips, with and without scores, and what it says of what is not there."""

from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from nte.denoiser import Denoiser, Noisy, Result, State
from nte.errors import NteError
from nte.evaluation.view import CutShortWarning, view
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.viewer.page import PAGE
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import disc_clip, write_clip
from tests.viewer.reading import data_of, layer_of, pixels_of


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("clips") / "disc", noisy_frames(4))


@pytest.fixture(scope="module")
def page(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("view") / "out"
    return view([clip], {spec: load_denoiser(spec) for spec in ("taa", "svgf")}, out)


class Failing(Denoiser):
    """A denoiser that gives up at frame 2."""

    needs = ("color",)

    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        if frame.index == 2:
            raise NteError("cannot go on")
        return Result(frame["color"]), ()


class Wanting(Failing):
    needs = ("color", "roughness")


def test_the_pixels_are_those_of_the_files(page: Path, clip: Path) -> None:
    for index in (0, 3):
        frame = Clip(clip).frame(index)
        color = pixels_of(page, index, "image", "noisy input")
        np.testing.assert_array_equal(color, frame["color"][0].astype(np.float16))
        reference = pixels_of(page, index, "image", "reference")
        np.testing.assert_array_equal(reference, frame["reference"][0].astype(np.float16))
        for name in ("depth", "motion", "instance"):
            found = pixels_of(page, index, "channel", name, name)
            assert found.dtype == np.float32
            np.testing.assert_array_equal(found, frame[name][0])


def test_outputs_and_what_else_denoisers_give_are_recorded(page: Path, clip: Path) -> None:
    svgf = load_denoiser("svgf")
    state: State | None = None
    for index in range(4):
        result, state = svgf.step(Clip(clip).frame(index), state, ("history_length", "alpha"))
        image = pixels_of(page, index, "image", "svgf")
        np.testing.assert_allclose(image, np.asarray(result.image[0], np.float16), rtol=2e-3, atol=1e-6)
        history = pixels_of(page, index, "extra", "svgf", "history_length")
        np.testing.assert_array_equal(history, np.asarray(result.extras["history_length"][0], np.float16))
    data = data_of(page.read_text("utf-8"))
    assert layer_of(data, "extra", "svgf", "alpha")["shown"] == "heat"
    assert pixels_of(page, 1, "channel", "disoccluded", "disoccluded").max() == 1


def test_scores_are_those_of_the_evaluation(page: Path, clip: Path, tmp_path: Path) -> None:
    from nte.evaluation.evaluate import evaluate

    rows = data_of(page.read_text("utf-8"))["rows"]
    expected = evaluate([clip], ["taa", "svgf"], tmp_path / "out").metrics["rows"]
    for row in (*rows, *expected):
        row.pop("ms_per_frame")
    assert rows == expected
    flip = pixels_of(page, 2, "flip", "taa")
    (row,) = (row for row in rows if (row["denoiser"], row["region"]) == ("taa", "all"))
    assert flip.mean() / 255 == pytest.approx(row["per_frame"]["flip"][1], abs=1e-3)


def test_without_a_reference_clips_are_shown_and_not_scored(tmp_path: Path) -> None:
    frames = noisy_frames(2)
    for channels in frames:
        del channels["reference_a"], channels["reference_b"]
    folder = write_clip(tmp_path / "bare", frames)
    page = view([folder], {"taa": load_denoiser("taa")}, tmp_path / "out")
    data = data_of(page.read_text("utf-8"))
    assert data["clips"][0]["notes"] == ["No scores: the clip has no reference."]
    assert (data["rows"], data["tables"]) == ([], [])
    assert pixels_of(page, 1, "image", "taa").shape == (3, 40, 56)


def test_without_the_packages_for_scores_pixels_are_the_same(
    page: Path, clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nte.evaluation.view.find_spec", lambda name: None)
    bare = view([clip], {"taa": load_denoiser("taa")}, tmp_path / "out")
    assert "pip install 'nte-denoiser[eval]'" in data_of(bare.read_text("utf-8"))["clips"][0]["notes"][0]
    for of, group in (("taa", "image"), ("reference", "image")):
        np.testing.assert_array_equal(pixels_of(bare, 3, group, of), pixels_of(page, 3, group, of))


@pytest.mark.parametrize("scored", [True, False])
def test_what_fails_is_said_and_the_rest_is_shown(
    clip: Path, tmp_path: Path, scored: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not scored:
        monkeypatch.setattr("nte.evaluation.view.find_spec", lambda name: None)
    said: list[str] = []
    denoisers = {"failing": Failing(), "wanting": Wanting(), "noisy": Noisy()}
    page = view([clip], denoisers, tmp_path / "out", say=said.append)
    assert len(said) == 2
    assert said[0].startswith("wanting failed on disc: Wanting needs roughness, which is missing; ")
    assert said[1] == "failing failed on disc: cannot go on"
    data = data_of(page.read_text("utf-8"))
    notes = "\n".join(data["clips"][0]["notes"])
    assert "failing failed: " in notes
    assert "cannot go on" in notes
    assert "wanting failed: disc: Wanting needs roughness" in notes
    names = {layer["of"] for layer in data["clips"][0]["layers"] if layer["group"] == "image"}
    assert names == {"noisy", "noisy input", "reference"}


def test_a_denoiser_that_fails_on_several_clips_has_one_line(clip: Path, tmp_path: Path) -> None:
    other = disc_clip(tmp_path / "other", frames=3, seed=2)
    said: list[str] = []
    view([clip, other], {"failing": Failing()}, tmp_path / "out", say=said.append)
    assert said == ["failing failed on disc and 1 more of 2 clips: cannot go on"]


def test_the_command_tells_of_a_failure_at_the_end_and_by_its_status(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["view", str(clip), "--out", str(tmp_path / "out"), "--no-open", "--denoiser", "motion_blur", "noisy"]
    assert main(arguments) == 2
    told = capsys.readouterr()
    assert told.err.splitlines()[-1].startswith("nte: motion_blur failed on disc: MotionBlur needs ")
    assert told.err.count("failed") == 1
    assert "page: " in told.out
    layers = data_of((tmp_path / "out" / PAGE).read_text("utf-8"))["clips"][0]["layers"]
    assert "noisy" in {layer["of"] for layer in layers}


def test_a_range_beyond_the_end_is_told(clip: Path, tmp_path: Path) -> None:
    others = [disc_clip(tmp_path / name, frames=2, size=(24, 30), start=(10.0, 12.0)) for name in "abc"]
    with pytest.warns(CutShortWarning) as told:
        page = view([clip, *others], {}, tmp_path / "out", frames=range(1, 10), channels=())
    assert [str(one.message) for one in told] == [
        "--frames 1-9 goes beyond the end of disc (its last frame is 3), a (its last frame is 1), b (its last frame is "
        "1) and 1 more: what there is of the range is shown"
    ]
    assert [one["frames"] for one in data_of(page.read_text("utf-8"))["clips"]] == [[1, 2, 3], [1], [1], [1]]


def test_a_range_that_all_clips_have_is_told_nothing_of(
    clip: Path, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    view([clip], {}, tmp_path / "out", frames=range(2, 4), channels=())
    assert not [one for one in recwarn if issubclass(one.category, CutShortWarning)]


@pytest.mark.filterwarnings("ignore::nte.evaluation.view.CutShortWarning")
def test_clips_of_different_sizes_and_lengths(clip: Path, tmp_path: Path) -> None:
    other = disc_clip(tmp_path / "small", frames=2, size=(24, 30), seed=2, start=(10.0, 12.0))
    page = view([clip, other], {}, tmp_path / "out", frames=range(1, 3))
    one, two = data_of(page.read_text("utf-8"))["clips"]
    assert (one["width"], one["height"], one["frames"], one["count"]) == (56, 40, [1, 2], 4)
    assert (two["width"], two["height"], two["frames"], two["count"]) == (30, 24, [1], 2)
    one_only = view([clip, other], {}, tmp_path / "late", frames=range(3, 10))
    assert data_of(one_only.read_text("utf-8"))["clips"][1]["frames"] == []


def test_channels_may_be_chosen(clip: Path, tmp_path: Path) -> None:
    page = view([clip], {}, tmp_path / "out", channels=("depth",))
    shown = {layer["of"] for layer in data_of(page.read_text("utf-8"))["clips"][0]["layers"]}
    assert shown == {"noisy input", "reference", "depth", "disoccluded"}


def test_the_command_writes_a_page_and_replaces_one_only_by_force(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or True)
    out = tmp_path / "out"
    arguments = ["view", str(clip), "--out", str(out), "--frames", "1-2"]
    assert main([*arguments, "--denoiser", "noisy", "--denoiser", "taa"]) == 0
    assert opened == [(out / PAGE).as_uri()]
    assert "MB in" in capsys.readouterr().out
    assert main([*arguments, "--no-open"]) == 2
    assert "replace its index.html and layers with --force" in capsys.readouterr().err
    assert main([*arguments, "--no-open", "--force"]) == 0
    assert len(opened) == 1
    assert not list(out.rglob("image_taa*"))  # of the page before
    monkeypatch.setattr("tempfile.mkdtemp", lambda prefix: str(tmp_path / "temporary"))
    assert main(["view", str(clip)]) == 0
    assert (tmp_path / "temporary" / PAGE).is_file()


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["--frames", "7-9"], "--frames 7-9: expected a range from 0 to 3"),
        (["--channels", "colour"], "--channels colour: no such channel, did you mean color? expected one of color, "),
        (["--denoiser", "tea"], "'tea' is no denoiser, did you mean taa?"),
    ],
)
def test_wrong_use_is_one_line(
    clip: Path, tmp_path: Path, arguments: list[str], what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(clip), "--out", str(tmp_path / "out"), "--no-open", *arguments]) == 2
    error = capsys.readouterr().err
    assert what in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()
