"""Text files as tables: CSV in the dialects of laboratories and spreadsheets."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

import numpy as np

from solver.errors import InputError

from .clock import in_seconds, past_midnight
from .layout import SPACE, Layout, layout
from .numbers import quickly, slowly
from .table import Column, Fault, Place, Table

_HEAD = 1 << 20  # bytes, in which the samples begin
_ENDLESS = 1 << 62
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


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
    for mark, name in _MARKS.items():
        if head.startswith(mark):
            return name
    if b"\0" in head:
        raise InputError(f"{source}: not text (byte {head.index(0)} is zero); export it as CSV, in UTF-8.")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"
