"""The page: whole without a network, safe from names, and as fresh as its sources."""

import json
import re
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path

import pytest

import nte
from nte.errors import NteError
from nte.viewer.page import clear, render_page, write_page
from tests.viewer.reading import data_of

NASTY = "</script><!--<b>x&y"
SOURCES = Path(__file__).parents[2] / "viewer"
BUNDLE = Path(nte.__file__).parent / "viewer" / "bundle"
DATA = {"title": NASTY, "clips": [], "rows": [{"denoiser": NASTY}]}


class Tags(HTMLParser):
    """Collects the tags of a page, and that each is closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes nothing"


def test_the_page_is_whole_and_needs_no_network(tmp_path: Path) -> None:
    path = write_page(tmp_path, DATA, "psnr 3")
    html = path.read_text("utf-8")
    page = Tags(html)
    assert [tag for tag, _ in page.tags].count("script") == 2
    assert not any({"src", "href"} & attributes.keys() for _, attributes in page.tags)
    assert "@import" not in html
    assert not re.search(r"url\((?!data:)", html)
    code = re.sub(r"/\*!.*?\*/", "", html, flags=re.DOTALL)  # without the licences
    assert not re.search(r"https?://(?!www\.w3\.org/)", code)
    assert [found.name for found in tmp_path.iterdir()] == ["index.html"]
    assert ("html", {"lang": "en"}) in page.tags


def test_names_cannot_break_the_page() -> None:
    html = render_page(DATA, NASTY)
    assert NASTY not in html
    assert data_of(html)["title"] == NASTY
    assert data_of(html)["rows"] == [{"denoiser": NASTY}]
    Tags(html)


def test_only_what_the_viewer_wrote_is_deleted(tmp_path: Path) -> None:
    write_page(tmp_path, DATA)
    for name in ("layers/clip/image/0001.js", "layers/clip/image/notes.js", "layers/mine.txt", "other/0001.js"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    clear(tmp_path)
    left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert left == {"layers/clip/image/notes.js", "layers/mine.txt", "other/0001.js"}
    for name in left:
        (tmp_path / name).unlink()
    clear(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"other"}


def test_nothing_is_deleted_through_a_link(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    (outside / "clip" / "image").mkdir(parents=True)
    (outside / "clip" / "image" / "0001.js").write_text("x")
    (tmp_path / "out" / "layers").mkdir(parents=True)
    (tmp_path / "out" / "layers" / "clip").symlink_to(outside / "clip")
    clear(tmp_path / "out")
    (tmp_path / "out2").mkdir()
    (tmp_path / "out2" / "layers").symlink_to(outside)
    with pytest.raises(NteError, match="is a link"):
        clear(tmp_path / "out2")
    assert (outside / "clip" / "image" / "0001.js").exists()


def test_the_bundle_was_built_from_these_sources() -> None:
    """`make viewer` builds it; the digest in its first line is that of its sources."""
    files = ["build.mjs", "package-lock.json", *sorted(f"src/{path.name}" for path in (SOURCES / "src").iterdir())]
    digest = sha256(b"".join((SOURCES / name).read_bytes() for name in files)).hexdigest()
    script = (BUNDLE / "viewer.js").read_text("utf-8")
    assert script.startswith(f"/* sources {digest} */"), "the sources of the viewer were changed: run make viewer"


def test_every_package_of_the_bundle_is_listed_with_its_licence() -> None:
    """Those that the lock file installs, but not for development, are those that esbuild put into the bundle."""
    packages = json.loads((SOURCES / "package-lock.json").read_text("utf-8"))["packages"]
    expected = {
        path.rpartition("node_modules/")[2]: (about["version"], about["license"])
        for path, about in packages.items()
        if path and not about.get("dev")
    }
    listed = (BUNDLE / "THIRD_PARTY_LICENSES.txt").read_text("utf-8")
    found = re.findall(r"^(\S+) (\d+\.\d+\.\d+)\nLicence: (.+)$", listed, re.MULTILINE)
    assert {name: (version, licence) for name, version, licence in found} == expected
    assert [licence for *_, licence in found] == ["MIT"] * len(found)  # another one has other duties: look at them
    assert listed.count("Permission is hereby granted") == listed.count("Copyright (c)") == len(found)


def test_the_bundle_is_small_and_brings_its_licences() -> None:
    script = (BUNDLE / "viewer.js").read_text("utf-8")
    assert len(script) < 150_000
    listed = (BUNDLE / "THIRD_PARTY_LICENSES.txt").read_text("utf-8")
    assert listed.partition("\n\n")[2] in script
    assert "</script" not in script
    assert "<!--" not in script
