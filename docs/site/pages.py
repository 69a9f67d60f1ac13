"""What the site is made of: the Markdown of the repository, at the same paths, so links lead where they lead there.

A link to another file or folder of the repository leads to a page that shows it, and the picture of a page comes along.
"""

import json
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
PAGES = ("*.md", "docs/*.md", "datasets/*.md", "export/*.md", "nte/released/*.md")
LINK = re.compile(r"\]\((?!\w+:|#)([^)#\s]+)(#[^)\s]*)?\)")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".xml": "xml", ".json": "json"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Replace the files of docs_dir by the pages of the repository and what they link to."""
    pages = [page for pattern in PAGES for page in sorted(ROOT.glob(pattern))]
    linked = {target for page in pages for target in targets(page) if target.exists() and target.suffix != ".md"}
    others = [file for file in files if not Path(file.abs_src_path or "/").is_relative_to(config.docs_dir)]  # a theme's
    made = [copied(path, config) for path in (*pages, *Path(__file__).parent.glob("*.[cj]s*"))]
    for target in sorted(linked):
        made.append(copied(target, config) if is_picture(target) else shown(target, config))
    return Files([*others, *made])


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Let links to files that are no pages lead to the pages that show them."""
    here = ROOT / page.file.src_uri
    if not here.is_file():  # a page that shows a file
        return markdown

    def leads(link: re.Match[str]) -> str:
        target = (here.parent / link[1]).resolve()
        is_shown = target.exists() and target.suffix != ".md" and not is_picture(target)
        return f"]({link[1].rstrip('/')}.md)" if is_shown else link[0]

    return LINK.sub(leads, markdown)


def targets(page: Path) -> list[Path]:
    """Return the files and folders that a page links to."""
    return [(page.parent / path).resolve() for path, _ in LINK.findall(page.read_text("utf-8"))]


def is_picture(path: Path) -> bool:
    return path.suffix in (".png", ".svg", ".webp")


def copied(path: Path, config: MkDocsConfig) -> File:
    """Return a file of the repository, at its own path in the site."""
    name = path.relative_to(ROOT).as_posix()
    return File(name, str(ROOT), config.site_dir, config.use_directory_urls)


def shown(path: Path, config: MkDocsConfig) -> File:
    """Return a page that shows a file as code, a notebook as its cells, or the files of a folder."""
    name = path.relative_to(ROOT).as_posix()
    if path.is_dir():
        text = "\n\n".join(code(inside) for inside in sorted(path.iterdir()) if inside.is_file())
    elif path.suffix == ".ipynb":
        text = "\n\n".join(map(cell, json.loads(path.read_text("utf-8"))["cells"]))
    else:
        text = code(path)
    return File.generated(
        config, f"{name}.md", content=f"---\ntitle: {name}\n---\n\n{text}\n", inclusion=InclusionLevel.NOT_IN_NAV
    )


def code(path: Path) -> str:
    return f"# `{path.name}`\n\n~~~~{LANGUAGES.get(path.suffix, 'text')}\n{path.read_text('utf-8')}\n~~~~"


def cell(of_notebook: dict[str, Any]) -> str:
    text = "".join(of_notebook["source"])
    return text if of_notebook["cell_type"] == "markdown" else f"~~~~python\n{text}\n~~~~"
