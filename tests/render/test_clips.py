"""Rendered clips: bytes, resuming, and what the channels promise of each other."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from nte.errors import NteError
from nte.frames import CHANNELS, Clip
from nte.frames.exr import read_exr
from nte.render.engine.mesh_stage import MeshStage
from nte.render.passes.radiance import radiance
from nte.render.recipes.clips import render_clip, render_recipe
from nte.render.recipes.recipe import plan, read_recipe
from nte.render.scenes.families import FAMILIES
from nte.render.world.seeds import derive_generator

CLIP = "train/rooms_000"


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_layout_and_channels(rendered: Path):
    assert sorted(p.name for p in rendered.iterdir()) == ["recipe.yaml", "test", "train"]
    clip = Clip(rendered / CLIP)
    assert (len(clip), clip.height, clip.width, clip.seeds) == (4, 40, 48, 2)
    promised = {
        "color", "reference", "reference_a", "reference_b", "albedo", "normal", "roughness", "emission",
        "depth", "position", "instance", "motion", "forward_motion", "previous_forward_motion",
    }  # fmt: skip
    assert set(clip.channels) == promised
    for name in promised - {"previous_forward_motion"}:
        values = clip.frame(1)[name]
        assert values.shape == (1, len(CHANNELS[name].components), 40, 48)
        assert np.isfinite(values).all()


def test_storage_is_as_specified(rendered: Path):
    layers = read_exr(rendered / CLIP / "frame_0000.exr")
    assert {"color.R", "reference_a.G", "depth.Z", "instance.ID", "motion.X", "roughness.V"} <= set(layers)
    assert set(read_exr(rendered / CLIP / "seed_01" / "frame_0003.exr")) == {"color.R", "color.G", "color.B"}


def test_the_same_bytes_after_any_interruption(rendered: Path, recipe: Path, tmp_path: Path):
    out = tmp_path / "out"
    shutil.copytree(rendered, out)
    clip = out / CLIP
    (clip / "frame_0001.exr").unlink()
    (clip / "seed_01" / "frame_0002.exr").unlink()
    (clip / "clip.json").unlink()
    whole = (clip / "frame_0003.exr").read_bytes()
    (clip / "frame_0003.exr").write_bytes(whole[: len(whole) // 2])
    shutil.rmtree(out / "test")
    kept = (clip / "frame_0000.exr").stat().st_mtime_ns
    render_recipe(recipe, out, progress=False)
    assert contents(out) == contents(rendered)
    assert (clip / "frame_0000.exr").stat().st_mtime_ns == kept


def test_nothing_is_touched_when_all_is_done(rendered: Path, recipe: Path):
    before = {p: p.stat().st_mtime_ns for p in rendered.rglob("*")}
    render_recipe(recipe, rendered, progress=False)
    assert {p: p.stat().st_mtime_ns for p in rendered.rglob("*")} == before


def test_only_the_wanted_clips_are_rendered_and_others_can_follow(rendered: Path, recipe: Path, tmp_path: Path):
    out, asked = tmp_path / "out", []

    def wanted(folder: str) -> bool:
        asked.append(folder)
        return folder.startswith("test/")

    folders = render_recipe(recipe, out, progress=False, wanted=wanted)
    assert CLIP in asked
    assert {folder.parent for folder in folders} == {out / "test"}
    assert not (out / "train").exists()
    render_recipe(recipe, out, progress=False)
    assert contents(out) == contents(rendered)


@pytest.mark.slow
def test_jobs_give_the_same_bytes(rendered: Path, recipe: Path, tmp_path: Path):
    render_recipe(recipe, tmp_path / "out", jobs=2, progress=False)
    assert contents(tmp_path / "out") == contents(rendered)


@pytest.mark.skipif(os.geteuid() == 0 and not Path("/dev/full").exists(), reason="needs a full device")
def test_a_full_disk_is_one_line(rendered: Path, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(path: Path, channels: object) -> None:
        raise NteError(f"{path}: cannot be written: No space left on device")

    monkeypatch.setattr("nte.render.recipes.clips.write_frame", full)
    unit = plan(read_recipe(recipe))[1]
    with pytest.raises(NteError, match="No space left"):
        render_clip(unit, tmp_path)
    assert not (tmp_path / unit.name / "clip.json").exists()


def test_clips_hold_no_trace_of_where_they_were_made(rendered: Path):
    text = (rendered / CLIP / "clip.json").read_text()
    assert str(rendered) not in text
    assert "/tmp" not in text
    assert str(rendered).encode() not in (rendered / CLIP / "frame_0000.exr").read_bytes()


def test_depth_is_along_the_view_axis(rendered: Path):
    for frame in Clip(rendered / CLIP):
        position, view = frame["position"], frame.view
        along = np.einsum("j,njhw->nhw", view[0, 2, :3], position) + view[0, 2, 3]
        np.testing.assert_allclose(frame["depth"][:, 0], along, atol=1e-4)


def test_positions_project_to_their_pixel_centres(rendered: Path):
    frame = Clip(rendered / CLIP).frame(2)
    np.testing.assert_allclose(projected(frame["position"], frame)[0], centres(frame.size), atol=2e-3)


@pytest.mark.parametrize("index", [1, 2, 3])
def test_motion_leads_to_the_same_surface(rendered: Path, index: int):
    """Where motion says a point was, the previous frame shows the same instance, and moves back."""
    clip = Clip(rendered / CLIP)
    now, before = clip.frame(index), clip.frame(index - 1)
    target = centres(now.size) + now["motion"][0]
    cell = np.floor(target).astype(int)
    inside = ((cell >= 0) & (cell < np.array([48, 40])[:, None, None])).all(0)
    x, y = np.where(inside, cell, 0)
    seen = inside & (before["instance"][0, 0, y, x] == now["instance"][0, 0])
    whole = np.abs(now["normal"][0]).max(0) > 0.999  # pixels that see nothing else
    flat = seen & whole & (now["instance"][0, 0] <= 6)  # walls: flat and at rest
    assert flat.mean() > 0.3
    # The previous frame saw the same plane, within half a pixel of the same point.
    offset = now["position"][0] - before["position"][0][:, y, x]
    assert np.abs((offset * now["normal"][0]).sum(0))[flat].max() < 0.02
    forward = before["forward_motion"][0][:, y, x]
    assert np.abs(forward + now["motion"][0])[:, flat].max() < 0.6  # half a pixel beside, and never opposite


def test_motion_of_moving_objects_matches_the_tracks(rendered: Path, recipe: Path):
    """A slow twin: carry each point back with its object's own 4×4 and project it."""
    unit = plan(read_recipe(recipe))[0]
    scene = FAMILIES["rooms"](derive_generator(unit.seed, unit.name, "scene"))
    clip = Clip(rendered / CLIP)
    now, before, after = (clip.frame(i) for i in (1, 0, 2))
    for number in np.unique(now["instance"]).astype(int):
        track = scene.objects[number - 1].track
        mine = now["instance"][0, 0] == number
        for name, other, time in (("motion", before, 0), ("forward_motion", after, 2)):
            carry = track(time) @ np.linalg.inv(track(1))
            then = np.einsum("ij,jhw->ihw", carry[:3, :3], now["position"][0]) + carry[:3, 3][:, None, None]
            expected = projected(then[None], other)[0] - centres(now.size)
            np.testing.assert_allclose(now[name][0][:, mine], expected[:, mine], atol=5e-3)


def test_frames_move_and_hide_things(rendered: Path):
    frame = Clip(rendered / CLIP).frame(2)
    assert np.hypot(*frame["motion"][0]).mean() > 0.5  # of 48 pixels
    assert len(np.unique(frame["instance"])) > 5


def test_reference_halves_are_independent_and_agree(rendered: Path):
    frame = Clip(rendered / CLIP).frame(0)
    a, b = frame["reference_a"], frame["reference_b"]
    assert not np.array_equal(a, b)
    assert a.mean() == pytest.approx(b.mean(), rel=0.1)
    dark = frame["emission"] == 0
    assert abs(np.corrcoef((a - b)[dark], (a + b)[dark])[0, 1]) < 0.5


def test_noise_seeds_differ(rendered: Path):
    clip = Clip(rendered / CLIP)
    assert not np.array_equal(clip.frame(0)["color"], clip.frame(0, seeds=(1,))["color"])


def test_many_seeds_at_one_sample_have_the_references_mean():
    """No bias between `color` and `reference`: the mean of many 1 spp renderings is a reference."""
    stage = MeshStage(FAMILIES["rooms"](derive_generator("mean")), 24, 24, 4)
    with stage.at(0) as moment:
        singles = np.stack([radiance(moment, 1, seed) for seed in range(96)])
        reference = radiance(moment, 128, seed=10_000)
    error = singles.std(0, ddof=1) / np.sqrt(len(singles))
    z = (singles.mean(0) - reference) / (np.sqrt(2) * error + 1e-3)
    assert abs(z.mean()) < 0.2
    assert (np.abs(z) < 5).mean() > 0.97


def centres(size: tuple[int, int]) -> np.ndarray:
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    return np.stack([x, y])


def projected(points: np.ndarray, frame) -> np.ndarray:
    """Pixel positions (N, 2, H, W) of world points by the clip's own camera matrices."""
    matrix = (frame.projection.astype(float) @ frame.view.astype(float))[0]
    ones = np.ones_like(points[:, :1])
    clip = np.einsum("ij,njhw->nihw", matrix, np.concatenate([points, ones], 1))
    return clip[:, :2] / clip[:, 3:] * np.array([frame.size[1], frame.size[0]])[None, :, None, None]
