"""Every denoiser, whatever a renderer may write: finite light that is not negative, and no lasting damage."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from nte import Denoiser, Frame, load_denoiser
from nte.denoiser import Session
from nte.frames.channels import CHANNELS
from nte.runtime.export import export_onnx
from tests.everything import floor_frame
from tests.networks import small_network

Pixels = npt.NDArray[np.float32]
SIZE, WHERE = (24, 36), (11, 17)
BEFORE, AFTER = (0, 8), 10  # frames with a bad pixel, and how many frames later the damage must be gone
FRAMES = BEFORE[-1] + AFTER + 1
TEXTURE = 4.0  # largest albedo over that of the bad pixel: light without texture may land on a brighter surface
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


# name → what it does to a frame, and the light that it adds to one pixel as a usable value (or whole frames: None)
PIXELS = {f"color {value}": (pixel(RADIANCE, value), value) for value in (nan, inf, -inf, -1, 1e30, 3e38, 1e19, 6e4)}
PIXELS["one component NaN"] = pixel(RADIANCE, nan, 1), nan
GUIDES = {
    f"{where.__name__} {name} {value}": where((name,), value)
    for name in ("albedo", "normal", "depth") for value in (0.0, nan, -1.0, 3e38) for where in (pixel, whole)
}  # fmt: skip
MOVED = {
    f"{where.__name__} vectors {value}": where(VECTORS, value)
    for value in (nan, inf, 1e6, -3e38) for where in (pixel, whole)
}  # fmt: skip
LIGHT = {"all NaN": all_nan, "all black": whole(RADIANCE, 0.0), "color all NaN": whole(RADIANCE, nan)}
CASES: dict[str, Callable[[Channels], None]] = {
    "clean": lambda channels: None, **{name: spoil for name, (spoil, _) in PIXELS.items()}, **GUIDES, **MOVED, **LIGHT,
    "all sky": all_sky,
}  # fmt: skip


def running(floor: float) -> Callable[[int], float]:
    """α of frame i: a running mean until `floor`."""
    return lambda i: max(1 / (i + 1), floor)


# spec → α of the current frame, by frame number; None: the method has no memory
METHODS: Mapping[str, Callable[[int], float] | None] = {
    "noisy": None, "post_blur": None, "mcguire": None,
    "oidn:quality=fast": None, "oidn:quality=balanced": None, "oidn:quality=high": None,
    "taa:clamp=none": lambda i: 0.1, "taa": lambda i: 0.1, "taa:clamp=clip": lambda i: 0.1,
    "estimate+taa": lambda i: 0.1, "estimate+taa:clamp=none": lambda i: 0.1,
    "svgf": running(0.05), "asvgf": running(0.1),
    "svgf:target=components": running(0.05), "taa:target=components,clamp=none": lambda i: 0.1,
    "trmv": running(0.1), "trmv:indirect=colour": running(0.1), "trmv:clamp=inf": running(0.1),
    "align_taa": lambda i: 0.1, "align_accumulate": running(0.1),
    "align_taa:guides=true,tolerance=adaptive": lambda i: 0.1, "align_accumulate:demodulate=true": running(0.1),
    "motion_blur": lambda i: 2 / 3,
    "network": lambda i: 0.5, "network.onnx": lambda i: 0.5,
}  # fmt: skip


@pytest.fixture(scope="session")
def network_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "network.onnx"
    export_onnx(small_network(demodulate=True, feed_masks=True), path, progress=lambda line: None)
    return path


def make(spec: str, network_file: Path) -> Denoiser:
    if spec == "network":
        return small_network(demodulate=True, feed_masks=True)
    if "oidn" in spec:
        pytest.importorskip("pyoidn")
    return load_denoiser(str(network_file) if spec == "network.onnx" else spec)


def spoilt(index: int) -> Frame:
    """Frame `index`: a batch element for each case in frame 0, then one for each in frame 8."""
    frame = floor_frame(index, SIZE, len(CASES) * len(BEFORE))
    if index in BEFORE:
        first = BEFORE.index(index) * len(CASES)
        for number, spoil in enumerate(CASES.values(), first):
            spoil({name: values[number] for name, values in frame.channels.items()})
    return frame


def run(denoiser: Denoiser) -> list[Pixels]:
    names = (*denoiser.needs, *denoiser.optional)
    session = Session(denoiser)
    frames = (spoilt(i) for i in range(FRAMES))
    kept = (Frame({name: f[name] for name in names if name in f}, f.index) for f in frames)
    return [session.denoise(frame) for frame in kept]
