"""Every denoiser, whatever a renderer may write: finite light that is not negative, and no lasting damage."""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from nte import Denoiser, Frame, load_denoiser, released
from nte.filters.composition import EACH, Composition
from nte.filters.named import NAMES, filter_type, parse
from nte.filters.prior import complete
from nte.frames.channels import CHANNELS
from nte.models.registry import KINDS
from nte.registry import parts_of
from nte.runtime.export import export_onnx
from nte.session import Session
from tests.conftest import Rounds
from tests.everything import floor_frame
from tests.models.lights import NETWORKS, light_network
from tests.networks import small_network
from tests.shared import made_once

Pixels = npt.NDArray[np.float32]
# 16: the least that a network of three levels takes. What is at WHERE is still in the picture AFTER frames.
SIZE, WHERE = (16, 20), (12, 3)
BEFORE, AFTER = (0, 8), 10  # frames with a bad pixel, and how many frames later the damage must be gone
BRIGHTER = float((floor_frame(0, SIZE)["albedo"].max((2, 3)) / floor_frame(0, SIZE)["albedo"][:, :, *WHERE]).max())
nan, inf = float("nan"), float("inf")

RADIANCE = tuple(name for name, row in CHANNELS.items() if row.kind == "radiance")
LIGHTS = (*RADIANCE, "visibility")
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
PIXELS = {f"color {value}": pixel(LIGHTS, value) for value in (nan, inf, -inf, -1, 1e30, 3e38, 1e19, 6e4)}
PIXELS["one component NaN"] = pixel(RADIANCE, nan, 1)
GUIDES = {
    f"{where.__name__} {name} {value}": where(names, value)
    for where, values in ((pixel, (0.0, nan, -1.0, 3e38)), (whole, (0.0, nan)))
    for value in values
    for name, names in (
        ("albedo", ("albedo", "diffuse_albedo")),
        ("normal", ("normal", "geometric_normal")),
        ("depth", ("depth", "shutter_depth")),
    )
}
MOVED = {
    f"{where.__name__} vectors {value}": where(VECTORS, value)
    for where in (pixel, whole)
    for value in (nan, inf, 1e6, -3e38)
}
SINGLE = (*PIXELS, *(name for name in (*GUIDES, *MOVED) if name.startswith("pixel")))
LIGHT = {"all NaN": all_nan, "all black": whole(RADIANCE, 0.0), "color all NaN": whole(LIGHTS, nan)}
CASES: dict[str, Callable[[Channels], None]] = {
    "clean": lambda channels: None, **PIXELS, **GUIDES, **MOVED, **LIGHT,
    "all sky": all_sky,
}  # fmt: skip


LEARNED = 0.3  # what a network with random weights may keep of a bad pixel: a rae does of its depth
USABLE_LIGHT = 6e4  # below any cap: a method that remembers may remember it
SPOT = f"color {USABLE_LIGHT}"
# No vectors are given, and no clamp bounds history.
SEARCHED = ("estimate+taa:clamp=none", "align_accumulate")
NOTHING_SEEN = "color all NaN"
TELLING = (  # one case of each kind
    "color nan", "color 3e+38", SPOT, "whole albedo 0.0", "whole normal nan", "pixel depth nan",
    "pixel vectors 1000000.0", "whole vectors nan", "whole vectors -3e+38", "all NaN", "all black", NOTHING_SEEN,
)  # fmt: skip
TAUGHT = ("all", "whole albedo", "color all")  # cases of frames that a denoiser has to take as they are, if dark


class Memory(NamedTuple):
    """How a method forgets."""

    alpha: Callable[[int], float]  # least weight of frame i, by its number
    replaces: bool  # a frame unlike the history takes its place: history is clamped to it, or found nowhere in it

    def left(self, start: int, pixel: bool) -> float:
        """Weight of frame `start` in the mean, AFTER frames later.

        α (1 − α)^n of one frame, of a running mean 1/n; but where the frame took the place of the whole history,
        or was the first, (1 − α)^n.
        """
        kept = math.prod(1 - self.alpha(i) for i in range(start + 1, start + AFTER + 1))
        return kept if start == 0 or (self.replaces and not pixel) else self.alpha(start) * kept


def mean_until(floor: float) -> Callable[[int], float]:
    """α of frame i: a running mean until `floor`."""
    return lambda i: max(1 / (i + 1), floor)


def always(alpha: float) -> Callable[[int], float]:
    return lambda i: alpha


# In motion_blur a pixel has at least the weight of its own tap, 9/64 of the 5×5 kernel, and history ½.
BLUR = (9 / 64) / (9 / 64 + 1 / 2)
# Every filter by its name: how its options make it forget; None: it remembers nothing.
MEMORIES: dict[str, Callable[[Any], Memory | None]] = {
    **dict.fromkeys(("noisy", "post_blur", "mcguire", "oidn"), lambda how: None),
    "taa": lambda how: Memory(always(how.alpha), how.clamp != "none"),
    "svgf": lambda how: Memory(mean_until(how.alpha), False),
    "asvgf": lambda how: Memory(mean_until(how.alpha), True),
    "trmv": lambda how: Memory(mean_until(how.alpha) if how.warm_up else always(how.alpha), how.clamp < inf),
    "align_taa": lambda how: Memory(always(how.alpha), True),
    "align_accumulate": lambda how: Memory(mean_until(how.alpha), True),
    "motion_blur": lambda how: Memory(always(BLUR), True),
}
MIXED = "composite:visibility=trmv,glossy=[taa:clamp=none,alpha=0.2],indirect=[align_accumulate:motion=geometric]"
OFTEN = (*NAMES, "taa:clamp=none", "estimate+taa", MIXED)
COMPONENTWISE = ("taa:target=components", "svgf:target=components", "asvgf:target=components")
RELEASED = tuple(released.names())
NEURAL = ("network", "network.onnx", *NETWORKS, *RELEASED)
NEURAL_OFTEN = ("network", "network.onnx", "mixing", "on top", "rae", "separated", *RELEASED)
FILLED = ("taa", "svgf", "asvgf", "align_taa", "align_accumulate")  # history stands in for a frame without light


def with_every_choice() -> list[str]:
    """Every filter with each choice of each option, and what else may stand around a filter."""
    specs = ["taa:target=components,clamp=none", "estimate+taa:clamp=none", "trmv:clamp=inf", "trmv:warm_up=false"]
    specs += ["align_taa:guides=true,tolerance=adaptive", "align_accumulate:demodulate=true"]
    for name in NAMES:
        options = filter_type(name).options_type
        for key in options.names():
            typed = [f"{name}:{key}={choice}" for choice in options.choices(key)]
            specs += [spec for spec in typed if options.parse(parse(spec, spec.partition(":")[2]), spec) != options()]
    return [spec for spec in specs if spec not in OFTEN]


def memories_of(spec: str) -> list[Memory]:
    """How the filters of a specification forget."""
    found = []
    for part in parts_of(spec):
        name, _, text = part.partition(":")
        given = {key: value for key, value in parse(part, text).items() if value != EACH}
        memory = MEMORIES[name](filter_type(part).options_type.parse(given, part))
        if memory and spec.startswith("estimate"):
            memory = memory._replace(replaces=True)
        found += [memory] if memory else []
    return found


def test_every_filter_and_every_kind_of_network_is_among_them() -> None:
    assert MEMORIES.keys() == NAMES.keys()
    assert set(TELLING) <= set(CASES)
    assert {kind for kind, _ in NETWORKS.values()} == KINDS.keys()


@pytest.fixture(scope="session")
def network_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def export(folder: Path) -> None:
        network = small_network(demodulate=True, feed_masks=True)
        export_onnx(network, folder / "network.onnx", progress=lambda line: None)

    return made_once(tmp_path_factory, "bad_pixels", export) / "network.onnx"


def make(spec: str, network_file: Path) -> Denoiser:
    if spec == "network":
        return small_network(demodulate=True, feed_masks=True)
    if spec in NETWORKS:
        return complete(light_network(spec))
    if "oidn" in spec or spec in RELEASED:
        pytest.importorskip("pyoidn")
    return load_denoiser(str(network_file) if spec == "network.onnx" else spec)


def given(denoiser: Denoiser, index: int, start: int, cases: Sequence[str]) -> Frame:
    """Frame `index`, a batch element for each case, which happens in frame `start`."""
    names = (*denoiser.needs, *denoiser.optional)
    frame = floor_frame(index, SIZE, len(cases))
    frame.channels["diffuse_albedo"] = np.float32(0.9) * frame["albedo"]
    frame.channels["geometric_normal"] = frame["normal"].copy()
    if index == start:
        for number, case in enumerate(cases):
            CASES[case]({name: values[number] for name, values in frame.channels.items()})
    return Frame({name: frame[name] for name in names if name in frame}, index)


def run(denoiser: Denoiser, start: int, cases: Sequence[str], frames: Iterable[int]) -> dict[int, Pixels]:
    """The images (len(cases), 3, H, W) of `frames`."""
    session = Session(denoiser)
    return {i: session.denoise(given(denoiser, i, start, cases)) for i in frames}


def concerned(denoiser: Denoiser, among: Iterable[str]) -> list[str]:
    """Those of the cases that change anything that the denoiser reads; the clean one first."""
    names = (*denoiser.needs, *denoiser.optional)

    def changes(case: str) -> bool:
        channels = {n: v[0] for n, v in floor_frame(0, SIZE).channels.items() if n in names}
        before = {n: v.copy() for n, v in channels.items()}
        CASES[case](channels)
        return any(not np.array_equal(v, before[n], equal_nan=True) for n, v in channels.items())

    return ["clean", *(case for case in among if changes(case))]


def network_memory(denoiser: Denoiser) -> Memory:
    """What the network's α leaves at the most: of each clean frame, the least α of any pixel.

    Networks without α forget a frame that was black, which a renderer may well give, as their weights will have it:
    those of these tests, which are random, keep less than two thirds from frame to frame.
    """
    if "alpha" not in denoiser.extras:
        return Memory(always(1 / 3), True)
    state, alphas = None, []
    for i in range(BEFORE[-1] + AFTER + 1):
        result, state = denoiser.step(given(denoiser, i, 0, ["clean"]), state, ("alpha",))
        alphas.append(float(result.extras["alpha"].min()))
    return Memory(alphas.__getitem__, True)


@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::nte.motion.correspondence.FewerLevelsWarning")
@pytest.mark.parametrize(
    ("spec", "start", "among"),
    [
        *((spec, BEFORE[1], TELLING) for spec in (*OFTEN, *NEURAL_OFTEN)),
        *(
            pytest.param(spec, start, tuple(CASES), marks=pytest.mark.slow)
            for spec in (*OFTEN, *COMPONENTWISE, *NEURAL)
            for start in BEFORE
        ),
        *(pytest.param(spec, BEFORE[1], TELLING, marks=pytest.mark.torture) for spec in with_every_choice()),
    ],
    ids=lambda value: {TELLING: "telling", tuple(CASES): "all"}[value] if isinstance(value, tuple) else None,
)
def test_light_stays_finite_and_the_damage_does_not_last(
    spec: str, start: int, among: tuple[str, ...], network_file: Path, rounds: Rounds
) -> None:
    denoiser = make(spec, network_file)
    memories = [network_memory(denoiser)] if spec in NEURAL else memories_of(spec)
    filled = spec.replace("estimate+", "").partition(":")[0] in FILLED
    last = start + AFTER
    # What remembers nothing need not see the rest.
    seen = range(last + 1) if memories else (start, last)
    cases = concerned(denoiser, among)
    rounds("bad frames", len(cases) - 1, len(cases) - 1)
    images = run(denoiser, start, cases, seen)
    for i, image in images.items():
        assert np.isfinite(image).all(), f"frame {i}"
        assert image.min() >= 0, f"frame {i}"
    image, alone = images[last], run(denoiser, start, ["clean"], seen)[last]
    np.testing.assert_allclose(image[0], alone[0], rtol=1e-3, atol=1e-4)
    wrong = {}
    for number, case in enumerate(cases):
        if case == SPOT and spec.startswith(SEARCHED):
            # Vectors that were found may fetch one pixel twice; the weight in any of them is bounded.
            weight = max(memory.left(start, True) for memory in memories)
            assert image[number].max() < 1.01 * alone.max() + weight * BRIGHTER * USABLE_LIGHT
            continue
        error = abs(float(image[number].mean() / alone.mean()) - 1)
        allowed = 0.0 if case == NOTHING_SEEN and filled else left_of(case, start, memories, denoiser, alone.mean())
        if "factor=share" in spec:
            allowed += 0.001  # its window of 15×15 pixels is most of these pictures
        if not error < 0.01 + allowed:
            wrong[case] = error, allowed
        # A mean does not see a single pixel, which may be black in all that is left of the first frame.
        worst = float(np.abs(image[number] - alone).max() / alone.mean())
        kept = max((memory.left(start, True) for memory in memories), default=0.0)
        bound = LEARNED if spec in NEURAL else 0.05 + kept
        if case in SINGLE and case != SPOT and not worst < bound:
            wrong[f"{case}, in one pixel"] = worst, bound
    assert not wrong
    if start and filled and denoiser.target == "color" and not isinstance(denoiser, Composition):
        before, during = (images[i][cases.index(NOTHING_SEEN)].mean() for i in (start - 1, start))
        assert during > 0.8 * before


def left_of(case: str, start: int, memories: Sequence[Memory], denoiser: Denoiser, mean: float) -> float:
    """Relative error of the mean beyond 1 %: the weight that is left, times the light that the frame brought."""
    if case == SPOT:
        # Of the light components two are remembered. Light without texture may land on a brighter surface.
        noisy = sum(name in denoiser.needs for name in ("color", "glossy", "indirect", "indirect_radiance"))
        texture = BRIGHTER if "albedo" in denoiser.needs else 1
        weight = max((memory.left(start, True) for memory in memories), default=0)
        copies = 9 if "alpha" in denoiser.extras else 1  # all pixels of a temporal kernel of 3×3 may fetch one
        return weight * noisy * texture * copies * USABLE_LIGHT / (SIZE[0] * SIZE[1] * mean)
    return max((memory.left(start, False) for memory in memories), default=0) if case.startswith(TAUGHT) else 0.0


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
