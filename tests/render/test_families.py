"""Families of scenes: parameters, seeds and splits, and what every scene of every family promises. No rendering."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nte.errors import NteError
from nte.render.recipes.recipe import read_recipe
from nte.render.scenes.families import FAMILIES
from nte.render.scenes.family import Dice
from nte.render.world.seeds import derive_generator

# Every family as it is, and with parameters that change what is in it.
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {name: (name, {}) for name in FAMILIES} | {
    "rooms-window": ("rooms", {"window": True}),
    "fence-lights": ("fence", {"lights": 3, "moving_lights": True, "moving_camera": True}),
    "pica-boxes": ("pica", {"boxes": 6, "moving_camera": True}),
    "apples-rolling": ("apples", {"rolling": True, "apples": 3}),
    "pinkroom-lamp": ("pinkroom", {"swinging_lamp": True, "moving_camera": True}),
    "robot-wave": ("robot", {"action": "wave"}),
    "penumbra-lights": ("penumbra", {"lights": 3, "bars": 0}),
    "spheres-pinhole": ("spheres", {"aperture": 0.0}),
    "cloud-storm": ("cloud", {"cover": 0.8, "change": 3.0}),
    "subsurface-dense": ("subsurface", {"extinction": 30.0}),
    "motion_blur-propeller": ("motion_blur", {"case": "propeller"}),
    "motion_blur-crossing": ("motion_blur", {"case": "crossing"}),
    "motion_blur-rotation": ("motion_blur", {"case": "rotation"}),
}


def made(variant: str, split: str = "train", seed: int = 0):
    family, given = VARIANTS[variant]
    return FAMILIES[family](derive_generator("test", family, seed), split, given)


@pytest.mark.parametrize("split", ["train", "test"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_scenes_are_finite_lit_and_unit(variant: str, split: str):
    scene = made(variant, split)
    assert scene.environment is not None or any(obj.radiance for obj in scene.objects)
    for obj in scene.objects:
        assert obj.mesh.faces.max() < len(obj.mesh.positions) == len(obj.mesh.normals) == len(obj.mesh.uv)
        assert np.isfinite(obj.mesh.uv).all()
        assert obj.mesh.positions.dtype == obj.mesh.normals.dtype == obj.mesh.uv.dtype == np.float32
        assert 0 <= obj.material.color.min() <= obj.material.color.max() <= 1
        assert 0 <= np.min(obj.material.roughness) <= np.max(obj.material.roughness) <= 1
        for time in (-1.0, 0.37, 12.5):
            positions, normals = obj.at(time)
            assert np.isfinite(positions).all()
            np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)


@pytest.mark.parametrize("variant", VARIANTS)
def test_tracks_are_rigid_and_continuous(variant: str):
    scene = made(variant)
    for track in [scene.camera.track, *(obj.track for obj in scene.objects if hasattr(obj, "track"))]:
        for time in (-1.0, 3.3, 11.0):
            matrix, soon = track(time), track(time + 1e-4)
            np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-9)
            assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1)
            assert np.abs(soon - matrix).max() < 1e-2


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_same_seed_gives_the_same_scene(variant: str):
    first, second, other = made(variant), made(variant), made(variant, seed=1)
    for a, b in zip(first.objects, second.objects, strict=True):
        np.testing.assert_array_equal(a.at(2.5)[0], b.at(2.5)[0])
        np.testing.assert_array_equal(a.material.color, b.material.color)
    np.testing.assert_array_equal(first.camera.track(2.5), second.camera.track(2.5))
    assert any(
        a.material.color.shape != b.material.color.shape or (a.material.color != b.material.color).any()
        for a, b in zip(first.objects, other.objects, strict=False)
    )


@pytest.mark.parametrize("variant", VARIANTS)
def test_what_is_set_apart_never_meets(variant: str, monkeypatch: pytest.MonkeyPatch):
    """Every family but `rooms` holds values back for its test clips, so no two scenes of the splits are alike."""
    if VARIANTS[variant][0] == "rooms":
        pytest.skip("rooms tell their splits apart by seed alone, so that the quick start keeps its data")
    drawn: dict[str, list[float]] = {"train": [], "test": []}
    apart = Dice.apart

    def note(self: Dice, low: float, high: float) -> float:
        value = apart(self, low, high)
        drawn[self.split].append((value - low) / (high - low))
        return value

    monkeypatch.setattr(Dice, "apart", note)
    for seed in range(3):
        made(variant, "train", seed)
        made(variant, "test", seed)
    assert drawn["train"]
    assert all(not 0.4 <= share < 0.6 for share in drawn["train"])
    assert all(0.4 <= share < 0.6 for share in drawn["test"])


def test_the_splits_fill_their_parts_of_a_range():
    train = Dice(np.random.default_rng(0), "train")
    test = Dice(np.random.default_rng(0), "test")
    trained = np.array([train.apart(-1, 3) for _ in range(2000)])
    tested = np.array([test.apart(-1, 3) for _ in range(2000)])
    assert ((trained < 0.6) | (trained >= 1.4)).all()
    assert trained.min() < -0.9 < 2.9 < trained.max()
    assert 0.6 <= tested.min() < 0.62 < 1.38 < tested.max() < 1.4


@pytest.mark.parametrize(
    ("family", "given", "said"),
    [
        ("fence", {"lihgts": 3}, "'lihgts' is not a parameter, did you mean lights[?] expected one of lights, "),
        ("rooms", {"lights": 3}, "'lights' is not a parameter"),
        ("fence", {"lights": 9}, "'lights' is 9: expected a whole number from 1 to 4"),
        ("fence", {"lights": 2.0}, "'lights' is 2.0: expected a whole number"),
        ("fence", {"lights": True}, "'lights' is True: expected a whole number"),
        ("fence", {"moving_lights": 1}, "'moving_lights' is 1: expected true or false"),
        ("temple", {"speed": "fast"}, "'speed' is 'fast': expected a number from 0 to 4"),
        ("temple", {"speed": float("nan")}, "'speed' is nan"),
        ("spheres", {"aperture": -0.1}, "'aperture' is -0.1: expected a number from 0 to 1"),
        ("cloud", {"cover": 1.5}, "'cover' is 1.5: expected a number from 0.1 to 0.9"),
        ("motion_blur", {"case": "upwards"}, "'upwards': expected one of sideways_fast, "),
        ("motion_blur", {"case": ["still"]}, "'case' is .*: expected one of"),
    ],
)
def test_faulty_parameters_are_refused_in_one_line(family: str, given: dict[str, Any], said: str):
    with pytest.raises(NteError, match=said) as caught:
        FAMILIES[family].read(given)
    assert "\n" not in str(caught.value)


def test_whole_numbers_are_numbers():
    assert FAMILIES["temple"].read({"speed": 2}).speed == 2


@pytest.mark.parametrize("family", ["cloud", "subsurface"])
def test_light_in_a_medium_is_not_separated(family: str, tmp_path: Path):
    path = tmp_path / "r.yaml"
    path.write_text(f"name: a\ntrain: [{{clips: 1, scene: {family}, components: true}}]")
    said = rf"r\.yaml: train\[0\]\.components is true: .*'{family}'.*expected false"
    with pytest.raises(NteError, match=said) as caught:
        read_recipe(path)
    assert "\n" not in str(caught.value)


def test_recipes_say_which_group_is_wrong(tmp_path: Path):
    path = tmp_path / "r.yaml"
    path.write_text("name: a\ntest: [{clips: 1, scene: fence, parameters: {lihgts: 2}}]")
    with pytest.raises(NteError, match=r"r\.yaml: test\[0\]\.parameters: scene 'fence': 'lihgts' is not a parameter"):
        read_recipe(path)
