"""Small tables in HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], notes: Sequence[str] = ()) -> str:
    """A title, a table with its first column left-aligned and all others right-aligned, and sentences below it.

    All are plain text: HTML markup is escaped.
    """
    body = "".join(f"<tr>{_cells('td', row)}</tr>" for row in rows)
    paragraphs = "".join(f"<p>{escape(note)}</p>" for note in notes)
    inside = f"<table><thead><tr>{_cells('th', head)}</tr></thead><tbody>{body}</tbody></table>" if body else ""
    return f"<div><p><b>{escape(title)}</b></p>{inside}{paragraphs}</div>"


def _cells(tag: str, texts: Sequence[str]) -> str:
    sides = ("left", *("right",) * (len(texts) - 1))
    return "".join(
        f'<{tag} style="text-align:{side}">{escape(t)}</{tag}>' for side, t in zip(sides, texts, strict=True)
    )
