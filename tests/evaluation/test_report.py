"""The report: one file with everything in it, safe from what users call their clips."""

import base64
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nte.evaluation.evaluate import evaluate
from nte.evaluation.metric_table import format_table
from nte.evaluation.report.page import render_report, write_report
from nte.evaluation.results import Evaluation
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import write_clip

NASTY = "</script><b>x&y"


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    folder = tmp_path_factory.mktemp("report")
    clips = [write_clip(folder / name, noisy_frames(3, seed)) for seed, name in enumerate(("one", "two & <b>"))]
    return evaluate(clips, ["taa", "noisy"], folder / "out")


class Page(HTMLParser):
    """Collects what the tests ask of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text: dict[str, list[str]] = {}
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "input", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        if self.open:
            self.text.setdefault(self.open[-1], []).append(data.strip())


def blob(html: str) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found
    return json.loads(found[1])


def test_the_page_is_whole_and_needs_no_network(evaluation: Evaluation, tmp_path: Path) -> None:
    path = write_report(evaluation, tmp_path)
    html = path.read_text(encoding="utf-8")
    page = Page(html)  # balanced tags
    for tag, attributes in page.tags:
        assert tag != "link"
        source = attributes.get("src") or attributes.get("href") or "#"
        assert source.startswith(("data:image/png;base64,", "#")), source
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", html)
    assert "@import" not in html
    assert [p.name for p in tmp_path.iterdir()] == ["index.html"]


def test_tables_state_the_numbers_of_metrics_json(evaluation: Evaluation) -> None:
    page = Page(render_report(evaluation))
    best = max(row["psnr"] for row in evaluation.metrics["means"].values())
    assert f"{best:.2f}" in page.text["strong"]
    worst = min(row["psnr"] for row in evaluation.metrics["means"].values())
    assert f"{worst:.2f}" in page.text["td"]
    assert {"noisy", "taa"} <= set(page.text["th"])
    assert any("2 denoisers, 2 clips, 4 frames scored" in text for text in page.text["p"])
    assert {"Disoccluded", "Static", "Moving"} <= set(page.text["h3"])


def test_the_script_gets_all_rows_and_pictures(evaluation: Evaluation) -> None:
    data = blob(render_report(evaluation))
    assert data["rows"] == evaluation.metrics["rows"]
    assert list(data["means"]) == ["taa", "noisy"]  # as typed, not sorted
    assert [shown["clip"] for shown in data["shown"]] == ["one", "two & <b>"]
    encoded = data["shown"][0]["images"]["taa"].removeprefix("data:image/png;base64,")
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(encoded))))
    np.testing.assert_array_equal(pixels, evaluation.shown[0].images["taa"])
    assert list(data["shown"][0]["flip"]) == ["taa", "noisy"]


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
    html = render_report(found)
    assert "quality=fast,clean_aux=true,prefilter=true on theirs" in html
    Page(html)
    assert "<h3>Settings</h3>" not in render_report(evaluation)


def test_names_cannot_break_the_page(evaluation: Evaluation) -> None:
    text = json.dumps(evaluation.metrics).replace('"taa"', json.dumps(NASTY))
    html = render_report(Evaluation(json.loads(text), evaluation.shown))
    assert NASTY not in html
    assert NASTY in blob(html)["means"]
    assert NASTY in Page(html).text["th"]


def test_what_a_reader_cannot_see_has_a_label(evaluation: Evaluation) -> None:
    page = Page(render_report(evaluation))
    assert all("alt" in attributes for tag, attributes in page.tags if tag == "img")
    assert page.text["label"][:4] == ["Clip", "Light", "Left", "Right"]
    assert ("html", {"lang": "en"}) in page.tags


def test_every_element_that_the_script_asks_for_exists(evaluation: Evaluation) -> None:
    html = render_report(evaluation)
    ids = {attributes["id"] for _, attributes in Page(html).tags if "id" in attributes}
    assert set(re.findall(r'\bat\("([\w-]+)"\)', html)) <= ids
