"""Open Image Denoise as a denoiser of ours: it denoises, keeps our conventions and says what is wrong."""

import sys
from collections.abc import Callable

import numpy as np
import pytest
import torch

from nte import Denoiser, Frame, NteError
from nte.filters.oidn import Oidn, OidnOptions
from nte.registry import load_denoiser

pyoidn = pytest.importorskip("pyoidn")


def noisy_gradient(height: int = 45, width: int = 61, batch: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(noisy, clean), each (N, 3, H, W): a ramp of light, and the same with exponential noise."""
    ramp = np.linspace(0.2, 2, width, dtype=np.float32)
    clean = np.broadcast_to(ramp, (batch, 3, height, width)).copy()
    noise = np.random.default_rng(0).exponential(size=clean.shape).astype(np.float32)
    return clean * noise, clean


def denoise(denoiser: Denoiser, clean_guides: bool | None = True, **channels: np.ndarray) -> np.ndarray:
    result, _ = denoiser.step(Frame(channels, clean_guides=clean_guides), None)
    assert isinstance(result.image, np.ndarray)
    return result.image


@pytest.mark.parametrize("quality", OidnOptions.choices("quality"))
def test_it_removes_most_of_the_noise(quality: str) -> None:
    noisy, clean = noisy_gradient()
    image = denoise(Oidn(OidnOptions(quality)), color=noisy)
    assert image.shape == noisy.shape
    assert image.dtype == np.float32
    assert np.square(image - clean).mean() < 0.1 * np.square(noisy - clean).mean()


def test_a_component_is_denoised_like_any_radiance() -> None:
    noisy, _ = noisy_gradient()
    oidn = load_denoiser("oidn:quality=fast,target=indirect")
    assert (oidn.needs, oidn.target) == (("indirect",), "indirect")
    image = denoise(oidn, indirect=noisy, color=5 * noisy)
    np.testing.assert_array_equal(image, denoise(Oidn(OidnOptions("fast")), color=noisy))


@pytest.mark.parametrize("size", [(7, 13), (33, 20), (65, 97)])
def test_a_constant_stays_constant_at_odd_sizes(size: tuple[int, int]) -> None:
    image = denoise(Oidn(), color=np.full((1, 3, *size), 3.0, np.float32))
    assert image.shape == (1, 3, *size)
    # OIDN itself errs by up to a fifth in the outermost pixels; the image as a whole keeps its light
    assert abs(image.mean() / 3 - 1) < 0.01
    assert np.median(np.abs(image / 3 - 1)) < 0.02


def textured(height: int = 45, width: int = 61) -> dict[str, np.ndarray]:
    """A slanted, coloured texture under exponential noise: color, reference, albedo, normal, each (1, 3, H, W)."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:height, :width] + 0.5
    tile = ((0.9 * x + 0.4 * y) // 6).astype(int) % 7, ((0.9 * y - 0.4 * x) // 6).astype(int) % 7
    texture = rng.uniform(0.1, 0.9, (7, 7, 3))[tile].transpose(2, 0, 1)[None].astype(np.float32)
    up = np.zeros_like(texture)
    up[:, 2] = 1
    noise = rng.exponential(size=(1, 1, height, width)).astype(np.float32)
    return {"color": texture * noise, "reference": texture, "albedo": texture, "normal": up}


def with_noisy_guides(kind: str) -> dict[str, np.ndarray]:
    """Guides of one sample per pixel: with noise in every pixel, or aliased: the texture of a place nearby."""
    channels, rng = textured(), np.random.default_rng(2)
    if kind == "aliased":
        rows, columns = np.mgrid[:45, :61] + rng.integers(-1, 2, (2, 45, 61))
        at = (..., rows.clip(0, 44), columns.clip(0, 60))
        return {**channels, "albedo": channels["albedo"][at].copy(), "normal": channels["normal"]}
    noise = rng.normal(scale=0.3, size=(2, *channels["albedo"].shape)).astype(np.float32)
    normal = channels["normal"] + noise[1]
    return {**channels, "albedo": (channels["albedo"] + noise[0]).clip(0, 1), "normal": normal / np.abs(normal).max()}


def as_image(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array[0].transpose(1, 2, 0))


def prefiltered(name: str, guide: np.ndarray) -> np.ndarray:
    """A guide (H, W, 3) denoised by a filter that has nothing else, as OIDN's documentation shows it."""
    output = np.empty_like(guide)
    with pyoidn.Device() as device:
        device.commit()
        with pyoidn.Filter(device, pyoidn.OIDN_FILTER_TYPE_RT) as chosen:
            chosen.set_image(name, guide, pyoidn.OIDN_FORMAT_FLOAT3)
            chosen.set_image("output", output, pyoidn.OIDN_FORMAT_FLOAT3)
            chosen.commit()
            chosen.execute()
        assert device.get_error() is None
    return output


def mse(image: np.ndarray, channels: dict[str, np.ndarray]) -> float:
    return float(np.square(image - channels["reference"]).mean())


def seen(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: channels[name] for name in ("color", "albedo", "normal")}


def test_clean_guides_are_trusted() -> None:
    channels = textured()
    image = denoise(Oidn(), **seen(channels))
    assert mse(image, channels) < 0.5 * mse(denoise(Oidn(), color=channels["color"]), channels)
    as_images = [as_image(channels[name]) for name in ("color", "albedo", "normal")]
    theirs = pyoidn.denoise(*as_images, hdr=True, clean_aux=True, quality="high")
    np.testing.assert_array_equal(as_image(image), theirs)
    assert not np.array_equal(theirs, pyoidn.denoise(*as_images, hdr=True, clean_aux=False, quality="high"))


@pytest.mark.parametrize("said", [None, False])
@pytest.mark.parametrize("kind", ["noisy", "aliased"])
def test_guides_that_nobody_calls_clean_are_prefiltered_as_oidn_recommends(kind: str, said: bool | None) -> None:
    channels = with_noisy_guides(kind)
    image = denoise(Oidn(), said, **seen(channels))
    guides = (prefiltered(name, as_image(channels[name])) for name in ("albedo", "normal"))
    theirs = pyoidn.denoise(as_image(channels["color"]), *guides, hdr=True, clean_aux=True, quality="high")
    np.testing.assert_array_equal(as_image(image), theirs)
    trusting = denoise(Oidn(OidnOptions(clean_aux=True)), said, **seen(channels))
    assert mse(image, channels) < mse(trusting, channels)


def test_options_win_over_what_is_known_of_the_guides() -> None:
    channels = seen(with_noisy_guides("noisy"))
    both, neither, trusted = (
        Oidn(OidnOptions("fast", *options)) for options in ((None, True), (False, None), (True, False))
    )
    as_images = [as_image(channels[name]) for name in ("color", "albedo", "normal")]
    for made in (both, neither, trusted):
        np.testing.assert_array_equal(denoise(made, None, **channels), denoise(made, True, **channels))
    for made, clean_aux in ((neither, False), (trusted, True)):
        theirs = pyoidn.denoise(*as_images, hdr=True, clean_aux=clean_aux, quality="fast")
        np.testing.assert_array_equal(as_image(denoise(made, **channels)), theirs)
    assert not np.array_equal(denoise(both, **channels), denoise(trusted, **channels))


def test_one_guide_alone_and_batches_are_prefiltered_too() -> None:
    channels = with_noisy_guides("noisy")
    alone = denoise(Oidn(OidnOptions("fast")), None, color=channels["color"], albedo=channels["albedo"])
    flipped = {name: np.concatenate([values, values[..., ::-1]]) for name, values in channels.items()}
    oidn = Oidn(OidnOptions("fast"))
    both = denoise(oidn, None, color=flipped["color"], albedo=flipped["albedo"])
    np.testing.assert_array_equal(both[:1], alone)
    small = {name: flipped[name][..., :20, :30] for name in ("color", "albedo")}
    assert denoise(oidn, None, **small).shape == (2, 3, 20, 30)


@pytest.mark.parametrize(
    ("spec", "said", "settings"),
    [
        ("oidn", True, "quality=high,clean_aux=true,prefilter=false"),
        ("oidn", None, "quality=high,clean_aux=true,prefilter=true"),
        ("oidn:quality=fast,prefilter=false", False, "quality=fast,clean_aux=false,prefilter=false"),
        ("oidn:clean_aux=True", None, "quality=high,clean_aux=true,prefilter=false"),
        ("oidn:clean_aux=true,prefilter=true", True, "quality=high,clean_aux=true,prefilter=true"),
        ("oidn:clean_aux=false", True, "quality=high,clean_aux=false,prefilter=false"),
    ],
)
def test_it_says_what_its_options_come_to(spec: str, said: bool | None, settings: str) -> None:
    oidn = load_denoiser(spec)
    assert isinstance(oidn, Oidn)
    channels = seen(textured())
    assert oidn.settings(Frame(channels, clean_guides=said)) == settings
    assert oidn.settings(Frame({"color": channels["color"]})).endswith(", without guides")


def test_batch_elements_are_independent_and_sizes_may_change() -> None:
    oidn = Oidn(OidnOptions("fast"))
    noisy, _ = noisy_gradient(batch=2)
    both = denoise(oidn, color=noisy)
    assert denoise(oidn, color=noisy[:, :, :20, :30]).shape == (2, 3, 20, 30)
    np.testing.assert_array_equal(both[1:], denoise(oidn, color=noisy[1:]))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_bad_pixels_count_as_black_and_do_not_spread(bad: float) -> None:
    noisy, _ = noisy_gradient()
    black = noisy.copy()
    black[..., 20, 30] = 0
    given = black.copy()
    given[..., 20, 30] = bad
    image = denoise(Oidn(OidnOptions("fast")), color=given)
    np.testing.assert_array_equal(image, denoise(Oidn(OidnOptions("fast")), color=black))
    assert given[0, 0, 20, 30] == bad or np.isnan(bad)  # the input is left as it was


def test_torch_in_torch_out() -> None:
    noisy, _ = noisy_gradient()
    result, _ = Oidn(OidnOptions("fast")).step(Frame({"color": torch.from_numpy(noisy)}), None)
    assert isinstance(result.image, torch.Tensor)
    np.testing.assert_array_equal(result.image.numpy(), denoise(Oidn(OidnOptions("fast")), color=noisy))


def raises(message: str, call: Callable[[], object]) -> None:
    with pytest.raises(NteError, match=message):
        call()


def test_an_unknown_quality_names_the_choices() -> None:
    raises("quality is 'best', expected one of high, balanced, fast", lambda: Oidn(OidnOptions("best")))


@pytest.mark.parametrize("key", ["clean_aux", "prefilter"])
def test_a_switch_that_is_none_names_the_choices(key: str) -> None:
    raises(f"{key} is 'yes', expected one of auto, true, false", lambda: load_denoiser(f"oidn:{key}=yes"))


def test_a_missing_pyoidn_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    raises(r"pip install 'nte-denoiser\[oidn\]'", Oidn)


@pytest.mark.parametrize("quality", OidnOptions.choices("quality"))
@pytest.mark.parametrize("bright", [65000.0, 1e10, 1e20])
def test_one_bright_pixel_stays_where_it_is(quality: str, bright: float) -> None:
    noisy, _ = noisy_gradient(64, 160)
    spoilt = noisy.copy()
    spoilt[..., 32, 20] = bright
    image, expected = (
        denoise(Oidn(OidnOptions(quality)), color=spoilt),
        denoise(Oidn(OidnOptions(quality)), color=noisy),
    )
    assert image[..., 110:].mean() == pytest.approx(expected[..., 110:].mean(), rel=0.02)


def test_normals_without_albedo_are_left_out() -> None:
    """OIDN has no network for colour and normals alone."""
    noisy, _ = noisy_gradient()
    normal = np.zeros_like(noisy)
    normal[:, 2] = 1
    np.testing.assert_array_equal(denoise(Oidn(), color=noisy, normal=normal), denoise(Oidn(), color=noisy))


def test_a_library_that_fails_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """The package is imported without its library, which is loaded for the first image."""

    def fails(*_: object, **__: object) -> None:
        raise OSError("cannot load library 'libOpenImageDenoise.so':\n version `GLIBC_2.99' not found")

    monkeypatch.setattr(pyoidn, "denoise", fails)
    noisy, _ = noisy_gradient()
    with pytest.raises(NteError, match=r"^Open Image Denoise fails: cannot load .* not found: install") as error:
        denoise(Oidn(), color=noisy)
    assert "\n" not in str(error.value)
