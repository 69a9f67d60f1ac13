"""The frame number in a file's name, and the order of a sequence."""

import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nte.errors import NteError
from nte.frames.numbering import by_number


def order(*names: str) -> list[int]:
    """Frame numbers of shuffled names, which must come out as they are listed."""
    shuffled = random.Random(1).sample(names, len(names))
    found = by_number(Path(f"{name}.exr") for name in shuffled)
    assert [path.stem for path in found.values()] == list(names)
    return list(found)


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["shot.-0005", "shot.-0004", "shot.-0003"], [-5, -4, -3]),
        (["shot_-2", "shot_-1", "shot_0", "shot_1"], [-2, -1, 0, 1]),
        (["-1", "0", "1"], [-1, 0, 1]),
        (["shot -2", "shot -1"], [-2, -1]),
        (["shot--2", "shot--1", "shot-0", "shot-1"], [-2, -1, 0, 1]),
        (["shot-0005", "shot-0006"], [5, 6]),  # a hyphen after a letter or a digit is none
        (["take2-0005", "take2-0006"], [5, 6]),
        (["shot (2)-0005", "shot (2)-0006"], [5, 6]),
        (["shot(-2)", "shot(-1)"], [-2, -1]),
        (["shot=-2", "shot=-1"], [-2, -1]),
        (["shot.v002.0001", "shot.v002.0002"], [1, 2]),
        (["0001_v2_left", "0002_v2_left"], [1, 2]),
        (["beauty.0001.denoised-2", "beauty.0002.denoised-2"], [1, 2]),
        (["v0007", "v0008"], [7, 8]),  # where there is nothing else, it is the frame
        (["frame_9", "frame_10", "frame_11"], [9, 10, 11]),
        (["shot_0099", "shot_100"], [99, 100]),
        (["s01e02 [größer] 0001", "s01e02 [größer] 0002"], [1, 2]),
        (["0001_0001", "0002_0002"], [1, 2]),  # the same number twice
        (["2024-05-01.1", "2024-05-01.2"], [1, 2]),
        (["still"], [0]),
        (["still.0012"], [12]),
    ],
)
def test_the_number_that_differs_is_the_frame(names: list[str], numbers: list[int]) -> None:
    assert order(*names) == numbers


@given(
    st.text(st.sampled_from("aZ_. []ö"), max_size=5).filter(lambda t: not t.endswith("v")),
    st.sampled_from(["", ".left", "_final", " (a)"]),
    st.integers(-120, 1100),
    st.integers(2, 14),
    st.integers(1, 5),
)
@settings(deadline=None)
def test_any_run_of_numbers_is_ordered(before: str, after: str, first: int, count: int, padding: int) -> None:
    before += "."
    numbers = list(range(first, first + count))
    names = [f"{before}{'-' * (n < 0)}{abs(n):0{padding}d}{after}" for n in numbers]
    assert order(*names) == numbers


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["shot.v001.0001", "shot.v002.0001"], r"holds 2 sequences, shot\.v001\.0001\.exr \(1 file\) and shot\.v002"),
        (
            ["a.1", "a.2", "b.1", "b.2", "c.1"],
            r"3 sequences, a\.1\.exr \(2 files\) and b\.1\.exr \(2 files\) and 1 more: choose one .*--map",
        ),
        (["shot-1", "shot--1", "shot-x.1"], "2 sequences"),
        (["shot.1", "shot.01"], r"frame 1 is there twice \(shot\.1\.exr and shot\.01\.exr\)"),
        (["shot.1", "shot.2", "shot.4"], r"frame 3 is missing: after shot\.2\.exr comes shot\.4\.exr: render or copy"),
        (["shot.-1", "shot.1"], "frame 0 is missing"),
        (["shot.1", "notes"], r"notes\.exr: has no frame number in its name"),
        (["shot--1", "shot--2"], r"a hyphen after a hyphen, as that of shot--1\.exr, may be a minus or part of a sep"),
        (["a1_b7", "a2_b9"], r"2 numbers differ in the names, such as a1_b7\.exr and a2_b9\.exr: choose by a pattern"),
    ],
)
def test_what_is_not_one_sequence_is_refused(names: list[str], message: str) -> None:
    with pytest.raises(NteError, match=message) as error:
        by_number(Path("shots") / f"{name}.exr" for name in names)
    assert "\n" not in str(error.value)


def test_frames_of_two_folders_are_one_sequence_only_if_each_has_its_own() -> None:
    """A pattern such as `*/beauty.*.exr` would join a shot of frames 1 and 2 and another of frames 3 and 4."""
    with pytest.raises(NteError, match="a and b: the frames lie in 2 folders: choose those of one"):
        by_number([Path("a/beauty.1.exr"), Path("a/beauty.2.exr"), Path("b/beauty.3.exr"), Path("b/beauty.4.exr")])
    assert list(by_number([Path("a/1.exr"), Path("b/../a/2.exr"), Path("a/3.exr")])) == [1, 2, 3]
    assert list(by_number([Path("1/beauty.1.exr"), Path("2/beauty.2.exr"), Path("3/beauty.3.exr")])) == [1, 2, 3]
