"""Text files as tables: CSV in the dialects of laboratories and spreadsheets.

The first lines decide all of the layout: what separates fields, the decimal mark, and where header and samples begin. A
later line that contradicts them is rejected, and an ambiguous layout is an error that asks for the option.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver.errors import InputError

from .clock import in_seconds, is_clock, is_date, past_midnight
from .numbers import COMMENT, MISSING, quickly, slowly, without_remark
from .table import Column, Fault, Place, Table
from .titles import is_time, is_unit, name_and_unit

_HEAD = 1 << 20  # bytes, in which the samples begin
_ENDLESS = 1 << 62
_BYTE_ORDER = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def read_text_table(path: Path, decimal: str | None) -> Table:
    """A text file as a table. Raises ValueError, one sentence with line and column where there is one."""
    source = str(path)
    with open(path, "rb") as stream:
        head = stream.read(_HEAD)
    encoding = _encoding(head, source)
    form = layout(_lines(head.decode(encoding, "replace")), source, decimal)
    titles = list(form.titles)
    if len(titles) == 1:
        raise InputError(
            f"{source}: line {form.header}: there is no channel beside the time; add one, such as 'AA.P [mmHg]'."
        )
    numbers = None
    plain = form.header == form.first - 1 < 2 and encoding.startswith("utf-8")
    plain = plain and form.separator != SPACE and not any(form.clocks) and not head.startswith(b"'")
    lines: list[str] = []
    if plain and form.mark == ".":
        numbers = quickly(path, form.header, len(titles), form.separator, form.mark)
    if numbers is None:
        lines = _prepared(_lines(path.read_bytes().decode(encoding, "replace")), form)
        data = "\n".join(lines[form.first - 1 :]).rstrip("\n").encode() + b"\n"
        if not plain or form.mark != ".":
            numbers = quickly(data, 0, len(titles), form.separator, form.mark)
    header = form.header or None
    place = Place(source, header, range(form.first, _ENDLESS))
    faults: list[Fault | None] = [None] * len(titles)
    if numbers is None:
        numbers, where, faults = slowly(lines, place, titles, form.separator, form.mark, form.grouped)
        place = Place(source, header, where)
    columns = [
        Column(title or f"column {i}", past_midnight(values) if clock else values, unit, "", fault, clock)
        for i, (title, values, unit, clock, fault) in enumerate(
            zip(titles, numbers, form.units, form.clocks, faults, strict=True), start=1
        )
        if title or not np.isnan(values).all()  # a separator at the end of every line makes a column of nothing
    ]
    return Table(place, columns, str(form), header is not None)


def _prepared(lines: list[str], form: Layout) -> list[str]:
    """The lines, with one blank between fields for several and seconds for clock times."""
    head, samples = lines[: form.first - 1], lines[form.first - 1 :]
    if form.separator == SPACE:
        samples = [" ".join(line.split()) for line in samples]
    return head + (in_seconds(samples, form.separator, form.mark) if any(form.clocks) else samples)


def _lines(text: str) -> list[str]:
    """Lines, without the single quotes of a file that begins with one, nor the date in them, as rdsamp writes them, and
    without the fixed blanks that group digits by thousands in French."""
    text = re.sub(r"(?<=\d)[\u00a0\u202f](?=\d{3}(?!\d))", "", text)
    if text.startswith("'"):
        text = re.sub(r"'(?:\[(\S+)[^\]'\n]*\]|([^'\n]*))'", r"\1\2", text)
    return re.split(r"\r\n|\r|\n", text)


def _encoding(head: bytes, source: str) -> str:
    """UTF-8, UTF-16 by its mark, or the encoding of Windows, in which only letters of names and units can be wrong."""
    for mark, name in _BYTE_ORDER.items():
        if head.startswith(mark):
            return name
    if b"\0" in head:
        raise InputError(f"{source}: not text (byte {head.index(0)} is zero); export it as CSV, in UTF-8.")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


# --- the layout of a file ---------------------------------------------------------------------------------------------

_LOOKED_AT = 2000  # lines
_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas"}
SPACE = " "  # any number of blanks, where there is nothing else between the fields
_MARKS = {"comma": ",", "point": "."}
_NUMBER = re.compile(r"(?!.*\.\d*,[+-]?\d*\.)[+-]?[\d.,]*\d[\d.,]*(?:[eE][+-]?\d+)?|nan|[+-]?inf|", re.IGNORECASE)
# a word with what stands in brackets behind it, as titles are, or the latter alone
_WORD = re.compile(r"[^\s\[(]+(?:\s*(?:\[[^\]]*\]|\([^)]*\)))?|\[[^\]]*\]|\([^)]*\)")
_CLOCK = re.compile(r"hh?:mm:ss\S*.*", re.IGNORECASE)  # how a clock is written, below its title
_GROUPED = r"[+-]?[1-9]\d{{0,2}}(?:\{}\d{{3}})+"  # may be thousands


@dataclass(frozen=True)
class Layout:
    """titles and units of the columns, "" where the title has the unit; header and first : lines of both, from 1.

    Without a header, its line is 0 and the titles are the columns' numbers, from 1.
    clocks : whether each column is a time as clocks show it.
    """

    separator: str
    mark: str
    grouped: bool
    titles: Sequence[str]
    units: Sequence[str]
    header: int
    first: int
    clocks: Sequence[bool]

    def __str__(self) -> str:
        mark = next(word for word, sign in _MARKS.items() if sign == self.mark)
        header = f"header in line {self.header}" if self.header else "no header"
        return f"{_SEPARATORS.get(self.separator, 'spaces')} between fields, decimal {mark}, {header}"


def layout(lines: Sequence[str], source: str, decimal: str | None) -> Layout:
    """The layout of a file that begins with these lines; decimal : comma or point, by default found.

    Raises ValueError, one sentence, where there is no table or no single way to read it.
    """
    if decimal is not None and decimal not in _MARKS:
        raise InputError(f"--decimal = {decimal!r}: must be comma or point.")
    lines = lines[:_LOOKED_AT]
    separator, start = _separator(lines, source)
    width = len(_fields(lines[start], separator)) if start < len(lines) else None
    separators = [_separator_above(each, separator, width) for each in lines[:start]] + [separator] * len(lines[start:])
    rows = [_fields(line, each, width) for line, each in zip(lines, separators, strict=True)]
    header = _header(rows, start, lines)
    untitled = [str(i + 1) for i in range(width or 0)]
    titles = untitled if header < 0 else _titles(lines[header], separators[header], source, header, width)
    if chart := labchart(rows[:start], rows[start] if start < len(rows) else ()):
        header = next(i for i, row in enumerate(rows) if row and row[0].strip() == "ChannelTitle=")
        titles, units = chart
    else:
        beside = [*rows[max(header - 1, 0) : max(header, 0)], *rows[header + 1 : start]]
        between = [row for row in beside if any(cell.strip() for cell in row)]
        units = next(([cell.strip(" []()") for cell in row] for row in between if _is_units(row)), [])
        titles, units = biopac(lines[:header], titles) or (titles, units or [""] * len(titles))
        if start == len(lines) or not (
            all(_beside(row, line) for row, line in zip(rows[header + 1 : start], lines[header + 1 :], strict=False))
        ):
            start = header + 1  # what is there is said cell by cell
    if not any(map(str.strip, further := rows[start][len(titles) :] if start < len(rows) else [])):
        titles = [*titles, *further]  # of a separator at the end of each line of numbers
    units += [""] * (len(titles) - len(units))
    mark = _MARKS[decimal] if decimal else _mark(rows[start:], separator, source, start + 1)
    clocks = [is_clock(cell) for cell in rows[start][: len(titles)]] if start < len(rows) else []
    clocks += [False] * (len(titles) - len(clocks))
    return Layout(separator, mark, decimal is not None, titles, units, header + 1, start + 1, clocks)


def _fields(line: str, separator: str, width: int | None = None, strict: bool = False) -> list[str]:
    """The fields of a line, a leading mark of a comment aside, none of one that is not CSV; width : of a line of
    numbers. strict : raise csv.Error for a line that is not."""
    if separator == SPACE:
        text = line.lstrip("#%/ ")
        words, apart = _WORD.findall(text), re.split(r"\s{2,}", text.strip())
        return apart if len(words) != width == len(apart) else words
    rows = csv.reader([line.lstrip("#%/ ")], delimiter=separator, skipinitialspace=True, strict=strict)
    try:
        return next(rows, [])
    except csv.Error:
        if strict:
            raise
        return []


def _separator_above(line: str, separator: str, width: int | None) -> str:
    """What separates the fields of a line above the numbers: that of the numbers, or another that makes as many."""
    if len(_fields(line, separator, width)) > 1:
        return separator
    return next((each for each in _SEPARATORS if len(_fields(line, each)) == width != 1), separator)


def _separator(lines: Sequence[str], source: str) -> tuple[str, int]:
    """What separates the fields, and the first line of numbers, from 0: the end of the lines if there is none."""
    found = []
    for rank, each in enumerate(_SEPARATORS):
        at = next((i for i, line in enumerate(lines) if _is_sample(line, each)), None)
        if at is not None:
            found.append((at, rank, each))
    if found:
        at, _, separator = min(found)
        return separator, at
    at = next((i for i, line in enumerate(lines) if _is_sample(line, SPACE)), None)
    if at is not None:
        return SPACE, at
    for i, line in enumerate(lines):
        marks = [each for each in _SEPARATORS if each in line]
        if len(marks) > 1 and _is_sample(line.translate(dict.fromkeys(map(ord, marks), ";")), ";"):
            names = " and ".join(_SEPARATORS[each] for each in marks)
            raise InputError(f"{source}: line {i + 1}: {names} separate its fields; export the table with one of them.")
    header = next((line for line in lines if line.strip() and not line.startswith(COMMENT)), "")
    if not header:
        raise InputError(f"{source}: the file is empty; export the recording again.")
    if is_time(name_and_unit(header)[0]):
        raise InputError(f"{source}: line 1: there is no channel beside the time; add one, such as 'AA.P [mmHg]'.")
    if not any(each in line for each in _SEPARATORS for line in lines):
        raise InputError(
            f"{source}: line 1: there are no columns, but {header[:30]!r}; give a table with commas, semicolons, "
            "tabs or spaces between its fields, whose first lines name the columns, such as time [s],AA.P [mmHg]."
        )
    return max(_SEPARATORS, key=header.count), len(lines)  # what is below the header is said cell by cell


def _is_sample(line: str, separator: str) -> bool:
    """Whether it is a line of two numbers at least, the first, a time, among them."""
    if separator not in line or line.lstrip().startswith(COMMENT):
        return False
    cells = [cell.strip() for cell in _fields(without_remark(line), separator)]
    there = [cell for cell in cells if cell]
    return (
        len(there) > 1
        and bool(cells[0])
        and all(_NUMBER.fullmatch(cell) or cell in MISSING or is_clock(cell) or is_date(cell) for cell in cells)
    )


def _header(rows: Sequence[Sequence[str]], start: int, lines: Sequence[str]) -> int:
    """The line of the titles, from 0: the last before the numbers that names a time, else the last with as many fields.

    A line of units below it is none. -1: there are numbers, and nothing above that could be titles.
    """
    above = [i for i in range(min(start, len(rows))) if len(rows[i]) > 1]
    if start < len(rows):
        above = [i for i in above if len(rows[i]) == len(rows[start])] or above
    timed = [i for i in above if not _is_units(rows[i]) and any(is_time(name_and_unit(cell)[0]) for cell in rows[i])]
    if timed:
        return timed[-1]
    named = [i for i in above if not _is_units(rows[i]) and rows[i][0].strip()] or above
    plain = [i for i in named if not lines[i].startswith(COMMENT)]
    if plain or named:
        return (plain or named)[-1]
    return -1 if start < len(rows) else next(i for i, line in enumerate(lines) if line.strip())


def _titles(line: str, separator: str, source: str, at: int, width: int | None) -> list[str]:
    try:
        return [title.strip() for title in _fields(line, separator, width, strict=True)]
    except csv.Error as error:
        why = f"not a CSV header ({error}); write time [s],AA.P [mmHg], ..."
        raise InputError(f"{source}: line {at + 1}: {why}") from None


def _is_units(row: Sequence[str]) -> bool:
    """Whether a line below the titles holds their units: all that it has, or two among those of other signals, as of an
    ECG."""
    cells = [cell for cell in (cell.strip(" []()") for cell in row) if cell]
    known = sum(is_unit(cell) or _CLOCK.fullmatch(cell) is not None for cell in cells)
    return known > 0 and (known == len(cells) or known > 1)


def _beside(row: Sequence[str], line: str) -> bool:
    """Whether a line between header and numbers is neither: empty, a comment, units, words without a number, or counts
    of samples (Biopac)."""
    cells = [cell.strip() for cell in row]
    if not any(cells) or line.startswith(COMMENT) or _is_units(row):
        return True
    numbers = [bool(_NUMBER.fullmatch(cell)) for cell in cells]
    return not any(number and cell for number, cell in zip(numbers, cells, strict=True)) or (
        not cells[0] and all(numbers)
    )


def _mark(rows: Sequence[Sequence[str]], separator: str, source: str, first: int) -> str:
    """The decimal mark of the numbers; raises ValueError where it may as well group thousands."""
    if separator == "," and not any("," in cell for row in rows for cell in row):
        return "."
    cells = [cell.strip() for row in rows for cell in row if _NUMBER.fullmatch(cell.strip()) and not is_date(cell)]
    commas = [cell for cell in cells if "," in cell and "." not in cell]
    points = [cell for cell in cells if "." in cell and "," not in cell]
    if not commas and (separator == "," or not points):
        return "."
    mark, other, marked = (",", ".", commas) if len(commas) > len(points) else (".", ",", points)
    if commas and points or not all(re.fullmatch(_GROUPED.format(mark), cell) for cell in marked):
        return mark
    if mark == "." and separator != ";":
        return mark
    name = {sign: word for word, sign in _MARKS.items()}
    whole = marked[0].replace(mark, "")
    raise InputError(
        f"{source}: line {first}: {marked[0]!r} may be {marked[0].replace(mark, '.')} or {whole}; say which: "
        f"--decimal {name[mark]} (it is the decimal mark) or --decimal {name[other]} (it groups thousands)."
    )


# --- what LabChart (ADInstruments) and AcqKnowledge (Biopac) write above the columns ---------------------------------


def labchart(rows: Sequence[Sequence[str]], first: Sequence[str]) -> tuple[list[str], list[str]] | None:
    """Titles and units, time first, of lines ``ChannelTitle=``, ``Range=`` and ``UnitName=``, which stand for a header;
    None if there are none. first : row of numbers, among which a date has no title."""
    lines = {row[0].strip(): [cell.strip() for cell in row[1:]] for row in rows if row}
    titles = lines.get("ChannelTitle=")
    if titles is None:
        return None
    units = lines.get("UnitName=") or [re.sub(r"^[\d.,\s]+", "", each) for each in lines.get("Range=", [])]
    units += [""] * (len(titles) - len(units))
    clock = lines.get("TimeFormat=", [""])[0]
    units = units[: len(titles)]
    if len(first) != len(titles):  # else it was exported without times
        titles = ["Time", *titles]
        units = ["s" if not clock or clock.startswith("StartOf") else "", *units]
    for i, cell in enumerate(first):
        if is_date(cell.strip()):
            titles.insert(i, "")
            units.insert(i, "")
    return titles, units


def biopac(lines: Sequence[str], titles: Sequence[str]) -> tuple[list[str], list[str]] | None:
    """The same of AcqKnowledge, where every channel's name and unit are lines of their own above the header.

    titles : of the header, such as min, CH1, CH2.
    """
    start = next((i for i, line in enumerate(lines) if re.fullmatch(r"\d+ channels?", line.strip(" \t,;"))), None)
    if start is None:
        return None
    pairs = [line.strip(" \t,;") for line in lines[start + 1 :]]
    names, units = pairs[::2], pairs[1::2]
    channels = [title for title in titles[1:] if title]
    if len(names) != len(channels) or len(units) != len(channels):
        return None
    last = [""] * (len(titles) - 1 - len(channels))  # of a separator at the end
    return [titles[0], *names, *last], ["", *(unit if is_unit(unit) else "" for unit in units)]
