import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from nte.cli import main
from nte.frames.clip import Clip
from nte.importing.noisebase_files import NoisebaseSequence
from nte.motion.camera import points_from_depth, project
from nte.motion.warp import pixel_centres
from tests.importing.producers import SKY_ROWS, noisebase_arrays, scene

zarr = pytest.importorskip("zarr")
pytestmark = pytest.mark.filterwarnings("ignore:Duplicate name")


def write_zip(path: Path, arrays: dict[str, Any]) -> Path:
    """LZ4HC, zarr's second format: what the data sets are."""
    from numcodecs import Blosc

    path.parent.mkdir(parents=True, exist_ok=True)
    with zarr.storage.ZipStore(path, mode="w") as store:
        group = zarr.open_group(store, mode="w", zarr_format=2)
        for name, values in arrays.items():
            group.create_array(name, data=np.asarray(values), compressors=Blosc(cname="lz4hc", clevel=9))
    return path


def sequence(path: Path, count: int = 4) -> Path:
    frames = noisebase_arrays(scene(count))
    return write_zip(path, {name: np.stack([f[name] for f in frames]) for name in frames[0]})


def run(source: Path, out: Path, *more: str) -> int:
    return main(["import", "noisebase", str(source), "--out", str(out), *more])


@pytest.mark.parametrize("layout", ["training", "test"])
def test_samples_become_pixels(tmp_path: Path, capsys: pytest.CaptureFixture[str], layout: str) -> None:
    frames = scene()
    if layout == "training":
        source = sequence(tmp_path / "scene0003.zip")
    else:
        source = tmp_path / "bistro"
        for i, arrays in enumerate(noisebase_arrays(frames)):
            write_zip(source / f"frame{i:04d}.zip", {n: a for n, a in arrays.items() if n != "crop_offset"})
    assert run(source, tmp_path / "clip") == 0
    # The wall moves by itself, so its vectors are not those that the file's moving camera gives to what stands still;
    # and its normals are any, so most of them point away.
    told = capsys.readouterr().out
    assert "clip: undecidable: " in told
    assert "cameras: lead with depth to other vectors than motion" in told
    clip = Clip(tmp_path / "clip")
    assert clip.info["spp"] == 1
    for index, frame in enumerate(frames):
        found = clip.frame(index)
        for name in ("reference", "albedo", "normal", "depth"):
            np.testing.assert_allclose(found[name][0], frame[name], rtol=1e-3, atol=1e-3, err_msg=name)
        np.testing.assert_allclose(found["color"][0], frame["color"], rtol=0.02, atol=0.02 * frame["color"].max())
        expected = frame["motion"][:, SKY_ROWS:] if index else 0
        np.testing.assert_allclose(found["motion"][0, :, SKY_ROWS:], expected, atol=2e-3)


def test_one_file_is_open_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Path] = []

    class Watched(zarr.storage.ZipStore):  # type: ignore[misc, name-defined]
        def __init__(self, path: Path, **how: Any) -> None:
            super().__init__(path, **how)
            opened.append(path)

        def close(self) -> None:
            super().close()
            opened.remove(self.path)

    for i, arrays in enumerate(noisebase_arrays(scene())):
        write_zip(tmp_path / f"frame{i:04d}.zip", arrays)
    monkeypatch.setattr(zarr.storage, "ZipStore", Watched)
    sequence = NoisebaseSequence(tmp_path)
    for frame in (0, 1, 2, 1):
        assert sequence.read(frame, "color").shape[0] == 4
        assert opened == [sequence.path(frame)]


def test_cameras_agree_with_positions_and_the_sky_with_the_cameras(tmp_path: Path) -> None:
    assert run(sequence(tmp_path / "a.zip"), tmp_path / "clip") == 0
    clip = Clip(tmp_path / "clip")
    before, frame = clip.frame(1).torch(), clip.frame(2).torch()
    seen = project(frame["position"], frame.view, frame.projection)
    apart = (seen - pixel_centres(seen)).abs()[..., SKY_ROWS:, :]
    assert apart.max() < 0.5
    assert apart.mean() < 0.2  # the most central of six samples
    rays = points_from_depth(frame["depth"], frame.view, frame.projection)
    sky = project(rays, before.view, before.projection, frame.hit) - pixel_centres(rays)
    np.testing.assert_allclose(frame["motion"][..., :SKY_ROWS, :], sky[..., :SKY_ROWS, :], atol=1e-2)
    assert sky[..., :SKY_ROWS, :].abs().mean() > 1


def test_color_is_the_mean_of_so_many_samples(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = noisebase_arrays(scene(2))
    for arrays in frames:
        arrays["color"][3, ..., 1] = arrays["color"][3, ..., 0] - (arrays["color"][3, ..., 0] > 0)  # a darker sample
    source = write_zip(tmp_path / "a.zip", {name: np.stack([f[name] for f in frames]) for name in frames[0]})
    assert run(source, tmp_path / "one") == 0
    assert run(source, tmp_path / "two", "--spp", "2") == 0
    one, two = (Clip(tmp_path / name).frame(0)["color"].mean() for name in ("one", "two"))
    assert 0.9 * one < two < one
    assert run(source, tmp_path / "seven", "--spp", "7") == 2
    assert "has 6 samples per pixel, 7 are asked for" in capsys.readouterr().err


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def garble(path: Path) -> None:
    """Damage a chunk of `position` without the zip's directory noticing."""
    with zipfile.ZipFile(path) as file:
        offset = next(i.header_offset for i in file.infolist() if i.filename.startswith("position/1"))
    data = bytearray(path.read_bytes())
    data[offset + 200 : offset + 260] = bytes(60)
    path.write_bytes(data)


def rewrite(**changed: Any) -> Callable[[Path], object]:
    def harm(path: Path) -> None:
        frames = noisebase_arrays(scene(2))
        arrays = {name: np.stack([f[name] for f in frames]) for name in frames[0]}
        for name, change in changed.items():
            if change is None:
                del arrays[name]
            else:
                arrays[name] = change(arrays[name])
        path.unlink()
        write_zip(path, arrays)

    return harm


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (cut, "not a readable zarr zip file"),
        (garble, "'position' is damaged in frame 1"),
        (lambda p: p.write_text("text"), "not a readable zarr zip file"),
        (rewrite(position=None), "array 'position' is missing; the file has camera_position,"),
        (rewrite(color=None), "no array 'color'"),
        (rewrite(motion=lambda a: a[..., :3]), "'motion' has the shape (2, 3, 48, 64, 3), expected (2, 3, 48, 64, 6)"),
        (rewrite(color=lambda a: np.float32(a)), "'color' has the type float32, expected uint8"),
        (rewrite(view_proj_mat=lambda a: a.swapaxes(1, 2)), "'view_proj_mat' for row vectors"),
        (rewrite(position=lambda a: a[..., ::-1, :, :]), "positions are not seen in their own pixels"),
        (rewrite(normal=lambda a: 0 * a), "frame 0: no surface is seen in the image"),
        (rewrite(camera_up=lambda a: 0 * a), "frame 0: the camera's position, target and up give no view"),
        (lambda p: p.rename(p.with_name("a.tar")), "does not exist: expected a folder, a file or a quoted pattern"),
        (lambda p: write_zip(p.with_name("b2.zip"), {"x": np.ones(3)}), ""),
    ],
)
def test_bad_files_are_one_line_and_leave_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], harm: Callable[[Path], object], said: str
) -> None:
    source = sequence(tmp_path / "data" / "a1.zip", 2)
    harm(source)
    whole_folder = not said
    assert run(source.parent if whole_folder else source, tmp_path / "clip") == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert (said or "holds 2 sequences") in error[0]
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_without_zarr_the_extra_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = sequence(tmp_path / "a.zip", 2)
    monkeypatch.setitem(__import__("sys").modules, "zarr", None)
    assert run(source, tmp_path / "clip") == 2
    assert "noisebase data needs the package 'zarr': pip install 'nte-denoiser[import]'" in capsys.readouterr().err


def test_a_wrong_direction_of_motion_is_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "a.zip"
    source.touch()
    rewrite(motion=lambda a: -a)(source)
    assert run(source, tmp_path / "clip") == 2
    assert "implausible" in capsys.readouterr().out
    assert torch.isfinite(torch.from_numpy(Clip(tmp_path / "clip").frame(1)["motion"])).all()


def test_bad_pixels_of_the_reference_are_counted_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for i, arrays in enumerate(noisebase_arrays(scene(3))):
        arrays["reference"] = arrays["reference"].copy()
        arrays["reference"][0, :i, 5] = [np.nan, -20.0][:i]
        write_zip(tmp_path / "bistro" / f"frame{i:04d}.zip", arrays)
    assert run(tmp_path / "bistro", tmp_path / "clip") == 0
    assert f"bad: 3 pixels of reference, first in {tmp_path}/bistro/frame0001.zip" in capsys.readouterr().out
