"""Denoisers over clips: what metrics.json says, that it is true, and what is refused."""

import json
import math
import os
import subprocess
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from nte import Clip, Denoiser, Frame, NteError, Result
from nte.denoiser import Noisy, State
from nte.evaluation.benchmark.quality import Judge
from nte.evaluation.evaluate import OURS, evaluate
from nte.evaluation.metrics import score
from nte.evaluation.results import Evaluation, means_of
from nte.evaluation.score_clip import ClipRun, mean
from nte.files import temporary_name
from nte.frames.clip import write_frame
from nte.frames.clip_files import clip_labels, find_clips, frame_path
from nte.frames.clip_info import write_clip_info
from nte.frames.reference import BadReferenceWarning
from nte.frames.scalars import estimate_exposure
from nte.frames.show import display
from nte.unfinished import MARK
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import Pixels, disc_clip, disc_frame, write_clip

ROW = {
    "denoiser", "clip", "target", "region", "first_frame", "scored_from", "frames", "psnr", "ssim", "flip", "l1", "mse",
    "rmse", "temporal_l1", "temporal_l1_floor", "ms_per_frame", "per_frame",
}  # fmt: skip


class Scaled(Noisy):
    """The input times a factor: an error that is known."""

    def __init__(self, factor: float, target: str = "color") -> None:
        self.factor, self.target, self.needs = factor, target, (target,)

    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        return Result(frame[self.target] * self.factor), ()


def clean_frame(index: int, **options: tuple[float, float]) -> dict[str, Pixels]:
    """The disc without noise: the reference is the colour, with the half floats that colour is stored in."""
    channels = disc_frame(index, **options)
    return channels | {"reference": channels["color"].astype(np.float16).astype(np.float32)}


def rows_of(evaluation: Evaluation, **wanted: object) -> list[dict]:
    return [r for r in evaluation.metrics["rows"] if all(r[key] == value for key, value in wanted.items())]


def test_a_clip_whose_exposure_nobody_knows_is_refused_before_any_work(tmp_path: Path) -> None:
    """As of light alone, without the colour that an exposure could be measured of."""
    for index in range(2):
        light = np.full((3, 16, 16), 0.5, np.float32)
        write_frame(frame_path(tmp_path / "b", index), {"indirect": light, "reference_indirect": light})
    size = {"width": 16, "height": 16, "frames": 2}
    write_clip_info(tmp_path / "b", size)
    noisy = {"noisy": Scaled(1.0, "indirect")}
    with pytest.raises(
        NteError, match=r"b: no channel 'color' to measure the exposure of, .*'exposure' in its clip\.json$"
    ):
        evaluate([tmp_path / "b"], noisy, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    write_clip_info(tmp_path / "b", size | {"exposure": 1.0})
    assert rows_of(evaluate([tmp_path / "b"], noisy, tmp_path / "out"), target="indirect")


def test_metrics_json_has_the_promised_form(clip: Path, tmp_path: Path) -> None:
    evaluation = evaluate([clip], ["noisy", "taa"], tmp_path / "report")
    text = (tmp_path / "report" / "metrics.json").read_text()
    assert "NaN" not in text
    metrics = json.loads(text)
    assert metrics == evaluation.metrics
    assert metrics["format"] == "nte-metrics/1"
    assert len(metrics["rows"]) == 2 * 4
    for row in metrics["rows"]:
        assert set(row) == ROW
        assert (row["clip"], row["target"], row["first_frame"], row["frames"]) == ("disc", "color", False, 3)
        assert all(len(values) == 3 for values in row["per_frame"].values())
    assert set(metrics["means"]) == {"noisy", "taa"}
    assert metrics["means"]["taa"]["psnr"] > metrics["means"]["noisy"]["psnr"] + 1
    assert {p.name for p in (tmp_path / "report").iterdir()} == {*OURS}


def test_scores_agree_with_the_metrics_of_hand_made_display_images(clip: Path, tmp_path: Path) -> None:
    row = rows_of(evaluate([clip], ["noisy"], tmp_path / "out"), region="all")[0]
    opened = Clip(clip)
    from nte.frames.scalars import sequence_scalars

    exposure = float(sequence_scalars(opened.frame(0))[0][0])
    shown = [
        [torch.from_numpy(display(f[name][0], exposure))[None] for name in ("color", "reference")]
        for f in map(opened.frame, range(4))
    ]
    everywhere = {"all": torch.ones(1, 1, 40, 56, dtype=torch.bool)}
    for name in ("psnr", "ssim", "flip", "l1", "mse", "rmse"):
        expected = [score(*pair, everywhere)[0]["all"][name] for pair in shown[1:]]
        assert row["per_frame"][name] == pytest.approx(expected, rel=1e-3)
        assert row[name] == pytest.approx(np.mean(expected), rel=1e-3)
    changes = [float(((now[0] - before[0]) - (now[1] - before[1])).abs().mean()) for before, now in pairwise(shown)]
    assert row["per_frame"]["temporal_l1"] == pytest.approx(changes, rel=1e-3)
    assert 0 < row["temporal_l1_floor"] < 0.1 * row["temporal_l1"]


def test_the_first_frame_is_scored_only_when_asked(clip: Path, tmp_path: Path) -> None:
    without = rows_of(evaluate([clip], ["noisy"], tmp_path / "a"), region="all")[0]
    with_first = rows_of(evaluate([clip], ["noisy"], tmp_path / "b", first=0), region="all")[0]
    assert with_first["frames"] == 4
    assert with_first["first_frame"] is True
    assert with_first["per_frame"]["psnr"][1:] == without["per_frame"]["psnr"]
    assert with_first["per_frame"]["temporal_l1"][0] is None
    assert with_first["temporal_l1"] == without["temporal_l1"]


def test_scoring_can_begin_where_histories_are_long(clip: Path, tmp_path: Path) -> None:
    all_scored = rows_of(evaluate([clip], ["taa"], tmp_path / "a"), region="all")[0]
    late = rows_of(evaluate([clip], ["taa"], tmp_path / "b", first=3), region="all")[0]
    assert (late["frames"], late["scored_from"]) == (1, 3)
    assert late["psnr"] == all_scored["per_frame"]["psnr"][2]  # the history began in frame 0 all the same
    assert late["temporal_l1"] == all_scored["per_frame"]["temporal_l1"][2]
    with pytest.raises(NteError, match="has 4 frames, and frame 4 is the first that is scored"):
        evaluate([clip], ["taa"], tmp_path / "c", first=4)


def test_a_perfect_output_scores_perfectly_and_a_steady_error_does_not_flicker(tmp_path: Path) -> None:
    folder = write_clip(tmp_path / "still", [clean_frame(i, velocity=(0.0, 0.0)) for i in range(4)])
    specs = {"exact": Scaled(1), "dark": Scaled(0.5)}
    evaluation = evaluate([folder], specs, tmp_path / "out")
    exact, dark = (rows_of(evaluation, denoiser=spec, region="all")[0] for spec in specs)
    assert (exact["psnr"], exact["flip"], exact["temporal_l1"]) == (100.0, 0.0, 0.0)
    assert dark["psnr"] < 30
    assert dark["temporal_l1"] < 1e-6
    assert exact["temporal_l1_floor"] is None  # the clip has no halves
    assert rows_of(evaluation, denoiser="exact", region="moving")[0]["psnr"] is None
    assert rows_of(evaluation, denoiser="exact", region="moving")[0]["frames"] == 0
    assert rows_of(evaluation, denoiser="exact", region="disoccluded")[0]["per_frame"]["ssim"] == [None] * 3


class Relit(Clip):
    """A clip whose light becomes twice as bright with each frame, while its exposure becomes half as large.

    told: the frames that give their exposure; others leave it as it was.
    """

    told: tuple[int, ...] = (0, 1, 2, 3)

    def frame(self, *wanted: object) -> Frame:
        frame = super().frame(*wanted)
        factor = np.float32(2**frame.index)
        lights = ("color", "reference", "reference_a", "reference_b")
        changed = {name: frame[name] * factor for name in lights if name in frame}
        given = np.array([0.25 / factor], np.float32) if frame.index in self.told else None
        return replace(frame.with_channels(**changed), exposure=given)


def scores(clip: Clip) -> list[dict]:
    run = ClipRun("clip", clip, {"noisy": Noisy(), "dark": Scaled(0.7)}, "cpu", first=0)
    for index in range(len(clip)):
        run.advance(index)
    return [row | {"ms_per_frame": 0} for row in run.rows()]


def test_each_frame_is_scored_in_its_own_exposure(tmp_path: Path) -> None:
    """Twice the light at half the exposure is the same picture, to the last bit, and so are its scores."""
    folder = write_clip(tmp_path / "clip", noisy_frames(4), exposure=0.25)
    steady, relit = scores(Clip(folder)), scores(Relit(folder))
    assert steady == relit
    assert steady[0]["temporal_l1"] > 0
    assert steady[0]["temporal_l1_floor"] > 0
    color = Clip(folder).frame(2)["color"]
    expected = Judge(folder, "color").score(2, color, "noisy")
    judge = Judge(folder, "color")
    judge.clip = Relit(folder)
    assert judge.score(2, 4 * color, "noisy") == expected


def test_an_exposure_holds_until_a_frame_gives_another(tmp_path: Path) -> None:
    folder = write_clip(tmp_path / "clip", noisy_frames(4))
    relit = Relit(folder)
    relit.told = (0, 2)
    found = scores(relit)[0]["per_frame"]["psnr"]
    relit.told = (0, 1, 2, 3)
    each = scores(relit)[0]["per_frame"]["psnr"]
    assert (found[0], found[2]) == (each[0], each[2])
    assert found[1] != each[1]


def test_a_clip_that_begins_in_the_dark_has_the_exposure_of_its_first_light(tmp_path: Path) -> None:
    frames = noisy_frames(4)
    frames[0] |= {name: np.zeros_like(frames[0][name]) for name in ("color", "reference_a", "reference_b")}
    clip = Clip(write_clip(tmp_path / "dark", frames))
    run = ClipRun("clip", clip, {"noisy": Noisy()}, "cpu")
    found = []
    for index in range(3):
        run.advance(index)
        found += run.exposure.tolist()
    (lit,) = estimate_exposure(clip.frame(1)["color"]).tolist()
    assert found == [1, lit, lit]


def test_a_component_is_compared_with_its_own_reference(tmp_path: Path) -> None:
    frames = [clean_frame(i) for i in range(2)]
    for channels in frames:
        channels["indirect"] = channels["reference"] / 4
        channels["reference_indirect"] = channels["reference"] / 4
        channels["visibility"] = channels["reference_visibility"] = channels["albedo"][:1]
    folder = write_clip(tmp_path / "parts", frames)
    specs = {"indirect": Scaled(1, "indirect"), "visibility": Scaled(1, "visibility"), "color": Scaled(1)}
    evaluation = evaluate([folder], specs, tmp_path / "out")
    assert [row["target"] for row in rows_of(evaluation, region="all")] == list(specs)
    assert all(row["psnr"] == 100 for row in rows_of(evaluation, region="all"))
    assert [shown.target for shown in evaluation.shown] == list(specs)
    assert all(list(shown.images)[1:] == ["reference", shown.target] for shown in evaluation.shown)


class Apart(Denoiser):
    """A denoiser that filters shadows and indirect light apart, one well and one badly."""

    components = ("visibility", "indirect", "glossy")
    extras = components
    needs = ("color", "visibility", "indirect")

    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        found = {"visibility": frame["visibility"], "indirect": frame["indirect"] / 2}
        return Result(frame["color"], {name: found[name] for name in extras}), ()


def test_light_components_are_scored_too_where_the_clip_has_their_reference(tmp_path: Path) -> None:
    frames = [clean_frame(i) for i in range(3)]
    for channels in frames:
        channels["indirect"] = channels["reference_indirect"] = channels["reference"]
        channels["visibility"] = channels["reference_visibility"] = channels["albedo"][:1]
    folder = write_clip(tmp_path / "parts", frames)
    evaluation = evaluate([folder], {"apart": Apart(), "plain": Scaled(1)}, tmp_path / "out")
    whole = rows_of(evaluation, region="all")
    assert [(row["denoiser"], row["target"]) for row in whole] == [
        ("apart", "color"),
        ("apart", "visibility"),
        ("apart", "indirect"),
        ("plain", "color"),
    ]
    colour, visibility, indirect, _ = whole
    assert colour["psnr"] == visibility["psnr"] == 100
    assert indirect["psnr"] < 40
    assert evaluation.metrics["means"]["apart"]["psnr"] == 100  # of what it gives as its image
    assert means_of(evaluation.metrics["rows"], target="indirect").keys() == {"apart"}
    assert [shown.target for shown in evaluation.shown] == ["color", "visibility", "indirect"]
    assert list(evaluation.shown[2].images) == ["noisy input", "reference", "apart"]


def test_a_denoiser_sees_only_what_it_asks_for(clip: Path, tmp_path: Path) -> None:
    seen: set[str] = set()

    class Curious(Noisy):
        optional = ("albedo", "roughness")

        def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
            seen.update(frame.channels)
            return super().step(frame, state, extras)

    evaluate([clip], {"curious": Curious()}, tmp_path / "out")
    assert seen == {"color", "albedo"}


def test_time_is_the_median_without_the_first_step(clip: Path, tmp_path: Path, monkeypatch) -> None:
    ticks = iter([0, 5, 10, 10.001, 20, 20.003, 30, 30.002])
    monkeypatch.setattr("nte.evaluation.timed.time.perf_counter", lambda: next(ticks))
    row = rows_of(evaluate([clip], {"one": Noisy()}, tmp_path / "out"), region="all")[0]
    assert row["ms_per_frame"] == pytest.approx(2)


def test_means_count_every_clip_the_same(clip: Path, tmp_path: Path) -> None:
    other = write_clip(tmp_path / "other", noisy_frames(2, seed=7))
    evaluation = evaluate([clip, other], ["noisy"], tmp_path / "out")
    rows = rows_of(evaluation, region="all")
    assert [row["clip"] for row in rows] == ["disc", "other"]
    assert evaluation.metrics["means"]["noisy"]["psnr"] == pytest.approx((rows[0]["psnr"] + rows[1]["psnr"]) / 2)


def test_the_frame_that_is_shown_has_the_most_disoccluded_pixels(tmp_path: Path) -> None:
    frames = noisy_frames(5)
    for name in ("motion", "forward_motion"):  # the disc is said to stand still after frame 2
        for i in (2, 3, 4) if name == "forward_motion" else (3, 4):
            frames[i][name] = np.zeros_like(frames[i][name])
    frames[1]["forward_motion"][:, :6] = 5.0  # and more than the disc came into sight in frame 2
    shown = evaluate([write_clip(tmp_path / "x", frames)], ["noisy", "taa"], tmp_path / "out").shown[0]
    assert shown.frame == 2
    assert shown.disoccluded > 6 * 56
    assert list(shown.images) == ["reference", "noisy", "taa"]
    assert list(shown.flip) == ["noisy", "taa"]
    assert shown.images["taa"].shape == shown.flip["taa"].shape == (40, 56, 3)


def test_of_frames_without_disocclusion_the_last_is_shown(tmp_path: Path) -> None:
    still = disc_clip(tmp_path / "still", velocity=(0.0, 0.0))
    assert evaluate([still], ["noisy"], tmp_path / "out").shown[0].frame == 3


def test_the_noisy_input_is_shown_even_if_it_is_not_compared(clip: Path, tmp_path: Path) -> None:
    shown = evaluate([clip], ["taa"], tmp_path / "out").shown[0]
    assert list(shown.images) == ["noisy input", "reference", "taa"]


def test_the_noisy_input_of_a_component_is_shown_once(tmp_path: Path) -> None:
    frames = [clean_frame(i) | {"indirect": clean_frame(i)["color"]} for i in range(2)]
    folder = write_clip(tmp_path / "parts", [f | {"reference_indirect": f["reference"]} for f in frames])
    spec = "noisy:target=indirect"
    assert list(evaluate([folder], [spec], tmp_path / "out").shown[0].images) == ["reference", spec]


@pytest.mark.slow
def test_processes_give_the_same_numbers_in_the_same_order(clip: Path, tmp_path: Path) -> None:
    frames = noisy_frames(3, seed=7)
    frames[1]["reference_a"][0, 3, 4] = math.nan
    other = write_clip(tmp_path / "other", frames)
    said: list[tuple[int, int, str]] = []
    found = []
    for jobs in (1, 2):
        with pytest.warns(BadReferenceWarning, match="other, frame 1") as told:
            found.append(
                evaluate(
                    [clip, other], ["taa", "noisy"], tmp_path / str(jobs), jobs=jobs,
                    progress=lambda *what: said.append(what),
                )
            )  # fmt: skip
        assert len(told) == 1
    for evaluation in found:
        for row in evaluation.metrics["rows"]:
            row.pop("ms_per_frame")
    assert found[1].metrics["rows"] == found[0].metrics["rows"]
    assert said[-1][:2] == (7, 7)
    assert [shown.clip for shown in found[1].shown] == ["disc", "other"]


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_one_line(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("nte.cluster.PATIENCE", 1)
    with pytest.raises(NteError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1: start one") as caught:
        evaluate([clip], ["noisy"], tmp_path / "out", scheduler="tcp://127.0.0.1:1")
    assert "\n" not in str(caught.value)
    # Nobody can tell here that no worker writes: the mark lets the same command begin again.
    assert [path.name for path in (tmp_path / "out").iterdir()] == [MARK]


def test_objects_cannot_be_evaluated_elsewhere(clip: Path, tmp_path: Path) -> None:
    with pytest.raises(NteError, match="denoisers are objects of this process: give specifications"):
        evaluate([clip], {"one": Noisy()}, tmp_path / "out", jobs=2)
    with pytest.raises(NteError, match="--jobs 0: expected a number of processes, 1 or more"):
        evaluate([clip], ["noisy"], tmp_path / "out", jobs=0)
    assert not (tmp_path / "out").exists()


class Stranger:
    """Has what a denoiser needs, but inherits nothing."""

    needs = ("color",)

    def step(self, frame: Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[Result, None]:
        return Result(frame["color"]), None


class Stepless(Denoiser):
    needs = ("color",)


class Needless(Denoiser):
    def step(self, frame: Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[Result, None]:
        return Result(frame["color"]), None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (Stranger(), "Stranger has no 'optional': expected a class that inherits from nte.Denoiser"),
        (Stepless(), "Stepless has no 'step': expected a class that inherits from nte.Denoiser, with needs and step"),  # type: ignore[abstract]
        (Needless(), "Needless has no 'needs'"),  # type: ignore[abstract]
        (Noisy, r"the class Noisy is given: expected an object, Noisy\(\)"),
    ],
)
def test_what_is_no_denoiser_is_one_line(clip: Path, tmp_path: Path, given: object, said: str) -> None:
    with pytest.raises(NteError, match=f"mine: {said}"):
        evaluate([clip], {"mine": given}, tmp_path / "out")  # type: ignore[dict-item]
    assert not (tmp_path / "out").exists()


def test_progress_counts_frames(clip: Path, tmp_path: Path) -> None:
    said: list[tuple[int, int, str]] = []
    evaluate([clip], ["noisy"], tmp_path / "out", progress=lambda *what: said.append(what))
    assert [s[:2] for s in said] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert said[-1][2] == "disc, frame 3"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_non_finite_output_is_an_error_not_a_score(clip: Path, tmp_path: Path, value: float) -> None:
    with pytest.raises(NteError, match="broken on disc, frame 0: 2240 of 2240 pixels are not finite"):
        evaluate([clip], {"broken": Scaled(value)}, tmp_path / "out")
    assert not (tmp_path / "out" / "metrics.json").exists()


def test_an_output_of_another_size_is_an_error(clip: Path, tmp_path: Path) -> None:
    class Cropping(Noisy):
        def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
            return Result(frame["color"][..., 1:]), ()

    with pytest.raises(NteError, match=r"frame 0: the image is \(1, 3, 40, 55\), expected \(1, C, 40, 56\)"):
        evaluate([clip], {"cropping": Cropping()}, tmp_path / "out")


def without(frames: list[dict], *names: str) -> list[dict]:
    return [{name: values for name, values in f.items() if name not in names} for f in frames]


def test_what_is_missing_is_told_before_any_work(clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    blind = write_clip(tmp_path / "blind", without(noisy_frames(2), "reference_a", "reference_b"))
    still = write_clip(tmp_path / "still", without(noisy_frames(2), "motion"))
    single = write_clip(tmp_path / "single", noisy_frames(1))
    (tmp_path / "empty").mkdir()
    for clips, specs, message in [
        ([blind], ["noisy"], "blind: no channel 'reference' to compare noisy with"),
        ([still], ["taa"], "still: taa: Taa needs motion, which is missing"),
        ([single], ["noisy"], "single: has one frame.*--first-frame"),
        ([tmp_path / "empty"], ["noisy"], "empty: no clip in it"),
        ([tmp_path / "nowhere"], ["noisy"], "nowhere: does not exist"),
        ([], ["noisy"], "no clips are named"),
        ([clip], [], "no denoisers to evaluate"),
        ([clip], ["nosy"], "'nosy' is no denoiser"),
    ]:
        with pytest.raises(NteError, match=message):
            evaluate(clips, specs, out)
    assert not out.exists()
    assert rows_of(evaluate([single], ["noisy"], out, first=0), region="all")[0]["frames"] == 1


def test_results_are_replaced_only_by_force(clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()  # an empty folder may be used
    evaluate([clip], ["noisy"], out)
    (out / "notes.txt").write_text("mine")
    before = (out / "metrics.json").read_text()
    with pytest.raises(
        NteError, match=r"out: exists: .*or replace its metrics\.json, .*, index\.html and layers with --force"
    ):
        evaluate([clip], ["noisy"], out)
    assert (out / "metrics.json").read_text() == before
    evaluate([clip], ["taa"], out, force=True)
    assert json.loads((out / "metrics.json").read_text())["means"].keys() == {"taa"}
    assert (out / "notes.txt").read_text() == "mine"
    with pytest.raises(NteError, match=r"notes\.txt: cannot be made a folder"):
        evaluate([clip], ["noisy"], out / "notes.txt", force=True)


def test_what_was_stopped_while_it_wrote_is_written_again_by_the_same_evaluation(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "out"
    with monkeypatch.context() as patched:
        patched.setattr("nte.evaluation.evaluate.write_report", stop)
        with pytest.raises(KeyboardInterrupt):
            evaluate([clip], ["noisy"], out)
    with pytest.raises(NteError, match="out: exists"):
        evaluate([clip], ["taa"], out)
    evaluate([clip], ["noisy"], out)
    assert {path.name for path in out.iterdir()} == {*OURS}


def test_leftovers_of_a_killed_process_are_in_nobodys_way(clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with subprocess.Popen(["true"]) as dead:
        pass
    for name in ("metrics.json", "evaluate"):  # the second: what workers of a cluster look for
        path = temporary_name(out / name)
        path.with_name(path.name.replace(f"_{os.getpid()}_", f"_{dead.pid}_")).touch()
    evaluate([clip], ["noisy"], out)
    assert {path.name for path in out.iterdir()} == {*OURS}


def test_clips_are_found_below_a_folder_once_and_in_order(tmp_path: Path) -> None:
    for name in ("b", "a", "deep/a"):
        disc_clip(tmp_path / name, frames=1)
    found = find_clips([tmp_path, tmp_path / "b", tmp_path / "b" / ".." / "a"])
    assert found == [tmp_path / "a", tmp_path / "b", tmp_path / "deep" / "a"]
    assert clip_labels(found) == ["a", "b", "deep/a"]


def test_mean_leaves_out_what_is_not_there() -> None:
    assert mean([1.0, None, 3.0]) == 2
    assert mean([None]) is None


@pytest.mark.parametrize("value", [math.nan, math.inf, -20.0])
def test_bad_pixels_of_a_reference_are_not_scored(tmp_path: Path, value: float) -> None:
    # A denoiser that is wrong where the reference is bad, and nowhere else, is perfect.
    frames = [clean_frame(i) for i in range(3)]
    good = write_clip(tmp_path / "good", frames)
    for i, frame in enumerate(frames):
        frame["reference"][i % 3, 7 + i, 9] = value
        frame["color"][:, 7 + i, 9] = 40.0
    bad = write_clip(tmp_path / "bad", frames)
    with pytest.warns(BadReferenceWarning, match=r"bad, frame 0: 1 pixels of 'reference' are NaN, inf") as told:
        found = evaluate([bad], ["noisy"], tmp_path / "out")
    assert len(told) == 1
    (row,) = rows_of(found, region="all")
    assert row["psnr"] == 100
    assert row["l1"] == row["temporal_l1"] == 0
    assert row["ssim"] == pytest.approx(1, abs=1e-6)
    assert row["flip"] == pytest.approx(0, abs=1e-6)
    (perfect,) = rows_of(evaluate([good], ["noisy"], tmp_path / "out2"), region="all")
    assert row["frames"] == perfect["frames"] == 2


def test_too_many_bad_pixels_of_a_reference_are_an_error(tmp_path: Path) -> None:
    frames = [clean_frame(i) for i in range(3)]
    height, width = frames[0]["color"].shape[1:]
    frames[2]["reference"][:, : height // 4] = np.nan
    clip = write_clip(tmp_path / "half", frames)
    message = rf"half, frame 2: {height // 4 * width} of {height * width} pixels of 'reference' are NaN, infinite or"
    with pytest.raises(NteError, match=message):
        evaluate([clip], ["noisy"], tmp_path / "out")
