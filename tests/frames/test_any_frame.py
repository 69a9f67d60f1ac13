"""Whatever a frame holds, it comes back from its file as the table of channels promises."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nte.frames.channels import CHANNELS
from nte.frames.clip import read_frame, write_frame

HALVES = ("reference_a", "reference_b")  # from which a reference is made as they are read: test_clip
STORED = sorted(name for name, row in CHANNELS.items() if row.storage != "derived" and name not in HALVES)


def values_of(name: str, size: tuple[int, int], scale: float, rng: np.random.Generator) -> np.ndarray:
    """Values of the channel's kind: radiance and lengths of any unit, the rest in its range."""
    kind, shape = CHANNELS[name].kind, (len(CHANNELS[name].components), *size)
    if kind == "radiance":
        return scale * rng.exponential(size=shape)
    if kind in ("reflectance", "scalar"):
        return rng.random(shape)
    if kind == "direction":
        return rng.uniform(-1, 1, shape)
    if kind == "id":
        return rng.integers(0, 1 << 24, shape).astype(float)
    return scale * rng.normal(size=shape)


@settings(max_examples=60)
@given(
    st.lists(st.sampled_from(STORED), min_size=1, unique=True),
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.integers(-6, 6),
    st.booleans(),
    st.integers(0, 10_000),
)
def test_any_channels_of_any_size_survive(
    tmp_path_factory: pytest.TempPathFactory,
    names: list[str],
    size: tuple[int, int],
    exponent: int,
    holes: bool,
    seed: int,
) -> None:
    rng, path = np.random.default_rng(seed), tmp_path_factory.getbasetemp() / "any.exr"
    channels = {name: values_of(name, size, 10.0**exponent, rng).astype(np.float32) for name in names}
    for name, values in channels.items():
        if holes and CHANNELS[name].nan_means:
            values[:, rng.random(size) < 0.3] = np.nan
    write_frame(path, channels)
    read = read_frame(path)
    assert set(read) == set(names)
    for name, values in channels.items():
        assert read[name].dtype == np.float32
        if CHANNELS[name].storage == "float":
            np.testing.assert_array_equal(read[name], values, err_msg=name)
        else:  # of radiance: a thousandth, or a millionth of the frame's mean
            least = 1e-6 * (10.0**exponent if CHANNELS[name].kind == "radiance" else 1)
            np.testing.assert_allclose(read[name], values, rtol=1e-3, atol=least, err_msg=name)
