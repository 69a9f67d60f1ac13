"""The optical flow that ours is compared with: every method finds a shift, with our sign and axes."""

from pathlib import Path

import pytest
import torch

from nte.motion.pyramid import count_levels
from nte.motion.search import SEARCHES
from nte.motion.warp import warp
from nte.render.recipes.recipe import read_recipe

pytest.importorskip("cv2")
pytest.importorskip("gefolki")
from benchmarks.flow_costs import cost_table, pass_table
from benchmarks.flows import FLOWS, Find, candidates, ours


@pytest.mark.parametrize("find", [*FLOWS.values(), ours(), ours("noisy")], ids=[*FLOWS, "auto", "noisy"])
@pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")
def test_a_shift_is_found_with_our_sign_and_axes(find: Find) -> None:
    generator = torch.Generator().manual_seed(0)
    coarse = torch.rand(1, 1, 16, 20, generator=generator)
    large = torch.nn.functional.interpolate(coarse, scale_factor=8, mode="bicubic").clamp(0, 1)
    current, previous = large[..., 8:104, 8:136], large[..., 7:103, 10:138]  # previous(x) = current(x + (2, −1))
    motion = find(current, previous)
    assert motion.shape == (1, 2, 96, 128)
    inner = motion[0, :, 20:-20, 20:-20].mean((1, 2))
    torch.testing.assert_close(inner, torch.tensor([-2.0, 1.0]), atol=0.4, rtol=0)
    moved = (warp(previous, motion).image - current).abs()[..., 20:-20, 20:-20].mean()
    assert moved < 0.4 * (previous - current).abs()[..., 20:-20, 20:-20].mean()


def test_every_setting_that_a_method_may_be_given_finds_the_shift() -> None:
    """Also blurred images of 5 levels: a candidate with a wrong sign or scale would make its method look worse."""
    generator = torch.Generator().manual_seed(1)
    coarse = torch.rand(1, 1, 24, 28, generator=generator)
    large = torch.nn.functional.interpolate(coarse, scale_factor=8, mode="bicubic").clamp(0, 1)
    current, previous = large[..., 8:168, 8:200], large[..., 7:167, 10:202]
    for method, settings in candidates(slow=False).items():
        assert len(settings) > 1
        for name, find in settings.items():
            motion = find(current, previous)[0, :, 40:-40, 40:-40].flatten(1).median(1).values
            assert (motion - torch.tensor([-2.0, 1.0])).abs().max() < 0.5, (method, name)


def test_tables_of_costs() -> None:
    rows = {"Farnebäck": {"ms": 200.0, "peak_mb": 10.0}, "eFOLKI": {"ms": 500.0}}
    lines = [line.split()[-3:] for line in cost_table(rows).splitlines()]
    assert lines[1:] == [["200", "1.00", "10"], ["500", "2.50", "–"]]
    assert pass_table({"level 0": 1.25}).splitlines()[1].split() == ["level", "0", "1.2"]


@pytest.mark.parametrize("name", ["correspondence", "correspondence_reduced"])
def test_methods_are_compared_and_tuned_where_no_level_of_a_search_is_missing(name: str) -> None:
    recipe = read_recipe(Path(__file__).parents[2] / "datasets" / f"{name}.yaml")
    for split in (recipe.train, recipe.test):
        pairs = [group for group in split if group.frames < 6]  # longer clips are for the accumulation
        assert len({group.scene for group in pairs}) >= 4
        for group in pairs:
            assert min(group.width, group.height) >= 512
            for search in SEARCHES.values():
                size = min(group.width, group.height) // (2 if search.half else 1)
                assert count_levels(size, size, len(search.radii)) == len(search.radii)
