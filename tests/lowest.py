"""Prints constraints for make compat: every package that pyproject.toml names, in the lowest version that it allows."""

import tomllib
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def lower_bounds() -> Iterator[tuple[str, str]]:
    """Each package that is named in the dependencies and extras, once, with its lower bound."""
    project = tomllib.loads(PROJECT.read_text("utf-8"))["project"]
    asked = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    found = dict[str, str]()
    for text in asked:
        needed = Requirement(text)
        (bound,) = (one.version for one in needed.specifier if one.operator == ">=")
        assert found.setdefault(needed.name, bound) == bound, f"{needed.name} has two bounds"
    yield from found.items()


if __name__ == "__main__":
    for name, bound in lower_bounds():
        print(f"{name}=={bound}")
