"""The comparisons that ship name networks that load and give no method an advantage; one may change another."""

import math
from pathlib import Path

import pytest

from nte.evaluation.comparison.read import read_comparison
from nte.evaluation.comparison.run import check_methods
from nte.filters.trmv.shadows import LINES
from nte.render.recipes.recipe import read_recipe

ROOT = Path(__file__).parents[2]
COMPARISONS = sorted(ROOT.glob("configs/compare_*.yaml"))


@pytest.mark.slow
@pytest.mark.skipif(not (ROOT / "configs" / "neural").is_dir(), reason="the networks' configurations are not there yet")
@pytest.mark.parametrize("path", COMPARISONS, ids=lambda path: path.name)
def test_shipped_comparisons_name_networks_that_fit_their_tables(path: Path, tmp_path: Path) -> None:
    check_methods(read_comparison(path), tmp_path, tmp_path, "cpu")


@pytest.mark.parametrize(("name", "clips"), [("compare_trmv", 8), ("compare_trmv_640", 2)])
def test_reliable_vectors_are_compared_on_one_scale_with_all_that_the_paper_compares(name: str, clips: int) -> None:
    comparison = read_comparison(ROOT / "configs" / f"{name}.yaml")
    groups = [group for recipe in comparison.recipes.values() for group in read_recipe(Path(recipe)).test]
    assert min(group.frames for group in groups) >= 24
    assert comparison.first is not None
    assert 1 / (comparison.first + 1) < 0.1  # α is at its floor
    (size,) = {min(group.width, group.height) for group in groups}
    levels = round(5 + math.log2(size / LINES))  # of SVGF, if it shrinks with the image as TRMV's shadow filter does
    figures = {"visibility": set[str](), "glossy": {"specular", "specular_clamp"}, "indirect": {"dual_colours"}}
    for situation in comparison.situations:
        specs = set(situation.methods.values())
        if not situation.name.startswith("limit"):
            assert len(situation.clips) == clips
            wanted = {"traditional", "traditional_clamp", "gradient"} | figures[situation.light]
            assert {"trmv", *(f"trmv:preset={preset}" for preset in wanted)} <= specs
        for spec in specs:
            if "svgf:" in spec:
                counts = [option for option in spec.split(",") if "iterations=" in option]
                assert {option.partition("=")[2] for option in counts} == {str(levels)}, spec


def test_a_comparison_may_change_another_one(tmp_path: Path) -> None:
    base = "seeds: [1, 2]\nnetworks: {a: {config: a.yaml, seeds: [7]}, b: {config: b.yaml}}\n"
    (tmp_path / "base.yaml").write_text(base + "situations: [{name: s, clips: [x], networks: [a, b]}]")
    path = tmp_path / "changed.yaml"
    path.write_text("base: base.yaml\nseeds: [3]\nnetworks: {b: {overrides: [log_every=1]}}")
    found = read_comparison(path)
    assert [found.seeds_of(title) for title in found.networks] == [[7], [3]]
    assert found.networks["b"].config == str(tmp_path / "b.yaml")
    assert found.networks["b"].overrides == ["log_every=1"]
