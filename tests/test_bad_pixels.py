"""Every denoiser, whatever a renderer may write: finite light that is not negative, and no lasting damage."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from nte import Denoiser, Frame, load_denoiser
from nte.denoiser import Session
from nte.filters.named import NAMES
from nte.frames.channels import CHANNELS
from nte.runtime.export import export_onnx
from tests.everything import floor_frame
from tests.networks import small_network
from tests.shared import made_once

Pixels = npt.NDArray[np.float32]
SIZE, WHERE = (16, 20), (8, 10)  # 16: the least that a network of three levels takes
BEFORE, AFTER = (0, 8), 6  # frames with a bad pixel, and how many frames later the damage must be gone
LATER = 10  # the same of taa, whose mean is over the noise of fewer frames: the clean image itself is less certain
BRIGHTER = float((floor_frame(0, SIZE)["albedo"].max((2, 3)) / floor_frame(0, SIZE)["albedo"][:, :, *WHERE]).max())
nan, inf = float("nan"), float("inf")

RADIANCE = tuple(name for name, row in CHANNELS.items() if row.kind == "radiance")
VECTORS = tuple(name for name, row in CHANNELS.items() if row.kind in ("motion", "covariance"))
Channels = dict[str, Pixels]


def pixel(names: tuple[str, ...], value: float, component: int | None = None) -> Callable[[Channels], None]:
    """Write one pixel of channels (C, H, W), or one component of it."""

    def spoil(channels: Channels) -> None:
        for name in names:
            if name in channels:
                channels[name][(slice(None) if component is None else component), *WHERE] = value

    return spoil


def whole(names: tuple[str, ...], value: float) -> Callable[[Channels], None]:
    """Write whole channels."""

    def spoil(channels: Channels) -> None:
        for name in names:
            if name in channels:
                channels[name][:] = value

    return spoil


def all_nan(channels: Channels) -> None:
    for name, values in channels.items():
        if name != "time":
            values[:] = nan


def all_sky(channels: Channels) -> None:
    whole(("albedo", "normal", "depth", "shutter_depth", "roughness", "position"), 0)(channels)


# name → what it does to the channels of a frame
PIXELS = {f"color {value}": pixel(RADIANCE, value) for value in (nan, inf, -inf, -1, 1e30, 3e38, 1e19, 6e4)}
PIXELS["one component NaN"] = pixel(RADIANCE, nan, 1)
GUIDES = {
    f"{where.__name__} {name} {value}": where((name,), value)
    for where, values in ((pixel, (0.0, nan, -1.0, 3e38)), (whole, (0.0, nan)))
    for value in values
    for name in ("albedo", "normal", "depth")
}
MOVED = {
    f"{where.__name__} vectors {value}": where(VECTORS, value)
    for where, values in ((pixel, (nan, inf, 1e6, -3e38)), (whole, (nan, -3e38)))
    for value in values
}
LIGHT = {"all NaN": all_nan, "all black": whole(RADIANCE, 0.0), "color all NaN": whole(RADIANCE, nan)}
CASES: dict[str, Callable[[Channels], None]] = {
    "clean": lambda channels: None, **PIXELS, **GUIDES, **MOVED, **LIGHT,
    "all sky": all_sky,
}  # fmt: skip


USABLE_LIGHT = 6e4  # below any cap: a method that remembers may remember it
SPOT = f"color {USABLE_LIGHT}"
SEARCHED = ("estimate+taa:clamp=none", "align_accumulate")  # no vectors are given, and no clamp bounds history
NOTHING_SEEN = "color all NaN"
TAUGHT = ("all", "whole albedo", "color all")  # cases of frames that a denoiser has to take as they are, if dark


class Memory(NamedTuple):
    """How a method forgets."""

    alpha: Callable[[int], float]  # least weight of frame i, by its number
    replaces: bool  # a frame unlike the history takes its place: history is clamped to it, or found nowhere in it
    after: int = AFTER

    def left(self, start: int, pixel: bool) -> float:
        """Weight of frame `start` in the mean, `after` frames later.

        α (1 − α)^n of one frame, of a running mean 1/n; but where the frame took the place of the whole history,
        or was the first, (1 − α)^n.
        """
        kept = math.prod(1 - self.alpha(i) for i in range(start + 1, start + self.after + 1))
        return kept if start == 0 or (self.replaces and not pixel) else self.alpha(start) * kept


def mean_until(floor: float) -> Callable[[int], float]:
    """α of frame i: a running mean until `floor`."""
    return lambda i: max(1 / (i + 1), floor)


def tenth(frame: int) -> float:
    return 0.1


# In motion_blur a pixel has at least the weight of its own tap, 9/64 of the 5×5 kernel, and history ½.
BLUR = (9 / 64) / (9 / 64 + 1 / 2)
METHODS: Mapping[str, Memory | None] = {
    "noisy": None, "post_blur": None, "mcguire": None,
    "oidn:quality=fast": None, "oidn:quality=balanced": None, "oidn:quality=high": None,
    "taa:clamp=none": Memory(tenth, False, LATER), "taa": Memory(tenth, True, LATER),
    "taa:clamp=clip": Memory(tenth, True, LATER),
    "taa:target=components": Memory(tenth, True, LATER),
    "taa:target=components,clamp=none": Memory(tenth, False, LATER),
    "estimate+taa": Memory(tenth, True), "estimate+taa:clamp=none": Memory(tenth, True),
    "svgf": Memory(mean_until(0.05), False), "svgf:target=components": Memory(mean_until(0.05), False),
    "asvgf": Memory(mean_until(0.1), True),
    "trmv": Memory(mean_until(0.1), True), "trmv:indirect=colour": Memory(mean_until(0.1), True),
    "trmv:clamp=inf": Memory(mean_until(0.1), False),
    "align_taa": Memory(tenth, True), "align_taa:guides=true,tolerance=adaptive": Memory(tenth, True),
    "align_accumulate": Memory(mean_until(0.1), True),
    "align_accumulate:demodulate=true": Memory(mean_until(0.1), True),
    "motion_blur": Memory(lambda i: BLUR, True),
}  # fmt: skip
NETWORKS = ("network", "network.onnx")
FILLED = (  # methods in which the history stands in for a frame without light
    "taa", "taa:clamp=none", "taa:clamp=clip", "taa:target=components", "svgf", "svgf:target=components", "asvgf",
    "align_taa", "align_accumulate", "estimate+taa",
)  # fmt: skip


@pytest.fixture(scope="session")
def network_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def export(folder: Path) -> None:
        network = small_network(demodulate=True, feed_masks=True)
        export_onnx(network, folder / "network.onnx", progress=lambda line: None)

    return made_once(tmp_path_factory, "bad_pixels", export) / "network.onnx"


def make(spec: str, network_file: Path) -> Denoiser:
    if spec == "network":
        return small_network(demodulate=True, feed_masks=True)
    if "oidn" in spec:
        pytest.importorskip("pyoidn")
    return load_denoiser(str(network_file) if spec == "network.onnx" else spec)


def given(denoiser: Denoiser, index: int, start: int, cases: Sequence[str]) -> Frame:
    """Frame `index`, a batch element for each case, which happens in frame `start`."""
    names = (*denoiser.needs, *denoiser.optional)
    frame = floor_frame(index, SIZE, len(cases))
    if index == start:
        for number, case in enumerate(cases):
            CASES[case]({name: values[number] for name, values in frame.channels.items()})
    return Frame({name: frame[name] for name in names if name in frame}, index)


def run(denoiser: Denoiser, start: int, cases: Sequence[str], frames: Iterable[int]) -> dict[int, Pixels]:
    """The images (len(cases), 3, H, W) of `frames`."""
    session = Session(denoiser)
    return {i: session.denoise(given(denoiser, i, start, cases)) for i in frames}


def concerned(denoiser: Denoiser) -> list[str]:
    """The cases that change anything that the denoiser reads; the clean one first."""
    names = (*denoiser.needs, *denoiser.optional)

    def changes(case: str) -> bool:
        channels = {n: v[0] for n, v in floor_frame(0, SIZE).channels.items() if n in names}
        before = {n: v.copy() for n, v in channels.items()}
        CASES[case](channels)
        return any(not np.array_equal(v, before[n], equal_nan=True) for n, v in channels.items())

    return ["clean", *(case for case in CASES if changes(case))]


def network_memory(network_file: Path) -> Memory:
    """What the network's α leaves at the most: of each clean frame, the least α of any pixel."""
    network, state, alphas = make("network", network_file), None, []
    for i in range(BEFORE[-1] + AFTER + 1):
        result, state = network.step(given(network, i, 0, ["clean"]), state, ("alpha",))
        alphas.append(float(result.extras["alpha"].min()))
    return Memory(alphas.__getitem__, True)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("spec", [*METHODS, *NETWORKS])
def test_light_stays_finite_and_the_damage_does_not_last(spec: str, network_file: Path) -> None:
    denoiser = make(spec, network_file)
    memory = network_memory(network_file) if spec in NETWORKS else METHODS[spec]
    cases = concerned(denoiser)
    after = memory.after if memory else AFTER
    judged = sorted({i + more for i in BEFORE for more in (0, after)})
    alone = run(denoiser, 0, ["clean"], range(judged[-1] + 1) if memory else judged)
    wrong = {}
    for start in BEFORE:
        last = start + after
        # What remembers nothing need not see the rest.
        images = run(denoiser, start, cases, range(last + 1) if memory else (start, last))
        for i, seen in images.items():
            assert np.isfinite(seen).all(), f"frame {i}"
            assert seen.min() >= 0, f"frame {i}"
        image, expected = images[last], alone[last].mean()
        np.testing.assert_allclose(image[0], alone[last][0], rtol=1e-3, atol=1e-4)
        for number, case in enumerate(cases):
            if case == SPOT and spec.startswith(SEARCHED):
                # Vectors that were found may fetch one pixel twice; the weight in any of them is bounded.
                light = memory.left(start, True) * BRIGHTER * USABLE_LIGHT if memory else 0
                assert image[number].max() < 1.01 * alone[last].max() + light
                continue
            error = abs(float(image[number].mean() / expected) - 1)
            weight = 0 if case == NOTHING_SEEN and spec in FILLED else allowed(case, start, memory, denoiser, expected)
            if not error < 0.01 + weight:
                wrong[f"{case}, in frame {start}"] = error
        if start and spec in FILLED and denoiser.target == "color" and "components" not in spec:
            before, during = (images[i][cases.index(NOTHING_SEEN)].mean() for i in (start - 1, start))
            assert during > 0.8 * before
    assert not wrong


def allowed(case: str, start: int, memory: Memory | None, denoiser: Denoiser, mean: float) -> float:
    """Relative error of the mean beyond 1 %: the weight that is left, times the light that the frame brought."""
    if memory is None:
        return 0.0
    if case == SPOT:
        # Of the light components two are remembered. Light without texture may land on a brighter surface.
        noisy = sum(name in denoiser.needs for name in ("color", "glossy", "indirect", "indirect_radiance"))
        texture = BRIGHTER if "albedo" in denoiser.needs else 1
        return memory.left(start, True) * noisy * texture * USABLE_LIGHT / (SIZE[0] * SIZE[1] * mean)
    return memory.left(start, False) if case.startswith(TAUGHT) else 0.0


def test_every_denoiser_by_name_is_asked() -> None:
    assert {spec.removeprefix("estimate+").partition(":")[0] for spec in METHODS} == set(NAMES)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("spec", ["taa", "taa:clamp=clip", "taa:target=components", "align_taa"])
def test_bad_pixels_in_every_frame_do_not_darken_the_history_of_those_around(spec: str) -> None:
    """Three in ten, elsewhere in each frame: history is clamped to what the others show, and black is not shown."""
    frames = [floor_frame(index, (32, 44)) for index in range(16)]
    broken = []
    for frame in frames:
        bad = np.random.default_rng([frame.index, 9]).random((1, 1, *frame.size)) < 0.3
        noisy = {name: frame[name] for name in ("color", "glossy", "indirect", "visibility")}
        broken.append(frame.with_channels(**{n: np.where(bad, np.float32(nan), v) for n, v in noisy.items()}))
    whole, holed = (Session(load_denoiser(spec)) for _ in range(2))
    expected, found = ([s.denoise(f).mean() for f in fs][8:] for s, fs in ((whole, frames), (holed, broken)))
    assert np.mean(found) == pytest.approx(np.mean(expected), rel=0.03)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("scale", [1e-6, 1e5])
@pytest.mark.parametrize("spec", ["taa:clamp=none", "align_accumulate", "svgf", "oidn:quality=fast", "network"])
def test_what_is_too_bright_is_a_matter_of_exposure(spec: str, scale: float, network_file: Path) -> None:
    """Scenes in cd/m², or in units of a millionth: a lamp stays as it is, a fault is one."""
    denoiser = make(spec, network_file)
    frames = [floor_frame(i, SIZE, 3, scale) for i in range(2)]
    lamp = 2e3 * scale
    frames[1]["color"][1, :, 7:10, 9:12] = lamp
    frames[1]["color"][2, :, 8, 10] = 1e30
    session = Session(denoiser)
    images = [session.denoise(frame) for frame in frames][1]
    assert (images[1] - images[0]).mean() > 0.05 * lamp * 9 / (SIZE[0] * SIZE[1])
    assert images[2].mean() == pytest.approx(images[0].mean(), rel=0.02)
