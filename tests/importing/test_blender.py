from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from nte.frames.clip import Clip
from nte.frames.exr import read_exr, write_exr
from nte.importing.ids import UNNAMED
from tests.importing.producers import SKY_ROWS, blender, scene, write_layers


def run(source: Path, out: Path, *more: str) -> int:
    return main(["import", "blender", str(source), "--out", str(out), *more])


@pytest.mark.parametrize("old_names", [True, False], ids=["blender 4", "blender 5"])
def test_cycles_passes_become_our_channels(tmp_path: Path, capsys: pytest.CaptureFixture[str], old_names: bool) -> None:
    frames = scene()
    source = blender(tmp_path / "noisy", frames, old_names)
    clean = blender(tmp_path / "clean", [{**f, "color": f["reference"]} for f in frames], old_names)
    assert run(source, tmp_path / "clip", "--reference", str(clean)) == 0
    assert "clip: plausible" in capsys.readouterr().out
    clip = Clip(tmp_path / "clip")
    for index, frame in enumerate(frames):
        found = clip.frame(index)
        for name in ("color", "reference", "albedo", "normal", "depth", "instance", "motion", "forward_motion"):
            np.testing.assert_allclose(found[name][0], frame[name], rtol=1e-3, atol=1e-3, err_msg=name)
        assert not found["emission"].any()


def test_objects_without_an_index_are_no_misses(tmp_path: Path) -> None:
    source = blender(tmp_path / "noisy", [{**f, "instance": 0 * f["instance"]} for f in scene(2)])
    assert run(source, tmp_path / "clip") == 0
    instance = Clip(tmp_path / "clip").frame(0)["instance"][0, 0]
    assert (instance[:SKY_ROWS] == 0).all()
    assert (instance[SKY_ROWS:] == UNNAMED).all()


def test_a_pattern_chooses_the_files(tmp_path: Path) -> None:
    source = blender(tmp_path / "shots", scene(2))
    write_layers(source / "other", [{"x": np.zeros((4, 4))}])
    assert run(source / "shot.*.exr", tmp_path / "clip") == 0
    assert len(Clip(tmp_path / "clip")) == 2


def test_only_the_combined_pass_is_needed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layers = {f"ViewLayer.Combined.{c}": np.ones((8, 8)) for c in "RGBA"}
    assert run(write_layers(tmp_path / "shots", [layers] * 2), tmp_path / "clip") == 0
    said = capsys.readouterr().out
    assert "without motion ('Vector.X Vector.Y'): no history" in said
    assert "without albedo ('Diffuse Color | DiffCol')" in said
    assert "not checked" in said


@pytest.mark.parametrize("frame", [0, 1, 2])
def test_a_pass_that_one_frame_lacks_is_named_and_nothing_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frame: int
) -> None:
    source = blender(tmp_path / "noisy", scene(3))
    path = sorted(source.iterdir())[frame]
    write_exr(path, {name: plane for name, plane in read_exr(path).items() if ".Vector." not in name})
    assert run(source, tmp_path / "clip") == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert str(path) in error
    assert "'motion'" in error
    assert {p.name for p in tmp_path.iterdir()} == {"noisy"}


def test_the_image_before_denoising_is_the_noisy_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = scene(2)
    source = blender(tmp_path / "noisy", [{**f, "color": f["reference"]} for f in frames])
    for path, frame in zip(sorted(source.iterdir()), frames, strict=True):
        noisy = dict(zip("RGB", frame["color"], strict=True))
        write_exr(path, read_exr(path) | {f"View Layer.001.Noisy Image.{c}": plane for c, plane in noisy.items()})
    assert run(source, tmp_path / "clip") == 0
    np.testing.assert_array_equal(Clip(tmp_path / "clip").frame(1)["color"][0], frames[1]["color"])
    assert "color from View Layer.001.Noisy Image" in capsys.readouterr().out


def test_what_the_compositor_made_counts_only_alone(tmp_path: Path) -> None:
    def image(layer: str, value: float) -> dict[str, np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
        return {f"{layer}.Combined.{c}": np.full((8, 8), value) for c in "RGBA"}

    both = write_layers(tmp_path / "both", [image("Composite", 0.25) | image("Scene.View", 0.5)])
    alone = write_layers(tmp_path / "alone", [image("Composite", 0.25)])
    for source, value in ((both, 0.5), (alone, 0.25)):
        assert run(source, tmp_path / source.name / "clip") == 0
        assert (Clip(source / "clip").frame(0)["color"] == value).all()
    assert run(both, tmp_path / "chosen", "prefix=Composite") == 0
    assert (Clip(tmp_path / "chosen").frame(0)["color"] == 0.25).all()


@pytest.mark.parametrize(
    ("layers", "said"),
    [
        (["R", "G", "B"], "no Noisy Image | Combined for 'color' (3 components); the file has B, G, R"),
        ([f"{a}.Combined.{c}" for a in "AB" for c in "RGB"], "has the layers A, B: choose one with prefix=NAME"),
        ([*(f"A.Combined.{c}" for c in "RGB"), "A.Vector.X"], "no Vector.X Vector.Y with the prefix 'A' for 'motion'"),
    ],
)
def test_other_files_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], layers: list[str], said: str
) -> None:
    source = write_layers(tmp_path / "shots", [dict.fromkeys(layers, np.ones((8, 8)))] * 2)
    assert run(source, tmp_path / "clip") == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "clip").exists()
