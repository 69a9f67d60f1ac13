"""What the pages name is there, and their Python runs."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from tests.evaluation.conftest import noisy_frames
from tests.synthetic import write_clip

ROOT = Path(__file__).parents[1]
PAGES = [page for kind in ("*.md", "docs/*.md", "datasets/*.md", "export/*.md") for page in ROOT.glob(kind)]
PAGES = [page for page in PAGES if page.name != "CHANGELOG.md"]  # which tells of what there was
NAME = re.compile(r"(?<![\w/.])nte(?:\.[A-Za-z_]\w*)+")
PLACE = re.compile(r"(?<![\w./-])(?:nte|docs|datasets|configs|benchmarks|tests|export|notebooks)/[\w./-]*\w")
BENCHMARK = re.compile(r"python -m (benchmarks\.[a-z_]+)")


def is_there(name: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    module, _, attribute = name.rpartition(".")
    try:
        import_module(name)
    except ImportError:
        return bool(module) and is_there(module) and hasattr(import_module(module), attribute)
    return True


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_names_and_paths_of_a_page_exist(page: Path) -> None:
    text = page.read_text("utf-8")
    assert not [name for name in {*NAME.findall(text), *BENCHMARK.findall(text)} if not is_there(name)]
    assert not [place for place in set(PLACE.findall(text)) if not (ROOT / place).exists()]


def test_names_that_are_not_there_are_found() -> None:
    assert is_there("nte.checking.guides_are_clean")
    assert not is_there("nte.filters.svgf.Sgvf")
    assert not is_there("nte.losses")
    assert NAME.findall("as `nte.warp`, see nte.motion.warp; not in x/nte.md") == ["nte.warp", "nte.motion.warp"]
    assert PLACE.findall("(`nte/filters/taa.py`, or configs/*.yaml)") == ["nte/filters/taa.py"]


def test_denoisers_of_ones_own_as_the_page_shows_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_clip(tmp_path / "data" / "quickstart" / "test" / "rooms_000", noisy_frames(4))
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "own_denoisers.md").read_text("utf-8"), re.DOTALL)
    assert len(blocks) == 2
    there: dict[str, object] = {"__name__": "own"}
    for block in blocks:
        exec(block, there)
    assert (tmp_path / "mean_report" / "index.html").is_file()
