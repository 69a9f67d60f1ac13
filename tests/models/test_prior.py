"""A network on top of another denoiser: what it starts with, and who gives it its prior."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.evaluation.evaluate import evaluate
from nte.filters.prior import complete
from nte.frames.clip import Clip, write_frame
from nte.frames.clip_files import frame_path
from nte.frames.frame import Frame
from nte.info import describe
from nte.models.registry import make_network
from nte.models.temporal import TemporalConfig
from nte.registry import load_denoiser
from nte.runtime.export import export_onnx
from nte.session import MissingChannelWarning, Session
from nte.training.loop import train
from nte.training.run import load_run
from nte.training.tiles import ClipStore
from tests.models.lights import light_network
from tests.synthetic import disc_frame, write_clip
from tests.training.runs import tiny_config

NEEDS = {"color", "albedo", "normal", "depth", "motion"}
ON_TAA = ("network.finest=mixing", "network.front=2", "network.prior='taa:alpha=0.5'")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """Four frames of 40×24 with two noise seeds. Only to be read."""
    rng = np.random.default_rng(3)
    frames = [disc_frame(i, (24, 40), rng=rng) for i in range(4)]
    folder = tmp_path_factory.mktemp("clips") / "disc_000"
    for i, frame in enumerate(frames):
        noise = rng.exponential(size=frame["color"].shape)
        write_frame(frame_path(folder, i, 1), {"color": (frame["reference"] * noise).astype(np.float32)})
    return Clip(write_clip(folder, frames, seeds=2))


def test_begins_near_its_prior_and_far_from_the_noise() -> None:
    network = make_network(TemporalConfig(channels=[8, 8], scales=2, front=2, finest="mixing", prior="noisy"))
    frame = Frame({name: values[None] for name, values in disc_frame(0, (32, 48)).items()})
    noisy = frame.with_channels(color=np.zeros_like(frame["color"]), prior=frame["color"])
    with torch.no_grad():
        image = network.step(noisy, None)[0].image
    share = image.mean() / frame["color"].mean()
    assert 0.4 < share < 0.9


def test_a_prior_is_made_as_a_sequence_and_of_the_mean_of_seeds(clip: Clip) -> None:
    store = ClipStore([clip], ("color", "prior"), prior="taa:alpha=0.5")
    whole = slice(0, 4), slice(0, 24), slice(0, 40)
    for seeds in ((0,), (1,), (1, 0)):
        session = Session(load_denoiser("taa:alpha=0.5"))
        expected = [session.denoise(clip.frame(i, seeds=seeds))[0] for i in range(4)]
        np.testing.assert_allclose(store.get(0, *seeds).crop(*whole)["prior"], expected, rtol=1e-6)
    assert not np.allclose(store.get(0, 0).crop(*whole)["prior"], store.get(0, 0).crop(*whole)["color"])


@pytest.mark.slow
def test_trains_is_exported_and_brings_its_prior_along(clip: Clip, tmp_path: Path) -> None:
    config = tiny_config(tmp_path, clip.folder, *ON_TAA)
    train(config, device="cpu")
    run = tmp_path / "runs" / "tiny"
    trained, model = load_denoiser(run), tmp_path / "model.onnx"
    export_onnx(load_run(run), model, progress=lambda line: None)
    exported = load_denoiser(model)
    assert {*trained.needs, *trained.wants} == {*exported.needs, *exported.wants} == NEEDS
    assert {*trained.needs} == {*exported.needs} == {"color", "motion"}  # those of taa
    assert "prior is made by taa:alpha=0.5" in describe(run)
    assert "prior: made by taa:alpha=0.5" in describe(model)
    session, graph = Session(trained), Session(exported)
    taa, plain = Session(load_denoiser("taa:alpha=0.5")), Session(load_run(run))
    for frame in clip:
        ours, theirs = session.denoise(frame), graph.denoise(frame)
        np.testing.assert_allclose(theirs, ours, rtol=1e-3, atol=1e-4)
        by_hand = plain.denoise(frame.with_channels(prior=taa.denoise(frame)))
        np.testing.assert_allclose(ours, by_hand, rtol=1e-5)


def test_what_cannot_be_a_prior_is_refused() -> None:
    network = light_network("on top")
    for spec, message in (
        ("elsewhere/model.onnx", "prior: 'elsewhere/model.onnx' is no denoiser by name, expected one of noisy, "),
        ("noisy:target=indirect", "prior: a denoiser of indirect, expected a denoiser of color"),
    ):
        network.prior = spec
        with pytest.raises(NteError, match=message):
            complete(network)


@pytest.mark.parametrize(
    ("missing", "alike"),
    [
        (("motion",), True),
        (("albedo", "normal", "depth"), True),
        (("albedo", "normal", "depth", "motion"), True),
        (("depth",), False),
        (("albedo", "normal"), False),
        (("normal",), False),
    ],
)
def test_the_released_model_does_without_what_a_frame_lacks(missing: tuple[str, ...], alike: bool, clip: Clip) -> None:
    """It is Open Image Denoise where nothing tells what became of a surface, and has a history where something does."""
    channels = [name for name in ("color", "albedo", "normal", "depth", "motion") if name not in missing]
    ours, theirs = Session(load_denoiser("steady")), Session(load_denoiser("oidn"))
    with pytest.warns(MissingChannelWarning, match=f"frame 0: steady does without {', '.join(missing)}, which"):
        first = ours.denoise(clip.frame(0, channels))
    reference = clip.frame(3)["reference"]
    images = [(first, theirs.denoise(clip.frame(0, channels)))]
    images += [(ours.denoise(frame), theirs.denoise(frame)) for frame in (clip.frame(i, channels) for i in (1, 2, 3))]
    error, other = (np.abs(image - reference).mean() for image in images[-1])
    if alike:
        assert error == pytest.approx(other, rel=0.02)
    else:
        # Without depth (nor forward vectors) nothing is accumulated below, and little is left to gain.
        assert error < (1 if "depth" in missing else 0.985) * other
    assert all(np.isfinite(image).all() for image, _ in images)


def test_a_channel_that_is_lost_on_the_way_is_named(clip: Clip) -> None:
    """A pass that is missing in one frame is a mistake, and no sequence without it."""
    session = Session(load_denoiser("steady"))
    session.denoise(clip.frame(0))
    with pytest.raises(NteError, match="frame 1: steady wants motion, which is missing; the frames before have it"):
        session.denoise(clip.frame(1, ["color", "albedo", "normal", "depth"]))


@pytest.mark.parametrize("spec", ["steady", "estimate+steady"])
def test_an_evaluation_tells_what_is_lacking(spec: str, clip: Clip, tmp_path: Path) -> None:
    frames = [{name: clip.frame(i)[name][0] for name in ("color", "reference", "normal", "motion")} for i in (0, 1)]
    bare = write_clip(tmp_path / "bare", frames)
    with pytest.warns(MissingChannelWarning, match="does without albedo, depth, which costs quality"):
        evaluate([bare], {spec: load_denoiser(spec)}, tmp_path / "out")
