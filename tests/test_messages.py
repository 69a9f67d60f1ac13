"""What nte says to its users: no message sends them to a file that an installed package lacks."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "nte"
# tables.md is what nte compare writes
NOT_INSTALLED = re.compile(
    r"\b(datasets|docs|configs|export|benchmarks|tests|notebooks)/|\b(?!tables\.md)\w+\.md\b"
)  # tables.md is written by nte compare


def messages(tree: ast.AST) -> Iterator[ast.Constant]:
    """Every text in the code that may be shown: all but docstrings, and paths that the code itself opens."""
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    hidden = {id(node.body[0].value) for node in ast.walk(tree) if isinstance(node, kinds) and is_text(node.body)}  # type: ignore[attr-defined]
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Path":
            hidden |= {id(argument) for argument in node.args}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in hidden:
            yield node


def is_text(body: list[ast.stmt]) -> bool:
    return bool(body) and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant)


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_no_message_names_a_file_of_the_repository(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert not [f"line {text.lineno}: {text.value}" for text in messages(tree) if NOT_INSTALLED.search(text.value)]


def test_a_message_that_does_is_found() -> None:
    code = '"""docs/a.md"""\nraise NteError(f"{path}: no channel (see datasets/README.md)")\nopen(Path("docs/x"))'
    assert [text.lineno for text in messages(ast.parse(code)) if NOT_INSTALLED.search(text.value)] == [2]
