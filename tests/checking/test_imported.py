"""What other people's files get wrong is still seen after the import has converted it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from tests.checking.test_values import ball_normals
from tests.importing.producers import blender, scene
from tests.synthetic import Pixels


def encode(frame: dict[str, Pixels]) -> None:
    frame["normal"] = ball_normals(frame["depth"].shape[1:]) / 2 + 0.5


def stop(frame: dict[str, Pixels]) -> None:
    frame["motion"], frame["forward_motion"] = 0 * frame["motion"], 0 * frame["forward_motion"]


def shorten(frame: dict[str, Pixels]) -> None:
    frame["motion"], frame["forward_motion"] = frame["motion"] / 64, frame["forward_motion"] / 64


@pytest.mark.slow
@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (encode, "normal: no component is negative: stored as n/2 + 1/2"),
        (stop, "the picture changes and the vectors do not"),
        (shorten, "unit (uv"),  # the image is 64 pixels wide
    ],
)
def test_blender_like_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], harm: Callable[[dict[str, Pixels]], None], told: str
) -> None:
    frames = scene()
    for frame in frames:
        harm(frame)
    source = blender(tmp_path / "blender", frames)
    assert main(["import", "blender", str(source), "--out", str(tmp_path / "clip")]) == 2
    assert told in capsys.readouterr().out
    assert main(["check", str(tmp_path / "clip")]) == 2


def test_depth_that_counts_backwards(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = blender(tmp_path / "blender", scene())
    # The importer takes what is not above 0 for a miss, so nothing is left of the surfaces.
    for path in source.iterdir():
        _negate_depth(path)
    assert main(["import", "blender", str(source), "--out", str(tmp_path / "clip")]) == 2
    assert "depth: 0 everywhere, though albedo" in capsys.readouterr().out


def _negate_depth(path: Path) -> None:
    from nte.frames.exr import read_exr, write_exr

    layers = {name: np.ascontiguousarray(values, np.float32) for name, values in read_exr(path).items()}
    depth = next(name for name in layers if name.endswith("Depth.Z"))
    layers[depth] = -np.abs(layers[depth])
    write_exr(path, layers)
