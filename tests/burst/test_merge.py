"""Merging synthetic bursts whose shifts and noise are known."""

import pytest
import torch

from nte.burst.defects import find_defects, mend
from nte.burst.merge import Merged, merge_burst
from nte.burst.noise import NoiseModel, fit_noise
from nte.errors import NteError
from tests.burst.scenes import NOISE, PATTERNS, mosaic_of, psnr, scene, sense

SIZE = 240, 320
PERIODS = [(0, 0), (12, -6), (-18, 6), (24, 12), (-6, -12), (6, 18)]  # whole periods of both arrays
PARTS = [(0, 0), (1.3, -0.7), (3.9, 2.4), (-2.6, 5.5), (-7.3, -3.1), (9.45, 4.2)]
KINDS = [*PATTERNS, "rgb"]


def merged(
    kind: str, shifts: list[tuple[float, float]], disc: bool = False
) -> tuple[Merged, torch.Tensor, torch.Tensor]:
    """What was merged with a fitted model, the noisy reference and the clean one."""
    mosaic = None if kind == "rgb" else mosaic_of(kind)
    clean = [scene(SIZE, shift, (100 + 9 * i, 120) if disc else None) for i, shift in enumerate(shifts)]
    frames = [sense(image, mosaic, NOISE, seed) for seed, image in enumerate(clean)]
    done = merge_burst(frames[0], frames[1:], fit_noise(frames[0], frames[1], mosaic), mosaic)
    return done, frames[0], sense(clean[0], mosaic, None, 0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("shifts", "least"), [([(0.0, 0.0)] * 6, 7.2), (PERIODS, 7.0), (PARTS, 6.0)], ids=["still", "periods", "parts"]
)
def test_six_frames_gain_nearly_what_six_frames_can(kind: str, shifts: list[tuple[float, float]], least: float) -> None:
    """10·log₁₀ 6 = 7.8 dB; bilinear fetching, which mixes pixels, may gain more. Parts of a pixel cost some."""
    done, noisy, clean = merged(kind, shifts)
    assert psnr(done.image, clean, margin=32) - psnr(noisy, clean, margin=32) > least
    for frame, shift in zip(done.frames, shifts[1:], strict=True):
        assert frame.motion == pytest.approx(shift, abs=0.3)
        assert frame.share > 0.7


@pytest.mark.parametrize("kind", KINDS)
def test_what_moves_by_itself_leaves_no_ghost(kind: str) -> None:
    """Around the disc and everywhere it has been, the mean is nowhere worse than the reference alone."""
    done, noisy, clean = merged(kind, PARTS, disc=True)
    where = (..., slice(104, 136), slice(84, 164))
    error, alone = ((image - clean)[where].square() for image in (done.image, noisy))
    assert error.mean() < 0.75 * alone.mean()
    local, local_alone = (torch.nn.functional.avg_pool2d(e.mean(1, keepdim=True), 8) for e in (error, alone))
    assert (local < 1.5 * local_alone).all()


def test_a_bright_thing_that_moves_by_itself_does_not_lead_the_search() -> None:
    """The phase correlation's highest peak is that of the disc here, and most of the picture moves otherwise."""
    shifts = [(0, 0), (-18, 14), (-16, 12)]
    frames = [scene((480, 640), s, (320 + 27 * i, 240), 24.0).mean(1, True) for i, s in enumerate(shifts)]
    done = merge_burst(frames[0], frames[1:], NOISE)
    for frame, shift in zip(done.frames, shifts[1:], strict=True):
        assert frame.motion == pytest.approx(shift, abs=0.1)


def test_without_weights_the_disc_would_be_a_ghost() -> None:
    """The scene is a hard one: with a model of huge noise everything fits, and the error is worse than alone."""
    mosaic = mosaic_of("bayer")
    clean = [scene(SIZE, (0, 0), (60 + 45 * i, 120)) for i in range(6)]
    frames = [sense(image, mosaic, NOISE, seed) for seed, image in enumerate(clean)]
    where = (..., slice(104, 136), slice(44, 76))
    truth = sense(clean[0], mosaic, None, 0)
    errors = [
        (merge_burst(frames[0], frames[1:], noise, mosaic).image - truth)[where].square().mean()
        for noise in (NOISE, NoiseModel(10.0, 10.0))
    ]
    alone = (frames[0] - truth)[where].square().mean()
    assert errors[0] < 1.05 * alone < 0.3 * errors[1]


@pytest.mark.parametrize("kind", KINDS)
def test_a_constant_stays_constant(kind: str) -> None:
    mosaic = None if kind == "rgb" else mosaic_of(kind)
    colour = torch.tensor([0.2, 0.4, 0.7]).view(1, 3, 1, 1).expand(1, 3, 96, 102)
    frame = sense(colour, mosaic, None, 0)
    done = merge_burst(frame, [frame, frame], NOISE, mosaic)
    torch.testing.assert_close(done.image, frame)
    assert all(weight.motion == pytest.approx((0, 0), abs=1e-3) for weight in done.frames)


def test_another_picture_is_not_used() -> None:
    mosaic = mosaic_of("bayer")
    frame, other = (sense(scene(SIZE) if i == 0 else 1 - scene(SIZE), mosaic, NOISE, i) for i in range(2))
    done = merge_burst(frame, [other], NOISE, mosaic)
    assert done.frames[0].share < 0.2
    truth = sense(scene(SIZE), mosaic, None, 0)
    assert psnr(done.image, truth) > psnr(frame, truth) - 0.1


def test_frames_of_another_size_are_refused() -> None:
    with pytest.raises(NteError, match="frame 1 is"):
        merge_burst(torch.zeros(1, 1, 64, 64), [torch.zeros(1, 1, 64, 66)], NOISE, mosaic_of("bayer"))


def hot(frames: list[torch.Tensor]) -> tuple[list[torch.Tensor], torch.Tensor]:
    """The frames with the same hot and dead pixels of the sensor, and where they are, (1, 1, H, W) bool."""
    generator = torch.Generator().manual_seed(3)
    number = torch.rand(frames[0].shape, generator=generator)
    bright, dead = number < 5e-4, number > 1 - 2e-4
    return [frame.masked_fill(bright, 0.98).masked_fill(dead, -0.02) for frame in frames], bright | dead


@pytest.mark.parametrize("kind", PATTERNS)
def test_hot_and_dead_pixels_are_found_filled_and_in_nobodys_way(kind: str) -> None:
    """As good as a burst of a sound sensor, in the defects' places and around them."""
    mosaic = mosaic_of(kind)
    clean = [scene(SIZE, shift) for shift in PARTS]
    sound = [sense(image, mosaic, NOISE, seed) for seed, image in enumerate(clean)]
    frames, places = hot(sound)
    truth = sense(clean[0], mosaic, None, 0)
    found = find_defects(frames[0], frames[1], NOISE, mosaic)
    seen = places & ((frames[0] - truth).abs() > 0.5)  # what hardly differs from what belongs there does no harm
    assert (found & seen).sum() > 0.9 * seen.sum()
    assert (found & ~places).sum() <= 2
    done = merge_burst(frames[0], frames[1:], NOISE, mosaic, defects=found)
    without = merge_burst(sound[0], sound[1:], NOISE, mosaic)
    kept = merge_burst(frames[0], frames[1:], NOISE, mosaic)
    inner = torch.zeros_like(found)
    inner[..., 16:-16, 16:-16] = True
    around = (torch.nn.functional.max_pool2d(seen.float(), 7, 1, 3) > 0) & inner
    errors = [float((one.image - truth)[around].square().mean()) for one in (done, without, kept)]
    assert errors[0] < 1.5 * errors[1]
    assert errors[2] > 5 * errors[0]
    assert float(done.weight[around & ~seen].mean()) > 0.9 * float(without.weight[around & ~seen].mean())


@pytest.mark.parametrize("kind", [*PATTERNS, None])
def test_defects_are_not_fetched(kind: str | None) -> None:
    mosaic = kind and mosaic_of(kind)
    frame = 0.2 + 0.5 * torch.rand(1, 1, *SIZE, generator=torch.Generator().manual_seed(4))
    defects = torch.zeros_like(frame, dtype=torch.bool)
    defects[..., 40, 50] = defects[..., 71, 33] = True
    weight = merge_burst(frame, [frame.clone()], NOISE, mosaic, defects=defects).weight
    assert weight[defects].max() < 0.5  # the substitute's, and no more
    assert weight[~defects].min() > 1.5


def test_mending_takes_the_neighbours_of_the_colour() -> None:
    mosaic = mosaic_of("xtrans")
    image = torch.tensor([0.1, 0.5, 0.9])[mosaic.colours(30, 36)][None, None]
    defects = torch.rand(1, 1, 30, 36, generator=torch.Generator().manual_seed(0)) < 0.03
    torch.testing.assert_close(mend(image.masked_fill(defects, 7.0), defects, mosaic), image)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_saturated_stays(kind: str) -> None:
    """Light beyond white, whose noise brings some pixels of some frames below it."""
    mosaic = None if kind == "rgb" else mosaic_of(kind)
    clean = scene(SIZE).clone()
    clean[..., 60:120, 80:200] = 1.01
    frames = [sense(clean, mosaic, NOISE, seed).clamp(max=1) for seed in range(4)]
    done = merge_burst(frames[0], frames[1:], NOISE, mosaic)
    white = frames[0] == 1
    assert 0.3 < float(white[..., 60:120, 80:200].float().mean()) < 0.9
    assert (done.image[white] == 1).all()
    linear = merge_burst(frames[0], frames[1:], NOISE, mosaic, clips=False)
    assert float(linear.image[white].mean()) < 0.999
