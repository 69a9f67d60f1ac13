"""The package has one name everywhere that people copy commands from."""

import re
import tomllib
from pathlib import Path

from nte.errors import DISTRIBUTION

ROOT = Path(__file__).parents[1]


def test_the_distribution_has_one_name_and_every_command_installs_it() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["name"] == DISTRIBUTION
    assert project["scripts"] == {"nte": "nte.cli:main"}  # import and command are shorter
    pages = [p for kind in ("*.md", "*.py", "*.ipynb", "*.yaml") for p in ROOT.rglob(kind) if p != Path(__file__)]
    shown = [
        path
        for path in pages
        if not {".venv", "build", "data", "runs", "node_modules"} & {*path.relative_to(ROOT).parts}
    ]
    strangers = re.compile(r"pip install [^\n`]*?['\" ]nte(?![-\w./])")  # `nte` on PyPI is somebody else's package
    assert not [f"{path}: {found[0]}" for path in shown if (found := strangers.search(path.read_text("utf-8")))]
    assert strangers.search("pip install 'nte[train]'")
    assert strangers.search("pip install -U nte")


def test_contributing_shows_every_room_of_the_house() -> None:
    house = (ROOT / "CONTRIBUTING.md").read_text("utf-8").split("## The house")[1].split("```")[1]
    for folder in (ROOT / "nte", ROOT / "nte" / "render"):
        rooms = [path.name for path in folder.iterdir() if (path / "__init__.py").is_file() or path.suffix == ".py"]
        assert not [room for room in rooms if room[:2] != "__" and not re.search(rf"\b{re.escape(room)}\b", house)]


def test_links_between_documents_lead_somewhere() -> None:
    link = re.compile(r"\]\((?!https?:|mailto:)([^)#\s]*)(?:#([^)\s]+))?\)")
    broken = []
    folders = (".", "docs", "datasets", "export", "nte/released")
    for page in (page for folder in folders for page in (ROOT / folder).glob("*.md")):
        for path, section in link.findall(page.read_text("utf-8")):
            target = (page.parent / path).resolve() if path else page
            if not target.exists() or (section and target.suffix == ".md" and section not in sections(target)):
                broken.append(f"{page.name}: {path}#{section}")
    assert not broken


def sections(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
