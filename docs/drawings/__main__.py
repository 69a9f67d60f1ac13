"""Draws the pictures of docs/concepts.md: python docs/drawings [FOLDER]."""

import sys
from pathlib import Path

from concepts import DRAWINGS

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "pictures"
for name, draw in DRAWINGS.items():
    (folder / f"{name}.svg").write_text(draw(), "utf-8")
