"""Small tables in HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from fitting.pages.page import paragraphs


def table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], notes: Sequence[str] = ()) -> str:
    """A title, a table with its first column left-aligned and all others right-aligned, and sentences below it.

    All are plain text: HTML markup is escaped. Of a title with several lines the first is bold; lines that begin with
    "- " are a list.
    """
    body = "".join(f"<tr>{_cells('td', row)}</tr>" for row in rows)
    first, _, more = title.partition("\n")
    inside = f"<table><thead><tr>{_cells('th', head)}</tr></thead><tbody>{body}</tbody></table>" if body else ""
    return f"<div><p><b>{escape(first)}</b></p>{_prose(more)}{inside}{''.join(map(_prose, notes))}</div>"


def _prose(text: str) -> str:
    """Paragraphs and lists in HTML; text is escaped."""
    found = ""
    for listed, lines in paragraphs(text) if text else ():
        tag, around = ("li", "<ul>{}</ul>") if listed else ("p", "{}")
        found += around.format("".join(f"<{tag}>{escape(line.strip())}</{tag}>" for line in lines))
    return found


def _cells(tag: str, texts: Sequence[str]) -> str:
    sides = ("left", *("right",) * (len(texts) - 1))
    return "".join(
        f'<{tag} style="text-align:{side}">{escape(t)}</{tag}>' for side, t in zip(sides, texts, strict=True)
    )
