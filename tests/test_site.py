"""The documentation as a site: it is built without a warning, opens from a folder, and no link of it leads nowhere."""

from __future__ import annotations

import os
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

pytest.importorskip("material", reason="mkdocs-material is not installed")

ROOT = Path(__file__).resolve().parents[1]
LOADED = {"script": "src", "img": "src", "link": "href"}  # what a page loads by itself


class Page(HTMLParser):
    """The addresses in a page: what it loads, where it links to, and what of it can be linked to."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = {key: value for key, value in attributes if value}
        self.ids |= {found["id"]} if "id" in found else set()
        if tag in LOADED and LOADED[tag] in found and found.get("rel") not in ("canonical", "prev", "next"):
            self.loads.append(found[LOADED[tag]])
        if tag == "a" and "href" in found:
            self.links.append(found["href"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True,
                          text=True, check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return out


def test_nothing_is_loaded_from_the_network(site: Path) -> None:
    """Styles, scripts, fonts and images lie beside the pages, the index of the search as a script among them."""
    pages = {file: Page(file) for file in site.glob("*.html") if file.name != "404.html"}
    assert len(pages) > 20
    for file, page in pages.items():
        for address in page.loads:
            assert "//" not in address and (file.parent / unquote(address.partition("?")[0])).is_file(), (file, address)
    styles = [file.read_text(encoding="utf-8") for file in site.rglob("*.css")]
    assert styles and not any("url(http" in text or "@import" in text for text in styles)
    assert (site / "search" / "search_index.js").is_file()


def test_links(site: Path) -> None:
    """Every link within the site leads to a file that is there, and to an anchor that is in it."""
    pages = {file: Page(file) for file in site.glob("*.html") if file.name != "404.html"}
    for file, page in pages.items():
        for link in page.links:
            path, _, anchor = unquote(link).partition("#")
            if "//" in link or link.startswith("mailto:") or path.startswith("api/"):  # make docs writes the API
                continue
            target = (file.parent / path).resolve() if path else file
            assert target.is_file() or path in (".", ""), (file.name, link)
            if anchor and target in pages and not anchor.startswith("__"):
                assert anchor in pages[target].ids, (file.name, link)
