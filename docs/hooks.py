"""What the site makes of pages that a code host shows too: the first page, notebooks, and links out of docs/."""

from __future__ import annotations

import base64
import json
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import live
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
# pages of the site that lie beside docs/, and where they stand in it
BESIDE = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
_LIVE = "<!-- live -->"  # where a page has the live beat
_LINK = re.compile(r"(\[(?:[^\[\]]|\[[^\]]*\])*\])\(([^)\s#:]+)(#[^)\s]*)?\)")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages from beside docs/, and as text every file that a page links to."""
    for name, page in BESIDE.items():
        files.append(File.generated(config, page, content=_within((ROOT / name).read_text(encoding="utf-8"), "")))
    for notebook in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")):
        for file, content in _pages(notebook):
            files.append(File.generated(config, file, content=content))
    files.append(File.generated(config, "live-data.js", content=live.script()))
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md")]
    targets = {target for text in texts for target in _targets(text, "docs")}
    for name in BESIDE:
        targets |= _targets((ROOT / name).read_text(encoding="utf-8"), "")
    for target in sorted(targets):
        if _is_source(target):
            content = (ROOT / target).read_text(encoding="utf-8")
            files.append(File.generated(config, f"source/{target}.txt", content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **others: Any) -> str:
    """Turn the links of a page in docs/ to where the site has what they lead to."""
    beside = page.file.src_uri in BESIDE.values()
    markdown = markdown.replace(_LIVE, live.block())
    return markdown if beside else _within(markdown, "docs")


def on_post_page(output: str, **others: Any) -> str:
    """Have the search of a site in a folder from the site itself, where the theme would ask the network."""
    return output.replace("https://unpkg.com/iframe-worker/shim", "worker.js")


def _pages(notebook: Path) -> Iterator[tuple[str, str | bytes]]:
    """The page of a notebook, as it was executed, and its figures: names and contents."""
    text = []
    for i, cell in enumerate(json.loads(notebook.read_text(encoding="utf-8"))["cells"]):
        source = "".join(cell["source"])
        text.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            data = {kind: "".join(lines) for kind, lines in output["data"].items()}
            if "image/png" in data:
                figure = f"notebook-{notebook.stem}-{i}.png"
                yield figure, base64.b64decode(data["image/png"])
                text.append(f"![]({figure})")
            elif "text/html" in data:
                text.append(data["text/html"])
            else:
                text.append(f"```text\n{data['text/plain']}\n```")
    text.append(f"This notebook: `examples/notebooks/{notebook.name}`.")
    yield f"notebook-{notebook.stem}.md", "\n\n".join(text)


def _within(markdown: str, folder: str) -> str:
    """The text with links that begin in ``folder`` of the project, as the site needs them."""

    def turned(link: re.Match[str]) -> str:
        text, target, anchor = link[1], posixpath.normpath(posixpath.join(folder, link[2])), link[3] or ""
        if target in BESIDE:
            return f"{text}({BESIDE[target]}{anchor})"
        if target.startswith("docs/"):
            return f"{text}({target.removeprefix('docs/')}{anchor})"
        return f"{text}(source/{target}.txt)" if _is_source(target) else text[1:-1]  # a folder has no page

    return _LINK.sub(turned, markdown)


def _targets(markdown: str, folder: str) -> set[str]:
    """The files and folders that a text links to, from the project's root."""
    return {posixpath.normpath(posixpath.join(folder, link[2])) for link in _LINK.finditer(markdown)}


def _is_source(target: str) -> bool:
    return target not in BESIDE and not target.startswith("docs/") and (ROOT / target).is_file()
