"""The comparisons that ship name networks that load, and a comparison may change another one."""

from pathlib import Path

import pytest

from nte.evaluation.comparison.read import read_comparison
from nte.evaluation.comparison.run import check_methods

ROOT = Path(__file__).parents[2]
COMPARISONS = sorted(ROOT.glob("configs/compare_*.yaml"))


@pytest.mark.slow
@pytest.mark.skipif(not (ROOT / "configs" / "neural").is_dir(), reason="the networks' configurations are not there yet")
@pytest.mark.parametrize("path", COMPARISONS, ids=lambda path: path.name)
def test_shipped_comparisons_name_networks_that_fit_their_tables(path: Path, tmp_path: Path) -> None:
    check_methods(read_comparison(path), tmp_path, tmp_path, "cpu")


def test_a_comparison_may_change_another_one(tmp_path: Path) -> None:
    base = "seeds: [1, 2]\nnetworks: {a: {config: a.yaml, seeds: [7]}, b: {config: b.yaml}}\n"
    (tmp_path / "base.yaml").write_text(base + "situations: [{name: s, clips: [x], networks: [a, b]}]")
    path = tmp_path / "changed.yaml"
    path.write_text("base: base.yaml\nseeds: [3]\nnetworks: {b: {overrides: [log_every=1]}}")
    found = read_comparison(path)
    assert [found.seeds_of(title) for title in found.networks] == [[7], [3]]
    assert found.networks["b"].config == str(tmp_path / "b.yaml")
    assert found.networks["b"].overrides == ["log_every=1"]
