"""Which frames of a clip are kept, and what the page is told of them."""

from pathlib import Path

import numpy as np
import pytest

from nte.viewer.recorder import KERNEL_BYTES, Layer, Recorder, Recording, slug, titled

IMAGE, FLIP = Layer("image", "taa", "color"), Layer("flip", "taa", "color")


def recorder(folder: Path, frames: int = 20, **options: object) -> Recorder:
    return Recorder(Recording(folder / "layers", **options), "clip", (4, 6), frames, 1.0)


def record(given: Recorder, chosen: dict[int, int] | None = None) -> list[int]:
    """Record every frame; chosen: frame → the frame that is in the middle from there on. Return what is on disk."""
    for index in range(given.frames):
        given.add(index, IMAGE, np.full((3, 4, 6), index, np.float32))
        if index in (chosen or {}):
            given.centre(chosen[index])
        given.end_frame(index)
    given.end()
    return sorted(int(path.stem) for path in given.folder.glob(f"{slug('image', 'taa', 'color')}/*.js"))


@pytest.mark.parametrize(
    ("chosen", "kept"),
    [
        ({10: 10}, [8, 9, 10, 11]),
        ({3: 3, 15: 15}, [13, 14, 15, 16]),  # a later one is better
        ({1: 1}, [0, 1, 2, 3]),  # the span is as long at the clip's beginning
        ({index: index for index in range(20)}, [16, 17, 18, 19]),  # and at its end
    ],
)
def test_a_span_lies_around_the_chosen_frame(tmp_path: Path, chosen: dict[int, int], kept: list[int]) -> None:
    given = recorder(tmp_path, span=4)
    assert record(given, chosen) == kept
    assert given.entry()["frames"] == kept
    assert given.entry()["chosen"] in kept


def test_few_frames_are_on_disk_at_any_time(tmp_path: Path) -> None:
    given = recorder(tmp_path, span=4)
    most = 0
    for index in range(20):
        given.add(index, IMAGE, np.zeros((3, 4, 6), np.float32))
        given.centre(min(index, 5))
        given.end_frame(index)
        most = max(most, len(list(given.folder.rglob("*.js"))))
    assert most <= 12


def test_a_span_longer_than_the_clip_is_all_of_it(tmp_path: Path) -> None:
    assert record(recorder(tmp_path, frames=3, span=24), {2: 2}) == [0, 1, 2]


def test_a_range_is_all_that_is_written(tmp_path: Path) -> None:
    given = recorder(tmp_path, first=5, last=7)
    assert record(given) == [5, 6, 7]
    assert given.entry()["count"] == 20


def test_layers_with_fewer_frames_say_which(tmp_path: Path) -> None:
    given = recorder(tmp_path, frames=3)
    for index in range(3):
        given.add(index, IMAGE, np.zeros((3, 4, 6), np.float32))
        if index:
            given.add(index, FLIP, np.zeros((1, 4, 6), np.uint8))
    image, flip = given.entry()["layers"]
    assert (image["frames"], image["shown"], flip["frames"], flip["shown"]) == (None, "radiance", [1, 2], "flip")


def test_a_denoiser_that_fails_leaves_nothing_but_its_reason(tmp_path: Path) -> None:
    given = recorder(tmp_path, frames=2)
    record(given)
    given.drop("taa", "cannot go on")
    assert not list(given.folder.rglob("*.js"))
    assert given.entry()["notes"] == ["taa failed: cannot go on"]
    assert given.entry()["layers"] == []


def test_the_scale_is_the_largest_over_the_frames(tmp_path: Path) -> None:
    given = recorder(tmp_path, frames=3)
    for index, depth in enumerate((2.0, 8.0, 4.0)):
        given.add(index, Layer("channel", "depth", "depth"), np.full((1, 4, 6), depth, np.float32))
    assert given.entry()["layers"][0]["scale"] == 8


def test_names_of_folders_are_plain_and_differ() -> None:
    names = ["taa", "taa:alpha=0.2", "taa:alpha=0,2", "../../x", "a" * 300, "Ä", "ä", ""]
    slugs = [slug(name) for name in names]
    assert len(set(slugs)) == len(names)
    assert all(len(name) < 60 and set(name) <= set("_-") | set("".join(map(chr, range(48, 123)))) for name in slugs)
    assert not any("/" in name or "." in name for name in slugs)


def test_titles_replace_specifications(tmp_path: Path) -> None:
    given = recorder(tmp_path, frames=1)
    record(given)
    assert titled(given.entry(), {"taa": "ours"})["layers"][0]["of"] == "ours"


def record_kernels(given: Recorder, chosen: dict[int, int], size: int) -> list[int]:
    """Record kernels of 3×3 taps of every frame; size: what they are said to take, in bytes. Return what is on disk."""
    layer = Layer("kernel", "net", "kernel at 1/2", 2, ("α",))
    for index in range(given.frames):
        if index in chosen:
            given.centre(chosen[index])
        if given.keeps_kernels(index, "net", size):
            given.add(index, layer, np.full((10, 2, 3), index, np.float32))
        given.end_frame(index)
    given.end()
    return sorted(int(path.stem) for path in given.folder.glob("kernel_*/*.js"))


@pytest.mark.parametrize(
    ("span", "chosen", "kept"),
    [
        (None, {}, []),  # nothing is chosen
        (None, {0: 0}, [0, 1, 2]),
        (None, {1: 1, 2: 2, 8: 8}, [8, 9, 10]),  # those of a frame that was chosen before are gone
        (None, {18: 18}, [18, 19]),
        (4, {8: 8}, [8, 9]),  # the frames 6 to 9 are played
    ],
)
def test_kernels_are_kept_of_few_frames_from_the_chosen_one_on(
    tmp_path: Path, span: int | None, chosen: dict[int, int], kept: list[int]
) -> None:
    given = recorder(tmp_path, span=span, extras=True)
    assert record_kernels(given, chosen, KERNEL_BYTES // 3) == kept
    assert given.entry()["frames"] == kept
    assert given.notes == []


def test_kernels_start_with_the_range_that_is_shown(tmp_path: Path) -> None:
    assert record_kernels(recorder(tmp_path, extras=True, first=5), {1: 1}, KERNEL_BYTES // 2) == [5, 6]


def test_kernels_that_are_too_large_are_said_once(tmp_path: Path) -> None:
    given = recorder(tmp_path, extras=True)
    assert record_kernels(given, {1: 1}, 2 * KERNEL_BYTES) == []
    assert given.notes == ["The kernels of net are not kept: those of one frame take 512 MB, more than 256 MB."]


def test_kernels_are_described_by_their_taps(tmp_path: Path) -> None:
    given = recorder(tmp_path, frames=1, extras=True)
    record_kernels(given, {0: 0}, 1)
    (kernel,) = given.entry()["layers"]
    assert (kernel["group"], kernel["of"], kernel["channel"], kernel["shown"]) == (
        "kernel", "net", "kernel at 1/2", "kernel",
    )  # fmt: skip
    assert (kernel["every"], kernel["components"]) == (2, [*[""] * 9, "α"])
