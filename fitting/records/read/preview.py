"""What is found in a file, column by column, before anything is asked of it: ``--columns``."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from .columns import NO_TIME, ROW, Reading, explained, may_be_time, which_is_which
from .kinds import read_table
from .titles import unit_of

_FIRST = 3  # values


def preview(path: str | os.PathLike[str], reading: Reading) -> dict[str, Any]:
    """The columns of a file: title, unit ("" unknown), first values, min, max, gaps and meaning; plain.

    Raises ValueError, one sentence, for a file that cannot be read.
    """
    table = read_table(path, reading.decimal)
    columns = []
    for column, (understood, meaning) in zip(table.columns, explained(table, reading), strict=True):
        values = column.values[np.isfinite(column.values)]
        columns.append(
            {
                "title": column.title,
                "unit": "s" if column.clock else unit_of(column),
                "first": [float(v) if np.isfinite(v) else None for v in column.values[:_FIRST]],
                "min": float(values.min()) if len(values) else None,
                "max": float(values.max()) if len(values) else None,
                "gaps": len(column.values) - len(values),
                "understood": understood,
                "read_as": meaning,
            }
        )
    samples = max((len(column.values) for column in table.columns), default=0)
    titled = table.titled or bool(reading.names)
    timed = ROW in reading.names or any(each["read_as"] == "time" for each in columns)
    return {
        "file": str(path),
        "format": table.found,
        "samples": samples,
        "titled": titled,
        "timed": timed if titled else may_be_time(table.columns[0]),
        "columns": columns,
    }


def preview_questions(found: dict[str, Any]) -> list[str]:
    """The options without which a column cannot be read, a line each: to copy, so that no table cuts them."""
    open_ones = [each for each in found["columns"] if not each["understood"]]
    if open_ones and not found["titled"]:
        return [f"The file has no header; {which_is_which(len(found['columns']), found['timed'])}"]
    asked = [f"{each['title']!r}: {each['read_as']}" for each in open_ones]
    return asked if found["timed"] else [*asked, f"{NO_TIME[0].upper()}{NO_TIME[1:]}"]
