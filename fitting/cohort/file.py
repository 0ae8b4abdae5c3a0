"""Cohort files: a CSV with a line per recording, ``animal,site,record,h [mm],R0 [mm]``; or ``subject``, or ``patient``.

Fields are separated by commas, semicolons or tabs; with the latter two, decimal marks may be commas.

``record`` is a file beside it, h the measured wall thickness, R0 the measured unstressed radius, which may be empty:
the fit estimates it in any case, and compares.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from solver.errors import InputError
from solver.network.description import Segment
from solver.network.files import parse_quantity, read_text
from solver.quantities.quantity import quantities

from ..records.read.titles import name_and_unit

_SEPARATORS = (",", ";", "\t")
_WHO = ("animal", "subject", "patient", "participant", "volunteer")  # possible titles of the first column
_COLUMNS = ("animal", "site", "record", "h", "R0")


@dataclass(frozen=True)
class Entry:
    """A line of a cohort file: h and R0 [m], R0 None if it was not measured; record : path that can be opened.

    noun : the title of the first column, "animal" or "patient".
    """

    animal: str
    site: str
    record: str
    h: float
    R0: float | None = None
    noun: str = "animal"


def read_cohort(path: str | os.PathLike[str]) -> list[Entry]:
    """The entries of a cohort file; paths of records are relative to it.

    Raises ValueError, one sentence with file and line, for a missing column, cell or record, an invalid number, or an
    animal with two lines for one site.
    """
    source = os.fspath(path)
    text = read_text(path)
    separator = max(_SEPARATORS, key=text.partition("\n")[0].count)
    rows = csv.reader(io.StringIO(text), skipinitialspace=True, delimiter=separator)
    entries: list[Entry] = []
    try:
        places, units, noun = _header(next(rows, []))
        for row in rows:
            if any(cell.strip() for cell in row):
                where = f"line {rows.line_num}"
                entry = _entry(row, places, units, noun, Path(path).parent, where)
                if any((e.animal, e.site) == (entry.animal, entry.site) for e in entries):
                    raise InputError(f"{where}: {entry.animal} has a line for {entry.site} already; keep one.")
                entries.append(entry)
        if not entries:
            raise InputError("line 2: there is no recording below the header; add a line for each.")
    except csv.Error as error:
        raise InputError(f"{source}: line {rows.line_num}: not CSV ({error}); correct the line.") from None
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    return entries


def _header(titles: Sequence[str]) -> tuple[dict[str, int], dict[str, str], str]:
    """Position and unit of each column, a missing unit being SI, and the title of the first one."""
    places, units, nouns = {}, {}, []
    for i, title in enumerate(titles):
        name, unit = name_and_unit(title)
        if name in _WHO:
            nouns.append(name)
            name = "animal"
        if name in _COLUMNS:
            if name in places:
                message = (
                    f"the column {name} occurs twice" if len(set(nouns)) < 2 else f"{' and '.join(nouns)} are columns"
                )
                raise InputError(f"line 1: {message}; keep one.")
            places[name], units[name] = i, unit
    missing = [name for name in _COLUMNS if name not in places]
    if missing:
        raise InputError(
            f"line 1: {_listed(missing)} missing; the header must be "
            f"animal,site,record,h [mm],R0 [mm] (R0 may be left empty), or {', '.join(_WHO[1:])} for animal."
        )
    return places, units, nouns[0]


def _listed(missing: list[str]) -> str:
    *first, last = missing
    return f"the columns {', '.join(first)} and {last} are" if first else f"the column {last} is"


def _entry(row: list[str], places: dict[str, int], units: dict[str, str], noun: str, folder: Path, where: str) -> Entry:
    cells = {name: row[i].strip() if i < len(row) else "" for name, i in places.items()}
    for name in ("animal", "site", "record", "h"):
        if not cells[name]:
            called = noun if name == "animal" else name
            raise InputError(f"{where}: {called} is missing; only R0 may be left empty.")
    record = folder / cells["record"]
    if not record.is_file():
        raise InputError(f"{where}: there is no record file {record}; correct the name or remove the line.")
    lengths = {}
    for name in ("h", "R0"):
        if cells[name]:
            entry = f"{where}: {name}"
            point = re.sub(r"^(\d+),(\d+)$", r"\1.\2", cells[name])  # no comma separates fields where one is in a cell
            lengths[name] = parse_quantity(f"{point} {units[name]}", "m", entry)
            quantities(Segment)[name].check(entry, lengths[name])
    return Entry(cells["animal"], cells["site"], str(record), lengths["h"], lengths.get("R0"), noun)
