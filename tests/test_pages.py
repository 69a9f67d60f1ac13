"""What the pages name is there, and their Python runs."""

import json
import re
from importlib import import_module
from pathlib import Path

import pytest

from nte.cli import main
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import write_clip

ROOT = Path(__file__).parents[1]
FOLDERS = (".", "docs", "datasets", "export", "nte/released")
PAGES = [page for folder in FOLDERS for page in (ROOT / folder).glob("*.md")]
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


@pytest.mark.parametrize("notebook", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_begins_with_its_title_and_has_no_other(notebook: Path) -> None:
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    lines = ["".join(cell["source"]).splitlines() for cell in cells if cell["cell_type"] == "markdown"]
    titles = [line for cell in lines for line in cell if line.startswith("# ")]
    assert titles == lines[0][:1]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_names_and_paths_of_a_page_exist(page: Path) -> None:
    text = page.read_text("utf-8")
    assert not [name for name in {*NAME.findall(text), *BENCHMARK.findall(text)} if not is_there(name)]
    assert not [place for place in set(PLACE.findall(text)) if not (ROOT / place).exists()]


def test_names_that_are_not_there_are_found() -> None:
    assert is_there("nte.frames.guides.guides_are_clean")
    assert not is_there("nte.filters.svgf.Sgvf")
    assert not is_there("nte.losses")
    assert NAME.findall("as `nte.warp`, see nte.motion.warp; not in x/nte.md") == ["nte.warp", "nte.motion.warp"]
    assert PLACE.findall("(`nte/filters/taa.py`, or configs/*.yaml)") == ["nte/filters/taa.py"]


@pytest.fixture
def own_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The page about denoisers of one's own, in a folder with the clips that it names."""
    monkeypatch.chdir(tmp_path)
    for part in ("train", "test"):
        write_clip(tmp_path / "data" / "quickstart" / part / "rooms_000", noisy_frames(5))
    return (ROOT / "docs" / "own_denoisers.md").read_text("utf-8")


def blocks(page: str, language: str = "") -> list[str]:
    """The blocks between fences that name this language; a command line names none."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    return [text for name, text in found if name == language]


def test_denoisers_of_ones_own_as_the_page_shows_them(own_page: str) -> None:
    there: dict[str, object] = {"__name__": "own"}
    for block in blocks(own_page.split("## A network")[0], "python"):
        exec(block, there)
    assert Path("mean_report/index.html").is_file()
    assert there["Lag"]


@pytest.mark.slow
def test_a_network_of_ones_own_as_the_page_shows_it(own_page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    page = own_page.split("## A network")[1]
    Path("blend.py").write_text(blocks(page, "python")[0])
    Path("blend.yaml").write_text(blocks(page, "yaml")[0])
    monkeypatch.syspath_prepend(Path.cwd())
    commands = [line.split()[1:] for line in blocks(page)[0].splitlines() if line.startswith("nte ")]
    for words in commands:
        smaller = ["--device", "cpu", "data.crop=16", "phases=[{steps: 6}]"] if words[0] == "train" else []
        assert main([*words, *smaller]) == 0, words
    assert [words[0] for words in commands] == ["train", "export", "info", "evaluate"]
    means = json.loads(Path("blend_report/metrics.json").read_text())["means"]
    assert means["runs/blend"]["psnr"] == pytest.approx(means["blend.onnx"]["psnr"], abs=0.01)
    assert means["runs/blend"]["psnr"] > means["noisy"]["psnr"]
