"""A comparison of situations: what it reads, writes and refuses; and the strips of pictures."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from nte import NteError
from nte.evaluation.evaluate import evaluate
from nte.evaluation.paper_comparison import read_comparison, run_comparison, summary_table
from nte.evaluation.report.strips import most_different, strip
from nte.evaluation.score_clip import Shown
from nte.files import only_writer
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import write_clip

TEXT = """
recipe: ../recipe.yaml
situations:
  - {name: disc, clips: ["test/disc_*"], region: moving, methods: {ghosts: "taa:clamp=none", clamped: taa}}
  - {name: other, clips: [test/other_000], methods: {nothing done: noisy}}
"""


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two finished clips and one that is not, of one scene, and one of another."""
    for seed, name in enumerate(("disc_000", "disc_001", "disc_002", "other_000")):
        write_clip(tmp_path / "data" / "test" / name, noisy_frames(3, seed))
    (tmp_path / "data" / "test" / "disc_002" / "clip.json").unlink()
    return tmp_path / "data"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "configs" / "small.yaml"
    path.parent.mkdir()
    path.write_text(TEXT)
    return path


def test_each_situation_has_its_numbers_its_report_and_its_strips(config: Path, data: Path, tmp_path: Path) -> None:
    comparison = read_comparison(config)
    assert Path(comparison.recipe).resolve() == (tmp_path / "recipe.yaml").resolve()
    out = tmp_path / "out"
    rows = run_comparison(comparison, data, out)
    assert json.loads((out / "summary.json").read_text())["rows"] == rows
    assert [(row["situation"], row["method"], row["clips"]) for row in rows] == [
        ("disc", "ghosts", 2),
        ("disc", "clamped", 2),
        ("other", "nothing done", 1),
    ]
    assert {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} == {
        "summary.json", "disc/metrics.json", "disc/index.html", "disc/strips/disc_000_color.png",
        "disc/strips/disc_001_color.png", "other/metrics.json", "other/index.html", "other/strips/other_000_color.png",
    }  # fmt: skip
    page = (out / "disc" / "index.html").read_text()
    assert '<th scope="row">ghosts</th>' in page  # a row of a table has the title, and the spec stands at the end
    assert "<dt>ghosts</dt><dd><code>taa:clamp=none</code></dd>" in page
    alone = evaluate([data / "test/disc_000", data / "test/disc_001"], ["taa"], tmp_path / "alone").metrics
    everywhere, moving = rows[1]["parts"]
    assert (everywhere["region"], moving["region"]) == ("all", "moving")
    assert everywhere["rmse"] == alone["means"]["taa"]["rmse"]
    assert moving["ssim"] == np.mean([row["ssim"] for row in alone["rows"] if row["region"] == "moving"])
    table = summary_table(rows)
    assert "disc, 2 clips" in table
    assert f"{moving['rmse']:.4f}" in table


def test_a_margin_is_a_paired_difference_with_an_interval(config: Path, data: Path, tmp_path: Path) -> None:
    text = TEXT.replace("nothing done: noisy", "nothing done: noisy, clamped: taa")
    config.write_text(f"against: clamped\nfirst: 2\n{text}")
    rows = run_comparison(read_comparison(config), data, tmp_path / "out")
    ghosts, clamped = rows[:2]
    assert clamped["margin"] is None
    scored = json.loads((tmp_path / "out" / "disc" / "metrics.json").read_text())["rows"]
    rmse = {(row["denoiser"], row["clip"]): row["rmse"] for row in scored if row["region"] == "moving"}
    differences = [rmse["taa:clamp=none", clip] - rmse["taa", clip] for clip in ("disc_000", "disc_001")]
    assert ghosts["margin"] == {
        "against": "clamped", "metric": "rmse", "clips": 2, "mean": np.mean(differences),
        "low": min(differences), "high": max(differences),  # of two clips the interval spans both
    }  # fmt: skip
    assert {row["frames"] for row in scored} == {1}
    assert f"{np.mean(differences):+.4f} ({min(differences):+.4f} … {max(differences):+.4f})" in summary_table(rows)


@pytest.mark.slow
def test_processes_give_what_one_process_gives(config: Path, data: Path, tmp_path: Path) -> None:
    comparison = read_comparison(config)
    one, two = (run_comparison(comparison, data, tmp_path / str(jobs), jobs=jobs) for jobs in (1, 2))
    for row in one + two:
        for part in row["parts"]:
            part.pop("ms_per_frame")
    assert two == one


def test_nothing_is_overwritten_without_force(config: Path, data: Path, tmp_path: Path) -> None:
    comparison = read_comparison(config)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(NteError, match="exists"):
        run_comparison(comparison, data, tmp_path / "out")
    run_comparison(comparison, data, tmp_path / "out", force=True)
    assert (tmp_path / "out" / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("recipe: r.yaml", "'situations' is empty"),
        (TEXT.replace("moving", "somewhere"), r"situations\[0\]\.region is 'somewhere': expected one of all, disoccl"),
        (TEXT.replace("region: moving", "light: red"), r"situations\[0\]\.light is 'red': expected one of color, vis"),
        (TEXT.replace("[test/other_000]", "[]"), r"situations\[1\]\.clips is empty"),
        (TEXT.replace("recipe:", "recip:"), "recip"),
        (TEXT.replace("name: disc", "name: ../disc"), r"situations\[0\]\.name is '../disc': expected the name of"),
        (TEXT.replace("name: disc", 'name: "a\\0"'), r"situations\[0\]\.name is .*: expected the name of"),
        (TEXT.replace("name: disc", 'name: "a\\nb"'), r"situations\[0\]\.name is 'a\\nb': expected the name of"),
        (TEXT.replace("name: disc", f"name: {'x' * 300}"), r"situations\[0\]\.name is .*: expected the name of"),
        (TEXT.replace("name: disc", "name: other"), "two situations are called 'other'"),
        ("first: -1\n" + TEXT, r"situations\[0\]\.first is -1: expected the index of a frame"),
        ("against: clamped\n" + TEXT, r"situations\[1\]\.methods lacks 'clamped', named by 'against'; it has"),
    ],
)
def test_a_faulty_comparison_is_named(config: Path, text: str, message: str) -> None:
    config.write_text(text)
    with pytest.raises(NteError, match=message):
        read_comparison(config)


def test_a_pattern_without_clips_is_named_before_any_work(config: Path, data: Path, tmp_path: Path) -> None:
    config.write_text(TEXT.replace("other_000", "nobody_*"))
    with pytest.raises(NteError, match=r"no finished clip matches 'test/nobody_\*' of situation 'other'"):
        run_comparison(read_comparison(config), data, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("pattern", ['""', "/etc/*", "../*", "a**b", '"."'])
def test_a_pattern_that_is_none_is_named(config: Path, data: Path, tmp_path: Path, pattern: str) -> None:
    config.write_text(TEXT.replace("[test/other_000]", f"[{pattern}]"))
    with pytest.raises(NteError, match="situation 'other'"):
        run_comparison(read_comparison(config), data, tmp_path / "out")


def test_one_writer_and_no_links(config: Path, data: Path, tmp_path: Path) -> None:
    out, outside = tmp_path / "out", tmp_path / "outside"
    (outside / "strips").mkdir(parents=True)
    comparison = read_comparison(config)
    with only_writer(out), pytest.raises(NteError, match="out: another process is writing to it"):
        run_comparison(comparison, data, out)
    out.mkdir()
    (out / "disc").symlink_to(outside)
    with pytest.raises(NteError, match=r"disc: is a link to .*outside: nothing is written through links"):
        run_comparison(comparison, data, out, force=True)
    assert list(outside.iterdir()) == [outside / "strips"]


@given(st.integers(8, 40), st.integers(8, 40), st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_the_crop_is_where_outputs_differ_most(height: int, width: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = height // 4, width // 4
    row, column = rng.integers(0, height - size[0] + 1), rng.integers(0, width - size[1] + 1)
    first, second = np.zeros((2, height, width, 3), np.uint8)
    second[row : row + size[0], column : column + size[1]] = 200
    assert most_different([first, second]) == ((row, column), size)


def test_a_strip_has_every_picture_and_its_crop(tmp_path: Path) -> None:
    red, blue = np.zeros((2, 64, 64, 3), np.uint8)
    red[..., 0] = blue[..., 2] = 255
    outputs = {"taa": red, "x": blue}
    shown = Shown("clip", "glossy", 3, 0, {"noisy input": red, "reference": red, **outputs}, outputs)
    sheet = strip(shown)
    Image.fromarray(sheet).save(tmp_path / "strip.png")
    is_red, is_blue = ((sheet == colour).all(-1) for colour in ((255, 0, 0), (0, 0, 255)))
    assert is_red.any(0).sum() == 3 * 192  # three pictures, enlarged
    assert is_red.any(1).sum() == is_blue.any(1).sum() == 2 * 192  # and a row of crops
