"""How much of nte mypy cannot see: every Any that is written down."""

import ast
from pathlib import Path

import nte

MOST = 60  # lines


def test_few_types_are_any():
    lines = [
        f"{path.name}:{line}"
        for path in sorted(Path(nte.__file__).parent.rglob("*.py"))
        for line in {
            node.lineno
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Name) and node.id == "Any"
        }
    ]
    assert len(lines) < MOST, "give these a type, or an alias that says what they are: " + " ".join(lines)
