"""`nte denoise --frames`: a part of a sequence, with the history that it has in the whole."""

from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from nte.denoiser import Noisy, Result
from nte.errors import NteError
from nte.filters.taa import Taa
from nte.frames.clip import Clip, read_frame, write_frame
from nte.frames.clip_files import frame_path
from nte.frames.exr import read_layers
from nte.frames.frame import Frame
from nte.frames.numbering import by_number
from nte.frames.scalars import sequence_scalars
from nte.sequences.denoise import denoise_files
from nte.sequences.sources import WARM_UP
from tests.importing.producers import blender, scene
from tests.synthetic import disc_clip


def silent(line: str) -> None:
    pass


class Counting(Taa):
    """TAA that counts its frames."""

    frames = 0

    def step(self, frame: Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[Result, object]:
        self.frames += 1
        return super().step(frame, state, extras)


@pytest.mark.parametrize("first", [-30, 0, 7])
def test_a_part_of_numbered_frames_is_that_of_the_whole(tmp_path: Path, first: int) -> None:
    disc = disc_clip(tmp_path / "disc", frames=40, seed=1, size=(24, 40), start=(10.0, 12.0), radius=6.0)
    folder = tmp_path / "shot"
    folder.mkdir()
    for i in range(40):
        frame_path(disc, i).rename(folder / f"shot.{first + i:04d}.exr")
    whole = denoise_files([folder], Taa(), tmp_path / "whole", exposure=1.0)
    for start, stop, steps in ((36, 39, 3 + WARM_UP), (WARM_UP, WARM_UP + 1, WARM_UP + 1), (3, 5, 5), (0, 40, 40)):
        denoiser, out = Counting(), tmp_path / f"part_{start}"
        wanted = range(first + start, first + stop)
        written = denoise_files([folder], denoiser, out, exposure=1.0, wanted=wanted)
        assert [path.name for path in written] == [path.name for path in whole[start:stop]]
        assert sorted(path.name for path in out.iterdir()) == sorted(path.name for path in written)
        assert denoiser.frames == steps
        for ours, theirs in zip(written, whole[start:stop], strict=True):
            # TAA keeps 0.9³² = 3 % of what it had 32 frames before.
            np.testing.assert_allclose(
                read_frame(ours)["color"], read_frame(theirs)["color"], rtol=0, atol=0 if start <= WARM_UP else 0.06
            )


def test_a_part_has_the_exposure_and_the_depth_of_the_whole(tmp_path: Path) -> None:
    """The light grows, and the camera withdraws: the first frame that is read is no measure of the sequence."""

    class Keeping(Noisy):
        needs = ("color", "depth")

        def __init__(self) -> None:
            super().__init__()
            self.seen: dict[int, tuple[float, float]] = {}

        def step(self, frame: Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[Result, object]:
            exposure, depth = sequence_scalars(frame)
            self.seen[int(frame["color"][0, 0, 0, 0] * 8)] = float(exposure[0]), float(depth[0])
            return super().step(frame, state, extras)

    folder = tmp_path / "shot"
    for i in range(40):
        light, far = np.full((3, 8, 8), (i + 1) / 8, np.float32), np.full((1, 8, 8), i + 1, np.float32)
        write_frame(folder / f"shot.{i:04d}.exr", {"color": light, "depth": far})
    whole, part = Keeping(), Keeping()
    denoise_files([folder], whole, tmp_path / "whole")
    denoise_files([folder], part, tmp_path / "part", wanted=range(38, 40))
    assert len({exposure for exposure, _ in whole.seen.values()}) == 1
    assert [part.seen[i + 1] for i in (38, 39)] == [(whole.seen[1][0], 1.0)] * 2


def test_some_frames_of_a_denoised_clip_are_replaced_and_it_stays_one(noisy_disc: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = ["denoise", str(noisy_disc), "--out", str(out)]
    assert main([*command, "--denoiser", "noisy"]) == 0
    before = {path: path.read_bytes() for path in out.iterdir()}
    assert main([*command, "--denoiser", "taa", "--frames", "2-3"]) == 2  # they exist
    assert {path: path.read_bytes() for path in out.iterdir()} == before
    assert main([*command, "--denoiser", "taa", "--frames", "2-3", "--force"]) == 0
    changed = {path.name for path in out.iterdir() if before[path] != path.read_bytes()}
    assert changed == {"frame_0002.exr", "frame_0003.exr"}
    assert len(Clip(out)) == 4


def test_a_part_of_anothers_frames_keeps_its_own_layers(tmp_path: Path) -> None:
    """Each file's planes go back into that file: frames differ in every layer."""
    folder = blender(tmp_path / "shot", scene(5))
    names = sorted(path.name for path in folder.iterdir())
    whole, part = tmp_path / "whole", tmp_path / "part"
    denoise_files([folder], Taa(), whole, exposure=1.0, say=silent)
    number = list(by_number(folder.iterdir()))[3]
    denoise_files([folder], Taa(), part, exposure=1.0, say=silent, wanted=range(number, number + 2))
    assert sorted(path.name for path in part.iterdir()) == names[3:]
    for name in names[3:]:
        ours, theirs = read_layers(part / name), read_layers(whole / name)
        assert all(np.array_equal(ours[layer], theirs[layer], equal_nan=True) for layer in theirs)


@pytest.mark.parametrize("wanted", [range(3, 5), range(-1, 2), range(9, 10)])
def test_a_range_that_is_not_wholly_there_is_named(noisy_disc: Path, tmp_path: Path, wanted: range) -> None:
    with pytest.raises(NteError, match=r"frames .*: the sequence has 0 to 3: expected a range in it"):
        denoise_files([noisy_disc], Taa(), tmp_path / "out", wanted=wanted)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["", "a", "5-3", "1-2-3", "1:2", "1.5", "9999999999", "-"])
def test_what_is_no_range_is_one_line(noisy_disc: Path, capsys: pytest.CaptureFixture[str], text: str) -> None:
    with pytest.raises(SystemExit):
        main(["denoise", str(noisy_disc), "--denoiser", "taa", "--out", "nowhere", f"--frames={text}"])
    said = capsys.readouterr().err
    assert "expected the first and the last frame, such as 10-20" in said
    assert said.count("\n") == 1


def test_a_denoiser_that_looks_ahead_sees_the_frame_behind_the_range(tmp_path: Path) -> None:
    pytest.importorskip("pyoidn")
    clip = disc_clip(tmp_path / "disc", frames=5)
    for out, frames in ("whole", []), ("part", ["--frames", "2-3"]):
        spec = "oidn:quality=fast,accumulate=8,ahead=true"
        assert main(["denoise", str(clip), "--out", str(tmp_path / out), "--denoiser", spec, *frames]) == 0
    for index in 2, 3:
        whole, part = (read_frame(frame_path(tmp_path / out, index))["color"] for out in ("whole", "part"))
        np.testing.assert_array_equal(part, whole)
    assert len(list((tmp_path / "part").glob("*.exr"))) == 2
