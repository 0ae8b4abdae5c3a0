"""Tables in text files (CSV): a row of names, with units in brackets or in a separate row, and rows of values."""

from __future__ import annotations

import csv
import os
import re
from dataclasses import dataclass

from ..errors import InputError
from ..quantities.text import parse_quantity, read_text

_HEADING = re.compile(r"(.*?)\s*\[(.*)\]")
_NO_UNIT = ("", "-", "–", "1")


@dataclass(frozen=True)
class Table:
    """names and units of the columns; rows of texts with their line in the file; ``comments``: lines after a #."""

    path: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    comments: tuple[str, ...]


def read(path: str | os.PathLike[str]) -> Table:
    """The table in a file. Raises ValueError, one sentence that starts with the file and names the line."""
    lines = read_text(path).splitlines()
    comments = tuple(line.lstrip()[1:].strip() for line in lines if line.lstrip().startswith("#"))
    kept = [(n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    rows = [(n, tuple(cell.strip() for cell in next(csv.reader([line])))) for n, line in kept]
    if len(rows) < 2:
        raise InputError(f"{path}: a table of {len(rows)} rows; it must have a row of names and rows of numbers.")
    headings, rows = rows[0][1], rows[1:]
    if len(headings) == 1 and re.search(r"[;\t]", headings[0]):
        raise InputError(f"{path}: its cells are separated by ; or tabs; separate them by commas.")
    for n, cells in rows:
        if len(cells) != len(headings):
            raise InputError(f"{path}, line {n}: {len(cells)} cells under {len(headings)} names; correct that line.")
    split = [_HEADING.fullmatch(heading) for heading in headings]
    names = tuple(found[1] if found else text for found, text in zip(split, headings, strict=True))
    units = tuple(found[2] if found else "" for found in split)
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: the column {name!r} occurs {names.count(name)} times; keep one.")
    if not any(units) and all(cell in _NO_UNIT or not _is_number(cell) for cell in rows[0][1]):
        units, rows = tuple(cell.strip("[]") for cell in rows[0][1]), rows[1:]
    return Table(str(path), names, tuple("" if u in _NO_UNIT else u for u in units), tuple(rows), comments)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def number(cell: str, given: str, unit: str, where: str, name: str) -> float:
    """A cell in SI; ``given`` : the unit of its column, where the cell has none. Raises ValueError."""
    text = f"{cell} {given}" if given and _is_number(cell) else cell
    return parse_quantity(text, unit, f"{where}: {name}")
