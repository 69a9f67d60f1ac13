"""The denoiser as its users see it: frames in, images out, in any size, batch and unit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from nte.denoiser import Denoiser
from nte.errors import NteError
from nte.frames.frame import Frame
from nte.models.temporal import TemporalDenoiser
from nte.recurrence import NetworkState
from tests.networks import small_network
from tests.synthetic import random_frames

VARIANTS = [{}, {"motion": "traditional"}, {"front": 2, "demodulate": True, "feed_masks": True, "head_size": 1}]


def run(denoiser: Denoiser, frames: list[Frame], extra: str | None = None) -> list[Tensor]:
    """The images (or an extra) of a sequence, as tensors."""
    images, state = [], None
    for frame in frames:
        result, state = denoiser.step(frame, state, (extra,) if extra else ())
        images.append(torch.as_tensor(result.extras[extra] if extra else result.image))
    return images


def remembering(state: NetworkState, history: Tensor) -> NetworkState:
    """The state with another history (N, 3, H, W)."""
    return state._replace(tensors={**state.tensors, "history": history})


def with_reset(frame: Frame, *reset: float) -> Frame:
    return replace(frame, reset=np.array(reset, np.float32))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("size", [(16, 16), (17, 31), (23, 18)])
def test_any_size_gives_an_image_of_that_size(variant: dict[str, object], size: tuple[int, int]) -> None:
    network = small_network(**variant)
    assert isinstance(network, Denoiser)
    for image in run(network, random_frames(2, size, batch=2)):
        assert image.shape == (2, 3, *size)
        assert image.isfinite().all()
        assert (image >= 0).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_sequences_side_by_side_do_not_see_each_other(variant: dict[str, object]) -> None:
    network = small_network(**variant)
    both = random_frames(3, batch=2)
    alone = [[Frame({k: v[n : n + 1] for k, v in f.channels.items()}, f.index) for f in both] for n in range(2)]
    together = run(network, both)
    for n in range(2):
        torch.testing.assert_close([image[n : n + 1] for image in together], run(network, alone[n]))


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_reset_is_a_new_start_for_that_sequence_alone(variant: dict[str, object]) -> None:
    network = small_network(**variant)
    frames = random_frames(4, batch=2)
    # The second sequence becomes ten times as bright where it starts anew: it needs its own exposure.
    for frame in frames[2:]:
        frame["color"][1] *= 10
    resumed = run(network, [*frames[:2], with_reset(frames[2], 0, 1), frames[3]])
    fresh, through = run(network, frames[2:]), run(network, frames)
    for image, new, old in zip(resumed[2:], fresh, through[2:], strict=True):
        assert torch.equal(image[1], new[1])
        assert torch.equal(image[0], old[0])
        assert not torch.equal(image[0], new[0])


def test_the_first_frame_takes_the_noisy_image_for_the_warped_one() -> None:
    network = small_network()
    (frame,) = random_frames(1)
    seen: list[Tensor] = []
    network.prediction.trunk.register_forward_hook(lambda _, inputs, __: seen.append(inputs[0]))
    run(network, [frame])
    compressed, warped = seen[0][:, :3], seen[0][:, -3:]
    assert torch.equal(compressed, warped)


def test_later_frames_take_the_warped_history() -> None:
    network = small_network(motion="traditional")
    frame, following = random_frames(2)
    following["motion"][:] = 0
    seen: list[Tensor] = []
    network.prediction.trunk.register_forward_hook(lambda _, inputs, __: seen.append(inputs[0]))
    _, state = network.step(frame, None)
    network.step(following, state)
    torch.testing.assert_close(seen[1][:, -3:], torch.log1p(state.tensors["history"]), atol=1e-4, rtol=1e-4)


def test_alpha_weighs_the_current_frame() -> None:
    network = small_network(motion="traditional")
    frame, following = random_frames(2)
    following["motion"][:] = 0
    black = following.with_channels(color=np.zeros_like(following["color"]))
    for bias, now, past in ((50.0, True, False), (-50.0, False, True)):
        network.prediction.heads.heads[0].bias[0] = bias  # of α before the sigmoid
        _, state = network.step(frame, None)
        forgotten = remembering(state, torch.zeros(1, 3, 24, 36))
        expected, changed, alone = (
            network.step(f, s, ("alpha",))[0] for f, s in ((following, state), (black, state), (following, forgotten))
        )
        np.testing.assert_allclose(expected.extras["alpha"], float(now), atol=1e-6)
        assert (changed.image.max() < 1e-6) == now  # black now, and nothing of the past
        assert (alone.image.max() < 1e-6) == past  # a black past, and nothing of now


def test_history_where_it_is_invalid_has_no_influence() -> None:
    network = small_network()
    frame, following = random_frames(2)
    following.channels["motion"][:] = 1e4  # everything comes from outside
    _, state = network.step(frame, None)
    other = remembering(state, state.tensors["history"] + 5)
    ours, theirs = (network.step(following, s)[0].image for s in (state, other))
    assert np.array_equal(ours, theirs)
    following.channels["motion"][:] = 0
    ours, theirs = (network.step(following, s)[0].image for s in (state, other))
    assert not np.array_equal(ours, theirs)


def half_invalid(motion_x: float = 1e4) -> tuple[Frame, Frame]:
    """Two frames; the left 18 of 36 columns of the second come from outside the image, the others stand still."""
    frame, following = random_frames(2)
    following["motion"][:] = 0
    following["motion"][:, 0, :, :18] = motion_x
    return frame, following


@pytest.mark.parametrize("variant", [*VARIANTS, {"scales": 1, "feed_warped": False}])
def test_temporal_kernels_leave_invalid_pixels_out(variant: dict[str, object]) -> None:
    # A history without noise, of one colour, and α of 0: whatever the kernels weigh, they can only give that colour.
    network = small_network(**variant)
    network.prediction.heads.heads[0].bias[
        0
    ] = -50.0  # of α before the sigmoid; of its first pixel where there are several
    if network.config.front == 2:
        network.prediction.heads.heads[0].bias[:4] = -50.0
    frame, following = half_invalid()
    following["previous_forward_motion"][:] = np.nan
    following["albedo"][:] = 1
    _, state = network.step(frame, None)
    colour = torch.tensor([0.2, 3.0, 7.0]).view(1, 3, 1, 1)
    state = remembering(state, colour.expand(1, 3, 24, 36).contiguous())
    result, after = network.step(following, state, ("alpha", "valid"))
    assert (result.extras["valid"][..., :18] == 0).all()
    assert (result.extras["valid"][..., 18:] == 1).all()
    # A 5×5 kernel reaches two pixels: columns 16 and 17 are served by their valid neighbours.
    np.testing.assert_allclose(after.tensors["history"][..., 16:], colour.expand(1, 3, 24, 20), rtol=1e-5)
    assert (result.extras["alpha"][..., 16:] < 1e-6).all()
    assert (result.extras["alpha"][..., :16] == 1).all()


def test_where_nothing_is_valid_the_current_frame_alone_counts() -> None:
    network = small_network()
    frame, following = half_invalid()
    _, state = network.step(frame, None)
    black = remembering(state, torch.zeros(1, 3, 24, 36))
    ours, theirs = (network.step(following, s)[0].image for s in (state, black))
    # Kernels may differ near the edge, where the network sees history; far from it nothing does.
    alpha = network.step(following, state, ("alpha",))[0].extras["alpha"]
    assert (alpha[..., :16] == 1).all()
    assert (alpha[..., 16:] < 1).any()
    assert not np.array_equal(ours[..., 18:], theirs[..., 18:])


def test_the_first_frame_blends_two_filtered_noisy_images() -> None:
    network = small_network()
    (frame,) = random_frames(1)
    result, _ = network.step(frame, None, ("alpha", "valid"))
    assert (result.extras["valid"] == 0).all()
    assert (result.extras["alpha"] < 1).all()


def test_gradients_are_finite_where_history_is_partly_invalid() -> None:
    network = small_network().requires_grad_(True)
    frame, following = half_invalid()
    run(network, [frame.torch(), following.torch()])[-1].sum().backward()
    assert all(parameter.grad is not None and parameter.grad.isfinite().all() for parameter in network.parameters())


@pytest.mark.parametrize("factor", [1e-6, 0.25, 1e4])
@pytest.mark.parametrize("variant", VARIANTS)
def test_the_output_has_the_units_of_the_input(variant: dict[str, object], factor: float) -> None:
    network = small_network(**variant)
    frames = random_frames(2)
    brighter = [f.with_channels(color=f["color"] * np.float32(factor)) for f in frames]
    for image, bright in zip(run(network, frames), run(network, brighter), strict=True):
        torch.testing.assert_close(bright / factor, image, rtol=1e-3, atol=1e-4)


def test_a_given_exposure_is_taken_and_changes_the_network_s_view() -> None:
    network = small_network()
    (frame,) = random_frames(1)
    given = replace(frame, exposure=np.array([7.0], np.float32))
    _, state = network.step(given, None)
    assert state.scalars.exposure.tolist() == [7]
    assert not torch.equal(*run(network, [frame]), *run(network, [given]))  # type: ignore[misc]


@pytest.mark.parametrize("scales", [1, 3])
def test_filtering_alone_stays_within_the_range_of_the_input(scales: int) -> None:
    (frame,) = random_frames(1, size=(20, 28))
    color = torch.from_numpy(frame["color"])
    low, high = color.amin((2, 3), keepdim=True), color.amax((2, 3), keepdim=True)
    network = small_network(scales=scales, temporal=False, feed_warped=False)
    (image,) = run(network, [frame])
    assert (image >= 0).all()
    if scales == 1:  # Eq. 4 may leave it
        assert ((image >= low * 0.9999) & (image <= high * 1.0001)).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_constant_stays_constant(variant: dict[str, object]) -> None:
    frames = random_frames(3)
    for frame in frames:
        frame["color"][:] = 3.0
        frame["albedo"][:] = 0.5
    for image in run(small_network(**variant), frames):
        torch.testing.assert_close(image, torch.full_like(image, 3.0), rtol=1e-4, atol=0)


BAD = {
    "color": [np.nan, np.inf, -1.0, 3e38], "albedo": [np.nan, np.inf, -1.0], "normal": [np.nan, np.inf, 1e9],
    "depth": [np.nan, np.inf, -1.0], "motion": [np.nan, np.inf, 1e30], "previous_forward_motion": [np.nan, 1e30],
}  # fmt: skip


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("share", [0.05, 1.0])
def test_bad_pixels_are_sanitised(variant: dict[str, object], name: str, share: float) -> None:
    rng = np.random.default_rng(0)
    frames = random_frames(3, batch=len(BAD[name]))  # a value for each sequence
    for frame in frames:
        for values, bad in zip(frame[name], BAD[name], strict=True):
            values[rng.random(values.shape) < share] = bad
    for image in run(small_network(**variant), frames):
        assert image.isfinite().all((1, 2, 3)).tolist() == [True] * len(BAD[name])
        assert (image >= 0).all()


def test_missing_forward_motion_is_scattered_and_only_dual_vectors_use_it() -> None:
    frames = random_frames(3)
    without = [Frame({k: v for k, v in f.channels.items() if k != "previous_forward_motion"}, f.index) for f in frames]
    dual, traditional = small_network(), small_network(motion="traditional")
    assert dual.optional == ("previous_forward_motion",)
    assert traditional.optional == ()
    assert not torch.equal(run(dual, frames)[-1], run(dual, without)[-1])
    assert torch.equal(run(traditional, frames)[-1], run(traditional, without)[-1])
    assert max(mask.max() for mask in run(dual, frames, "disoccluded")) == 1
    assert max(mask.max() for mask in run(traditional, frames, "disoccluded")) == 0


def test_arrays_are_returned_in_the_kind_that_was_given() -> None:
    network = small_network()
    (frame,) = random_frames(1)
    from_numpy, _ = network.step(frame, None, ("alpha",))
    from_torch, _ = network.step(frame.torch(), None, ("alpha",))
    pairs = (from_numpy.image, from_torch.image), (from_numpy.extras["alpha"], from_torch.extras["alpha"])
    for ours, theirs in pairs:
        assert isinstance(ours, np.ndarray)
        assert ours.dtype == np.float32
        assert isinstance(theirs, Tensor)
        assert np.array_equal(ours, theirs.numpy())


def test_bfloat16_is_close_to_full_precision() -> None:
    network = small_network()
    frames = random_frames(3)
    full = run(network, frames)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = run(network, frames)
    for image, rough in zip(full, mixed, strict=True):
        assert rough.dtype == torch.float32
        assert ((rough - image).abs() / (image + 0.1)).mean() < 0.01


def test_gradients_reach_every_weight_through_the_recurrence() -> None:
    network = small_network().requires_grad_(True)
    run_with_grad(network)[-1].sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name


def run_with_grad(network: TemporalDenoiser) -> list[Tensor]:
    return run(network, [frame.torch() for frame in random_frames(3)])


def test_what_does_not_fit_is_an_error() -> None:
    network = small_network()
    small, large = random_frames(1)[0], random_frames(1, size=(24, 40))[0]
    _, state = network.step(small, None)
    with pytest.raises(NteError, match=r"frame 0: .* \(1, 24, 40\) after \(1, 24, 36\): start a new sequence"):
        network.step(large, state)
    with pytest.raises(NteError, match="TemporalDenoiser has no extra 'kernels', expected one of disoccluded, valid, "):
        network.step(small, None, ("kernels",))
    with pytest.raises(NteError, match="channel 'albedo' is missing; it has color, motion"):
        network.step(Frame({"color": small["color"], "motion": small["motion"]}), None)
