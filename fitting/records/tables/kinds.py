"""The kinds of file that a record may come in, and what to do with those that are not read.

A further kind is a function from a path to a :class:`.table.Table`, and a line of ``READ``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from solver.errors import InputError

from .edf import read_edf
from .matlab import read_matlab
from .table import Table
from .text import read_text_table


@dataclass(frozen=True)
class _Kind:
    """suffixes of its names; starts : what its files begin with."""

    read: Callable[[Path, str | None], Table]
    suffixes: tuple[str, ...] = ()
    starts: tuple[bytes, ...] = ()


@dataclass(frozen=True)
class _Other:
    """What a file is that is not read, and what to do instead."""

    noun: str
    advice: str
    suffixes: tuple[str, ...] = ()
    starts: tuple[bytes, ...] = ()


_ZIP = b"PK\x03\x04"
READ = (
    _Kind(read_matlab, (".mat",), (b"MATLAB 5.0", b"MATLAB 7.")),
    _Kind(read_edf, (".edf", ".bdf"), (b"0       ", b"\xffBIOSEMI")),
)
_OTHERS = (
    _Other("an Excel workbook", "save the sheet as CSV", (".xlsx", ".xlsm", ".xls")),
    _Other("an OpenDocument sheet", "save the sheet as CSV", (".ods",)),
    _Other("a WFDB record", "write it as CSV: rdsamp -r NAME -c -H -v -pe > NAME.csv", (".hea", ".atr")),
    _Other("a LabChart file", "export it as text from LabChart", (".adicht", ".adibin")),
    _Other("a file of AcqKnowledge", "save it as text from AcqKnowledge", (".acq",)),
    _Other("a LabVIEW file", "export it as CSV", (".tdms",)),
    _Other("a Parquet file", "write it as CSV", (".parquet",), (b"PAR1",)),
    _Other("an HDF5 file", "write its columns as CSV, or save from MATLAB with save(…, '-v7')", (), (b"\x89HDF",)),
    _Other("an old Office document", "save the sheet as CSV", (), (b"\xd0\xcf\x11\xe0",)),
    _Other("a compressed file", "unpack it first", (".gz", ".bz2", ".xz", ".zst"), (b"\x1f\x8b",)),
    _Other("an FMU or another archive", "give the recording, such as a CSV file", (), (_ZIP,)),
)


def read_table(path: str | os.PathLike[str], decimal: str | None = None) -> Table:
    """The columns of a file of any kind. decimal : mark of a text file, comma or point; by default found.

    Raises ValueError, one sentence that names the file, what was found and what to do.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: cannot be read (not a regular file); give the name of a CSV file.")
    try:
        with open(path, "rb") as stream:
            start = stream.read(16)
        for kind in (*READ, *_OTHERS):
            if path.suffix.lower() in kind.suffixes or start.startswith(kind.starts):
                if isinstance(kind, _Kind):
                    return kind.read(path, decimal)
                raise InputError(f"{path}: {kind.noun}, which is not read; {kind.advice}.")
        return read_text_table(path, decimal)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the path.") from None
