"""Each step of the filter for motion blur, against a slow obvious twin or an analytic answer."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nte.filters.motion_blur.composition import Cover, compose, weighted_share
from nte.filters.motion_blur.first_stage import (
    COLUMNS,
    MOVING_COLOR,
    MOVING_MOTION,
    MOVING_WEIGHT,
    STATIC_COLOR,
    STATIC_WEIGHT,
    first_stage,
    normalise,
)
from nte.filters.motion_blur.history import find
from nte.filters.motion_blur.options import MotionBlurOptions
from nte.filters.motion_blur.prefilter import SLOWEST, prefilter
from nte.filters.motion_blur.samples import (
    COLOR,
    DEPTH,
    MOTION,
    MOVING,
    TIME,
    PixelList,
    Size,
    near_moving,
    read_samples,
    square,
)
from nte.filters.motion_blur.second_stage import fixed_steps, scaled_steps, second_stage
from nte.filters.motion_blur.variance import MotionStatistics, estimate_variance
from nte.filters.motion_blur.weight import B3, kernel, motion_weight, segment_distance
from nte.filters.noise import uniform_noise
from tests.filters.blurred import blurred_disc

SIZE = (20, 24)


def samples(velocity=(6.0, 3.0), radius=6.0) -> tuple[Tensor, Size]:
    frame = blurred_disc(velocity=velocity, size=SIZE, radius=radius)
    rng = np.random.default_rng(7)
    noise = rng.normal(scale=0.6, size=(1, 2, *SIZE)) * (frame["shutter_motion"] != 0).any(1, keepdims=True)
    return read_samples(frame.with_channels(shutter_motion=frame["shutter_motion"] + noise.astype(np.float32)).torch())


def everywhere(size: Size) -> PixelList:
    return PixelList.at(torch.arange(size.batch * size.height * size.width), size)


def estimated(count: int, length: float, angle: float = 0.0, variance: float = 0.0) -> MotionStatistics:
    columns = [torch.full((count,), value) for value in (length, 0.0, angle, variance)]
    return MotionStatistics(*columns, torch.tensor([[length, 0.0]]).expand(count, 2))


def slow_distance(p, q, v, t) -> float:
    """Eq. 1 as it is written."""
    q0, q1 = q - v * t, q + v * (1 - t)
    place = (p - q0) @ (q1 - q0) / ((q1 - q0) @ (q1 - q0))
    return math.dist(p, q0 + place * (q1 - q0)) if -1e-4 <= place <= 1.0001 else math.inf


coordinates = st.floats(-20, 20, width=32)


@given(st.tuples(*[coordinates] * 6), st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_distance_is_that_of_eq_1(numbers, t):
    p, q, v = np.array(numbers).reshape(3, 2)
    if np.hypot(*v) < 0.5:
        return
    expected = slow_distance(p, q, v, t)
    place = (p - q + v * t) @ v / (v @ v)
    if min(abs(place + 1e-4), abs(place - 1.0001)) < 1e-5:
        return  # rounding decides
    args = [torch.tensor(x, dtype=torch.float64) for x in (p, q, v, t)]
    assert segment_distance(*args).item() == pytest.approx(expected, abs=1e-6)


def test_a_sample_always_counts_where_it_was_seen():
    v = torch.tensor([[3.3, -7.1]]).expand(5, 2)
    q, t = torch.full((5, 2), 101.5), torch.linspace(0, 1, 5)
    assert motion_weight(q, q, v, t, torch.ones(5)).min() > 0.999


def test_weight_falls_linearly_and_ends():
    p = torch.tensor([[0.0, 0.0], [0.0, 0.5], [0.0, 1.0], [0.0, 1.5], [6.0, 0.0]])
    q, v, t = torch.zeros(5, 2), torch.tensor([[10.0, 0.0]]).expand(5, 2), torch.full((5,), 0.5)
    assert motion_weight(p, q, v, t, torch.full((5,), 1.0)).tolist() == pytest.approx([1, 0.5, 0, 0, 0])
    assert motion_weight(p, q, v, t, torch.full((5,), 2.0)).tolist() == pytest.approx([1, 0.75, 0.5, 0.25, 0])


def test_reach_is_limited_to_four():
    estimate = MotionStatistics(*(torch.tensor([1.0, 1.0]) for _ in range(4)), torch.zeros(2, 2))
    estimate = estimate._replace(length_variance=torch.tensor([0.05, 9.0]), angle_variance=torch.tensor([0.5, 1.0]))
    assert estimate.reach(1.0, 10.0).tolist() == pytest.approx([1.5 * 1.5, 4.0])
    assert estimate.reach(0.0, 0.0).tolist() == [1, 1]


def test_near_moving_is_fifteen_pixels_square():
    moving = torch.zeros(1, 1, 40, 40)
    moving[0, 0, 20, 11] = 1
    near = near_moving(moving)[0, 0]
    assert near.sum() == 15 * 15
    assert near[13:28, 4:19].all()


def test_variance_estimate_is_that_of_a_loop():
    rows, size = samples()
    pixels = everywhere(size)
    near = near_moving(rows[:, MOVING].view(1, 1, *SIZE)).flatten()
    found = estimate_variance(rows, pixels, 0.05).some(near)
    image, (ys, xs) = rows.view(*SIZE, 8).double(), np.nonzero(near.view(SIZE).numpy())
    for number in range(0, len(ys), 17):
        y, x = ys[number] // 2 * 2, xs[number] // 2 * 2
        tile = image[y : y + 2, x : x + 2].reshape(-1, 8)
        cover = math.inf if tile[:, MOVING].any() else 1.05 * tile[:, DEPTH].max().item()
        window = [
            (math.hypot(b - x - 0.5, a - y - 0.5), a, b)
            for a in range(max(0, y - 7), min(SIZE[0], y + 9))
            for b in range(max(0, x - 7), min(SIZE[1], x + 9))
        ]
        moving = [s for s in (image[a, b] for _, a, b in sorted(window)) if s[MOVING] > 0 and s[DEPTH] <= cover]
        lengths = np.array([math.hypot(*s[MOTION].tolist()) for s in moving])
        angles = np.array([math.atan2(s[MOTION][1], s[MOTION][0]) for s in moving])
        relative = angles - angles[0]
        relative = (relative + math.pi / 2) % math.pi - math.pi / 2
        assert found.length[number].item() == pytest.approx(lengths.mean(), rel=1e-4)
        assert found.length_variance[number].item() == pytest.approx(lengths.var(), rel=1e-3, abs=1e-5)
        turned = found.angle[number].item() - angles[0] - relative.mean()
        assert math.sin(turned) == pytest.approx(0, abs=1e-4)
        assert found.angle_variance[number].item() == pytest.approx(relative.var() / (math.pi / 2) ** 2, rel=1e-3)


@pytest.mark.parametrize(("naive", "variance"), [(False, 0.0), (True, 1.0)])
def test_directions_about_zero_vary_little_unless_naive(naive, variance):
    rows, size = samples()
    sign = torch.where(torch.arange(len(rows)) % 2 == 0, 1.0, -1.0)
    rows[:, MOVING], rows[:, MOTION] = 1, torch.stack([torch.full_like(sign, 5), 0.1 * sign], 1)
    found = estimate_variance(rows, everywhere(size), 0.05, naive).angle_variance
    assert found.mean().item() == pytest.approx(variance, abs=0.01)


def test_prefilter_is_that_of_a_loop():
    rows, size = samples()
    pixels = everywhere(size)
    moving = pixels.some(rows[:, MOVING] > 0)
    near, jitter = 2.5, 1.5
    filtered = prefilter(rows, moving, 4, near, jitter).view(*SIZE, 8)
    noise = uniform_noise(*SIZE, 4, 6, rows.device)[0].numpy()
    image = rows.view(*SIZE, 8)
    for y, x in [(10, 12), (9, 9), (12, 15), (5, 12), (0, 0)]:
        own, kept = image[y, x], [image[y, x, COLOR]]
        if own[MOVING] == 0 or own[MOTION].norm() < SLOWEST:
            assert torch.equal(filtered[y, x], own)
            continue
        p = np.array([x + 0.5, y + 0.5])
        for b, a in ((b, a) for a in range(y - 1, y + 2) for b in range(x - 1, x + 2)):
            if not (0 <= a < SIZE[0] and 0 <= b < SIZE[1]) or image[a, b, MOTION].norm() < SLOWEST:
                continue
            for draw in noise[:, a, b].reshape(2, 3):
                way = image[a, b, MOTION].numpy() * (draw[0] - image[a, b, TIME].item())
                column, row = np.floor(np.array([b + 0.5, a + 0.5]) + way + (2 * draw[1:] - 1) * jitter).astype(int)
                if not (0 <= row < SIZE[0] and 0 <= column < SIZE[1]) or image[row, column, MOVING] == 0:
                    continue
                s = image[row, column]
                if slow_distance(p, np.array([column, row]) + 0.5, s[MOTION].numpy(), s[TIME].item()) < near:
                    kept.append(s[COLOR])
        np.testing.assert_allclose(filtered[y, x, COLOR], torch.stack(kept).mean(0), rtol=1e-4)
        assert torch.equal(filtered[y, x, 3:], own[3:])


def test_first_stage_is_that_of_a_loop():
    rows, size = samples()
    pixels = everywhere(size)
    found = normalise(first_stage(rows, pixels, torch.full((len(rows),), 1.5), 0.05)).view(*SIZE, COLUMNS)
    image = rows.view(*SIZE, 8).double()
    for y, x in [(10, 12), (9, 8), (12, 16), (4, 12), (0, 0), (19, 23), (10, 4)]:
        own = image[y, x]
        moving, static = torch.zeros(6).double(), torch.zeros(4).double()
        for a, b in ((a, b) for a in range(y - 2, y + 3) for b in range(x - 2, x + 3)):
            if not (0 <= a < SIZE[0] and 0 <= b < SIZE[1]):
                continue
            q, weight = image[a, b], B3[a - y + 2] * B3[b - x + 2]
            if q[MOVING] == 0:
                static += weight * torch.cat([q[COLOR], torch.ones(1)])
            elif own[MOVING] or q[DEPTH] <= 1.05 * own[DEPTH]:
                places = np.array([x, y]) + 0.5, np.array([b, a]) + 0.5
                far = slow_distance(*places, q[MOTION].numpy(), q[TIME].item())
                moving += weight * max(0, 1 - far / 1.5) * torch.cat([q[COLOR], q[MOTION], torch.ones(1)])
        if not own[MOVING]:
            static = torch.cat([own[COLOR], torch.ones(1)])
        assert found[y, x, MOVING_WEIGHT].item() == pytest.approx(min(1, moving[5].item()), abs=1e-5)
        assert found[y, x, STATIC_WEIGHT].item() == pytest.approx(min(1, static[3].item()), abs=1e-5)
        if moving[5] > 0:
            np.testing.assert_allclose(found[y, x, :5], moving[:5] / moving[5], rtol=1e-3, atol=1e-4)
        if static[3] > 0:
            np.testing.assert_allclose(found[y, x, STATIC_COLOR], static[:3] / static[3], rtol=1e-4)


def history(motion: Tensor) -> Tensor:
    """Rows of which all moves by (N, 2) vectors."""
    rows = torch.zeros(len(motion), COLUMNS)
    rows[:, MOVING_MOTION], rows[:, MOVING_WEIGHT] = motion, 1
    return rows


def opened(pixels: PixelList) -> Tensor:
    """A shutter that is open all the time."""
    return torch.ones(len(pixels.index))


def test_reprojection_of_a_slide_needs_one_iteration():
    size = Size(1, *SIZE)
    pixels = everywhere(size)
    motion = torch.tensor([[3.0, -2.0]]).expand(len(pixels.index), 2)
    offset, accepted = find(history(motion), pixels, motion, opened(pixels), MotionBlurOptions(iterations=1))
    assert torch.equal(offset, torch.tensor([[-3, 2]]).expand_as(offset))
    inside = (pixels.x >= 3) & (pixels.y < SIZE[0] - 2)
    assert torch.equal(accepted, inside)


def test_a_shutter_of_half_the_frame_looks_twice_as_far():
    pixels = everywhere(Size(1, *SIZE))
    motion = torch.tensor([[2.0, 0.0]]).expand(len(pixels.index), 2)
    offset, _ = find(history(motion), pixels, motion, 0.5 * opened(pixels), MotionBlurOptions())
    assert offset[:, 0].unique().tolist() == [-4]


def test_the_second_iteration_finds_more_of_a_rotation():
    """A turn about the image's centre by 0.5 rad a frame: the vectors bend between two frames."""
    size = Size(1, 64, 64)
    pixels = everywhere(size)
    arm = pixels.centres()[:, 0] - 32
    motion = 2 * math.sin(0.25) * torch.stack([-arm[:, 1], arm[:, 0]], 1)
    shares, error = {}, {}
    for iterations in (1, 2):
        settings = MotionBlurOptions(iterations=iterations, accept=1.0)
        offset, accepted = find(history(motion), pixels, motion, opened(pixels), settings)
        shares[iterations] = accepted.float().mean().item()
        turn = torch.tensor([[math.cos(0.5), -math.sin(0.5)], [math.sin(0.5), math.cos(0.5)]])
        error[iterations] = (arm @ turn - arm - offset)[accepted].norm(dim=1).mean().item()
    assert shares[2] > 1.3 * shares[1]
    assert error[2] < 1.5


def test_what_is_far_off_is_dropped():
    pixels = everywhere(Size(1, *SIZE))
    motion = torch.tensor([[2.0, 0.0]]).expand(len(pixels.index), 2)
    assert not find(history(-20 * motion), pixels, motion, opened(pixels), MotionBlurOptions())[1].any()


def test_steps_of_the_second_stage():
    steps = scaled_steps(estimated(1, 20.0), 3)[0]
    assert steps[:, 0].unique().tolist() == [-8, -4, 0, 4, 8]
    assert steps[:, 1].unique().tolist() == [-2, -1, 0, 1, 2]
    assert scaled_steps(estimated(1, 20.0), 2)[0, :, 0].max() == 4
    assert scaled_steps(estimated(1, 20.0, math.pi / 2), 3)[0, :, 1].max() == 8
    assert scaled_steps(estimated(1, 20.0, 0.0, 1.0), 3)[0, :, 1].max() == 8
    assert scaled_steps(estimated(1, 20.0), 3, 0.5)[0, :, 0].max() == 4
    assert [int(fixed_steps(i, torch.device("cpu")).max()) for i in (1, 2, 3)] == [2, 4, 8]


def test_second_stage_spreads_what_moves_along_its_way_only():
    size = Size(1, 9, 41)
    pixels = everywhere(size)
    buffer = torch.zeros(len(pixels.index), 6)
    buffer[:, 3], buffer[:, 5] = 20.0, 1
    buffer[4 * 41 + 20, :3] = 1
    count = len(pixels.index)
    out = second_stage(buffer, pixels, estimated(count, 20.0), torch.ones(count), 1.0)[:, 0].view(9, 41)
    assert (out[4, 8:33] > 0).sum() > 10
    assert not out[:4].any()
    assert not out[5:].any()
    torch.testing.assert_close(out, out.flip(1))
    assert out.sum().item() == pytest.approx(1, rel=0.1)


def test_weighted_share_is_the_share_of_the_shutter():
    """A band 10 px wide that crosses by 20 px: its middle is covered for half of the shutter."""
    size = Size(1, 40, 60)
    generator = torch.Generator().manual_seed(0)
    time = torch.rand(2400, generator=generator)
    pixels = everywhere(size)
    moves = (pixels.x + 0.5 - 30 - 20 * (time - 0.5)).abs() < 5
    rows = torch.zeros(2400, 8)
    rows[:, TIME], rows[:, MOVING] = time, moves.float()
    rows[:, DEPTH], rows[:, MOTION.start] = 5 - moves.float(), 20 * moves.float()
    estimate, reach = estimate_variance(rows, pixels, 0.05), torch.ones(2400)
    sums = first_stage(rows, pixels, reach, 0.05)
    share = weighted_share(rows, pixels, sums, estimate, reach, 0.05)[:, 0].view(40, 60)
    x = torch.arange(60) + 0.5
    expected = ((15 - (x - 30).abs()) / 20).clamp(0, 0.5)
    torch.testing.assert_close(share.mean(0), expected, atol=0.12, rtol=0)
    assert abs(share.mean() - expected.mean()) < 0.02


def test_composition_takes_what_there_is():
    rows = torch.zeros(5, COLUMNS)
    rows[:, MOVING_COLOR], rows[:, STATIC_COLOR] = 1, 3
    rows[:, MOVING_WEIGHT], rows[:, STATIC_WEIGHT] = torch.tensor([1.0, 1, 0, 1, 0]), torch.tensor([1.0, 0, 1, 0, 1])
    spare = torch.zeros(5, 9)
    spare[:, 0] = 0.25
    spare[3, 5:], spare[4, 1:5] = torch.tensor([7.0, 7, 7, 2]), torch.tensor([5.0, 5, 5, 2])
    assert compose(rows, Cover.parts(spare))[:, 0].tolist() == [2.5, 1, 3, 5.5, 3.5]


def test_kernel_is_b3():
    assert kernel(torch.device("cpu")).sum().item() == pytest.approx(1)
    assert square(2, torch.device("cpu"))[0, 12].tolist() == [0, 0]
