"""The documentation as a site: it has every page and name, and its pictures and tables are what the code makes."""

import re
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

import nte
from benchmarks import options
from tests.test_pages import PAGES, ROOT

DOCS = ROOT / "docs"


def test_the_reference_has_every_name() -> None:
    page = (DOCS / "api.md").read_text("utf-8")
    named = {name.split(".")[-1] for name in re.findall(r"^::: (nte\S*)$", page, re.MULTILINE)}
    missing = {*nte.__all__} - named
    assert missing == {"CHANNELS", "__version__", "render"}  # data; and render_recipe by its own name
    assert "::: nte.render.recipes.clips.render_recipe" in page
    assert "`nte.CHANNELS`" in page


def test_options_on_the_page_are_those_of_the_classes() -> None:
    page = (DOCS / "denoisers.md").read_text("utf-8")
    assert options.updated(page) == page, "python -m benchmarks.options --write"
    assert {mark for mark, _ in options.MARK.findall(page)} == set(options.options_classes())


def test_every_option_has_a_meaning() -> None:
    for name, kind in options.options_classes().items():
        assert options.meanings(kind).keys() == {field.name for field in fields(kind)}, name


def test_drawings_are_what_their_program_draws(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "docs/drawings", str(tmp_path)], cwd=ROOT, check=True)
    drawn = {path.name: path.read_text("utf-8") for path in tmp_path.iterdir()}
    assert drawn == {path.name: path.read_text("utf-8") for path in (DOCS / "pictures").glob("*.svg")}
    assert set(drawn) == {*re.findall(r"\(pictures/(.*\.svg)\)", (DOCS / "concepts.md").read_text("utf-8"))}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` builds it."""
    pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
    pytest.importorskip("mkdocstrings", reason="the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True)
    return folder


def address(page: Path) -> str:
    """Where a page of the repository is on the site."""
    name = page.relative_to(ROOT).with_suffix(".html").as_posix()
    return re.sub(r"README\.html$", "index.html", name)


@pytest.mark.slow
def test_every_page_is_on_the_site_and_in_its_navigation(site: Path) -> None:
    front = (site / "index.html").read_text("utf-8")
    for page in PAGES:
        assert (site / address(page)).is_file()
        assert f'href="{address(page)}"' in front or page.name == "README.md"


@pytest.mark.slow
def test_links_within_the_site_lead_somewhere(site: Path) -> None:
    """Also those that mkdocs does not check, such as to pages that show a file of the repository."""
    broken = []
    for page in site.rglob("*.html"):
        if page.name == "404.html":  # made for the root of a server
            continue
        for link in re.findall(r'<[^<>]+ (?:href|src)="([^"#?]+)', page.read_text("utf-8")):
            if not re.match(r"\w+:|//", link) and not (page.parent / link).exists():
                broken.append(f"{page.relative_to(site)}: {link}")
    assert not broken


@pytest.mark.slow
def test_a_link_to_a_file_leads_to_a_page_that_shows_it(site: Path) -> None:
    shown = (site / "configs" / "paper.yaml.html").read_text("utf-8")
    assert "phases" in shown
    assert 'href="../configs/paper_small.yaml.html"' in (site / "docs" / "training.html").read_text("utf-8")
    assert "ntasd.yaml" in (site / "configs" / "neural.html").read_text("utf-8")
    assert "nte.denoise" in re.sub(r"<[^>]+>", "", (site / "notebooks" / "01_first_look.ipynb.html").read_text("utf-8"))


@pytest.mark.slow
def test_nothing_is_fetched_from_elsewhere(site: Path) -> None:
    fetched = re.compile(r'(?:src|<link[^>]+stylesheet"[^>]+href)="(https?:[^"]+)"')
    assert not [found for page in site.rglob("*.html") for found in fetched.findall(page.read_text("utf-8"))]


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("chromium"), reason="Chromium is not installed")
def test_the_search_works_from_disk_and_the_console_stays_empty(site: Path, tmp_path: Path) -> None:
    page = (site / "docs" / "concepts.html").as_uri() + "?q=disocclusion"
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", f"--user-data-dir={tmp_path}"]
    command = ["chromium", *flags, "--virtual-time-budget=15000", "--dump-dom", page]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    assert "CONSOLE" not in ran.stderr
    assert re.search(r"[1-9]\d* matching documents", ran.stdout)
