"""The page: one index.html with the viewer and all numbers in it; the pixels lie beside it in the folder `layers`."""

import html
import json
import re
import shutil
from importlib.resources import files
from pathlib import Path

from nte.errors import NteError
from nte.files import remove, sweep, write_whole
from nte.frames.show import heat_tables
from nte.version import __version__
from nte.viewer.recorder import FOLDER, Entry

PAGE = "index.html"
_LAYER = re.compile(r"\d{4,}\.js")

_SHELL = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="nte {version}">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<div id="app"></div>
<noscript>
<h1>{title}</h1>
<p>The pictures and curves need JavaScript. These are the numbers.</p>
<pre>{text}</pre>
</noscript>
<script type="application/json" id="data">{data}</script>
<script>{script}</script>
</body>
</html>
"""


def write_page(out: Path, data: Entry, text: str = "") -> Path:
    """Write `out`/index.html, which needs neither network nor server, and return its path.

    data: what the script reads; viewer/src/data.ts describes it. text: the numbers for readers without JavaScript.
    Raises NteError if the file cannot be written.
    """
    content = render_page(data, text)
    write_whole(out / PAGE, lambda temporary: temporary.write_text(content, encoding="utf-8"))
    return out / PAGE


def render_page(data: Entry, text: str = "") -> str:
    """Render the page as HTML text; see `write_page`."""
    bundle = files("nte.viewer") / "bundle"
    whole = {"version": __version__, "folder": FOLDER, "heat": heat_tables(), **data}
    # A < inside JSON could end the script's element: names come from users.
    blob = json.dumps(whole, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return _SHELL.format(
        version=__version__,
        title=html.escape(data["title"]),
        style=(bundle / "viewer.css").read_text("utf-8"),
        text=html.escape(text),
        data=blob,
        script=(bundle / "viewer.js").read_text("utf-8"),
    )


def clear(out: Path) -> None:
    """Delete a page and its layers, and nothing else: files of other names in the folder of layers stay.

    Raises NteError if that is not permitted.
    """
    remove(out / PAGE)  # first: a page must not show what is left of its layers
    folder = out / FOLDER
    if folder.is_symlink():
        raise NteError(f"{folder}: is a link: nothing is deleted through links; remove it")
    for path in sorted(folder.rglob("*"), reverse=True) if folder.is_dir() else ():  # what is inside comes first
        if path.is_dir() and not path.is_symlink():
            sweep(path)
            _remove_empty(path)
        elif _LAYER.fullmatch(path.name):
            remove(path)
    _remove_empty(folder)


def size_of(out: Path) -> int:
    """Return the size of a page and its layers in bytes."""
    return sum(path.stat().st_size for path in [out / PAGE, *(out / FOLDER).rglob("*.js")])


def _remove_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        shutil.rmtree(folder, ignore_errors=True)
