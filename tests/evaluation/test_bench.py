"""nte bench: what it runs on, what it measures, and what it says of wrong input."""

import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nte.cli import main
from nte.denoiser import Noisy, Result
from nte.errors import NteError
from nte.evaluation.benchmark.bench import bench
from nte.evaluation.benchmark.frames import clip_frames, scaled, synthetic_frames
from nte.evaluation.benchmark.steps import grouped, named_steps
from nte.evaluation.benchmark.worker import Task, Worker
from nte.filters.prior import complete
from nte.filters.svgf import Svgf
from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame
from nte.models.cost import macs_per_pixel
from nte.recurrence import NetworkState
from nte.runtime.engine import Spent
from nte.runtime.export import export_onnx
from nte.runtime.providers import OnnxOptions, installed
from nte.runtime.session import OnnxDenoiser
from tests.evaluation.test_bench_results import require_schema
from tests.models.lights import light_network
from tests.shared import made_once
from tests.synthetic import disc_clip, disc_frame, write_clip


@pytest.fixture(scope="session")
def light_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An exported network with few weights. Only to be read."""

    def export(folder: Path) -> None:
        export_onnx(light_network("color"), folder / "model.onnx", progress=lambda line: None)

    return made_once(tmp_path_factory, "bench", export) / "model.onnx"


def test_synthetic_frames_have_every_channel_and_any_size() -> None:
    frame = synthetic_frames((7, 10), CHANNELS)(3)
    assert frame.size == (7, 10)
    for name, row in CHANNELS.items():
        assert frame[name].shape == (1, len(row.components), 7, 10)
        assert frame[name].dtype == np.float32
        assert np.isfinite(frame[name]).any()
    first, again, later = (synthetic_frames((7, 10), ["color", "motion"])(i) for i in (0, 0, 1))
    np.testing.assert_array_equal(first["color"], again["color"])
    assert not np.array_equal(first["color"], later["color"])


def test_gradient_has_one_pixel_in_each_stratum() -> None:
    names = [name for name in CHANNELS if name.startswith("gradient")]
    assert len(names) == 4
    for values in synthetic_frames((9, 12), names)(0).channels.values():
        known = np.isfinite(values).all(1)[0].reshape(3, 3, 4, 3).sum((1, 3))
        np.testing.assert_array_equal(known, 1)


def test_scaling_takes_the_nearest_pixels_and_scales_vectors() -> None:
    values = np.arange(6, dtype=np.float32).reshape(1, 1, 2, 3)
    frame = Frame({"depth": values, "motion": np.concatenate([values, values], 1)})
    twice = scaled(frame, (4, 6))
    np.testing.assert_array_equal(twice["depth"], values.repeat(2, 2).repeat(2, 3))
    np.testing.assert_array_equal(twice["motion"], 2 * twice["depth"].repeat(2, 1))
    wide = scaled(frame, (2, 9))["motion"]
    np.testing.assert_array_equal(wide[:, 0], 3 * values[:, 0].repeat(3, 2))
    np.testing.assert_array_equal(wide[:, 1], values[:, 0].repeat(3, 2))
    assert scaled(frame, (1, 1))["depth"].item() in (1, 4)
    about = {"exposure": np.float32([3]), "shutter": np.float32([0.5])}
    kept = scaled(Frame({"depth": values}, 4, clean_guides=True, **about), (1, 1))
    assert (kept.clean_guides, kept.exposure, kept.shutter, kept.index) == (True, 3, 0.5, 4)


def test_a_clip_starts_again_after_its_last_frame(noisy_disc: Path) -> None:
    source = clip_frames(noisy_disc, None, ["color", "nothing"])
    np.testing.assert_array_equal(source(5)["color"], source(1)["color"])
    assert list(source(0).channels) == ["color"]
    assert clip_frames(noisy_disc, (5, 9), ["color"])(0).size == (5, 9)


def test_named_steps_are_those_of_the_denoiser() -> None:
    start = time.perf_counter()
    steps = named_steps(Svgf(), synthetic_frames((16, 16), Svgf().needs))
    whole = 1e3 * (time.perf_counter() - start)
    assert list(steps) == ["svgf: reprojection", "svgf: accumulation", "svgf: variance", "svgf: à-trous"]
    assert all(spent > 0 for spent in steps.values())
    assert sum(steps.values()) < whole
    assert named_steps(Noisy(), synthetic_frames((4, 4), ["color"])) == {}


def test_the_steps_of_a_network_are_its_modules() -> None:
    network = light_network("color")
    steps = named_steps(network, synthetic_frames((32, 32), [*network.needs, *network.optional]))
    assert list(steps) == ["reading", "carrying", "reprojection", "prediction", "kernels", "blending"]
    assert all(spent > 0 for spent in steps.values())
    assert not any(child._forward_hooks or child._forward_pre_hooks for child in network.children())


def test_the_denoiser_below_a_network_is_its_first_step() -> None:
    whole = complete(light_network("on top"))
    steps = named_steps(whole, synthetic_frames((32, 32), [*whole.needs, *whole.optional]))
    assert list(steps) == ["prior", "reading", "carrying", "reprojection", "prediction", "kernels", "blending"]
    assert all(spent > 0 for spent in steps.values())


@pytest.mark.slow
@pytest.mark.parametrize("provider", ["cpu", "openvino"])
def test_the_steps_of_an_exported_graph_are_those_of_its_network(light_model: Path, provider: str) -> None:
    if provider not in installed():
        pytest.skip("it is not installed")
    denoiser = OnnxDenoiser(light_model, OnnxOptions(provider=provider))
    steps = named_steps(denoiser, synthetic_frames((64, 64), [*denoiser.needs, *denoiser.optional]))
    known = {"scatter", "reading", "carrying", "reprojection", "prediction", "kernels", "blending"}
    assert steps.keys() - {"before the first step"} == known
    assert all(spent > 0 for spent in steps.values())


def test_operators_between_steps_count_for_the_step_before() -> None:
    frame = [("/network/unet/Conv", 30.0), ("ReorderOutput", 3.0), ("/kernels/Mul", 50.0), ("/Cast", 7.0)]
    assert grouped([frame]) == {"network": 33.0, "kernels": 57.0}
    assert grouped([frame, [(name, 3 * spent) for name, spent in frame]]) == {"network": 66.0, "kernels": 114.0}
    assert grouped([[("Log", 1.0), *frame]])["before the first step"] == 1.0
    fused = [("/kernels/Slice/GatherSliceToSplitFusion", 5.0), ("/Slice_2/GatherSliceToSplitFusion_token_1", 1.0)]
    assert grouped([[*frame, *fused]]) == {"network": 33.0, "kernels": 63.0}


class SlowWhenProfiled(OnnxDenoiser):
    """Stands for an exported model; its profile has every operator, and one frame takes as long as they do together."""

    def __init__(self, milliseconds: float) -> None:
        self.milliseconds, self.frames = milliseconds, 0

    def step(self, frame: Frame, state: NetworkState | None, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        time.sleep(self.milliseconds / 1e3)
        self.frames += 1
        return Result(frame["color"]), None

    def profiled(self) -> OnnxDenoiser:
        return SlowWhenProfiled(10 * self.milliseconds)

    def profile(self) -> list[Spent]:
        return [[("/a/Conv", 0.75 * self.milliseconds), ("/b/Conv", 0.25 * self.milliseconds)]] * self.frames


def test_the_steps_of_a_graph_are_within_the_time_of_its_frame_without_a_profile() -> None:
    steps = named_steps(SlowWhenProfiled(20.0), synthetic_frames((4, 4), ["color"]))
    assert list(steps) == ["a", "b"]
    assert steps["a"] == pytest.approx(3 * steps["b"])
    assert 12 < sum(steps.values()) < 100  # as the machine allows; 200 with the profile


def test_wrong_input_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(NteError, match="--frames is 0, expected at least 1"):
        bench(["noisy"], frames=0)
    with pytest.raises(NteError, match=r"clip.json"):
        bench(["noisy"], clip=tmp_path / "none")
    (tmp_path / "rows.json").touch()
    clip = str(disc_clip(tmp_path / "clip", frames=1))
    bare = str(write_clip(tmp_path / "bare", [{"color": disc_frame(0)["color"]}]))
    for arguments, message in (
        (["noisy", "--json", str(tmp_path / "rows.json")], "rows.json: exists: choose another name"),
        (["noisy", "--json", str(tmp_path / "none" / "rows.json")], "its folder does not exist"),
        (["noisy", "--threads", "0"], f"--threads is 0, expected 1 to {os.cpu_count()}"),
        (["noisy", "--threads", "1", "5000"], f"--threads is 5000, expected 1 to {os.cpu_count()}"),
        (["noisy", "--plot", str(tmp_path / "plot.svg")], "--plot needs --clip"),
        (
            ["noisy", "--plot", str(tmp_path / "plot.gif"), "--clip", clip],
            "plot.gif: expected a name that ends in .svg",
        ),
        (["noisy", "--plot", str(tmp_path / "none" / "plot.svg"), "--clip", clip], "its folder does not exist"),
        (
            ["noisy", "--plot", str(tmp_path / "plot.svg"), "--clip", clip, "--size", "9x9"],
            "needs the size of the clip",
        ),
        (["noisy", "--plot", str(tmp_path / "plot.svg"), "--clip", bare], "bare has no reference"),
        (["noisy", "--provider", "openvino"], "--provider openvino: no exported model (.onnx) among noisy"),
    ):
        assert main(["bench", *arguments]) == 2
        said = capsys.readouterr().err
        assert message in said
        assert len(said.splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"rows.json", "clip", "bare"}
    with pytest.raises(SystemExit) as stopped:
        main(["bench", "noisy", "--size", "12x0"])
    assert stopped.value.code == 2
    assert "'12x0' is no size: expected WIDTHxHEIGHT" in capsys.readouterr().err


@pytest.mark.slow
def test_bench_measures_each_denoiser_at_each_size(
    tmp_path: Path, light_model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = disc_clip(tmp_path / "clip", frames=3, seed=0)
    model = light_model
    paths = ["--json", str(tmp_path / "rows.json"), "--plot", str(tmp_path / "rows.svg")]
    arguments = f"noisy taa {model} --size 64x48 320x256 --frames 3 --clip {clip} --threads 1 --steps".split()
    assert main(["bench", *arguments, *paths]) == 0
    written = json.loads((tmp_path / "rows.json").read_text())
    require_schema(written)
    rows = written["rows"]
    specs = ["noisy", "taa", str(model)]
    assert [(row["denoiser"], row["width"], row["height"]) for row in rows] == [
        *((spec, 64, 48) for spec in specs),
        *((spec, 320, 256) for spec in specs),
    ]
    for row in rows:
        assert 0 < row["ms_per_frame"] <= row["p95"]
        assert (row["psnr"] is None) == (row["flip"] is None) == (row["width"] != 64)
        assert bool(row["macs"]) == (row["denoiser"] == str(model))
    assert rows[1]["psnr"] > rows[0]["psnr"]
    assert rows[1]["flip"] < rows[0]["flip"]
    assert rows[4]["peak_mb"] < 300
    network = light_network("color")
    assert rows[5]["macs"] == {name: pytest.approx(sum(of)) for name, of in macs_per_pixel(network).items()}
    assert 0 < rows[5]["step_shares_of_peak"]["prediction"] < 1
    assert rows[5]["step_shares_of_peak"]["scatter"] is None  # it has no multiply-accumulates
    said = capsys.readouterr().out
    assert "320x256" in said
    assert "peak of a convolution, 1 thread: float32" in said
    drawn = (tmp_path / "rows.svg").read_text()
    assert all(spec in drawn for spec in specs)


@pytest.mark.slow
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads as Linux lists them")
def test_a_denoiser_has_the_threads_that_it_is_given(light_model: Path) -> None:
    pytest.importorskip("pyoidn", reason="the extra `compare` is not installed")

    def running(spec: str, threads: int) -> int:
        worker = Worker(Task(spec, (64, 80), threads, None, "cpu"))
        try:
            worker.load()
            worker.denoise(0)
            return len(os.listdir(f"/proc/{worker.process.pid}/task"))
        finally:
            worker.stop()

    of_pytorch = running("noisy", 2) - running("noisy", 1)
    assert of_pytorch == 1
    for spec in ("oidn:quality=fast", str(light_model)):  # these have threads of their own
        assert running(spec, 2) - running(spec, 1) - of_pytorch == 1, spec


@pytest.mark.slow
def test_what_a_process_finds_wrong_is_told_here(tmp_path: Path) -> None:
    for spec, message in (("nosy", "'nosy' is no denoiser"), ("taa:alpha=3", "taa: alpha is 3.0")):
        with pytest.raises(NteError, match=message):
            bench([spec], [(8, 8)], frames=1)
    clip = disc_clip(tmp_path / "clip", frames=2)
    enormous = 10**7, 10**7  # more than an address can reach
    with pytest.raises(NteError, match=r"'noisy' at 10000000x10000000: too little memory: another [\d.]+ TiB were ask"):
        bench(["noisy"], [enormous], frames=1)
    with pytest.raises(NteError, match="clip: Asvgf needs gradient, which is missing"):
        bench(["asvgf"], clip=clip, frames=1)
