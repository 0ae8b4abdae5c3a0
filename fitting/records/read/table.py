"""What any file of measurements is read as: named columns of equal length, and where each sample stands in the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from solver.errors import InputError

Array = np.ndarray


@dataclass(frozen=True)
class Place:
    """Where the samples of a table stand. lines : line of each sample, None for a file without lines; header likewise.
    rows : of the samples that are used, None for all.

    As text it is the name of the file.
    """

    source: str
    header: int | None = None
    lines: Sequence[int] | None = None
    rows: Sequence[int] | None = None

    def __str__(self) -> str:
        return self.source

    def of(self, sample: int | None) -> str:
        """ "line 7", or "sample 5" of a file without lines; None: the header, "" if there is none."""
        if sample is None:
            return "" if self.header is None else f"line {self.header}"
        at = sample if self.rows is None else self.rows[sample]
        return f"sample {at + 1}" if self.lines is None else f"line {self.lines[at]}"


@dataclass(frozen=True)
class Fault:
    """The first cell of a column that is no number: its sample, a clause of a sentence, and whether it is words."""

    sample: int
    why: str
    words: bool


@dataclass(frozen=True)
class Column:
    """title as it is in the file; unit where the file says it elsewhere; values : (n,), NaN in gaps.

    problem : why its values are not there, a clause of a sentence. fault : of cells that are no numbers, which are
    gaps. clock : seconds, of a time as clocks show it.
    """

    title: str
    values: Array
    unit: str = ""
    problem: str = ""
    fault: Fault | None = None
    clock: bool = False


@dataclass(frozen=True)
class Table:
    """The columns of a file, in its order; found : how the file was understood, for people.

    titled : whether the file names its columns; else their titles are their numbers, from 1.
    """

    place: Place
    columns: Sequence[Column]
    found: str = ""
    titled: bool = True


def refuse(place: Place, sample: int | None, title: str, reason: str, error: type[InputError] = InputError) -> NoReturn:
    """Raises the ValueError of a cell that cannot be read, or of a column: sample None."""
    where = ", ".join(part for part in (place.of(sample), f"column {title!r}") if part)
    raise error(f"{place}: {where}: {reason}.")
