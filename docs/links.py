"""What is wrong with the links of a site in a folder: ``python docs/links.py build/docs``; exit code 1 if any."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

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


def faults(site: Path) -> Iterator[str]:
    """Sentences: what is loaded from the network or is not there, and links to files or anchors that are not there."""
    pages = {file.resolve(): Page(file) for file in site.rglob("*.html") if file.name != "404.html"}
    for file, page in pages.items():
        name = file.relative_to(site.resolve())
        for address in (each for each in page.loads if not each.startswith("data:")):
            if "//" in address or not (file.parent / unquote(address.partition("?")[0])).is_file():
                yield f"{name} loads {address}, which is not beside it."
        for link in page.links:
            path, _, anchor = unquote(link).partition("#")
            if "//" in link or link.startswith("mailto:"):
                continue
            target = (file.parent / path).resolve() if path else file
            if path not in (".", "") and not target.is_file():
                yield f"{name} links to {link}, which is not there."
            elif anchor and target in pages and "__" not in anchor and anchor not in pages[target].ids:
                yield f"{name} links to {link}, where there is no such anchor."


if __name__ == "__main__":
    found = list(faults(Path(sys.argv[1])))
    print(*found, sep="\n", end="\n" if found else "")
    sys.exit(bool(found))
