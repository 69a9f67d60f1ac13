"""`nte estimate`: a clip with motion from its images, its error and a mask."""

from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from nte.frames.clip import Clip, read_frame
from nte.frames.clip_files import frame_path
from tests.synthetic import disc_frame, write_clip

pytestmark = pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")
SPEED = (3.0, -1.0)


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames of a textured wall that moves; its vectors say 0, wrongly, except for 9 in the first rows."""
    frames = []
    for index in range(3):
        channels = disc_frame(index, (80, 120), SPEED, SPEED)
        channels["motion"] *= 0
        channels["motion"][:, :20] = 9
        frames.append(channels)
    return write_clip(tmp_path_factory.mktemp("clips") / "wall", frames)


def test_the_written_clip_has_the_motion_its_error_and_a_mask(wall: Path, tmp_path: Path) -> None:
    out = tmp_path / "estimated"
    assert main(["estimate", str(wall), "--out", str(out)]) == 0
    clip, source = Clip(out), Clip(wall)
    assert {"motion", "motion_error", "motion_mask", "color", "albedo"} <= set(clip.channels)
    assert "forward_motion" not in clip.channels
    first, last = clip.frame(0), clip.frame(2)
    assert not first["motion"].any()
    assert (first["motion_mask"] == 1).all()  # nothing to fetch
    expected = -np.array(SPEED).reshape(1, 2, 1, 1)
    assert np.abs(last["motion"] - expected)[..., 8:-8, 12:-8].mean() < 0.2
    assert (last["motion_mask"][..., 8:-8, 12:-8] < 0.5).all()
    assert (last["motion_mask"][..., 20:60, :2] == 1).all()  # came into sight: the motion leads out of the image
    assert last["motion_error"][..., 8:-8, 12:-8].max() < 0.5
    np.testing.assert_array_equal(last["color"], source.frame(2)["color"])
    assert main(["denoise", str(out), "--denoiser", "taa", "--out", str(tmp_path / "denoised")]) == 0


def test_known_vectors_of_the_clip_are_kept(wall: Path, tmp_path: Path) -> None:
    assert main(["estimate", str(wall), "--out", str(tmp_path / "known"), "--known", "--noise", "clean"]) == 0
    assert (Clip(tmp_path / "known").frame(1)["motion"][:, :, :20] == 9).all()


def test_guides_of_the_clip_are_searched_where_its_light_is_black(wall: Path, tmp_path: Path) -> None:
    frames = [dict(read_frame(frame_path(wall, index))) for index in range(3)]
    dark = write_clip(tmp_path / "dark", [frame | {"color": 0 * frame["color"]} for frame in frames])
    expected, errors = -np.array(SPEED).reshape(1, 2, 1, 1), []
    for more in ([], ["--guides"]):
        assert main(["estimate", str(dark), "--out", str(tmp_path / "out"), "--force", *more]) == 0
        motion = Clip(tmp_path / "out").frame(2)["motion"]
        errors.append(np.abs(motion - expected)[..., 8:-8, 12:-8].mean())
    assert errors[0] > 1.9  # black stands still
    assert errors[1] < 0.2


def test_what_cannot_be_is_said_in_a_line(wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bare = write_clip(tmp_path / "bare", [{"color": disc_frame(i)["color"]} for i in range(2)])
    out = tmp_path / "out"
    told = {
        (str(bare), "--out", str(out), "--guides"): "albedo, normal is missing",
        (str(bare), "--out", str(out), "--known"): "motion is missing",
        (str(bare), "--out", str(bare)): "is the clip itself",
        (str(bare), "--out", str(out), "--noise", "loud"): "noise is 'loud', expected one of auto, clean",
        (str(bare), "--out", str(out), "--device", "nothing"): "--device nothing",
        (str(tmp_path / "none"), "--out", str(out)): "does not exist",
    }
    for arguments, message in told.items():
        assert main(["estimate", *arguments]) == 2
        assert message in capsys.readouterr().err
        assert not out.exists()
    assert main(["estimate", str(bare), "--out", str(out)]) == 0
    assert main(["estimate", str(bare), "--out", str(out)]) == 2
    assert "exists" in capsys.readouterr().err
    assert main(["estimate", str(bare), "--out", str(out), "--force"]) == 0
