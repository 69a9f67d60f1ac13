"""Light accumulated before a spatial denoiser: noise falls where nothing changes, and nothing lags behind."""

import numpy as np
import pytest
import torch

from nte import Frame, NteError, Session
from nte.filters.accumulation import History, Surface, _index, accumulate, with_denoised
from nte.filters.change import in_blocks
from nte.frames.clip import Pixels
from nte.motion.geometric import dual_motion
from nte.registry import load_denoiser
from nte.session import MissingChannelWarning
from tests.filters.noisy_scene import H, Scene, W, by_oidn, error, glance, interleaved

pyoidn = pytest.importorskip("pyoidn")


def run(scene: Scene, frames: int, lights: dict[int, float] | None = None) -> tuple[Pixels, Pixels, Pixels, History]:
    """The last frame of a sequence: accumulated, as it came, and clean, and the history; `lights` from a frame on."""
    history, light = None, 1.0
    for frame in range(frames):
        light = (lights or {}).get(frame, light)
        clean, albedo = scene.clean(frame, light)
        color, surface = scene.noisy(clean, frame), scene.surface(albedo)
        mean, history = accumulate(color, surface, history, 8, glance(albedo))
        history = with_denoised(history, clean, surface)
    return mean, color, clean, history


def test_noise_falls_where_nothing_changes() -> None:
    mean, color, clean, history = run(Scene(), 12)
    assert error(mean, clean) < 0.4 * error(color, clean)
    assert history.length.mean() > 2


@pytest.mark.parametrize("motion", [(3.0, -2.0), (1.5, 0.5), (-0.3, 0.25)])
def test_noise_falls_along_the_motion_and_the_texture_stays(motion: tuple[float, float]) -> None:
    mean, color, clean, _ = run(Scene(motion), 12)
    assert error(mean, clean) < 0.6 * error(color, clean)


def test_the_mean_has_the_brightness_of_the_light() -> None:
    mean, _, clean, _ = run(Scene((0.4, 0.3)), 12)
    assert abs(float(mean.mean() / clean.mean()) - 1) < 0.03  # the noise of four frames gives ±0.01


def test_a_slow_motion_moves_the_history() -> None:
    """A third of a pixel would be rounded to none in every frame, and what was accumulated would stay on the screen."""
    history, slope = None, 1e-3
    for frame in range(12):
        clean = np.float32(1 + slope * (np.arange(W) + 0.5 - 0.3 * frame))
        color = np.broadcast_to(clean, (3, H, W)).copy()
        motion = np.broadcast_to(np.float32([-0.3, 0])[:, None, None], (2, H, W)).copy()
        mean, history = accumulate(color, Surface(None, motion, None, -motion), history, 8, glance())
    inner = np.s_[:, 8:-8]
    assert history.length[inner].min() > 3
    assert abs(history.beside[:, *inner]).max() < 1
    # The light is that of the place where the history says that it comes from.
    np.testing.assert_allclose((mean - color)[0][inner], slope * history.beside[0][inner], atol=2e-6)


@pytest.mark.parametrize("light", [0.5, 1.5, 4.0])
def test_light_that_changes_everywhere_leaves_no_trace(light: float) -> None:
    scene = Scene()
    mean, color, clean, history = run(scene, 9, {8: light})
    # Seen over a neighbourhood, as a spatial denoiser sees it, the mean is that of the frame itself.
    lag = abs(float((mean / clean).mean()) - 1), abs(float((color / clean).mean()) - 1)
    assert lag[0] < lag[1] + 0.03
    assert history.length.max() < 1.3


def test_a_shadow_that_arrives_is_not_late() -> None:
    scene, history = Scene(), None
    for frame in range(9):
        clean, albedo = scene.clean(frame)
        if frame == 8:
            clean = clean.copy()
            clean[:, 20:40, 25:55] *= 0.2
        mean, history = accumulate(scene.noisy(clean, frame), scene.surface(albedo), history, 8, glance(albedo))
        history = with_denoised(history, clean, scene.surface(albedo))
    inside = np.s_[24:36, 30:50]
    assert (mean / clean)[:, *inside].mean() < 1.25  # five times as bright without a test; the noise alone gives ±0.1
    assert history.length[inside].max() < 1.3
    assert history.length[:, :8].mean() > 2  # far from the shadow the history stays


@pytest.mark.parametrize("noise", [0.1, 0.5])
def test_shadows_of_slats_that_run_leave_no_trace(noise: float) -> None:
    """As wide as what statistics of neighbourhoods see, they are light that changes in both directions at once."""
    scene, history = Scene(noise=noise, contrast=0.3), None
    for frame in range(6):
        clean, albedo = scene.clean(0)
        slats = (np.mgrid[:H, :W][1] + np.mgrid[:H, :W][0] // 3 - 6 * frame) % 24 < 11
        clean = np.where(slats, np.float32(0.1), np.float32(1)) * clean
        color, surface = scene.noisy(clean, frame), scene.surface(albedo)
        mean, history = accumulate(color, surface, history, 8, glance(albedo))
        history = with_denoised(history, by_oidn(interleaved(mean), interleaved(albedo)), surface)
    trace = np.log1p(mean) - np.log1p(clean)
    of_noise = np.log1p(color) - np.log1p(clean)
    assert np.square(trace)[:, 6:-6, 6:-6].mean() < 1.2 * np.square(of_noise)[:, 6:-6, 6:-6].mean()


@pytest.mark.parametrize("motion", [(0.0, 0.0), (0.5, 0.5), (2.3, -1.4)])
def test_a_frame_with_little_noise_is_not_made_worse(motion: tuple[float, float]) -> None:
    mean, color, clean, _ = run(Scene(motion, noise=0.02), 10)
    assert error(mean, clean) < 1.5 * error(color, clean)


@pytest.mark.parametrize("motion", [(0.0, 0.0), (0.5, 0.5)])
def test_a_converged_frame_stays(motion: tuple[float, float]) -> None:
    mean, color, _, _ = run(Scene(motion, noise=1e-4), 6)
    assert np.quantile(abs(mean / color - 1), 0.999) < 0.01


@pytest.mark.parametrize("noise", [1.0, 0.3])
def test_light_that_changes_its_colour_alone_leaves_no_trace(noise: float) -> None:
    """Red becomes green of the same luminance."""
    scene, history = Scene(noise=noise), None
    for frame in range(9):
        clean, albedo = scene.clean(0)
        clean = clean.mean(0) * np.float32([1.0, 0.2, 0.3] if frame < 8 else [0.2, 0.438, 0.3])[:, None, None]
        mean, history = accumulate(scene.noisy(clean, frame), scene.surface(albedo), history, 8, glance(albedo))
    assert abs((mean / clean).mean((1, 2)) - (scene.noisy(clean, 8) / clean).mean((1, 2))).max() < 0.05


def test_a_lamp_takes_no_history_from_what_is_beside_it() -> None:
    """A lamp itself has none, as it has no albedo, and cuts through blocks."""
    scene, history = Scene(noise=0.3, contrast=0.3), None
    lamp = np.s_[:, 22:37, 33:50]
    for frame in range(9):
        clean, albedo = scene.clean(0)
        clean[lamp], albedo[lamp] = 50, 0
        color, surface = scene.noisy(clean, frame), scene.surface(albedo)
        mean, history = accumulate(color, surface, history, 8, glance(albedo))
        history = with_denoised(history, by_oidn(interleaved(mean), interleaved(albedo), clean_aux=True), surface)
    assert (history.length[lamp[1:]] == 1).all()
    above, far = history.length[16:22, 33:50].mean(), history.length[:8].mean()
    assert above > 0.7 * far


def test_shadows_of_slats_are_seen_in_blocks_that_stick_out_of_the_picture() -> None:
    rng, history = np.random.default_rng(0), None
    still = Surface(None, np.zeros((2, 3, W), np.float32), np.ones((1, 3, W), np.float32), None)
    for frame in range(6):
        slats = (np.mgrid[:3, :W][1] - 6 * frame) % 24 < 11
        clean = np.where(slats, np.float32(0.1), np.ones((3, 1, 1), np.float32))
        noisy = clean * np.float32(rng.gamma(1.0, 1.0, (3, W)))
        _, history = accumulate(noisy, still, history, 8, lambda _, seen=clean: in_blocks(seen))
        history = with_denoised(history, clean, still)
    assert history.length.mean() < 1.1


def test_a_screen_has_no_history() -> None:
    """It has no albedo, and what it shows moves otherwise than it does."""
    scene, history = Scene((3.0, 0.0), noise=0.02), None
    for frame in range(4):
        clean, albedo = scene.clean(frame)
        color, screen = scene.noisy(clean, frame), Scene().surface(0 * albedo)
        mean, history = accumulate(color, screen, history, 8, glance())
        history = with_denoised(history, clean, screen)
    np.testing.assert_allclose(mean, color, rtol=1e-5)


@pytest.mark.parametrize("factor", [1e-4, 1e4])
def test_a_sequence_that_begins_with_another_brightness_finds_its_changes(factor: float) -> None:
    scene, history = Scene(), None
    for frame in range(9):
        clean, albedo = scene.clean(frame, factor if frame == 0 else 0.3 if frame == 8 else 1.0)
        mean, history = accumulate(scene.noisy(clean, frame), scene.surface(albedo), history, 8, glance(albedo))
        history = with_denoised(history, clean, scene.surface(albedo))
    assert (mean / clean).mean() < 1.15


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_light_that_fades_for_long_leaves_no_trace(factor: float) -> None:
    """Halved in every frame, it soon is black in the exposure of the first one."""
    scene = Scene(noise=0.5)
    mean, color, clean, _ = run(scene, 20, {frame: factor**frame for frame in range(20)})
    assert abs(float((mean / clean).mean() / (color / clean).mean()) - 1) < 0.05


def test_there_are_indices_for_as_many_pixels_as_8k_has() -> None:
    place = np.float32([[[7679.5]], [[4319.5]]])
    assert _index(place, np.float32([7680, 4320])[:, None, None]).item() == 7680 * 4320 - 1


def test_strips_are_as_the_whole_image(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene((1.7, -2.6))
    whole = run(scene, 6)
    monkeypatch.setattr("nte.filters.accumulation.STRIP", 8)
    np.testing.assert_array_equal(run(scene, 6)[0], whole[0])


@pytest.mark.parametrize("threads", ["auto", "-1", "1.5", "0", " 2 "])
def test_a_number_of_threads_that_is_none_is_as_if_not_given(monkeypatch: pytest.MonkeyPatch, threads: str) -> None:
    """So it is to OIDN itself."""
    usual = run(Scene(), 2)
    monkeypatch.setenv("OIDN_NUM_THREADS", threads)
    np.testing.assert_array_equal(run(Scene(), 2)[0], usual[0])


def test_a_constant_stays_constant() -> None:
    color, history = np.full((3, 9, 7), 3.0, np.float32), None
    still = Surface(None, np.zeros((2, 9, 7), np.float32), np.ones((1, 9, 7), np.float32), None)
    for _ in range(4):
        mean, history = accumulate(color, still, history, 8, lambda blocks: blocks)  # OIDN has a bias of its own
        history = with_denoised(history, color, still)
        np.testing.assert_allclose(mean, 3, rtol=1e-6)
    np.testing.assert_allclose(history.length, 4, rtol=1e-3)


def hidden_by_a_square(forward: bool, depth: bool) -> tuple[Surface, np.ndarray]:
    """A bright square in front of a dark wall that moves by six pixels; where it was, the wall has no history."""
    motion, distance = np.zeros((2, H, W), np.float32), np.full((1, H, W), 9.0, np.float32)
    motion[0, 20:40, 36:56], distance[0, 20:40, 36:56] = -6, 2.0
    ahead = np.zeros((2, H, W), np.float32)
    ahead[0, 20:40, 30:50] = 6
    uncovered = np.zeros((H, W), bool)
    uncovered[20:40, 30:36] = True
    return Surface(None, motion, distance if depth else None, ahead if forward else None), uncovered


@pytest.mark.parametrize(("forward", "depth"), [(True, True), (True, False), (False, True)])
def test_what_was_hidden_has_no_history(forward: bool, depth: bool) -> None:
    surface, uncovered = hidden_by_a_square(forward, depth)
    before, now = np.full((3, H, W), 0.5, np.float32), np.full((3, H, W), 0.5, np.float32)
    before[:, 20:40, 30:50] = now[:, 20:40, 36:56] = 0.6  # too alike to be told by their light
    distance = np.full((1, H, W), 9.0, np.float32)
    distance[0, 20:40, 30:50] = 2.0
    rng = np.random.default_rng(0)
    noise = [np.float32(rng.gamma(1.0, 1.0, (H, W))) for _ in range(2)]
    first = Surface(None, np.zeros((2, H, W), np.float32), distance if depth else None, None)
    _, history = accumulate(before * noise[0], first, None, 8, glance())
    mean, history = accumulate(now * noise[1], surface, history, 8, glance())
    assert (history.length[uncovered] == 1).all()
    np.testing.assert_allclose(mean[:, uncovered], (now * noise[1])[:, uncovered], rtol=1e-6)
    assert history.length[~uncovered].mean() > 1.5


@pytest.mark.parametrize("seed", range(4))
def test_surfaces_are_hidden_where_dual_vectors_say_so(seed: int) -> None:
    """Random whole motions, which start in pixels' centres: both fetch what is nearest to the same place."""
    rng = np.random.default_rng(seed)
    motion, forward = (np.float32(rng.integers(-2, 3, (2, H, W))) for _ in range(2))
    depth, before = (np.float32(rng.choice([0, 1, 1.05, 3], (1, H, W))) for _ in range(2))
    vectors = dual_motion(*(torch.from_numpy(image[None]) for image in (motion, forward, depth, before)))
    seen = (vectors.valid & ~vectors.disoccluded)[0, 0].numpy()
    color = np.ones((3, H, W), np.float32)
    _, history = accumulate(color, Surface(None, 0 * motion, before, None), None, 8, glance())
    _, history = accumulate(color, Surface(None, motion, depth, forward), history, 8, glance())
    inner = np.s_[2:-2, 2:-2]  # at the border, places on the edge itself are inside of one and outside of the other
    np.testing.assert_array_equal(history.length[inner] > 1, seen[inner])


def test_vectors_that_are_not_known_leave_it_to_the_depth() -> None:
    known, uncovered = hidden_by_a_square(forward=True, depth=True)
    assert known.forward is not None
    _, history = accumulate(np.ones((3, H, W), np.float32), known._replace(motion=0 * known.motion), None, 8, glance())
    depth = np.full((H, W), 9.0, np.float32)
    depth[20:40, 30:50] = 2.0
    unknown = known._replace(forward=np.full_like(known.forward, np.nan))
    _, after = accumulate(np.ones((3, H, W), np.float32), unknown, history._replace(depth=depth), 8, glance())
    assert (after.length[uncovered] == 1).all()


@pytest.mark.parametrize("lacking", [{"motion": None}, {"depth": None, "forward": None}])
def test_without_what_it_takes_a_frame_stays_as_it_is(lacking: dict[str, None]) -> None:
    scene, history = Scene(), None
    for frame in range(3):
        clean, albedo = scene.clean(frame)
        color, surface = scene.noisy(clean, frame), scene.surface(albedo)._replace(**lacking)
        mean, history = accumulate(color, surface, history, 8, glance(albedo))
        history = with_denoised(history, clean, surface)
        np.testing.assert_allclose(mean, color, rtol=1e-5)


def test_a_black_frame_begins_nothing() -> None:
    scene = Scene()
    clean, albedo = scene.clean(0)
    black, history = accumulate(0 * clean, scene.surface(albedo), None, 8, glance())
    assert (black == 0).all()
    history = with_denoised(history, black, scene.surface(albedo))
    mean, history = accumulate(clean, scene.surface(albedo), history, 8, glance())
    np.testing.assert_array_equal(mean, clean)
    assert np.isfinite(history.log).all()


@pytest.mark.parametrize("seed", range(8))
def test_random_frames_give_finite_means_within_what_was_seen(seed: int) -> None:
    rng, history = np.random.default_rng(seed), None
    height, width = (int(n) for n in rng.integers(1, 40, 2))
    scale, top = 10 ** rng.uniform(-6, 6), 0.0
    for _ in range(4):
        color = np.float32(scale * rng.exponential(size=(3, height, width)) * (rng.random((height, width)) < 0.7))
        motion = np.float32(rng.normal(0, 20, (2, height, width)))
        motion[:, rng.random((height, width)) < 0.1] = np.nan
        depth = np.float32(rng.exponential(size=(1, height, width)))
        surface = Surface(None, motion, depth, -motion if rng.random() < 0.5 else None)
        mean, history = accumulate(color, surface, history, 8, glance())
        history = with_denoised(history, mean, surface)
        top = max(top, float(color.max()))
        assert np.isfinite(mean).all()
        assert mean.min() >= 0
        assert mean.max() <= top * 1.00001
        assert ((history.length >= 1) & (history.length <= 8)).all()


def frame_of(scene: Scene, number: int, **given: object) -> Frame:
    clean, albedo = scene.clean(number)
    surface = scene.surface(albedo)
    images = {"color": scene.noisy(clean, number), "albedo": albedo, "motion": surface.motion, "depth": surface.depth}
    channels = {name: image[None] for name, image in images.items()}
    return Frame(channels, number, clean_guides=True, **given)


def sequence(spec: str, frames: list[Frame]) -> list[Pixels]:
    denoiser, state, images = load_denoiser(spec), None, []
    for frame in frames:
        result, state = denoiser.step(frame, state)
        images.append(np.asarray(result.image))
    return images


@pytest.mark.parametrize(("motion", "most"), [((0.0, 0.0), 0.85), ((0.4, 0.3), 1.02)])
def test_oidn_is_better_for_it(motion: tuple[float, float], most: float) -> None:
    """Errors of frames 4 to 11; of one frame alone, other noise makes 0.85 to 1 times as much of it."""
    scene = Scene(motion)
    frames = [frame_of(scene, number) for number in range(12)]
    clean = [scene.clean(number)[0] for number in range(12)]
    alone, accumulated = (
        np.mean([error(image[0], truth) for image, truth in zip(sequence(spec, frames), clean, strict=True)][4:])
        for spec in ("oidn:quality=fast", "oidn:quality=fast,accumulate=8")
    )
    assert accumulated < most * alone


def test_a_sequence_of_a_batch_starts_anew_by_itself() -> None:
    frames = [frame_of(Scene(), number) for number in range(4)]
    spec = "oidn:quality=fast,accumulate=8"
    alone, anew = sequence(spec, frames), sequence(spec, frames[3:])
    both = [
        Frame({name: np.concatenate([image] * 2) for name, image in frame.channels.items()}, frame.index,
              clean_guides=True, reset=np.array([0, 1], np.float32) if frame.index == 3 else None)
        for frame in frames
    ]  # fmt: skip
    last = sequence(spec, both)[-1]
    np.testing.assert_allclose(last[0], alone[-1][0], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(last[1], anew[-1][0], rtol=1e-4, atol=1e-5)


def test_noisy_guides_do_not_darken() -> None:
    """The mean of light over a noisy albedo, times its mean, is less than the light."""
    rng, still = np.random.default_rng(0), np.zeros((1, 2, H, W), np.float32)
    frames = []
    for number in range(8):
        albedo = np.broadcast_to(np.where(rng.random((1, 1, H, W)) < 0.5, 0.02, 1), (1, 3, H, W))
        color = np.broadcast_to(rng.gamma(1.0, 0.4, (1, 1, H, W)), (1, 3, H, W))
        channels = {"color": color, "albedo": albedo, "motion": still, "depth": still[:, :1] + 1}
        frames.append(Frame({name: np.float32(image) for name, image in channels.items()}, number))
    alone, accumulated = (sequence(f"oidn:quality=fast,accumulate={n}", frames)[-1].mean() for n in (1, 8))
    assert abs(accumulated / alone - 1) < 0.03


def test_without_motion_a_session_warns() -> None:
    frame = frame_of(Scene(), 0)
    lacking = Frame({name: frame[name] for name in ("color", "albedo", "depth")}, 0, clean_guides=True)
    with pytest.warns(MissingChannelWarning, match="motion"):
        Session(load_denoiser("oidn:quality=fast,accumulate=8")).denoise(lacking)


def test_another_size_within_a_sequence_is_refused() -> None:
    frame = frame_of(Scene(), 0)
    smaller = Frame({name: image[..., :40, :40] for name, image in frame.channels.items()}, 1)
    with pytest.raises(NteError, match="start a new sequence"):
        sequence("oidn:accumulate=8", [frame, smaller])


@pytest.mark.parametrize("frames", ["0", "65", "-1"])
def test_a_number_of_frames_that_is_none_is_refused(frames: str) -> None:
    with pytest.raises(NteError, match="accumulate"):
        load_denoiser(f"oidn:accumulate={frames}")
