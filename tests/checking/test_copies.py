"""Further noise seeds and the second half of the reference are looked at: they are the same light with other noise."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport, check
from nte.errors import NteError
from nte.frames.clip import Clip, write_frame
from nte.frames.clip_files import frame_path
from tests.checking.test_late import SHOTS, noisy
from tests.synthetic import Pixels, write_clip

WRONG: dict[str, tuple[Callable[[Pixels], Pixels], str]] = {
    "black": (lambda x: 0 * x, "black everywhere"),
    "not finite": (lambda x: np.where(x > 1, np.nan, x), "not finite"),
    "another exposure": (lambda x: 3 * x, "times as bright"),
    "upside down": (lambda x: x[:, ::-1], "upside down"),
}
RIGHT: Callable[[Pixels], Pixels] = lambda x: x  # noqa: E731


def of_seeds(
    folder: Path, change: Callable[[Pixels], Pixels], seed: int = 100, noise: Callable[[Pixels, int], Pixels] = noisy
) -> CheckReport:
    shots = SHOTS[:4]
    path = write_clip(folder / "clip", [s | {"color": noise(s["color"], i)} for i, s in enumerate(shots)], seeds=2)
    (path / "seed_01").mkdir()
    for i, shot in enumerate(shots):
        color = np.ascontiguousarray(change(noise(shot["color"], seed + i)), np.float32)
        write_frame(frame_path(path, i, 1), {"color": color})
    return check(Clip(path))


def of_halves(
    folder: Path, change: Callable[[Pixels], Pixels], seed: int = 100, noise: Callable[[Pixels, int], Pixels] = noisy
) -> CheckReport:
    frames = []
    for i, shot in enumerate(SHOTS[:4]):
        light = shot["reference"]
        halves = noise(light, i), np.asarray(change(noise(light, seed + i)), np.float32)
        others = {n: v for n, v in shot.items() if n != "reference"}
        named = dict(zip(("reference_a", "reference_b"), halves, strict=True))
        frames.append(others | named | {"color": noisy(light, 50 + i)})
    return check(Clip(write_clip(folder / "clip", frames)))


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_seed_is_told(tmp_path: Path, name: str) -> None:
    change, told = WRONG[name]
    report = of_seeds(tmp_path, change)
    assert report.verdict == "implausible"
    assert any(f.channel == "color" and f.found.startswith("in seed 1: ") and told in f.found for f in report.findings)


@pytest.mark.parametrize("name", [name for name in WRONG if name != "not finite"])
def test_a_wrong_half_is_told(tmp_path: Path, name: str) -> None:
    change, told = WRONG[name]
    report = of_halves(tmp_path, change)
    assert report.verdict == "implausible"
    assert any(f.channel == "reference_b" and told in f.found for f in report.findings)


@pytest.mark.parametrize("of", [of_seeds, of_halves])
def test_a_copy_has_no_noise_of_its_own(tmp_path: Path, of: Callable[..., CheckReport]) -> None:
    report = of(tmp_path, RIGHT, seed=0)
    assert report.verdict == "implausible"
    assert "is the same image as" in report.reason


@pytest.mark.parametrize("of", [of_seeds, of_halves])
def test_nothing_is_said_of_other_noise(tmp_path: Path, of: Callable[..., CheckReport]) -> None:
    report = of(tmp_path, RIGHT)
    assert report.verdict == "plausible"
    assert not [f for f in report.findings if f.channel in ("color", "reference", "reference_b")]


def splatted(light: Pixels, seed: int) -> Pixels:
    """Noise of samples that count in the pixels around theirs as well, as with a Gaussian filter."""
    image = noisy(light, seed) * np.random.default_rng(1000 + seed).exponential(size=light.shape[1:])
    for axis in (1, 2):
        image = 0.2 * np.roll(image, -1, axis) + 0.6 * image + 0.2 * np.roll(image, 1, axis)
    return image.astype(np.float32)


@pytest.mark.parametrize("of", [of_seeds, of_halves])
def test_noise_that_neighbours_share_is_no_curve(tmp_path: Path, of: Callable[..., CheckReport]) -> None:
    report = of(tmp_path, RIGHT, noise=splatted)
    assert not [f for f in report.findings if f.found.startswith("in seed") or f.channel == "reference_b"]


def curve(light: Pixels) -> Pixels:
    return light / (1 + light)


@pytest.mark.parametrize("of", [of_seeds, of_halves])
def test_a_curve_is_told(tmp_path: Path, of: Callable[..., CheckReport]) -> None:
    report = of(tmp_path, curve)
    assert any("is no multiple of" in f.found for f in report.findings)


def test_the_file_of_the_seed_that_lacks_a_channel_is_named(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "clip", SHOTS[:2], seeds=2)
    (path / "seed_01").mkdir()
    for i in range(2):
        write_frame(frame_path(path, i, 1), {"albedo": SHOTS[i]["albedo"]})
    with pytest.raises(NteError, match=r"seed_01/frame_0000\.exr: channel 'color' is missing; the file has albedo"):
        check(Clip(path))


def test_a_seed_of_another_size_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NteError, match=r"seed_01/frame_0000\.exr"):
        of_seeds(tmp_path, lambda x: x[:, :20])


MOVED: dict[str, tuple[Callable[[int], Pixels], str]] = {
    "another place": (lambda i: np.roll(SHOTS[i]["color"], (6, -8), (1, 2)), "about 8 px to the right and 6 px above"),
    "the frame before": (lambda i: SHOTS[i - 1]["color"], "one frame earlier"),
    "the next frame": (lambda i: SHOTS[i + 1]["color"], "one frame later"),
    "its own": (lambda i: SHOTS[i]["color"], ""),
}


@pytest.mark.parametrize("name", MOVED)
def test_a_seed_or_half_of_another_place_or_frame_is_told(tmp_path: Path, name: str) -> None:
    """Its noise hides edges, but the reference, and many samples, have less of it."""
    shown, words = MOVED[name]
    seeds, halves = (write_clip(tmp_path / of, frames(of == "halves", shown), seeds=2 - (of == "halves")) for of in OF)
    (seeds / "seed_01").mkdir()
    for i in range(1, 6):
        write_frame(frame_path(seeds, i - 1, 1), {"color": noisy(shown(i), 90 + i)})
    for path, channel, start in ((seeds, "color", "in seed 1: shows what reference"), (halves, "reference_b", "shows")):
        report = check(Clip(path))
        found = [f.found for f in report.findings if f.channel == channel]
        assert len(found) == bool(words)
        assert all(what.startswith(start) and words in what for what in found)
        assert report.verdict == ("implausible" if words else "plausible")


OF = ("seeds", "halves")


def frames(halves: bool, shown: Callable[[int], Pixels]) -> list[dict[str, Pixels]]:
    found = []
    for i in range(1, 6):
        shot = SHOTS[i] | {"color": noisy(SHOTS[i]["color"], i)}
        if halves:
            drawn = [np.random.default_rng(50 * k + i).gamma(64, 1 / 64, (1, 64, 96)) for k in range(2)]
            pair = SHOTS[i]["color"] * drawn[0], shown(i) * drawn[1]
            shot |= {f"reference_{k}": image.astype(np.float32) for k, image in zip("ab", pair, strict=True)}
            del shot["reference"]
        found.append(shot)
    return found
