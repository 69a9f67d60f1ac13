"""The results of nte bench: shares and real time by hand, the JSON file, the table, the plot, and the quality."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.evaluation.benchmark.plot import write_plot
from nte.evaluation.benchmark.quality import Judge, quality
from nte.evaluation.benchmark.results import FORMAT, Measured, Results
from nte.frames.frame import Frame
from nte.machine import Speed
from tests.synthetic import disc_clip, disc_frame, write_clip

SPEED = Speed(float32=4e9, bfloat16=8e9, int8=None, memory=5e9)
FILTER = Measured("svgf", 1280, 720, 1, 10, 1.0, 90.0, 50.0, 60.0, 12.0, {})
NETWORK = Measured(
    "mine.onnx", 640, 360, 2, 10, 100.0, 80.0, 40.0, 44.0, 20.0, {"prediction": 200.0, "kernels": 50.0},
    psnr=30.0, flip=0.05, steps={"reading": 10.0, "prediction": 20.0},
)  # fmt: skip

ROW = {
    "denoiser": str, "width": int, "height": int, "threads": int, "frames": int, "start_ms": float, "first_ms": float,
    "ms_per_frame": float, "p95": float, "peak_mb": float, "macs": dict, "psnr": float | None, "flip": float | None,
    "steps": dict, "macs_per_pixel": float | None, "share_of_peak": float | None, "step_shares_of_peak": dict,
    "too_slow_for_720p30": float, "share_needed_for_720p30": float | None,
}  # fmt: skip
MACHINE = {"threads": int, "float32": float, "bfloat16": float, "int8": float | None, "memory": float}


def require_schema(content: dict[str, Any]) -> None:
    """Assert that this is what the page about the command describes."""
    assert content.keys() == {"format", "machine", "rows"}
    assert content["format"] == FORMAT == "nte-bench/2"
    pairs: list[tuple[dict[str, Any], dict[str, Any]]] = [(row, ROW) for row in content["rows"]]
    for found, wanted in [*pairs, *((row, MACHINE) for row in content["machine"])]:
        assert found.keys() == wanted.keys()
        for name, kind in wanted.items():
            assert isinstance(found[name], kind), name
    known = [row["threads"] for row in content["machine"]]
    for row in content["rows"]:
        assert row["threads"] in known
        assert row["step_shares_of_peak"].keys() == row["steps"].keys()


def test_shares_and_real_time_by_hand() -> None:
    # 250 multiply-accumulates of 230,400 pixels in 40 ms are 1.44·10⁹ a second.
    assert NETWORK.share(SPEED) == pytest.approx(0.36)
    assert NETWORK.share(SPEED, "prediction") == pytest.approx(200 * 640 * 360 / 0.02 / 4e9)
    assert NETWORK.share(SPEED, "reading") is None  # no multiply-accumulates
    assert NETWORK.share(SPEED, "kernels") is None  # no time
    assert FILTER.share(SPEED) is None
    assert FILTER.too_slow == pytest.approx(1.5)
    assert NETWORK.too_slow == pytest.approx(4.8)  # a quarter of the pixels
    assert NETWORK.share_needed(SPEED) == pytest.approx(250 * 1280 * 720 * 30 / 4e9)
    # It is as many times too slow as the share that it needs is above the one that it reaches.
    assert NETWORK.share_needed(SPEED) == pytest.approx(NETWORK.too_slow * NETWORK.share(SPEED))


def test_the_json_file_and_the_text_have_everything() -> None:
    results = Results([FILTER, NETWORK, replace(NETWORK, width=1920, height=1080)], {1: SPEED, 2: SPEED})
    content = results.json()
    require_schema(content)
    assert content["rows"][0]["macs_per_pixel"] is None
    assert content["rows"][1]["share_of_peak"] == pytest.approx(0.36)
    lines = results.text().splitlines()
    table = [re.split(r"  +", line) for line in lines[:4]]
    assert table[0][-2:] == ["PSNR", "FLIP"]
    assert table[2] == [
        "mine.onnx", "640x360", "2", "100.0", "80.0", "40.0", "44.0", "20", "250", "36 %", "30.00", "0.0500",
    ]  # fmt: skip
    assert "mine.onnx 640x360, 2 threads: prediction 20.0 ms, 58 % of the peak" in lines
    assert "mine.onnx 640x360, 2 threads: reading 10.0 ms" in lines
    assert "peak of a convolution, 1 thread: float32 4, bfloat16 8 GMAC/s; memory 5 GB/s" in lines
    assert [line for line in lines if "frames/s" in line] == [
        "svgf 1280x720, 1 thread: 1.5 times too slow for 1280x720 at 30 frames/s",
        # of two sizes, the one that is closer in its number of pixels
        "mine.onnx 640x360, 2 threads: 4.8 times too slow, 173 % of the peak needed for 1280x720 at 30 frames/s",
    ]
    assert "PSNR" not in Results([FILTER], {1: SPEED}).text()


def test_the_plot_has_a_point_for_each_denoiser_and_number_of_threads(tmp_path: Path) -> None:
    rows = [replace(NETWORK, denoiser=spec, threads=n, ms_per_frame=30.0 / n) for n in (1, 2) for spec in ("a", "b")]
    write_plot(tmp_path / "plot.svg", [FILTER, *rows])
    drawn = (tmp_path / "plot.svg").read_text()
    points = re.findall(r'<g id="PathCollection_\d+">', drawn)
    assert len(points) == 2 * len(rows) + 2  # in two panels; and a legend for two denoisers
    assert "svgf" not in drawn  # it has no quality
    write_plot(tmp_path / "again.svg", rows)
    assert (tmp_path / "again.svg").read_text() == drawn
    with pytest.raises(NteError, match=r"none\.svg: not drawn: no denoiser's target has a reference in the clip"):
        write_plot(tmp_path / "none.svg", [FILTER])
    assert not (tmp_path / "none.svg").exists()


def test_a_clip_is_judged_in_its_own_frames(tmp_path: Path) -> None:
    judge = Judge(disc_clip(tmp_path / "clip", frames=3), "color")
    assert judge.scores
    clean = [disc_frame(index)["reference"][None] for index in range(3)]
    assert judge.score(1, clean[1], "mine").psnr > 60  # what is stored has half the bits
    assert judge.score(4, clean[1], "mine") == judge.score(1, clean[1], "mine")  # it begins again after three
    assert judge.score(2, clean[1], "mine").psnr < 40
    assert judge.score(2, clean[1], "mine").flip > judge.score(1, clean[1], "mine").flip
    broken = clean[1].copy()
    broken[0, 1, 3, 4] = np.nan
    with pytest.raises(NteError, match=r"mine on .*clip, frame 1: 1 of 3072 pixels are not finite"):
        judge.score(1, broken, "mine")
    bare = write_clip(tmp_path / "bare", [{"color": disc_frame(0)["color"]}])
    assert not Judge(bare, "color").scores


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -20.0])
def test_bad_pixels_of_a_reference_do_not_count(value: float) -> None:
    image, reference = torch.rand(2, 1, 3, 6, 9)
    exposure = torch.ones(1)
    reference[:, :, 2, 5] = image[:, :, 2, 5]
    without = quality(Frame({"reference": reference}), image, "color", exposure, "a clip")
    reference[:, 1, 2, 5] = value
    found = quality(Frame({"reference": reference}), image, "color", exposure, "a clip")
    # One of 54 pixels had no error: without it the mean is 54/53 of what it was.
    assert found.psnr == pytest.approx(without.psnr - 10 * np.log10(54 / 53), abs=1e-4)
    assert found.flip > without.flip > 0
