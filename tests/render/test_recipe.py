"""Recipes: what is refused, and what is planned."""

from pathlib import Path

import pytest

from nte.errors import NteError
from nte.render.recipes.recipe import SPLITS, plan, read_recipe, recipe_text
from nte.render.world.seeds import derive_generator, derive_seed

ROOT = Path(__file__).parents[2]


def written(folder: Path, text: str) -> Path:
    path = folder / "r.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name: a\nseeed: 1\ntrain: [{clips: 1}]", "seeed"),
        ("name: a\ntrain: [{clips: 1, widht: 64}]", "widht"),
        ("name: a\ntrain: [{clips: many}]", "clips"),
        ("name: a\ntrain: [{scene: rooms}]", "clips"),
        ("train: [{clips: 1}]", "name"),
        ("name: a", "at least one"),
        ("name: a\ntrain: [{clips: 1, scene: forests}]", r"train\[0\].scene is 'forests', expected one of rooms"),
        ("name: a\ntest: [{clips: 1, width: 0}]", r"test\[0\].width is 0: expected at least 1"),
        ("name: a\ntest: [{clips: 1, reference_spp: 33}]", "even"),
        ("name: a\ntest: [{clips: 1, max_depth: 99999999999}]", r"test\[0\].max_depth is 99999999999: expected less"),
        ("name: ${oc.env:HOME}\ntrain: [{clips: 1}]", "resolver"),
        ("name: [", "r.yaml"),
        ("- 1", "r.yaml"),
    ],
)
def test_faulty_recipes_are_refused_in_one_line(tmp_path: Path, text: str, said: str):
    with pytest.raises(NteError, match=said) as caught:
        read_recipe(written(tmp_path, text))
    assert "r.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("shutter: 1.5", r"shutter is 1.5: expected the open share of the frame, in \[0, 1\]"),
        ("shutter: -0.1", "expected the open share"),
        ("shutter: .nan", "expected the open share"),
        ("shutter: 1, components: true", "components is true: expected false with a shutter"),
        ("shutter: 1, spp: 4", "spp is 4: expected 1"),
        ("shutter: 1, reference_spp: 100", "reference_spp is 100: expected a multiple of 128"),
        ("unshadowed: true, scene: cloud", "the medium of 'cloud' has no surface: expected false"),
        ("components: true, unshadowed: true", "unshadowed is true: expected false with components"),
        ("guides: aliased", "guides is 'aliased', expected one of averaged, centred, random"),
        ("mirrors: grey", "mirrors is 'grey', expected one of colour, black, white"),
        ("guides: random, components: true", "guides is 'random': expected 'averaged' with components"),
        ("mirrors: black, shutter: 0.5", "mirrors is 'black': expected 'colour' with a shutter"),
    ],
)
def test_faulty_groups_are_one_line(tmp_path: Path, keys: str, said: str):
    with pytest.raises(NteError, match=said) as caught:
        read_recipe(written(tmp_path, f"name: a\ntrain: [{{clips: 1, {keys}}}]"))
    assert "\n" not in str(caught.value)


def test_missing_recipe(tmp_path: Path):
    with pytest.raises(NteError, match=r"none\.yaml"):
        read_recipe(tmp_path / "none.yaml")


def test_plan_numbers_clips_by_family_and_split(tmp_path: Path):
    text = "name: a\ntrain: [{clips: 2}, {clips: 1, width: 64}]\ntest: [{clips: 1}]"
    plans = plan(read_recipe(written(tmp_path, text)))
    names = ["train/rooms_000", "train/rooms_001", "train/rooms_002", "test/rooms_000"]
    assert [p.name for p in plans] == names
    assert plans[2].group.width == 64


def test_recipe_text_does_not_depend_on_how_it_was_written(tmp_path: Path):
    short = read_recipe(written(tmp_path, "name: a\ntrain: [{clips: 2}]"))
    long = read_recipe(written(tmp_path, "seed: 0\ntrain:\n- clips: 2\n  scene: rooms\nname: a"))
    assert recipe_text(short) == recipe_text(long)


def test_seeds_differ_in_every_part():
    seeds = {derive_seed(*parts) for parts in [(0, "train", 1), (1, "train", 1), (0, "test", 1), (0, "train", 2)]}
    assert len(seeds) == 4
    assert all(0 <= seed < 2**32 for seed in seeds)
    assert derive_seed(0, "train/rooms_000", 3) == 911011127
    assert derive_generator(1, "a").integers(1 << 30) == derive_generator(1, "a").integers(1 << 30)


def test_quickstart_is_a_recipe():
    plans = plan(read_recipe(ROOT / "datasets" / "quickstart.yaml"))
    assert {p.split for p in plans} == {"train", "test"}


def test_paper_states_the_papers_numbers_and_its_small_twin_has_the_same_shape():
    paper, small = (plan(read_recipe(ROOT / "datasets" / name)) for name in ("paper.yaml", "paper-small.yaml"))
    assert [unit.name for unit in paper] == [unit.name for unit in small]
    assert {split: sum(unit.split == split for unit in paper) for split in SPLITS} == {"train": 142, "test": 139}
    for unit in paper:
        group = unit.group
        assert (group.width, group.height, group.frames, group.spp, group.reference_spp) == (1280, 720, 10, 1, 2048)
    assert {unit.group.scene for unit in paper} == {"apples", "robot", "pinkroom", "pica"}
    assert {unit.group.frames for unit in small} == {10}
    assert {unit.group.width * 720 == unit.group.height * 1280 for unit in small} == {True}
