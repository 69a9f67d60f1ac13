"""Accumulation and antialiasing along correspondences, and motion for those who have none."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.cli import main
from nte.denoiser import Denoiser, Result
from nte.errors import NteError
from nte.filters.align import SearchOptions, align
from nte.filters.align_accumulate import AlignAccumulate, AlignAccumulateOptions
from nte.filters.align_taa import AlignTaa, AlignTaaOptions
from nte.filters.estimated import Chooser, EstimatedMotion, EstimateOptions, Estimator, matched_grey
from nte.filters.taa import Taa, TaaOptions
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.motion.catmull_rom import warp_catmull_rom
from nte.motion.correspondence import FewerLevelsWarning, Search, find_correspondence, patch_error
from nte.motion.patch_distance import Norm
from nte.motion.search import SEARCHES
from nte.registry import load_denoiser
from nte.session import Session
from tests.synthetic import disc_frame, write_clip

pytestmark = pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")
SPEED = 3.0


def moving(count: int, noise: float = 0.0, seed: int = 0) -> list[Frame]:
    """A textured wall that moves by 3 px a frame, with noise of mean 1 and this deviation; `motion` says 0, wrongly."""
    rng = np.random.default_rng(seed)
    frames = []
    for index in range(count):
        channels = disc_frame(index, (96, 128), (SPEED, 0.0), (SPEED, 0.0))
        channels["color"] *= rng.gamma(1 / noise**2, noise**2, (1, 96, 128)).astype(np.float32) if noise else 1
        channels["motion"] *= 0
        frames.append(Frame({name: values[None] for name, values in channels.items()}, index))
    return frames


def error(image: np.ndarray, frame: Frame) -> float:
    """Mean |image − reference| without a border that has come into sight."""
    return float(np.abs(image - frame["reference"])[..., 8:-8, 24:-8].mean())


def test_accumulation_along_estimated_motion_beats_zero_and_wrong_geometric_motion() -> None:
    frames = moving(8, noise=0.5)
    errors = {}
    for motion in ("estimate", "zero", "geometric"):
        session = Session(AlignAccumulate(AlignAccumulateOptions(motion, noise="moderate", kappa=0, eta=0)))
        image = [session.denoise(frame) for frame in frames][-1]
        errors[motion] = error(image, frames[-1])
    assert errors["estimate"] < 0.6 * errors["zero"]
    assert errors["zero"] == errors["geometric"]  # the channel says 0
    assert errors["estimate"] < 0.6 * error(frames[-1]["color"], frames[-1])


@pytest.mark.parametrize("demodulate", [False, True])
def test_without_motion_and_rejection_it_is_the_mean_and_then_the_exponential_mean(demodulate: bool) -> None:
    rng = np.random.default_rng(1)
    albedo = rng.uniform(0.2, 0.9, (1, 3, 12, 16)).astype(np.float32)
    colors = rng.exponential(size=(6, 1, 3, 12, 16)).astype(np.float32)
    session = Session(
        AlignAccumulate(AlignAccumulateOptions("zero", kappa=0, eta=0, alpha=0.25, demodulate=demodulate))
    )
    mean = colors[0]
    for index, color in enumerate(colors):
        image = session.denoise(Frame({"color": color, "albedo": albedo}, index))
        weight = max(1 / (index + 1), 0.25)  # of the current frame
        mean = weight * color + (1 - weight) * mean
        np.testing.assert_allclose(image, mean, rtol=1e-4, atol=1e-5)


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
def test_frames_in_which_a_pixel_was_bad_do_not_count_in_its_mean() -> None:
    session = Session(AlignAccumulate(AlignAccumulateOptions(motion="zero", kappa=0)))
    for index, level in enumerate((1.0, 2.0, 3.0, 4.0, 9.0)):
        color = np.full((1, 3, 16, 16), level, np.float32)
        if 0 < index < 4:
            color[..., 5, 6] = np.nan
        result = session.step(Frame({"color": color}, index), ("history_length",))
    image, length = np.asarray(result.image), np.asarray(result.extras["history_length"])
    np.testing.assert_allclose(image[..., 5, 6], (1 + 9) / 2, rtol=1e-4)
    np.testing.assert_allclose(image[..., 9, 6], (1 + 2 + 3 + 4 + 9) / 5, rtol=1e-4)
    assert length[0, 0, 5, 6] == pytest.approx(2)
    assert length[0, 0, 9, 6] == pytest.approx(5)


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
@pytest.mark.parametrize(("spec", "share"), [("taa:clamp=none", 0.4), ("align_taa:motion=zero", 0.2)])
def test_pixels_that_were_bad_do_not_keep_their_neighbours_from_their_history(spec: str, share: float) -> None:
    session = Session(load_denoiser(spec))
    for index in range(10):
        bad = np.random.default_rng(index).random((24, 32)) < share
        color = np.where(bad, np.float32(np.nan), np.ones((1, 3, 24, 32), np.float32))
        image = session.denoise(Frame({"color": color, "motion": np.zeros((1, 2, 24, 32), np.float32)}, index))
    assert np.asarray(image).mean() == pytest.approx(1, rel=0.01)


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
@pytest.mark.parametrize(("spec", "most"), [("align_taa", 0.04), ("align_accumulate", 0.05), ("estimate", 0.1)])
@pytest.mark.parametrize("noise", [0.05, 0.3])
def test_a_hole_in_the_first_frame_does_not_mislead_the_vectors_around_it(spec: str, most: float, noise: float) -> None:
    """A black hole would repel them; filled with the mean of the image, it adds at most a third as much error."""
    frames, hole, errors = moving(2, noise, 3), (..., slice(30, 62), slice(46, 90)), {}
    around = np.zeros((96, 128), bool)
    around[24:68, 40:99] = True
    around[30:62, 46:93] = False  # the hole, and where it has moved to
    for holed in (False, True):
        session = Session(EstimatedMotion(Taa(TaaOptions("none"))) if spec == "estimate" else load_denoiser(spec))
        color = frames[0]["color"].copy()
        color[hole] = np.nan if holed else color[hole]
        session.denoise(frames[0].with_channels(color=color))
        image = session.denoise(frames[1])
        errors[holed] = np.sqrt(np.square(image - frames[1]["reference"])[..., around].mean())
    assert errors[True] < errors[False] + most


def test_demodulation_keeps_a_texture_that_moves_apart_from_the_light() -> None:
    """Light that stands still on a texture that moves: without albedo history at the same place is right."""
    texture = moving(4)
    light = disc_frame(0, (96, 128))["albedo"][None]
    errors = []
    for demodulated in (False, True):
        session = Session(AlignAccumulate(AlignAccumulateOptions("zero", kappa=0, eta=0, demodulate=demodulated)))
        for frame in texture:
            truth = frame["albedo"] * light
            image = session.denoise(frame.with_channels(color=truth))
        errors.append(np.abs(image - truth).mean())
    assert errors[1] < 1e-4
    assert errors[0] > 0.02


def test_the_mask_rejects_history_that_differs_and_keeps_what_agrees() -> None:
    dark, bright = (np.full((1, 3, 64, 64), value, np.float32) for value in (0.1, 5.0))
    mixed = np.concatenate([dark[..., :32], bright[..., 32:]], 3)
    denoiser = AlignAccumulate(AlignAccumulateOptions("zero", noise="clean", kappa=4, eta=0.2))
    _, state = denoiser.step(Frame({"color": dark}), None)
    result, _ = denoiser.step(Frame({"color": mixed}, 1), state, ("mask", "history_length", "motion"))
    mask = result.extras["mask"]
    assert (mask[..., :26] == 0).all()
    assert (mask[..., 36:] == 1).all()
    np.testing.assert_allclose(result.image[..., 36:], mixed[..., 36:], rtol=1e-5)
    assert (result.extras["history_length"][..., :26] == 2).all()
    assert (result.extras["history_length"][..., 36:] == 1).all()
    assert not result.extras["motion"].any()


@pytest.mark.parametrize("noise", ["clean", "moderate", "noisy"])
@pytest.mark.parametrize("norm", ["l2", "l1", "log_centred"])
def test_the_patch_error_of_given_motion_is_what_the_search_says_of_the_same_motion(noise: str, norm: Norm) -> None:
    """On a wall that moves and is noisy: constant images would not tell one motion's error from another's."""
    before, now = (frame.torch() for frame in moving(2, noise=0.3))
    frames = [matched_grey(frame["color"], torch.ones(1)) for frame in (now, before)]
    search = replace(SEARCHES[noise], norm=norm)
    found = find_correspondence(*frames, search)
    given = Frame({"motion": found.motion})
    aligned = align(*frames, given, "geometric", Chooser(noise, {"norm": norm}))
    torch.testing.assert_close(aligned.error, found.error)
    off = patch_error(*frames, found.motion + 2, search)
    assert off.mean() > 1.1 * found.error.mean()  # a wrong motion has a larger error


def test_true_vectors_are_kept_at_one_sample_per_pixel() -> None:
    """A wall that moves, lit evenly to the left and by rare bright samples to the right: the mask keeps both."""
    rng, frames = np.random.default_rng(0), []
    for frame in moving(3):
        noise = rng.gamma(1 / 8, 8, frame["color"].shape[-2:]).astype(np.float32)
        noise[:, :64] = rng.gamma(1, 1, (96, 64))
        vectors = np.full_like(frame["motion"], 0) - np.array([SPEED, 0], np.float32).reshape(1, 2, 1, 1)
        frames.append(frame.with_channels(color=frame["color"] * noise, motion=vectors))
    for preset in ("noisy", "auto"):
        session = Session(AlignAccumulate(AlignAccumulateOptions("geometric", noise=preset)))
        for frame in frames:
            mask = session.step(frame, ("mask",)).extras["mask"]
        assert (mask[..., 4:64] > 0).mean() < 0.02
        assert (mask[..., 68:] > 0).mean() < 0.02


@pytest.mark.parametrize("sky", [0.0, 0.7])
def test_true_vectors_are_kept_before_a_background_without_noise(sky: float) -> None:
    """Most of the image is clean, but what is seen before it has one sample per pixel: the search is one for noise."""
    rng, session = np.random.default_rng(0), Session(AlignAccumulate(AlignAccumulateOptions("geometric")))
    y, x = np.indices((96, 128))
    for index, frame in enumerate(moving(3)):
        thing = (x - 60 - SPEED * index) ** 2 + (y - 50) ** 2 < 34**2
        color = np.where(thing, frame["color"] * rng.exponential(size=(96, 128)), sky).astype(np.float32)
        vectors = np.where(thing, np.reshape([-SPEED, 0], (2, 1, 1)), 0)[None].astype(np.float32)
        mask = session.step(frame.with_channels(color=color, motion=vectors), ("mask",)).extras["mask"]
    assert (mask[0, 0][thing] > 0).mean() < 0.02


def test_catmull_rom_reproduces_whole_shifts_and_parabolas() -> None:
    y, x = torch.meshgrid(torch.arange(20.0), torch.arange(24.0), indexing="ij")
    image = (0.1 * x * x - 0.2 * x * y + y)[None, None]
    shift = torch.tensor([2.0, -3.0]).view(1, 2, 1, 1).expand(1, 2, 20, 24)
    whole = warp_catmull_rom(image, shift)
    torch.testing.assert_close(whole.image[..., 3:, :-2], image[..., :-3, 2:])
    assert torch.equal(whole.valid[0, 0], (x + 0.5 + 2 <= 24) & (y + 0.5 - 3 >= 0))
    part = torch.tensor([0.3, 0.6]).view(1, 2, 1, 1).expand(1, 2, 20, 24)
    expected = 0.1 * (x + 0.3) ** 2 - 0.2 * (x + 0.3) * (y + 0.6) + y + 0.6
    inner = (slice(2, -3), slice(2, -3))
    torch.testing.assert_close(warp_catmull_rom(image, part).image[0, 0][inner], expected[inner], rtol=1e-4, atol=1e-4)
    assert not warp_catmull_rom(image, part * float("nan")).valid.any()


def edges(count: int) -> tuple[list[Frame], np.ndarray]:
    """A still disc, every pixel sampled at a random place in it: aliased frames, and what they are the samples of."""
    rng = np.random.default_rng(0)
    y, x = np.meshgrid(np.arange(48), np.arange(64), indexing="ij")

    def sample(dx: np.ndarray, dy: np.ndarray) -> np.ndarray:
        return np.where((x + dx - 32) ** 2 + (y + dy - 24) ** 2 < 14.3**2, 2.0, 0.2)

    offsets = rng.random((256, 2, 48, 64))
    truth = np.mean([sample(*offset) for offset in offsets], 0)
    frames = []
    for index in range(count):
        color = sample(*rng.random((2, 48, 64))).astype(np.float32)[None, None].repeat(3, 1)
        albedo, normal = color / 4, np.zeros_like(color)
        normal[:, 2] = 1
        frames.append(Frame({"color": color, "albedo": albedo, "normal": normal}, index))
    return frames, truth.astype(np.float32)


@pytest.mark.parametrize("options", [{}, {"guides": True}, {"tolerance": "adaptive"}])
def test_taa_smooths_edges_and_leaves_flat_areas_alone(options: dict[str, object]) -> None:
    frames, truth = edges(24)
    session = Session(AlignTaa(AlignTaaOptions(**options)))  # type: ignore[arg-type]
    images = [session.denoise(frame)[0, 0] for frame in frames]
    aliased = np.mean([np.abs(frame["color"][0, 0] - truth).mean() for frame in frames[8:]])
    smoothed = np.mean([np.abs(image - truth).mean() for image in images[8:]])
    assert smoothed < 0.9 * aliased
    np.testing.assert_array_equal(images[-1][:4], frames[-1]["color"][0, 0, :4])  # far from the edge m is 0
    inputs = [frame["color"][0, 0] for frame in frames]
    after, before = (np.mean([np.abs(b - a).mean() for a, b in pairwise(s)]) for s in (images[8:], inputs[8:]))
    assert after < 0.9 * before  # clipping to 1σ of 3×3 pixels allows no more


def test_taa_weighs_the_current_frame_with_alpha_where_the_mask_is_1_and_wholly_where_it_is_0() -> None:
    rng = np.random.default_rng(0)
    frames = [Frame({"color": rng.random((1, 3, 24, 24), np.float32)}, i) for i in range(2)]
    changed = AlignTaa(AlignTaaOptions("zero", kappa=1e6, alpha=0.25))
    _, state = changed.step(frames[0], None)
    image = changed.step(frames[1], state, ("mask",))[0]
    assert (image.extras["mask"] == 1).all()
    everything = AlignTaa(AlignTaaOptions("zero", kappa=0))
    _, state = everything.step(frames[0], None)
    kept = everything.step(frames[1], state, ("mask",))[0]
    assert not kept.extras["mask"].any()
    np.testing.assert_allclose(kept.image, frames[1]["color"], rtol=1e-6)
    history = (image.image - 0.25 * frames[1]["color"]) / 0.75
    local = torch.from_numpy(frames[1]["color"]).unfold(2, 3, 1).unfold(3, 3, 1).flatten(4)
    mean, deviation = local.mean(4).numpy(), local.std(4, correction=0).numpy()
    assert (np.abs(history[..., 1:-1, 1:-1] - mean) <= deviation + 1e-3).all()


def test_the_adaptive_tolerance_is_looser_where_albedo_and_normal_agree() -> None:
    """A shadow that has left: the still albedo lets history differ by 2σ, a changed albedo by half a σ."""
    rng = np.random.default_rng(0)
    before, now = (base + 0.2 * rng.random((1, 3, 24, 24)).astype(np.float32) for base in (0.0, 1.0))
    same = np.full((1, 3, 24, 24), 0.5, np.float32)
    normal = np.zeros_like(same)
    distances = {}
    for name, albedo in (("same", same), ("other", same + 0.4)):
        denoiser = AlignTaa(AlignTaaOptions("zero", tolerance="adaptive", kappa=1e6, alpha=0.1))
        _, state = denoiser.step(Frame({"color": before, "albedo": same, "normal": normal}), None)
        image = denoiser.step(Frame({"color": now, "albedo": albedo, "normal": normal}, 1), state)[0].image
        distances[name] = np.abs(image - now).mean()
    assert distances["same"] > 1.5 * distances["other"]


class Recorder(Denoiser):
    """A denoiser that keeps the frames it was given."""

    needs: tuple[str, ...] = ("color", "motion")
    optional: tuple[str, ...] = ("previous_forward_motion",)

    def __init__(self) -> None:
        self.frames: list[Frame] = []

    def step(self, frame: Frame, state: object, extras: tuple[str, ...] = ()) -> tuple[Result, object]:
        self.frames.append(frame)
        return Result(frame["color"]), ()


def errors_of_motion(denoiser: Denoiser, frames: list[Frame]) -> list[np.ndarray]:
    """The distance (H, W) of the motion from the true one, px, in each frame but the first."""
    session = Session(denoiser)
    if isinstance(denoiser, EstimatedMotion):
        for frame in frames:
            session.step(frame)
        assert isinstance(denoiser.denoiser, Recorder)
        found = [frame["motion"] for frame in denoiser.denoiser.frames]
    else:
        found = [session.step(frame, ("motion",)).extras["motion"] for frame in frames]
    true = np.array([-SPEED, 0]).reshape(2, 1, 1)
    return [np.sqrt(np.square(np.asarray(motion)[0] - true).sum(0)) for motion in found[1:]]


@pytest.mark.parametrize("kind", ["align_taa", "estimate"])
@pytest.mark.parametrize("spoilt", [("albedo",), ("normal",), ("albedo", "normal")])
@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
def test_a_hole_in_the_guides_does_not_mislead_the_vectors_around_it(
    kind: str, spoilt: tuple[str, ...], index: int
) -> None:
    """Sanitised, it is 0, as black as a sky: the vectors around it would be wrong by ten pixels and more."""
    frames = moving(3)
    hole = {name: frames[index][name].copy() for name in spoilt}
    for values in hole.values():
        values[..., 30:62, 46:90] = np.nan
    frames[index] = frames[index].with_channels(**hole)
    wrapper = EstimatedMotion(Recorder(), EstimateOptions(guides=True))
    errors = errors_of_motion(wrapper if kind == "estimate" else AlignTaa(AlignTaaOptions(guides=True)), frames)
    around = np.zeros((96, 128), bool)
    around[22:70, 40:98] = True
    around[30:62, 43:93] = False  # the hole, and where it has moved to
    assert all(error[around].mean() < 0.6 for error in errors)


@pytest.mark.parametrize("kind", ["align_taa", "align_accumulate", "estimate"])
def test_an_exposure_that_a_frame_gives_is_the_one_in_which_it_is_searched(kind: str) -> None:
    """A cave, and then the open, 10⁶ times as bright: displayed in the cave's exposure, everything would be white."""
    made = {"align_taa": AlignTaa, "align_accumulate": AlignAccumulate}
    frames = []
    for index, frame in enumerate(moving(4)):
        light = 1.0 if index < 2 else 1e6
        color = frame["color"] * np.float32(light)
        frames.append(replace(frame.with_channels(color=color), exposure=np.float32([0.2 / light])))
    wrapper = EstimatedMotion(Recorder())
    errors = errors_of_motion(wrapper if kind == "estimate" else made[kind](), frames)
    inner = (slice(12, -12), slice(24, -12))
    assert errors[0][inner].mean() < 0.1
    assert errors[2][inner].mean() < 0.1  # errors[1] is that of the change


@pytest.mark.parametrize("kind", ["align_taa", "align_accumulate", "estimate"])
def test_light_that_stays_is_found_when_only_the_exposure_changes(kind: str) -> None:
    made = {"align_taa": AlignTaa, "align_accumulate": AlignAccumulate}
    frames = [replace(f, exposure=np.float32([e])) for f, e in zip(moving(3), (0.2, 2.0, 0.05), strict=True)]
    wrapper = EstimatedMotion(Recorder())
    for errors in errors_of_motion(wrapper if kind == "estimate" else made[kind](), frames):
        assert errors[12:-12, 24:-12].mean() < 0.1


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_the_wrapper_supplies_the_motion_that_the_images_show(kind: str) -> None:
    inner = Recorder()
    wrapped = EstimatedMotion(inner, EstimateOptions("moderate"))
    assert wrapped.needs == ("color",)
    assert wrapped.optional == ()
    session = Session(wrapped)
    for frame in moving(3):
        session.step(frame if kind == "numpy" else frame.torch())
    assert not np.asarray(inner.frames[0]["motion"]).any()
    for seen in inner.frames[1:]:
        assert isinstance(seen["motion"], np.ndarray) == (kind == "numpy")
        assert "forward_motion" not in seen
        motion = np.asarray(seen["motion"])[..., 12:-12, 24:-12]
        assert np.abs(motion - np.array([-SPEED, 0]).reshape(1, 2, 1, 1)).mean() < 0.3


def test_the_wrapper_makes_taa_without_vectors_better_than_with_none() -> None:
    frames = moving(6, noise=0.5)
    bare = [Frame({"color": frame["color"]}, frame.index) for frame in frames]
    estimated, zero = (
        Session(EstimatedMotion(Taa(TaaOptions("none")), EstimateOptions("moderate"))),
        Session(Taa(TaaOptions("none"))),
    )
    for without, still in zip(bare, frames, strict=True):
        images = estimated.denoise(without), zero.denoise(still)
    assert error(images[0], frames[-1]) < 0.7 * error(images[1], frames[-1])


def test_without_a_name_the_search_is_chosen_by_the_noise_of_the_images() -> None:
    chooser = Chooser()
    grey = matched_grey(moving(1)[0].torch()["color"], torch.ones(1))
    assert chooser(grey) == [SEARCHES["clean"]]
    assert chooser(matched_grey(moving(1, noise=1.0)[0].torch()["color"], torch.ones(1))) == [SEARCHES["noisy"]]
    assert Chooser("strong")(grey) == [SEARCHES["strong"]]
    assert Chooser("auto", {"radii": (3, 2)})(grey)[0].radii == (3, 2)


def test_known_vectors_are_kept_and_the_rest_is_searched() -> None:
    frames, rows = moving(2), (slice(None), slice(None), slice(0, 40))
    vectors = np.full_like(frames[1]["motion"], np.nan)
    vectors[rows] = 7.5
    inner = Recorder()
    wrapped = EstimatedMotion(inner, EstimateOptions("clean", known=True))
    assert "motion" in wrapped.needs
    _, state = wrapped.step(frames[0], None)
    wrapped.step(frames[1].with_channels(motion=vectors), state)
    motion = inner.frames[1]["motion"]
    assert (motion[rows] == 7.5).all()
    below = motion[..., 60:-12, 24:-12] - np.array([-SPEED, 0]).reshape(1, 2, 1, 1)
    assert np.abs(below).mean() < 0.3


def test_guides_are_searched_where_light_is_only_noise() -> None:
    rng = np.random.default_rng(0)
    inner = Recorder()
    session = Session(EstimatedMotion(inner, EstimateOptions(guides=True)))
    for frame in moving(2):
        session.step(frame.with_channels(color=rng.exponential(size=frame["color"].shape).astype(np.float32)))
    motion = inner.frames[1]["motion"][..., 12:-12, 24:-12]
    assert np.abs(motion - np.array([-SPEED, 0]).reshape(1, 2, 1, 1)).mean() < 0.3
    with pytest.raises(NteError, match="albedo, normal"):
        Session(EstimatedMotion(Recorder(), EstimateOptions(guides=True))).step(Frame({"color": frame["color"]}))


def test_the_search_runs_on_the_device_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """On PyTorch's `meta` device, which computes nothing: what arrives there was sent there."""
    searched: list[str] = []

    def record(current: torch.Tensor, previous: torch.Tensor, *_: object) -> torch.Tensor:
        searched.extend(image.device.type for image in (current, previous))
        return current.repeat(1, 2, 1, 1)

    monkeypatch.setattr("nte.filters.estimated.find_motion", record)
    monkeypatch.setattr("nte.filters.estimated.sequence_exposure", lambda frame, carried: np.ones(1, np.float32))
    estimator, state = Estimator(EstimateOptions("clean"), device="meta"), None
    for frame in moving(2):
        found, state = estimator.step(frame, state)
    assert searched == ["meta", "meta"]
    assert found.motion.device.type == "meta"
    wrapped = load_denoiser("estimate+taa", "meta")
    assert isinstance(wrapped, EstimatedMotion)
    assert wrapped.estimator.device == "meta"


def test_a_sequence_that_restarts_has_no_motion() -> None:
    inner = Recorder()
    session = Session(EstimatedMotion(inner, EstimateOptions("moderate")))
    frames = moving(2)
    twice = [Frame({"color": f["color"].repeat(2, 0)}, f.index, reset=np.array([0, 1], np.float32)) for f in frames]
    for frame in twice:
        session.step(frame)
    motion = inner.frames[1]["motion"]
    assert motion[0].any()
    assert not motion[1].any()


def test_names_and_options_of_the_registry() -> None:
    wrapped = load_denoiser("estimate+taa:clamp=clip")
    assert isinstance(wrapped, EstimatedMotion)
    assert isinstance(wrapped.denoiser, Taa)
    assert wrapped.denoiser.options.clamp == "clip"
    chosen = load_denoiser("estimate:noise=strong,guides=true,known=1+taa:clamp=clip")
    assert isinstance(chosen, EstimatedMotion)
    assert chosen.estimator.choose.noise == "strong"
    assert chosen.needs == ("color", "albedo", "normal", "motion")
    assert isinstance(chosen.denoiser, Taa)
    accumulate = load_denoiser("align_accumulate:radii=10-4-2-2,kappa=2,eta=0.1,demodulate=true,motion=geometric")
    assert isinstance(accumulate, AlignAccumulate)
    assert accumulate.choose(torch.zeros(1, 1, 8, 8))[0].radii == (10, 4, 2, 2)
    assert accumulate.needs == ("color", "motion", "albedo")
    assert load_denoiser("align_taa:guides=true").needs == ("color", "albedo", "normal")
    for spec, message in (
        ("estimate:noise=grain+taa", "noise is 'grain', expected one of auto, clean"),
        ("estimate:speed=2+taa", "unknown option 'speed', expected one of noise, guides, known$"),
        ("estimate:denoiser=svgf+taa", "unknown option 'denoiser'"),
        ("estimate:noise=clean", "'estimate:noise=clean' is no denoiser"),
        ("align_accumulate:motion=optical", "motion is 'optical', expected one of estimate, zero, geometric"),
        ("align_accumulate:radii=2-x", "radii is '2-x', expected whole numbers"),
        ("align_accumulate:norm=l7", "norm is 'l7', expected one of"),
        ("align_accumulate:target=visibility", "target is 'visibility', expected one of color, indirect, glossy"),
        ("align_accumulate:alpha=0", "alpha is 0.0, expected a weight"),
        ("align_accumulate:kappa=-1", "kappa is -1.0, expected a finite number of 0 or more"),
        ("align_taa:tolerance=none", "tolerance is 'none', expected one of fixed, adaptive"),
        ("align_taa:noise=grain", "noise is 'grain', expected one of auto, clean, moderate, noisy, strong"),
    ):
        with pytest.raises(NteError, match=message):
            load_denoiser(spec)
    for options, message in (
        (lambda: AlignTaaOptions(radii=(4, -1)), r"^align_taa: radii are \(4, -1\), expected "),
        (lambda: AlignAccumulateOptions(radii=(-1,)), r"^align_accumulate: radii are \(-1,\), expected "),
        (lambda: SearchOptions(alpha=2), "^SearchOptions: alpha is 2, expected a weight"),
    ):
        with pytest.raises(NteError, match=message):
            options()
    with pytest.raises(NteError, match="no extra 'flow'"):
        AlignTaa().step(moving(1)[0], None, ("flow",))


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
@pytest.mark.parametrize("denoiser", [AlignTaa(), AlignAccumulate(), EstimatedMotion(Taa())])
def test_bad_pixels_give_finite_images_and_sizes_may_not_change(denoiser: AlignTaa) -> None:
    session = Session(denoiser)
    for frame in moving(2):
        frame["color"][..., 40, 40:50] = np.nan
        frame["color"][..., 41, 40:50] = np.inf
        assert np.isfinite(session.denoise(frame)).all()
    with pytest.raises(NteError, match="start a new sequence"):
        session.denoise(Frame({"color": np.ones((1, 3, 8, 8), np.float32)}, 2))


def test_small_frames_are_told_about() -> None:
    session = Session(AlignAccumulate())
    tiny = Frame({"color": np.ones((1, 3, 8, 8), np.float32)})
    session.denoise(tiny)
    with pytest.warns(FewerLevelsWarning) as told:
        np.testing.assert_allclose(session.denoise(tiny), 1, rtol=1e-5)
    assert told[0].filename == __file__


def test_what_is_compared_is_displayed_luminance() -> None:
    grey = matched_grey(torch.full((1, 3, 2, 2), 0.5), torch.tensor([2.0]))
    assert grey.shape == (1, 1, 2, 2)
    assert grey.mean().item() == pytest.approx(1.055 * 0.5 ** (1 / 2.4) - 0.055, abs=1e-4)
    assert Search().gain > 1


def test_denoise_estimates_motion_for_a_clip_that_has_none(tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip", [{"color": frame["color"][0]} for frame in moving(2)])
    told = ["denoise", str(clip), "--denoiser", "taa", "--out"]
    assert main([*told, str(tmp_path / "without")]) == 2  # it needs motion
    assert main([*told, str(tmp_path / "with"), "--motion", "estimate"]) == 0
    written = Clip(tmp_path / "with").frame(1)["color"]
    expected = Session(EstimatedMotion(Taa()))
    images = [expected.denoise(frame) for frame in Clip(clip)]
    np.testing.assert_allclose(written, images[1], rtol=2e-3)  # stored as half floats


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
@pytest.mark.parametrize("spec", ["align_accumulate", "align_taa", "estimate+taa", "estimate+align_taa"])
def test_a_sequence_that_restarts_in_a_batch_is_a_new_one(spec: str) -> None:
    """It is 20 times as bright as the one that it follows, and its first frame has a bad pixel."""
    frames, extras = moving(5, noise=0.2), ("motion", "mask") if spec.startswith("align") else ()
    dark, bright = frames[:4], [f.with_channels(color=20 * f["color"][..., ::-1, :]) for f in frames[:2]]
    bright[0]["color"][..., 40:44, 60:64] = np.nan
    first = [f["color"] for f in dark[:2]] + [f["color"] for f in bright]
    batch = [
        Frame({"color": np.concatenate([beside["color"], of])}, index, reset=np.array([0, index == 2], np.float32))
        for index, (beside, of) in enumerate(zip(dark, first, strict=True))
    ]
    together, alone = Session(load_denoiser(spec)), Session(load_denoiser(spec))
    results = [together.step(frame, extras) for frame in batch][2:]
    for ours, frame in zip(results, bright, strict=True):
        expected = alone.step(Frame({"color": frame["color"]}, frame.index), extras)
        np.testing.assert_allclose(ours.image[1:], expected.image, rtol=1e-5, atol=1e-6)
        for name in extras:
            np.testing.assert_allclose(ours.extras[name][1:], expected.extras[name], atol=1e-5)
