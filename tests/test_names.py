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
    shown = [path for path in pages if not {".venv", "build", "data", "runs"} & {*path.relative_to(ROOT).parts}]
    strangers = re.compile(r"pip install [^\n`]*?['\" ]nte(?![-\w./])")  # `nte` on PyPI is somebody else's package
    assert not [f"{path}: {found[0]}" for path in shown if (found := strangers.search(path.read_text("utf-8")))]
    assert strangers.search("pip install 'nte[train]'")
    assert strangers.search("pip install -U nte")
