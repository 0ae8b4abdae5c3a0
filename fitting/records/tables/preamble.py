"""What programs write above their columns: names and units of channels that the header does not have.

LabChart (ADInstruments) writes lines ``ChannelTitle=``, ``Range=`` and ``UnitName=`` and no header; AcqKnowledge
(Biopac) writes every channel's name and unit on lines of their own, and CH1, CH2, … above the columns.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from .titles import is_unit


def labchart(rows: Sequence[Sequence[str]]) -> tuple[list[str], list[str]] | None:
    """Titles and units, time first, of the lines above the samples; None if they are not LabChart's."""
    lines = {row[0].strip(): [cell.strip() for cell in row[1:]] for row in rows if row}
    titles = lines.get("ChannelTitle=")
    if titles is None:
        return None
    units = lines.get("UnitName=") or [re.sub(r"^[\d.,\s]+", "", each) for each in lines.get("Range=", [])]
    units += [""] * (len(titles) - len(units))
    clock = lines.get("TimeFormat=", [""])[0]
    return ["Time", *titles], ["s" if clock in ("", "StartOfBlock", "StartOfFile") else "", *units[: len(titles)]]


def biopac(lines: Sequence[str], titles: Sequence[str]) -> tuple[list[str], list[str]] | None:
    """The same of AcqKnowledge. lines above the header; titles : of the header, such as min, CH1, CH2."""
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
