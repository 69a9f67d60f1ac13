"""A comparison of situations: what it reads, evaluates, keeps, prints and refuses; and the strips of pictures."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from nte import NteError
from nte.cli import main
from nte.denoiser import Noisy
from nte.evaluation.bootstrap import bootstrap_interval
from nte.evaluation.comparison.clips import is_used
from nte.evaluation.comparison.kept import keep, read_kept
from nte.evaluation.comparison.read import read_comparison
from nte.evaluation.comparison.run import run_comparison
from nte.evaluation.comparison.schema import Comparison, Network, Situation
from nte.evaluation.comparison.text import failure_lines, markdown, plain
from nte.evaluation.evaluate import evaluate
from nte.evaluation.report.strips import most_different, strip
from nte.evaluation.score_clip import Shown
from nte.evaluation.units import ClipScores, evaluate_clip
from nte.frames.clip import read_frame, write_frame
from nte.frames.clip_files import frame_path
from nte.frames.clip_info import write_clip_info
from nte.writers import only_writer
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import write_clip
from tests.training.test_clips import cut_off, scramble
from tests.viewer.reading import data_of

WITH_A_PAGE = ("index.html", "tables.csv", "tables.tex")
TEXT = """
recipes: {".": ../recipe.yaml}
situations:
  - {name: disc, clips: ["test/disc_*"], region: moving, methods: {ghosts: "taa:clamp=none", clamped: taa}}
  - {name: other, clips: [test/other_000], methods: {nothing done: noisy}}
"""
TABLES = """
tables:
  - name: both
    situation: disc
    caption: What it shows.
    methods: [clamped, ghosts]
    against: ghosts
    columns:
      - {metrics: [psnr, flip], margins: [psnr]}
      - {title: later, first: 2, metrics: [psnr, temporal_l1]}
      - {title: one, clips: ["test/disc_001"], region: moving, metrics: [ssim]}
plots:
  - {name: curves, situation: disc, clip: "*/disc_001", metrics: [ssim, mse]}
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


def compare(config: Path, data: Path, out: Path, **options: object) -> dict:
    return run_comparison(read_comparison(config), data, out, progress=False, **options)


def lines_of(summary: dict, table: int = 0) -> dict[str, list[dict]]:
    """The parts of each method in a table."""
    return {row["method"]: row["parts"] for row in summary["tables"][table]["rows"]}


def test_each_situation_has_its_numbers_its_report_and_its_strips(config: Path, data: Path, tmp_path: Path) -> None:
    comparison = read_comparison(config)
    assert Path(comparison.recipes["."]).resolve() == (tmp_path / "recipe.yaml").resolve()
    out = tmp_path / "out"
    summary = compare(config, data, out)
    assert json.loads((out / "summary.json").read_text()) == summary
    assert [(table["name"], *lines_of(summary, i)) for i, table in enumerate(summary["tables"])] == [
        ("disc", "ghosts", "clamped"),
        ("other", "nothing done"),
    ]
    files = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert {name for name in files if "/layers/" not in name} == {
        "summary.json", "tables.md", "tables.tex", "tables.csv", "comparison.yaml",
        *(f"{name}/{file}" for name in ("disc", "other") for file in ("metrics.json", *WITH_A_PAGE)),
        "disc/clips/disc_000.npz", "disc/clips/disc_001.npz", "disc/strips/disc_000_color.png",
        "disc/strips/disc_001_color.png", "other/clips/other_000.npz",
        "other/strips/other_000_color.png",
    }  # fmt: skip
    page = data_of((out / "disc" / "index.html").read_text("utf-8"))
    assert "ghosts" in page["tables"][0]["rows"]  # a row of a table has the title, and the spec stands at the end
    assert ["ghosts", "taa:clamp=none"] in next(part for part in page["about"] if part["title"] == "Methods")["terms"]
    assert "disc/layers/disc_000/image_ghosts_color/0001.js" in files
    alone = evaluate([data / "test/disc_000", data / "test/disc_001"], ["taa"], tmp_path / "alone").metrics
    everywhere, moving = lines_of(summary)["clamped"]
    assert (everywhere["region"], moving["region"], everywhere["clips"]) == ("all", "moving", 2)
    assert everywhere["metrics"]["rmse"] == pytest.approx(alone["means"]["taa"]["rmse"], rel=1e-12)
    ssim = np.mean([row["ssim"] for row in alone["rows"] if row["region"] == "moving"])
    assert moving["metrics"]["ssim"] == pytest.approx(ssim, rel=1e-12)
    table = plain(summary)
    assert "disc, 2 clips" in table
    assert "other, 1 clip " in table
    assert f"{moving['metrics']['rmse']:.4f}" in table


def test_a_margin_is_a_paired_difference_with_an_interval(config: Path, data: Path, tmp_path: Path) -> None:
    text = TEXT.replace("nothing done: noisy", "nothing done: noisy, clamped: taa")
    config.write_text(f"against: clamped\nfirst: 2\n{text}")
    summary = compare(config, data, tmp_path / "out")
    ghosts, clamped = (parts[1] for parts in lines_of(summary).values())
    assert "margins" not in clamped
    scored = json.loads((tmp_path / "out" / "disc" / "metrics.json").read_text())["rows"]
    rmse = {(row["denoiser"], row["clip"]): row["rmse"] for row in scored if row["region"] == "moving"}
    differences = [rmse["taa:clamp=none", clip] - rmse["taa", clip] for clip in ("disc_000", "disc_001")]
    low, high = bootstrap_interval(differences)
    assert low < min(differences) < max(differences) < high  # two clips say little
    assert ghosts["margins"]["rmse"] == {
        "against": "clamped", "clips": 2, "seeds": [1, 1], "mean": np.mean(differences), "low": low, "high": high,
    }  # fmt: skip
    assert {row["frames"] for row in scored} == {1}
    said = f"{np.mean(differences):+.4f} ({low:+.4f} … {high:+.4f})"
    assert said in plain(summary)
    assert "moving: RMSE − clamped's, 95 % interval" in plain(summary)


def test_a_table_is_a_selection_of_what_was_evaluated_once(config: Path, data: Path, tmp_path: Path) -> None:
    config.write_text(f"first: 0\n{TEXT}{TABLES}")
    summary = compare(config, data, tmp_path / "out")
    clips = [data / "test" / name for name in ("disc_000", "disc_001")]
    by_first = {first: evaluate(clips, ["taa"], tmp_path / str(first), first).metrics for first in (0, 2)}
    whole, later, one = lines_of(summary)["clamped"]
    assert list(lines_of(summary)) == ["clamped", "ghosts"]  # in the table's order
    assert whole["metrics"]["psnr"] == pytest.approx(by_first[0]["means"]["taa"]["psnr"], rel=1e-12)
    for name in ("psnr", "temporal_l1"):
        assert later["metrics"][name] == pytest.approx(by_first[2]["means"]["taa"][name], rel=1e-12)
    (alone,) = (r for r in by_first[0]["rows"] if (r["clip"], r["region"]) == ("disc_001", "moving"))
    assert one["metrics"] == {"ssim": pytest.approx(alone["ssim"], rel=1e-12)}
    assert [part["clips"] for part in (whole, later, one)] == [2, 2, 1]
    page = (tmp_path / "out" / "tables.md").read_text()
    assert page == markdown(summary)
    lines = page.splitlines()
    assert lines[:3] == ["### both", "", "What it shows."]
    assert "color, all, 2 clips: PSNR, dB − ghosts's, 95 % interval" in lines[4]
    assert lines[5] == "| --- |" + " ---: |" * 6
    best = max(parts[0]["metrics"]["psnr"] for parts in lines_of(summary).values())
    assert f"**{best:.2f}**" in page
    drawn = (tmp_path / "out" / "curves.svg").read_text()
    assert drawn.startswith("<?xml")
    assert drawn == (compare(config, data, tmp_path / "again") and (tmp_path / "again" / "curves.svg").read_text())


def test_clips_that_are_done_are_kept_and_tables_alone_evaluate_nothing(
    config: Path, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def counting(unit, tick):
        if len(done) == 2 and "killed" not in done:
            done.append("killed")
            raise KeyboardInterrupt
        done.append(unit.label)
        return evaluate_clip(unit, tick)

    monkeypatch.setattr("nte.evaluation.comparison.run.evaluate_clip", counting)
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        compare(config, data, out)
    assert not (out / "summary.json").exists()
    whole = out / "disc/clips/disc_001.npz"
    whole.write_bytes(whole.read_bytes()[:-100])  # a damaged file counts as none
    summary = compare(config, data, out)
    assert done == ["disc_000", "disc_001", "killed", "disc_001", "other_000"]
    config.write_text(TEXT + TABLES.replace("[psnr, flip]", "[l1]"))
    tables = compare(config, data, out)
    assert len(done) == 5
    assert list(lines_of(tables)["ghosts"][0]["metrics"]) == ["l1"]
    config.write_text(TEXT)
    assert compare(config, data, out) == summary
    monkeypatch.setattr("nte.evaluation.comparison.run.evaluate_clip", evaluate_clip)
    undisturbed = compare(config, data, tmp_path / "undisturbed")
    assert undisturbed == summary
    assert (out / "disc/strips/disc_001_color.png").read_bytes() == (
        tmp_path / "undisturbed/disc/strips/disc_001_color.png"
    ).read_bytes()
    write_clip_info(data / "test/other_000", {"width": 56, "height": 40, "frames": 3, "exposure": 0.5})
    brighter = compare(config, data, out)  # a clip that has changed is evaluated again
    assert lines_of(brighter, 1)["nothing done"] != lines_of(summary, 1)["nothing done"]
    assert lines_of(brighter) == lines_of(summary)


def test_a_clip_with_other_pixels_is_evaluated_again(config: Path, data: Path, tmp_path: Path) -> None:
    before = compare(config, data, tmp_path / "out")
    write_clip(data / "test/other_000", noisy_frames(3, seed=9))  # as from a render with another seed: same clip.json
    after = compare(config, data, tmp_path / "out")
    assert lines_of(after, 1) != lines_of(before, 1)
    assert lines_of(after) == lines_of(before)


def test_pictures_are_of_some_clips_and_numbers_of_all(config: Path, data: Path, tmp_path: Path) -> None:
    config.write_text(TEXT.replace("region: moving", "pictures: 1"))
    compare(config, data, tmp_path / "out")
    assert [path.name for path in (tmp_path / "out/disc/strips").iterdir()] == ["disc_000_color.png"]
    assert {row["clip"] for row in json.loads((tmp_path / "out/disc/metrics.json").read_text())["rows"]} == {
        "disc_000",
        "disc_001",
    }


@pytest.mark.slow
def test_processes_give_what_one_process_gives(config: Path, data: Path, tmp_path: Path) -> None:
    config.write_text(TEXT + TABLES)
    one, two = (compare(config, data, tmp_path / str(jobs), jobs=jobs) for jobs in (1, 2))
    assert two == one
    for name in ("tables.md", "curves.svg", "disc/strips/disc_000_color.png"):
        assert (tmp_path / "2" / name).read_bytes() == (tmp_path / "1" / name).read_bytes()


def test_a_method_that_fails_on_a_clip_is_told_and_the_rest_goes_on(
    config: Path, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def step(self, frame, state, extras=()):
        raise NteError("cannot go on")

    def compared() -> int:
        monkeypatch.setattr("nte.render.recipes.clips.render_recipe", lambda *args, **options: None)
        return main(["compare", str(config), "--data", str(data), "--out", str(tmp_path / "out")])

    whole = Noisy.step
    monkeypatch.setattr("nte.denoiser.Noisy.step", step)
    config.write_text(TEXT.replace("nothing done: noisy", "nothing done: noisy, clamped: taa"))
    assert compared() == 2
    assert "nothing done failed in other: cannot go on" in capsys.readouterr().out
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["failures"] == [
        {"method": "nothing done", "seed": None, "situation": "other", "what": "cannot go on", "clip": None}
    ]
    nothing, clamped = lines_of(summary, 1).values()
    assert nothing[0]["metrics"] == {"rmse": None, "ssim": None}
    assert clamped[0]["metrics"]["rmse"] > 0
    assert "- nothing done failed in other: cannot go on" in (tmp_path / "out/tables.md").read_text()
    assert "nothing done" not in (tmp_path / "out/other/index.html").read_text()
    monkeypatch.setattr("nte.denoiser.Noisy.step", whole)  # the reason is gone, and what failed is tried again
    assert compared() == 0
    assert not json.loads((tmp_path / "out/summary.json").read_text())["failures"]


def nothing_to_compare_with(clip: Path) -> None:
    for index in range(3):
        frame = read_frame(frame_path(clip, index))
        frame["reference"][:] = np.nan
        write_frame(frame_path(clip, index), frame)


def too_small(clip: Path) -> None:
    write_clip(clip, [{name: values[:, :5, :5] for name, values in frame.items()} for frame in noisy_frames(3, 1)])


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (scramble, "disc_001/frame_0001.exr: the OpenEXR file is truncated"),
        (nothing_to_compare_with, "disc_001, frame 0: 2240 of 2240 pixels of 'reference' are NaN"),
        (too_small, "SSIM of a 5x5 image"),
    ],
)
def test_a_clip_that_cannot_be_scored_is_one_line_and_the_rest_goes_on(
    config: Path, data: Path, tmp_path: Path, spoil: Callable[[Path], None], said: str
) -> None:
    spoil(data / "test/disc_001")
    config.write_text(TEXT + TABLES)
    summary = compare(config, data, tmp_path / "out")
    (failure,) = summary["failures"]
    assert (failure["method"], failure["situation"], failure["clip"]) == (None, "disc", "disc_001")
    assert said in failure["what"]
    (line,) = failure_lines(summary)
    assert line == f"clip disc_001 failed in disc: {failure['what']}"
    assert f"- {line}" in (tmp_path / "out/tables.md").read_text()
    assert [part["clips"] for part in summary["tables"][0]["columns"]] == [1, 1, 0]
    assert "one, 0 clips" in plain(summary)
    alone = evaluate(data / "test/disc_000", ["taa"], tmp_path / "alone").metrics
    whole, _, nothing = lines_of(summary)["clamped"]
    assert whole["metrics"]["psnr"] == pytest.approx(alone["means"]["taa"]["psnr"], rel=1e-12)
    assert nothing["metrics"] == {"ssim": None}
    assert not (tmp_path / "out/curves.svg").exists()
    write_clip(data / "test/disc_001", noisy_frames(3, 1))  # the reason is gone, and the clip takes part
    assert not compare(config, data, tmp_path / "out")["failures"]
    assert (tmp_path / "out/curves.svg").exists()


def test_a_file_that_is_cut_off_is_named_before_any_work(config: Path, data: Path, tmp_path: Path) -> None:
    cut_off(data / "test/other_000", 2)
    with pytest.raises(NteError, match=r"other_000/frame_0002.exr: the OpenEXR file is truncated or damaged"):
        compare(config, data, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_titles_in_a_plot_are_what_they_are(config: Path, data: Path, tmp_path: Path) -> None:
    config.write_text((TEXT + TABLES).replace("clamped", "'_a $x^{ $'"))
    compare(config, data, tmp_path / "out")
    drawn = (tmp_path / "out/curves.svg").read_text()
    assert "<!-- _a $x^{ $ -->" in drawn
    assert "<!-- ghosts -->" in drawn


def test_scores_that_are_damaged_are_none(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path, picture = tmp_path / "clips/a.npz", rng.integers(0, 30, (24, 24, 3), np.uint8)
    scores = ClipScores([{"psnr": 20.5}], [Shown("a", "color", 1, 2, {"taa": picture}, {"taa": picture})])
    keep(path, "digest", scores)
    content = path.read_bytes()
    for place in range(0, len(content), 7):
        for spoilt in (bytes(50), rng.bytes(2)):
            path.write_bytes(content[:place] + spoilt + content[place + len(spoilt) :])
            found = read_kept(path, "digest")
            assert found is None or found.rows == scores.rows


def test_nothing_is_overwritten_without_force(config: Path, data: Path, tmp_path: Path) -> None:
    (tmp_path / "out" / "thing" / "clips").mkdir(parents=True)
    (tmp_path / "out" / "thing" / "clips" / "mine.npz").write_text("mine")
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(NteError, match="out: exists and is not empty: choose another folder"):
        compare(config, data, tmp_path / "out")
    compare(config, data, tmp_path / "out", force=True)
    assert (tmp_path / "out" / "mine.txt").read_text() == "mine"
    assert (tmp_path / "out" / "thing" / "clips" / "mine.npz").read_text() == "mine"
    before = (tmp_path / "out" / "summary.json").read_text()
    config.write_text(TEXT.replace("clamped: taa", "clamped: taa:clamp=clip"))
    with pytest.raises(NteError, match="out: holds another comparison: choose another folder"):
        compare(config, data, tmp_path / "out")
    assert (tmp_path / "out" / "summary.json").read_text() == before
    compare(config, data, tmp_path / "out", force=True)
    assert (tmp_path / "out" / "summary.json").read_text() != before


def test_a_key_that_results_do_not_know_yet_has_its_default(config: Path, data: Path, tmp_path: Path) -> None:
    compare(config, data, tmp_path / "out")
    mark = tmp_path / "out" / "comparison.yaml"
    assert "pictures: 8" in mark.read_text()
    mark.write_text(mark.read_text().replace("  pictures: 8\n", ""))
    compare(config, data, tmp_path / "out")
    mark.write_text(mark.read_text() + "polish: 1\n")
    with pytest.raises(NteError, match="out: holds another comparison"):
        compare(config, data, tmp_path / "out")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("first: 0", "'situations' is empty"),
        (TEXT.replace("moving", "somewhere"), r"situations\[0\]\.region is 'somewhere', expected one of all, disoccl"),
        (TEXT.replace("region: moving", "light: red"), r"situations\[0\]\.light is 'red', expected one of color, vis"),
        (TEXT.replace("[test/other_000]", "[]"), r"situations\[1\]\.clips is empty"),
        (TEXT.replace("recipes:", "recipe:"), "recipe"),
        (TEXT.replace('".": ../r', '"../x": ../r'), "recipes: '../x' leads out of the data's folder"),
        ("train: [../own]\n" + TEXT, "train: '../own' leads out of the data's folder: expected a folder in it"),
        ("train: [/own]\n" + TEXT, "train: '/own' leads out of the data's folder: expected a folder in it"),
        (TEXT.replace("name: disc", "name: ../disc"), r"situations\[0\]\.name is '../disc': expected the name of"),
        (TEXT.replace("name: disc", 'name: "a\\0"'), r"situations\[0\]\.name is .*: expected the name of"),
        (TEXT.replace("name: disc", 'name: "a\\nb"'), r"situations\[0\]\.name is 'a\\nb': expected the name of"),
        (TEXT.replace("name: disc", f"name: {'x' * 300}"), r"situations\[0\]\.name is .*: expected the name of"),
        (TEXT.replace("name: disc", "name: other"), "two situations are called 'other'"),
        (TEXT.replace("clamped: taa", "clamped: 'taa:clamp=none'"), "two methods are the denoiser 'taa:clamp=none'"),
        ("first: -1\n" + TEXT, r"situations\[0\]\.first is -1: expected the index of a frame"),
        ("against: clamped\n" + TEXT, r"situations\[1\]\.methods lacks 'clamped', named by 'against'; it has"),
        (TEXT.replace("region: moving", "pictures: 0"), r"pictures is 0: expected a number of clips, 1 or more"),
        (
            TEXT + TABLES.replace("[psnr, flip]", "[pnsr]"),
            r"tables\[0\]\.columns\[0\]: a metric is 'pnsr', did you mean psnr[?] expected one",
        ),
        (
            TEXT + TABLES.replace("[psnr, flip]", "[]").replace(", margins: [psnr]", ""),
            r"metrics is empty: expected some",
        ),
        (
            TEXT + TABLES.replace("situation: disc", "situation: disk"),
            "there is no situation 'disk', did you mean disc[?] expected one of d",
        ),
        (
            TEXT + TABLES.replace("[clamped, ghosts]", "[clumped]"),
            "there is no method 'clumped', did you mean clamped[?] ",
        ),
        (
            TEXT + TABLES.replace("against: ghosts", "against: gusts"),
            r"tables\[0\]\.against: there is no method 'gusts'",
        ),
        (TEXT + TABLES.replace("    against: ghosts\n", ""), r"columns\[0\]\.margins: no method to compare with"),
        (TEXT + TABLES.replace("first: 2", "first: 0"), "first is 0, but situation 'disc' is scored from frame 1 on"),
        (TEXT + TABLES.replace("region: moving", "region: here"), r"columns\[2\]\.region is 'here'"),
        (
            TEXT + TABLES.replace("[ssim, mse]", "[ssim, ms_per_frame]"),
            r"plots\[0\]\.metrics has ms_per_frame, which frames have no values of: put it into a table",
        ),
        (TEXT.replace("name: disc", "name: tables.md"), "a situation is called 'tables.md', as a file of the results"),
        (
            TEXT.replace("name: disc", "name: curves.svg") + TABLES.replace("n: disc", "n: curves.svg"),
            "a situation is called 'curves.svg', as a file of the results is",
        ),
        (TEXT.replace("clamped: taa", "reference: taa"), r"situations\[0\]: a method is called 'reference', as a pic"),
        (TEXT.replace("[test/other_000]", "3"), r"'situations\[1\]\.clips': 3 is given, expected a list"),
        ("situations: [3]", r"'situations\[0\]': 3 is given, expected keys with values"),
        (TEXT + TABLES.replace("first: 2", "first: x"), r"'tables\[0\]\.columns\[1\]\.first': 'x' is given, exp"),
        (TEXT.replace("clips: [test/other", "clip: [test/other"), r"'situations\[1\]\.clip': unknown key, did you mea"),
        (TEXT + TABLES.replace("name: curves", "name: a/b"), r"plots\[0\]\.name is 'a/b': expected the name of a file"),
    ],
)
def test_a_faulty_comparison_is_named(config: Path, text: str, message: str) -> None:
    config.write_text(text)
    with pytest.raises(NteError, match=message) as caught:
        read_comparison(config)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "pattern",
    ["mine/test/*", "mine/test/disc_00?", "*/test/disc_0[0-4]1", "mine/*", "mine/**", "**/disc_*", "nobody/test/*"],
)
def test_what_is_used_of_a_recipe_is_what_its_patterns_name(tmp_path: Path, pattern: str) -> None:
    """Agrees with the search among rendered clips, so that nothing is missing then; ** may name more."""
    folders = [f"mine/{split}/{name}" for split in ("train", "test") for name in ("disc_000", "disc_011", "other_001")]
    for folder in folders:
        (tmp_path / folder).mkdir(parents=True)
    named = {path.relative_to(tmp_path).as_posix() for path in tmp_path.glob(pattern)}
    comparison = Comparison(situations=[Situation("one", [pattern]), Situation("two", ["mine/test/other_001"])])
    used = {folder for folder in folders if is_used(comparison, "mine", folder.removeprefix("mine/"))}
    assert used >= (named & {*folders}) | {"mine/test/other_001"}
    assert "**" in pattern or used == (named & {*folders}) | {"mine/test/other_001"}


def test_what_networks_are_trained_on_is_used() -> None:
    one = [Situation("one", ["mine/test/disc_*"])]
    networks = {"small": Network("small.yaml")}
    known, unknown = (
        Comparison(train=["mine/train"], networks=networks, situations=one),
        Comparison(networks=networks, situations=one),
    )
    assert is_used(known, "mine", "train/disc_000")
    assert not is_used(known, "mine", "test/other_000")
    assert not is_used(known, "mine", "sharp/train/disc_000")
    assert is_used(unknown, "mine", "test/other_000")  # may be what a configuration names


def test_lists_that_have_a_name_are_changed_in_one_place(config: Path, data: Path, tmp_path: Path) -> None:
    named = TEXT.replace('["test/disc_*"]', '"${lists.discs}"')
    config.write_text("lists: {discs: ['test/disc_*']}\n" + named + TABLES)
    some = config.with_name("some.yaml")
    some.write_text("base: small.yaml\nlists: {discs: ['test/*_001']}\n")
    assert len(lines_of(compare(config, data, tmp_path / "all"))) == 2
    comparison = read_comparison(some)
    assert comparison.situations[0].clips == ["test/*_001"]
    comparison.tables[0].columns[0].clips = ["test/disc_00?"]  # of which the situation has one
    summary = run_comparison(comparison, data, tmp_path / "some", progress=False)
    assert summary["tables"][0]["columns"][0]["clips"] == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TEXT.replace("other_000", "nobody_*"), r"no finished clip matches 'test/nobody_\*' of situation 'other'"),
        (TEXT.replace("clamped: taa", "clamped: tea"), "'tea' is no denoiser"),
        (TEXT.replace("clamped: taa", "clamped: trmv"), r"disc_000: trmv: Trmv needs .*, which is missing"),
        (TEXT + TABLES.replace("disc_001", "nobody"), r"no finished clip matches 'test/nobody' of 'both'"),
        (
            TEXT + TABLES.replace("test/disc_001", "test/other_000"),
            "'both': .*other_000 is not a clip of its situation 'd",
        ),
        (
            TEXT + TABLES.replace("first: 2", "first: 3"),
            "'both': .*disc_000 has 3 frames, and frame 3 is the first that",
        ),
        (
            TEXT.replace("region: moving", "light: glossy") + TABLES,
            "table 'both' is about glossy, but method 'clamped' denoises 'color': give it that target, or leave it out",
        ),
        (TEXT + TABLES.replace("*/disc_001", "*/disc_*"), r"'curves': several clips match '\*/disc_\*': expected one"),
        *((TEXT.replace("[test/other_000]", f"[{p}]"), "situation 'other'") for p in ('""', "/etc/*", "../*", "a**b")),
    ],
)
def test_what_does_not_fit_the_clips_is_named_before_any_work(
    config: Path, data: Path, tmp_path: Path, text: str, message: str
) -> None:
    config.write_text(text)
    with pytest.raises(NteError, match=message) as caught:
        compare(config, data, tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_clips_with_other_channels_are_not_compared(config: Path, data: Path, tmp_path: Path) -> None:
    frames = [frame | {"roughness": frame["depth"]} for frame in noisy_frames(3, 9)]
    write_clip(data / "test" / "disc_003", frames)
    with pytest.raises(
        NteError, match=r"situation 'disc': .*disc_000 has no channel 'roughness', which .*disc_003 has"
    ):
        compare(config, data, tmp_path / "out")


def test_one_writer_and_no_links(config: Path, data: Path, tmp_path: Path) -> None:
    out, outside = tmp_path / "out", tmp_path / "outside"
    (outside / "strips").mkdir(parents=True)
    with only_writer(out), pytest.raises(NteError, match="out: another process is writing to it"):
        compare(config, data, out)
    out.mkdir()
    (out / "disc").symlink_to(outside)
    with pytest.raises(NteError, match=r"disc: is a link to .*outside: nothing is written through links"):
        compare(config, data, out, force=True)
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
