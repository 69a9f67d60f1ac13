"""What nte is installed from: the lock file has every tested version, with hashes."""

import json
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BILL = ROOT / "build" / "sbom.cdx.json"  # made by make supply, which ends with these tests
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


def differences(bill: Path, lock: Path) -> list[str]:
    """Packages of which a bill of materials does not say what the lock file does: version, and hash of each file."""
    listed = {}
    for one in json.loads(bill.read_text("utf-8")).get("components", []):
        of_files = [h["content"] for place in one.get("externalReferences", []) for h in place.get("hashes", [])]
        listed[plain(one["name"])] = one.get("version"), {h["content"] for h in one.get("hashes", [])} | {*of_files}
    locked = {n: (v, set(re.findall(r"sha256:([0-9a-f]{64})", rest))) for n, (v, rest) in entries(lock).items()}
    return sorted(name for name in {*listed, *locked} if listed.get(name) != locked.get(name))


@pytest.mark.skipif(not BILL.is_file(), reason="make supply, which needs a network, has not been run here")
def test_the_bill_of_materials_lists_what_is_locked_and_nothing_else() -> None:
    assert differences(BILL, ROOT / "requirements.lock") == []


def test_a_bill_of_materials_that_lacks_something_is_told(tmp_path: Path) -> None:
    digests = ["0" * 64, "1" * 64]
    lock, bill = tmp_path / "requirements.lock", tmp_path / "sbom.cdx.json"
    lock.write_text("a-b==1.0 \\\n" + " \\\n".join(f"    --hash=sha256:{d}" for d in digests) + "\n")
    places = [{"type": "distribution", "hashes": [{"alg": "SHA-256", "content": d}]} for d in digests]
    whole = {"name": "a_b", "version": "1.0", "externalReferences": places}
    for components, wrong in (
        ([whole], []),
        ([], ["a-b"]),
        ([{**whole, "version": "1.1"}], ["a-b"]),
        ([{**whole, "externalReferences": places[:1]}], ["a-b"]),
        ([whole, {**whole, "name": "c"}], ["c"]),
    ):
        bill.write_text(json.dumps({"components": components}))
        assert differences(bill, lock) == wrong


def test_the_bill_of_materials_is_of_what_is_locked_and_not_of_what_somebody_has_installed() -> None:
    (line,) = [line for line in (ROOT / "Makefile").read_text("utf-8").splitlines() if "cyclonedx-py" in line]
    assert "cyclonedx-py requirements requirements.lock" in line
