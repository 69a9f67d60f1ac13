"""What nte is installed from: the lock file has every tested version, with hashes."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
ENTRY = re.compile(r"^([A-Za-z0-9._-]+)==([^ ;\\\n]+)(.*(?:\n    --hash.*)*)", re.MULTILINE)


def plain(name: str) -> str:
    """A package's name as PyPI compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def entries(path: Path) -> dict[str, tuple[str, str]]:
    """Package → version, and the rest of its entry."""
    return {plain(name): (version, rest) for name, version, rest in ENTRY.findall(path.read_text("utf-8"))}


def test_the_lock_file_has_what_was_tested_with_hashes() -> None:
    locked, tested = entries(ROOT / "requirements.lock"), entries(ROOT / "constraints.txt")
    assert {name: version for name, (version, _) in tested.items()} == {name: locked[name][0] for name in tested}
    assert [name for name, (_, rest) in locked.items() if not re.search(r"--hash=sha256:[0-9a-f]{64}", rest)] == []


def test_whatever_nte_asks_for_is_locked() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    asked = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    names = {plain(found[0]) for one in asked if (found := re.match(r"[A-Za-z0-9._-]+", one))}
    assert names - {plain(project["name"])} <= set(entries(ROOT / "requirements.lock"))


def test_the_bill_of_materials_is_of_what_is_locked_and_not_of_what_somebody_has_installed() -> None:
    (line,) = [line for line in (ROOT / "Makefile").read_text("utf-8").splitlines() if "cyclonedx-py" in line]
    assert "cyclonedx-py requirements requirements.lock" in line
