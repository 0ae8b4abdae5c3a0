"""The cells of a text file as numbers: by NumPy or polars, and where both stumble one by one, to say where and why."""

from __future__ import annotations

import csv
import io
import math
import re
import warnings
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from solver.errors import InputError

from .table import Array, Fault, Place

_SMALL = 1 << 21  # bytes, which NumPy reads in less time than the import of polars takes
COMMENT = ("#", "%", "//")
# errors of a spreadsheet, in English and in German
_ERRORS = ("#N/A", "#DIV/0!", "#NAME?", "#NULL!", "#NUM!", "#REF!", "#VALUE!", "#NV", "#BEZUG!", "#WERT!", "#ZAHL!")
_EMPTY = ("NA", "N/A", "n/a", *_ERRORS, "null", "NULL", "None")  # for a gap
MISSING = (*_EMPTY, "-", "--", "---", "...", "*", "**", "***", "-?-", "-.-", "?", "???")
_NUMBER = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf(?:inity)?)|nan|", re.IGNORECASE | re.ASCII
)

_ALMOST = re.compile(r"[+-]?[\d.,:]+\S*")  # a number, perhaps with a fault


def quickly(data: Path | bytes, skip: int, width: int, separator: str, mark: str) -> list[Array] | None:
    """One float array per column, NaN in gaps; None where only a look at every cell can tell."""
    if mark == "." and (numbers := _of_plain_cells(data, skip, width, separator)) is not None:
        return numbers
    import polars as pl  # takes a fifth of a second

    schema = {str(i): pl.Float64() for i in range(width)}
    if mark == "," and isinstance(data, bytes) and b"." in data:  # which polars takes for a decimal mark, too
        return None
    try:
        frame = pl.read_csv(
            io.BytesIO(data) if isinstance(data, bytes) else data,
            has_header=False, skip_rows=skip, schema=schema, glob=False, separator=separator, decimal_comma=mark == ",",
            null_values=list(MISSING),
        )  # fmt: skip
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException):  # its CSV reader panics on some broken files
        return None
    # polars fills up a row that is too short, and takes line ends of old spreadsheets for part of the header
    whole = (frame.height + skip) * (width - 1)
    if frame.height == 0 or (frame[:, -1].null_count() and _count(data, separator.encode()) != whole):
        return None
    if frame.select(pl.all_horizontal(pl.all().is_null()).any()).item():  # a row of separators alone is no sample
        return None
    return [frame[name].fill_null(np.nan).rechunk().to_numpy() for name in frame.columns]


def _of_plain_cells(data: Path | bytes, skip: int, width: int, separator: str) -> list[Array] | None:
    """The same of a small file with a number in every cell, None of any other."""
    if (len(data) if isinstance(data, bytes) else data.stat().st_size) > _SMALL:
        return None
    text = data if isinstance(data, bytes) else data.read_bytes()
    n = text.count(b"\n") + (text[-1:] != b"\n") - skip
    with warnings.catch_warnings(action="error"):  # of a file without samples
        try:
            rows = np.loadtxt(
                io.BytesIO(text), delimiter=separator, comments=None, skiprows=skip, ndmin=2, encoding="latin-1"
            )
        except (ValueError, UserWarning):
            return None
    return list(np.ascontiguousarray(rows.T)) if rows.shape == (n, width) else None  # it passes over empty lines


def _count(data: Path | bytes, separator: bytes) -> int:
    if isinstance(data, bytes):
        return data.count(separator)
    with open(data, "rb") as stream:
        return sum(block.count(separator) for block in iter(lambda: stream.read(1 << 22), b""))


def slowly(
    lines: Sequence[str], place: Place, titles: Sequence[str], separator: str, mark: str, grouped: bool
) -> tuple[list[Array], list[int], list[Fault | None]]:
    """The same cell by cell, the line of each sample, and of each column the first cell that is no number, which is NaN
    like all such: for comments and words among the samples and spaces in the cells.

    lines : of the whole file; the samples begin at ``place.lines[0]``. grouped : digits may be grouped by threes.
    """
    assert place.lines is not None
    start = place.lines[0]
    numbers, where, at = array("d"), list[int](), [start - 1]
    faults: list[Fault | None] = [None] * len(titles)
    if found := _without_comments(lines, start, titles, separator, mark):
        return *found, faults
    rows = csv.reader(_samples(lines, start, separator, len(titles), at), strict=True, delimiter=separator)
    try:
        for row in rows:
            if not any(map(str.strip, row)) or _is_remark(row, mark, grouped):
                continue
            if len(row) != len(titles):
                raise InputError(
                    f"{place}: line {at[0]}: {len(row)} fields where the header has {len(titles)}; complete or remove "
                    "the line (gaps are empty fields; if decimal marks are commas, separate the fields by semicolons)."
                )
            for i, cell in enumerate(row):
                value = _number(cell.strip(), mark, grouped)
                if value is None and faults[i] is None:
                    faults[i] = _fault(len(where), cell.strip(), mark)
                numbers.append(math.nan if value is None else value)
            where.append(at[0])
    except csv.Error as error:
        raise InputError(f"{place}: line {at[0]}: not CSV ({error}); correct the line.") from None
    if not numbers:
        raise InputError(f"{place}: line {start}: there are no samples below the header; add them.")
    return list(np.ascontiguousarray(np.array(numbers).reshape(-1, len(titles)).T)), where, faults


def _without_comments(
    lines: Sequence[str], start: int, titles: Sequence[str], separator: str, mark: str
) -> tuple[list[Array], list[int]] | None:
    """The columns and the line of each sample if nothing but comments stands among the samples; None otherwise."""
    samples, where, at = list[str](), list[int](), [start - 1]
    for line in _samples(lines, start, separator, len(titles), at):
        samples.append(line)
        where.append(at[0])
    columns = quickly("".join(samples).encode(), 0, len(titles), separator, mark)
    return (columns, where) if columns is not None and len(columns[0]) == len(where) else None


_BEGINS = re.compile(r"\s*[\"'+\-.,;\t\d]|\s*(?:nan|inf)\b", re.IGNORECASE)  # of a line that may be a sample

_REMARK = re.compile(rf"#(?!(?:{'|'.join(re.escape(each[1:]) for each in _ERRORS)})(?:[,;\s]|$))")


def without_remark(line: str) -> str:
    """A line up to the # of a remark, which that of a spreadsheet's error is not."""
    return _REMARK.split(line, maxsplit=1)[0]


def _samples(lines: Sequence[str], start: int, separator: str, width: int, at: list[int]) -> Iterator[str]:
    """The lines from ``start`` on without comments and headers that are repeated; at[0] becomes the number of the
    line."""
    above = {line.split(separator)[0] for line in lines[: start - 1]}  # first fields, such as "Interval=" of LabChart
    above = {first for first in above if not _BEGINS.match(first) and first.strip()}
    # what stands behind the last number, such as "End of file", is no sample
    last = next((i for i in range(len(lines), start - 1, -1) if _BEGINS.match(lines[i - 1])), start - 1)
    for number in range(start, last + 1):
        line, at[0] = lines[number - 1], number
        if line.lstrip().startswith(COMMENT) or line.split(separator)[0] in above:
            continue
        if "#" in line and '"' not in line:  # a remark behind the numbers, in a field of its own in LabChart
            line = without_remark(line).rstrip(" ")
            line = line.removesuffix(separator) if line.count(separator) == width else line
        yield f"{line}\n"


def _is_remark(row: Sequence[str], mark: str, grouped: bool) -> bool:
    """Whether a row is no sample but an event: words, and perhaps its time, in place of all channels, or of its time
    above empty channels, as spreadsheets write a heading."""
    first, *others = map(str.strip, row)
    cells = list(filter(None, others)) or [first]
    return bool(cells) and not any(_ALMOST.fullmatch(c) or _number(c, mark, grouped) is not None for c in cells)


def _number(text: str, mark: str, grouped: bool) -> float | None:
    """None of what is no number."""
    if text in MISSING:
        return math.nan
    other = "." if mark == "," else ","
    plain = text
    if grouped and re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}(\{other}\d{{3}})+(\{mark}\d*)?", text):
        plain = text.replace(other, "")
    if mark == ",":
        plain = "?" if "." in plain else plain.replace(",", ".", 1)
    return float(plain or "nan") if _NUMBER.fullmatch(plain) else None


def _fault(sample: int, text: str, mark: str) -> Fault:
    return Fault(sample, f"{text[:40]!r} is not a number; {_advice(text, mark)}", not _ALMOST.fullmatch(text))


def _advice(text: str, mark: str) -> str:
    if re.fullmatch(r"[+-]?[\d.,]+", text):
        word, other, separator = ("comma", "point", ".") if mark == "," else ("point", "comma", ",")
        if re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}(([.,]\d{{3}})+|(\{separator}\d{{3}})+\{mark}\d*)", text):
            return f"if its {other} groups thousands, say --decimal {word}"
        if "," in text and "." in text:
            return "remove the separators of thousands, or state the decimal mark with --decimal comma or point"
        return f"the decimal mark is a {word} elsewhere: write it alike everywhere, or try --decimal {other}"
    if re.fullmatch(r"[+-]?\d{1,3}([ '’]\d{3})+([.,]\d*)?", text):
        return "export it without separators of thousands"
    if re.fullmatch(r"\d+:\d+.*", text):
        return "write a time as hours:minutes:seconds, 12:03:04.250, or as seconds"
    return "write a number, or nothing for a gap"
