"""The hierarchical search: discs whose motion is known, and images in which there is nothing to find."""

import warnings
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from nte.errors import NteError
from nte.motion.correspondence import (
    SEARCHES,
    FewerLevelsWarning,
    Known,
    Search,
    find_both_ways,
    find_correspondence,
    find_motion,
    patch_error,
    rejection_mask,
)
from nte.motion.search import RADII
from nte.motion.warp import inside, pixel_centres, warp

STEADY = Search(RADII["noisy"], "l1", smoothing=(4, 2, 1))


def texture(size: tuple[int, int], seed: int = 3) -> Tensor:
    """(H, W) in about [−1, 1], with detail of 4 to 128 px: every level of the pyramid has something to hold on to."""
    generator = torch.Generator().manual_seed(seed)
    total = torch.zeros(1, 1, *size)
    for octave in range(2, 8):
        step = 2**octave
        coarse = torch.rand(1, 1, size[0] // step + 2, size[1] // step + 2, generator=generator) - 0.5
        total += F.interpolate(coarse, size=size, mode="bicubic", align_corners=True) * 2 ** (0.6 * (octave - 7))
    return total[0, 0]


def disc(x: float, y: float, radius: float = 40.0, size: tuple[int, int] = (256, 320)) -> Tensor:
    """A shaded, textured disc around (x, y) before a textured wall, (1, 1, H, W) in [0, 1], its edge a pixel soft."""
    rows, columns = torch.meshgrid(torch.arange(size[0]) + 0.5, torch.arange(size[1]) + 0.5, indexing="ij")
    dx, dy = columns - x, rows - y
    inside = (radius - (dx * dx + dy * dy).sqrt() + 0.5).clamp(0, 1)
    face = 0.6 + 0.15 * dx / radius + 0.15 * torch.sin(dy * 4 / radius)
    for along_x, along_y in ((0.5, 0.0), (0.0, 0.4), (0.11, 0.13), (0.19, -0.16)):
        face = face + 0.08 * torch.sin(dx * along_x + dy * along_y + 1)
    return torch.lerp(0.25 + 0.25 * texture(size), face, inside).clamp(0, 1)[None, None]


def within(x: float, y: float, radius: float, like: Tensor) -> Tensor:
    """(H, W) bool: the disc's inner part."""
    height, width = like.shape[-2:]
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    return (columns - x) ** 2 + (rows - y) ** 2 < radius**2


def noisy(image: Tensor, deviation: float, seed: int) -> Tensor:
    return image + deviation * torch.randn(image.shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(("dx", "dy"), [(100.0, 0.0), (-60.0, 80.0)])
def test_a_disc_that_moved_by_100_px_is_found_within_a_pixel(dx: float, dy: float) -> None:
    size = (720, 1280)
    x, y = 640 - dx / 2, 320.0
    previous, current = disc(x, y, 100, size), disc(x + dx, y + dy, 100, size)
    motion = find_correspondence(current, previous, Search(norm="l1")).motion[0]
    on = within(x + dx, y + dy, 75, current)
    error = (motion - torch.tensor([-dx, -dy]).view(2, 1, 1)).square().sum(0).sqrt()[on]
    assert error.median() < 0.1
    assert (error < 1).float().mean() > 0.99
    off = ~within(x + dx, y + dy, 200, current) & ~within(x, y, 200, current)
    assert motion[:, off].abs().mean() < 2  # the wall stands still


def jitter(dx: float, dy: float, refined: int) -> float:
    """Mean change from frame to frame of the motion found for a disc at constant speed, px a frame, 2 % noise."""
    images = [noisy(disc(100 + dx * i, 128 + dy * i), 0.02, i) for i in range(5)]
    on = within(100, 128, 30, images[0])
    search = Search(RADII["strong"], "l1", refined=refined)
    found = [find_correspondence(now, before, search).motion[0][:, on] for before, now in pairwise(images)]
    return float(np.mean([(b - a).square().sum(0).sqrt().mean() for a, b in pairwise(found)]))


@pytest.mark.parametrize(("dx", "dy"), [(0.5, 0.0), (-0.5, 0.5)])
def test_constant_sub_pixel_speed_gives_constant_motion_by_refinement_on_two_levels(dx: float, dy: float) -> None:
    with_refinement, without = jitter(dx, dy, 2), jitter(dx, dy, 0)
    assert with_refinement < 0.1
    assert without >= 2 * with_refinement


@pytest.mark.parametrize("search", [Search(), Search(half=True), Search(norm="l2"), Search(radii=RADII["strong"])])
def test_identical_images_stand_still_and_are_equal(search: Search) -> None:
    image = noisy(disc(100, 128), 0.1, 0)
    found = find_correspondence(image, image, search)
    assert not found.motion.any()
    assert found.error.max() <= 1e-5


@pytest.mark.parametrize("value", [0.0, 0.5])
def test_black_and_constant_images_stand_still(value: float) -> None:
    image = torch.full((1, 1, 256, 256), value)
    found = find_correspondence(image, image.clone())
    assert not found.motion.any()
    brighter = find_correspondence(image + 0.1, image)  # everything is equally wrong: no shift wins
    assert brighter.motion.abs().max() < 1e-3
    assert brighter.error.min() > 0.01


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_bad_pixels_count_as_black_and_nothing_bad_comes_out(bad: float) -> None:
    current, previous = disc(110, 128), disc(100, 128)
    spoilt, black = current.clone(), current.clone()
    spoilt[..., 100:104, 50:60], black[..., 100:104, 50:60] = bad, 0
    found, expected = find_correspondence(spoilt, previous), find_correspondence(black, previous)
    assert found.motion.isfinite().all()
    assert found.error.isfinite().all()
    assert torch.equal(found.motion, expected.motion)
    all_bad = find_correspondence(torch.full_like(current, bad), previous)
    assert all_bad.motion.isfinite().all()


@pytest.mark.parametrize("find", [find_motion, find_correspondence, find_both_ways])
def test_the_warning_about_small_images_shows_the_line_that_called(find: Callable[[Tensor, Tensor], object]) -> None:
    with pytest.warns(FewerLevelsWarning) as told:
        find(torch.zeros(1, 1, 8, 9), torch.zeros(1, 1, 8, 9))
    assert {one.filename for one in told} == {__file__}


@pytest.mark.parametrize(("size", "levels", "reach"), [((1, 1), 1, 2), ((15, 300), 1, 2), ((16, 17), 2, 10)])
def test_small_images_get_fewer_levels_and_are_told_so_once(size: tuple[int, int], levels: int, reach: int) -> None:
    image = torch.rand(1, 1, *size, generator=torch.Generator().manual_seed(0))
    with pytest.warns(FewerLevelsWarning, match=rf"^images of {size[1]}x{size[0]} pixels: ") as told:
        found = find_correspondence(image, image, Search())
    assert len(told) == 1
    text = str(told[0].message)
    assert (
        f"uses {levels} of its {len(Search().radii)} levels, and misses what moves by more than {reach} pixel" in text
    )
    assert text.endswith("if anything does, give larger images, or motion vectors")
    assert found.motion.shape == (1, 2, *size)
    assert not found.motion.any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        find_correspondence(image, image, Search(radii=(2,) * levels))  # as many as there can be


def test_images_that_differ_in_size_are_refused() -> None:
    with pytest.raises(NteError, match=r"current \(1, 1, 8, 9\) and previous \(1, 1, 9, 8\): expected two images"):
        find_correspondence(torch.zeros(1, 1, 8, 9), torch.zeros(1, 1, 9, 8))
    with pytest.raises(NteError, match="expected two images"):
        find_correspondence(torch.zeros(8, 9), torch.zeros(8, 9))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"norm": "l3"}, "norm is 'l3', expected one of l2, l1, log, log_centred"),
        ({"radii": ()}, "radii are"),
        ({"radii": (2, -1)}, "radii are"),
        ({"error_level": 4}, "error_level is 4, expected a level from 0 to 3"),
    ],
)
def test_a_search_that_cannot_be_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(NteError, match=message):
        Search(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize("half", [False, True])
def test_known_vectors_overwrite_what_is_found_and_guide_what_is_around(half: bool) -> None:
    image = torch.full((1, 1, 256, 256), 0.5)  # in which nothing can be found
    mask = torch.zeros(1, 1, 256, 256, dtype=torch.bool)
    mask[..., 64:192, 64:192] = True
    told = torch.tensor([-32.0, 0.0]).view(1, 2, 1, 1).expand(1, 2, 256, 256)
    search = Search((2, 2, 2), half=half)
    guided = find_correspondence(image, image, search, Known(told, mask)).motion
    assert torch.equal(torch.where(mask, guided, told), told)
    assert (guided[0, 0, 128, 192:194] < -4).all()  # beside it, the search starts from there
    assert guided[0, :, :8, :8].abs().max() < 1  # far from it, it does not
    assert not find_correspondence(image, image, search).motion.any()


def test_known_vectors_that_are_not_finite_are_searched_and_double_precision_is_as_good() -> None:
    current, previous = disc(107, 124), disc(100, 128)
    mask = within(107, 124, 30, current)[None, None]
    told = torch.tensor([-7.0, 4.0], dtype=torch.float64).view(1, 2, 1, 1).expand(1, 2, 256, 320).clone()
    whole = find_motion(current, previous, known=Known(told, mask))
    assert (whole[0][:, mask[0, 0]] == told[0][:, mask[0, 0]]).all()
    told[..., 120:124, 100:110] = torch.tensor([float("nan"), float("inf")]).repeat(5)
    holed = find_motion(current, previous, known=Known(told, mask))
    assert holed.dtype == torch.float32
    assert (holed - whole)[..., within(107, 124, 20, current)].abs().mean() < 0.1
    assert (holed - whole)[..., ~within(107, 124, 100, current)].abs().max() < 1e-3
    with pytest.raises(NteError, match=r"known motion has the shape \(1, 2, 256, 319\)"):
        find_motion(current, previous, known=Known(told[..., :-1], mask))
    two = torch.cat([current, current])
    with pytest.raises(NteError, match=r"known motion has the shape \(1, 2, 256, 320\)"):
        find_motion(two, two, known=Known(told, mask))


def test_the_patch_error_takes_any_precision_and_refuses_other_sizes() -> None:
    current, previous = disc(107, 124), disc(100, 128)
    motion = torch.zeros(1, 2, 256, 320)
    error = patch_error(current, previous, motion, SEARCHES["clean"])
    assert torch.equal(patch_error(current.double(), previous.double(), motion.double(), SEARCHES["clean"]), error)
    with pytest.raises(NteError, match="expected two images"):
        patch_error(current, previous[..., :-1], motion, SEARCHES["clean"])
    with pytest.raises(NteError, match=r"motion has the shape \(1, 2, 256, 319\)"):
        patch_error(current, previous, motion[..., :-1], SEARCHES["clean"])


@pytest.mark.parametrize("noise", SEARCHES)
def test_values_of_any_size_give_finite_motion_and_mixed_precision_the_same(noise: str) -> None:
    image = 0.5 + 0.4 * texture((90, 110))[None, None]
    current, previous = image[..., 3:, 5:], image[..., :-3, :-5]
    for scale in (1e-30, 1e6, 1e20, 3e38):
        found = find_correspondence(scale * current, scale * previous, SEARCHES[noise])
        assert found.motion.isfinite().all()
        assert found.error.isfinite().all()
    with torch.autocast("cpu", torch.bfloat16):
        mixed = find_motion(current, previous, SEARCHES[noise])
    assert torch.equal(mixed, find_motion(current, previous, SEARCHES[noise]))


def test_noise_free_channels_lead_where_radiance_is_noise() -> None:
    generator = torch.Generator().manual_seed(1)
    noise = [torch.rand(1, 1, 256, 320, generator=generator) for _ in range(2)]
    guide = torch.cat([disc(107, 124), 1 - disc(107, 124)], 1), torch.cat([disc(100, 128), 1 - disc(100, 128)], 1)
    on = within(107, 124, 16, guide[0])
    led = find_correspondence(guide[0], guide[1], STEADY).motion[0][:, on]
    blind = find_correspondence(noise[0], noise[1]).motion[0][:, on]
    expected = torch.tensor([[-7.0], [4.0]])
    assert (led - expected).abs().mean() < 0.5
    assert (blind - expected).abs().mean() > 2


def test_larger_patches_withstand_more_noise() -> None:
    current, previous = (noisy(disc(100 + 6 * i, 128, 50), 0.1, i) for i in (1, 0))
    on = within(106, 128, 35, current)
    expected = torch.tensor([-6.0, 0.0]).view(2, 1)
    small, large = (
        (find_correspondence(current, previous, Search(RADII[noise], "l1")).motion[0][:, on] - expected).abs().mean()
        for noise in ("clean", "noisy")
    )
    assert large < 0.5
    assert large < 0.5 * small


def test_half_resolution_finds_fractions_of_a_pixel() -> None:
    current, previous = disc(102.6, 128, 50), disc(100, 128, 50)
    on = within(102.6, 128, 35, current)
    motion = find_correspondence(current, previous, Search(norm="l1", half=True)).motion[0][:, on]
    assert (motion[0] + 2.6).abs().mean() < 0.2
    assert motion[1].abs().mean() < 0.2


def test_there_and_back_agrees_except_where_something_came_into_sight() -> None:
    previous, current = disc(100, 128, 60), disc(112, 128, 60)
    found = find_both_ways(current, previous, STEADY)
    assert found.consistent[0, 0][within(112, 128, 45, current)].float().mean() > 0.9
    uncovered = within(100, 128, 58, current) & ~within(112, 128, 62, current)
    assert found.consistent[0, 0][uncovered].float().mean() < 0.6
    alone = find_correspondence(current, previous, STEADY)
    assert torch.equal(found.backward.motion, alone.motion)
    still = find_both_ways(current, current)
    assert still.consistent.all()


def real_patch_error(current: Tensor, previous: Tensor, motion: Tensor, search: Search) -> Tensor:
    """The patch distance along a motion, step by step: fetch, shrink, log L1, mean over the patch."""
    height, width = current.shape[-2:]
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    x, y = (columns + motion[:, 0]) * 2 / width - 1, (rows + motion[:, 1]) * 2 / height - 1
    grid = torch.stack([x, y], -1)
    fetched = F.grid_sample(previous, grid, padding_mode="border", align_corners=False)
    block, size = (2 if search.half else 1) * 4**search.error_level, 2 * search.radii[search.error_level] + 1
    small = [F.avg_pool2d(i * search.gain, block, ceil_mode=True, count_include_pad=False) for i in (current, fetched)]
    distance = torch.log(2 + (small[0] - small[1]).abs()) - np.log(2)
    patch = F.avg_pool2d(distance, size, 1, size // 2, count_include_pad=False)
    large = F.interpolate(patch, scale_factor=block, mode="bilinear", align_corners=False)
    return large[..., :height, :width]


@pytest.mark.parametrize("noise", SEARCHES)
@pytest.mark.parametrize("deviation", [0.0, 0.1])
def test_the_error_is_that_of_the_motion_that_is_returned(noise: str, deviation: float) -> None:
    """A wall that moved by whole pixels and a slanted disc that moved otherwise, clean and noisy, of odd size."""
    wall = 0.25 + 0.25 * texture((201, 307))[None, None]
    current, previous = wall[..., 4:], wall[..., :-4]
    current = torch.where(within(160, 120, 30, current), disc(160.3, 120, size=(201, 303)), current)
    previous = torch.where(within(152, 117, 30, previous), disc(152, 117.4, size=(201, 303)), previous)
    current, previous = noisy(current, deviation, 1), noisy(previous, deviation, 2)
    found = find_correspondence(current, previous, SEARCHES[noise])
    real = real_patch_error(current, previous, found.motion, SEARCHES[noise])
    torch.testing.assert_close(found.error, real, atol=1e-4, rtol=1e-3)
    assert torch.corrcoef(torch.stack([found.error.flatten(), real.flatten()]))[0, 1] > 0.99
    assert torch.equal(found.error, patch_error(current, previous, found.motion, SEARCHES[noise]))


def room(size: tuple[int, int]) -> Tensor:
    """Large flat and shaded areas with slanted edges, as renderings have, and few details; (1, 1, H, W) in [0, 1]."""
    rows, columns = torch.meshgrid(torch.arange(size[0]) + 0.5, torch.arange(size[1]) + 0.5, indexing="ij")
    image = 0.3 + 0.0005 * columns + 0.1 * texture(size)
    boxes = ((60, 40, 50, 90, 0.3, 0.8), (190, 150, 80, 40, -0.2, 0.1), (250, 60, 30, 30, 0.5, 0.6))
    for k, (x, y, wide, high, slant, value) in enumerate((*boxes, (90, 260, 120, 30, 0.1, 0.9))):
        across, down = columns - x - slant * (rows - y), rows - y + 0.15 * k * (columns - x)
        inside = torch.minimum(wide / 2 - across.abs(), high / 2 - down.abs()).clamp(-0.5, 0.5) + 0.5
        image = torch.lerp(image, torch.full_like(image, value) + 0.001 * across, inside)
    return image[None, None].clamp(0, 1)


@pytest.mark.parametrize("noise", SEARCHES)
@pytest.mark.parametrize("pan", [(24, 9), (48, 18), (80, 30), (-48, 18)])
@pytest.mark.parametrize(("kind", "size"), [("texture", (239, 317)), ("room", (301, 256))])
def test_a_pan_of_the_whole_image_is_found_by_every_preset(
    noise: str, pan: tuple[int, int], kind: str, size: tuple[int, int]
) -> None:
    x, y = pan
    large = (size[0] + y, size[1] + abs(x))
    image = 0.5 + 0.4 * texture(large)[None, None] if kind == "texture" else room(large)
    left = max(-x, 0)
    previous = image[..., : size[0], left : left + size[1]]
    current = image[..., y : y + size[0], left + x : left + x + size[1]]
    motion = find_correspondence(current, previous, SEARCHES[noise]).motion[0]
    there = (slice(0, size[0] - y), slice(max(-x, 0), size[1] - max(x, 0)))
    apart = (motion - torch.tensor([float(x), float(y)]).view(2, 1, 1)).square().sum(0).sqrt()[there]
    assert apart.median() < 0.35
    assert apart.mean() < 0.5


def hills(size: tuple[int, int], share: float, sky: float) -> Tensor:
    """Textured hills on this share of the image below a constant sky, (1, 1, H, W)."""
    rows, columns = torch.meshgrid(torch.arange(size[0]) + 0.5, torch.arange(size[1]) + 0.5, indexing="ij")
    line = size[0] * (1 - share) + size[0] / 20 * torch.sin(columns * 10 / size[1]) + 0.05 * columns
    return torch.where(rows > line, 0.5 + 0.4 * texture(size), sky)[None, None]


@pytest.mark.parametrize("noise", SEARCHES)
@pytest.mark.parametrize("pan", [(48, 18), (80, 30)])
def test_a_pan_is_found_below_a_sky_that_fills_most_of_the_image(noise: str, pan: tuple[int, int]) -> None:
    x, y = pan
    size = (300, 400)
    image = hills((size[0] + 40, size[1] + 100), 0.35, 0.0)
    current, previous = image[..., y : y + size[0], x : x + size[1]], image[..., : size[0], : size[1]]
    motion = find_correspondence(current, previous, SEARCHES[noise]).motion[0]
    there = current[0, 0, : size[0] - y, : size[1] - x] > 0
    apart = (motion - torch.tensor([float(x), float(y)]).view(2, 1, 1)).square().sum(0).sqrt()
    apart = apart[: size[0] - y, : size[1] - x][there]
    assert apart.median() < 0.35
    assert apart.mean() < 0.5


def stars(size: tuple[int, int]) -> Tensor:
    """Points of a pixel on black, one in 400 pixels, (1, 1, H, W)."""
    generator = torch.Generator().manual_seed(3)
    bright, chosen = torch.rand(2, 1, 1, *size, generator=generator)
    return torch.where(chosen < 1 / 400, 0.2 + 0.8 * bright, 0.0)


def stripes(size: tuple[int, int]) -> Tensor:
    """Slanted waves that fit nearly as well a period away, with a little texture, (1, 1, H, W)."""
    rows, columns = torch.meshgrid(torch.arange(size[0]) + 0.5, torch.arange(size[1]) + 0.5, indexing="ij")
    waves = 0.2 * torch.sin((0.7 * rows + columns) / 9) + 0.2 * torch.sin((rows - 0.4 * columns) / 23)
    return (0.5 + waves + 0.08 * texture(size))[None, None]


def require_the_pan(draw: Callable[[tuple[int, int]], Tensor], noise: str, pan: tuple[int, int]) -> None:
    """Require that a pan is found to the pixel, and that colours fetched along it are right."""
    x, y = pan
    image = draw((257 + abs(y), 321 + abs(x)))
    previous = image[..., max(-y, 0) :, max(-x, 0) :][..., :257, :321]
    current = image[..., max(y, 0) :, max(x, 0) :][..., :257, :321]
    motion = find_correspondence(current, previous, SEARCHES[noise]).motion
    seen = inside(pixel_centres(current) + motion.new_tensor([x, y]).view(1, 2, 1, 1))
    apart = (motion - motion.new_tensor([x, y]).view(1, 2, 1, 1)).square().sum(1, keepdim=True).sqrt()[seen]
    assert apart.median() < 0.1
    assert apart.mean() < 0.5
    change = (warp(previous, motion).image - current).abs()[seen].mean()
    assert change < 0.1 * (previous - current).abs()[seen].mean()


@pytest.mark.parametrize(
    ("draw", "noise"), [*((stars, noise) for noise in SEARCHES), (stripes, "clean"), (stripes, "moderate")]
)
@pytest.mark.parametrize("pan", [(24, 9), (-48, -18), (48, -18)])
def test_a_pan_is_found_where_patches_see_nothing_or_fit_elsewhere(
    draw: Callable[[tuple[int, int]], Tensor], noise: str, pan: tuple[int, int]
) -> None:
    """The image as a whole tells a pan."""
    require_the_pan(draw, noise, pan)


@pytest.mark.parametrize("noise", SEARCHES)
@pytest.mark.parametrize("pan", [(3, 2), (-6, 7), (0, 5)])
def test_a_slow_pan_is_found_around_details_of_a_pixel(noise: str, pan: tuple[int, int]) -> None:
    """Patches are meant to reach it, but see little but the ground."""
    require_the_pan(stars, noise, pan)


def test_a_still_thing_before_a_pan_stands_still() -> None:
    image = 0.5 + 0.4 * texture((270, 380))[None, None]
    current, previous = image[..., 14:, 60:].clone(), image[..., :-14, :-60].clone()
    sign = 0.5 + 0.4 * texture((96, 96), seed=9)
    for view in (current, previous):
        view[..., 80:176, 100:196] = sign
    motion = find_correspondence(current, previous, SEARCHES["clean"]).motion[0]
    assert motion[:, 96:160, 116:180].abs().sum(0).median() < 0.2
    assert motion[:, 96:160, 116:180].abs().mean() < 1.5
    assert (motion[:, 10:60, 10:250] - torch.tensor([60.0, 14.0]).view(2, 1, 1)).abs().mean() < 0.5


def waves(amplitude: float) -> tuple[Tensor, Tensor, Tensor]:
    """Trains of sines without noise, (current, previous, motion): bent by a motion of this amplitude, px."""
    here = pixel_centres(torch.zeros(1, 1, 203, 310))
    motion = amplitude * torch.cat([torch.sin(here[:, 1:] / 25) + 0.2, torch.cos(here[:, :1] / 31)], 1)

    def image(at: Tensor) -> Tensor:
        x, y = at[:, :1], at[:, 1:]
        return 0.5 + 0.2 * torch.sin(x / 5.1) * torch.cos(y / 6.3) + 0.15 * torch.sin((x - 2 * y) / 17)

    return image(here + motion), image(here), motion


@pytest.mark.parametrize("amplitude", [0.7, 2.0])
def test_clean_waves_are_followed_to_a_fraction_of_a_pixel(amplitude: float) -> None:
    current, previous, truth = waves(amplitude)
    for search in (SEARCHES["clean"], None):  # None: what the noise of the images chooses
        motion = find_correspondence(current, previous, search).motion
        apart = (motion - truth).square().sum(1).sqrt()[:, 12:-12, 12:-12]
        assert apart.mean() < 0.15


def test_error_of_a_coarser_level_is_given_at_full_size() -> None:
    current, previous = noisy(disc(105, 128), 0.1, 0), noisy(disc(100, 128), 0.1, 1)
    fine, coarse = (find_correspondence(current, previous, Search(error_level=level)) for level in (0, 1))
    assert torch.equal(fine.motion, coarse.motion)
    assert fine.error.shape == coarse.error.shape
    assert coarse.error.std() < fine.error.std()


def test_a_batch_is_its_images_one_by_one_and_a_second_run_is_the_first() -> None:
    pairs = [(noisy(disc(100 + d, 128), 0.05, d), noisy(disc(100, 128), 0.05, d + 9)) for d in (3, 17)]
    together = find_correspondence(torch.cat([c for c, _ in pairs]), torch.cat([p for _, p in pairs]))
    for n, (current, previous) in enumerate(pairs):
        for _ in range(2):
            alone = find_correspondence(current, previous)
            assert torch.equal(alone.motion[0], together.motion[n])
            assert torch.equal(alone.error[0], together.error[n])


def test_the_mask_is_between_0_and_1() -> None:
    error = torch.tensor([0.0, 0.1, 0.2, 5.0]).view(1, 1, 1, 4)
    torch.testing.assert_close(rejection_mask(error, 5, 0.5), torch.tensor([0.0, 0.0, 0.5, 1.0]).view(1, 1, 1, 4))


@pytest.mark.parametrize("noise", SEARCHES)
@pytest.mark.parametrize("size", [(1, 1), (2, 9), (3, 5), (17, 40), (3, 200), (1, 70)])
@pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")
def test_no_image_is_too_small_or_too_strange(noise: str, size: tuple[int, int]) -> None:
    image = torch.rand(1, 1, *size, generator=torch.Generator().manual_seed(7))
    same = find_correspondence(image, image, SEARCHES[noise])
    assert same.motion.abs().max() < 1e-3
    assert same.error.abs().max() < 1e-4
    for other in (torch.full_like(image, float("nan")), torch.zeros_like(image), torch.full_like(image, 1e20)):
        found = find_correspondence(image, other, SEARCHES[noise])
        assert found.motion.isfinite().all()
        assert found.error.isfinite().all()


def test_an_image_is_searched_in_a_batch_as_alone_whatever_stands_beside_it() -> None:
    """A pan beside a room that hardly moves, and a clean image beside a noisy one: each has its own search."""
    large = 0.5 + 0.4 * texture((150, 260))[None, None]
    still = room((150, 200))
    pairs = [
        (large[..., 60:], large[..., :-60]),
        (still.roll((1, 2), (2, 3)), still),
        (noisy(still.roll((1, 2), (2, 3)), 0.15, 1), noisy(still, 0.15, 2)),
    ]
    together = find_correspondence(torch.cat([c for c, _ in pairs]), torch.cat([p for _, p in pairs]))
    for n, (current, previous) in enumerate(pairs):
        alone = find_correspondence(current, previous)
        assert torch.equal(alone.motion[0], together.motion[n])
        assert torch.equal(alone.error[0], together.error[n])
    with pytest.raises(NteError, match="2 searches for 3 images"):
        find_correspondence(torch.zeros(3, 1, 8, 8), torch.zeros(3, 1, 8, 8), [Search()] * 2)
