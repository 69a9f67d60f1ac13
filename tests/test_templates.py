"""The forms for issues: what they ask for can be asked, and the commands in them exist."""

import re
from pathlib import Path

import pytest
import yaml

from nte.cli import _COMMANDS

FORMS = sorted((Path(__file__).parents[1] / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
NAMES = {module.__name__.rpartition(".")[2].removesuffix("_clip").replace("_", "-") for module in _COMMANDS}


@pytest.mark.parametrize("path", [path for path in FORMS if path.stem != "config"], ids=lambda path: path.stem)
def test_a_form_is_what_github_reads(path: Path) -> None:
    form = yaml.safe_load(path.read_text("utf-8"))
    assert {"name", "description", "body"} <= form.keys()
    asked = [part for part in form["body"] if part["type"] != "markdown"]
    assert {part["type"] for part in asked} <= {"textarea", "input"}
    assert len({part["id"] for part in asked}) == len(asked)
    assert all(part["attributes"]["label"] for part in asked)
    assert any(part.get("validations", {}).get("required") for part in asked)


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_the_commands_and_pages_that_a_form_names_exist(path: Path) -> None:
    text = path.read_text("utf-8")
    assert set(re.findall(r"\bnte ([a-z-]+) [A-Z]", text)) <= NAMES
    assert all((FORMS[0].parents[2] / page).is_file() for page in re.findall(r"docs/\w+\.md", text))


def test_a_bug_comes_with_what_the_commands_say() -> None:
    text = (FORMS[0].parent / "bug.yml").read_text("utf-8")
    for command in ("`nte check CLIP`", "`nte info CLIP`", "`nte --version`"):
        assert command in text
