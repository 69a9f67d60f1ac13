"""The recipes, the page and the pictures of the families."""

from pathlib import Path

import pytest

from nte.render.recipes.recipe import make_scene, plan, read_recipe
from nte.render.scenes.families import FAMILIES
from nte.render.scenes.family import describe

DATASETS = Path(__file__).parents[2] / "datasets"


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_has_a_recipe_a_page_and_a_picture(name: str):
    recipe = "quickstart" if name == "rooms" else name
    plans = plan(read_recipe(DATASETS / f"{recipe}.yaml"))
    assert {(unit.split, unit.group.scene) for unit in plans} == {("train", name), ("test", name)}
    make_scene(plans[0])
    page = (DATASETS / "SCENES.md").read_text(encoding="utf-8")
    assert f"## {name}\n" in page
    section = page.split(f"## {name}\n")[1].split("\n## ")[0]
    for parameter, (allowed, default) in describe(FAMILIES[name]).items():
        assert f"| `{parameter}` | {allowed} | {default} |" in section
    pictures = sorted((DATASETS / "thumbnails").glob(f"{name}*.png"))
    assert pictures
    for picture in pictures:
        assert picture.stat().st_size <= 40 * 1024
        assert f"thumbnails/{picture.name}" in section
