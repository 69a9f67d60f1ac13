"""The report: tables, intervals and pictures of an evaluation as the viewer reads them."""

import re
from html import escape
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from nte.errors import NteError
from nte.evaluation.bootstrap import bootstrap_interval
from nte.evaluation.evaluate import evaluate
from nte.evaluation.metric_table import format_table
from nte.evaluation.report import PLAYED
from nte.evaluation.report.page import report_data, write_report
from nte.evaluation.results import Evaluation
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import write_clip
from tests.viewer.reading import data_of, layer_of, pixels_of


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    folder = tmp_path_factory.mktemp("report")
    clips = [write_clip(folder / name, noisy_frames(3, seed)) for seed, name in enumerate(("one", "two & <b>"))]
    return evaluate(clips, ["taa", "noisy"], folder / "out")


def data_for(evaluation: Evaluation) -> dict:
    return report_data(evaluation, None, evaluation.recorded)


def test_the_report_is_one_page_and_its_layers(evaluation: Evaluation, tmp_path: Path) -> None:
    path = write_report(evaluation, tmp_path)
    data = data_of(path.read_text(encoding="utf-8"))
    assert data["rows"] == evaluation.metrics["rows"]
    assert [clip["name"] for clip in data["clips"]] == ["one", "two & <b>"]
    written = sorted(path.name for path in tmp_path.iterdir())
    assert written == ["index.html", "tables.csv", "tables.tex"]  # the layers were written by the evaluation


def test_tables_state_the_numbers_of_metrics_json(evaluation: Evaluation) -> None:
    data = data_for(evaluation)
    means = evaluation.metrics["means"]
    first = data["tables"][0]
    assert (first["region"], first["light"]) == ("all", "")
    assert list(first["rows"]) == ["taa", "noisy"]  # as typed, not sorted
    for spec, cells in first["rows"].items():
        assert {metric: cell[0] for metric, cell in cells.items()} == means[spec]
    assert first["best"]["psnr"] == [max(means, key=lambda spec: means[spec]["psnr"])]
    assert "2 denoisers, 2 clips, 4 frames scored" in data["summary"]
    assert {table["region"] for table in data["tables"]} >= {"disoccluded", "static", "moving"}


def test_intervals_are_those_of_the_bootstrap_over_clips(evaluation: Evaluation) -> None:
    for table in data_for(evaluation)["tables"]:
        for spec, cells in table["rows"].items():
            rows = [r for r in evaluation.metrics["rows"] if (r["denoiser"], r["region"]) == (spec, table["region"])]
            mean, low, high = cells["l1"]
            assert (low, high) == bootstrap_interval([row["l1"] for row in rows])
            assert low <= mean <= high
            assert low < high


def test_numbers_can_be_read_without_a_script(evaluation: Evaluation, tmp_path: Path) -> None:
    html = write_report(evaluation, tmp_path).read_text(encoding="utf-8")
    assert escape(format_table(evaluation.metrics)) in re.findall(r"<noscript>(.*?)</noscript>", html, re.DOTALL)[0]


def test_every_clip_plays_around_the_frame_with_most_disocclusion(evaluation: Evaluation) -> None:
    for entry, shown in zip(evaluation.recorded, evaluation.shown, strict=True):
        assert entry["chosen"] == shown.frame
        assert entry["frames"] == [0, 1, 2]
        images = [layer["of"] for layer in entry["layers"] if layer["group"] == "image"]
        assert sorted(images) == ["noisy", "noisy input", "reference", "taa"]
        assert [layer["of"] for layer in entry["layers"] if layer["group"] == "flip"] == ["taa", "noisy"]
        assert {layer["channel"] for layer in entry["layers"]} >= {"albedo", "normal", "depth", "motion", "disoccluded"}


def test_fewer_frames_play_if_one_asks(tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip", noisy_frames(5))
    found = evaluate([clip], ["noisy"], tmp_path / "out", played=2)
    assert len(found.recorded[0]["frames"]) == 2
    on_disk = {path.stem for path in (tmp_path / "out" / "layers").rglob("*.js")}
    assert on_disk == {f"{frame:04d}" for frame in found.recorded[0]["frames"]}
    with pytest.raises(NteError, match="played is 0: expected at least one frame"):
        evaluate([clip], ["noisy"], tmp_path / "none", played=0)


def test_the_number_of_frames_that_play_is_the_same_for_the_command_and_in_python(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["evaluate", "--help"])
    assert f"(default: {PLAYED})" in " ".join(capsys.readouterr().out.split())
    assert signature(evaluate).parameters["played"].default == PLAYED
    page = (Path(__file__).parents[2] / "docs" / "viewer.md").read_text("utf-8")
    assert f"A report plays {PLAYED} frames of each clip" in page


def test_clips_that_were_not_recorded_have_their_pictures(evaluation: Evaluation, tmp_path: Path) -> None:
    path = write_report(Evaluation(evaluation.metrics, evaluation.shown), tmp_path)
    data = data_of(path.read_text(encoding="utf-8"))
    assert [clip["frames"] for clip in data["clips"]] == [[shown.frame] for shown in evaluation.shown]
    assert layer_of(data, "image", "taa")["shown"] == layer_of(data, "flip", "taa")["shown"] == "picture"
    shown = evaluation.shown[0]
    found = pixels_of(path, shown.frame, "image", "taa")
    np.testing.assert_array_equal(found, shown.images["taa"].transpose(2, 0, 1))


def test_what_a_denoiser_chose_by_itself_is_said(evaluation: Evaluation, tmp_path: Path) -> None:
    """OIDN prefilters guides that the clip does not call clean: table, page and metrics.json say which it did."""
    pytest.importorskip("pyoidn")
    frames = noisy_frames(2)
    folders = [write_clip(tmp_path / "ours", frames, clean_guides=True), write_clip(tmp_path / "theirs", frames)]
    found = evaluate(folders, ["oidn:quality=fast", "noisy"], tmp_path / "out")
    settings = {(row["denoiser"], row["clip"]): row.get("settings") for row in found.metrics["rows"]}
    assert settings == {
        ("noisy", "ours"): None,
        ("noisy", "theirs"): None,
        ("oidn:quality=fast", "ours"): "quality=fast,clean_aux=true,prefilter=false",
        ("oidn:quality=fast", "theirs"): "quality=fast,clean_aux=true,prefilter=true",
    }
    said = "oidn:quality=fast: quality=fast,clean_aux=true,prefilter=false on ours; "
    assert said in format_table(found.metrics)
    (settings,) = (part for part in data_for(found)["about"] if part["title"] == "Settings")
    assert "quality=fast,clean_aux=true,prefilter=true on theirs" in settings["terms"][0][1]
    assert "Settings" not in [part["title"] for part in data_for(evaluation)["about"]]


def test_titles_stand_for_specifications_everywhere(evaluation: Evaluation) -> None:
    titles = {"ours": "taa", "input": "noisy"}
    data = report_data(evaluation.titled(titles), titles, evaluation.titled(titles).recorded)
    assert list(data["tables"][0]["rows"]) == ["ours", "input"]
    assert {layer["of"] for clip in data["clips"] for layer in clip["layers"] if layer["group"] == "flip"} == {*titles}
    (methods,) = (part for part in data["about"] if part["title"] == "Methods")
    assert methods["terms"] == [["ours", "taa"], ["input", "noisy"]]


def test_every_metric_says_how_it_is_computed(evaluation: Evaluation) -> None:
    data = data_for(evaluation)
    assert [term for term, _ in data["about"][0]["terms"]] == [metric["label"] for metric in data["metrics"]]
