"""The kinds of file that a record may come in, and advice for those that cannot be read.

A further kind is a function from a path to a :class:`.table.Table`, and a line of ``_KINDS``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from solver.errors import InputError

from ..recordings import check_readable
from .binary import read_edf, read_matlab
from .table import Table
from .text import read_text_table

# suffixes of names, what files begin with, and how they are read, or what they are and what to do instead
_KINDS: tuple[tuple[tuple[str, ...], tuple[bytes, ...], Callable[[Path, str | None], Table] | str], ...] = (
    ((".mat",), (b"MATLAB 5.0", b"MATLAB 7."), read_matlab),
    ((".edf", ".bdf"), (b"0       ", b"\xffBIOSEMI"), read_edf),
    ((".xlsx", ".xlsm", ".xls"), (), "an Excel workbook; save the sheet as CSV"),
    ((".ods",), (), "an OpenDocument sheet; save the sheet as CSV"),
    ((".hea", ".atr"), (), "a WFDB record; write it as CSV: rdsamp -r NAME -c -H -v -pe > NAME.csv"),
    ((".adicht", ".adibin"), (), "a LabChart file; export it as text from LabChart"),
    ((".acq",), (), "a file of AcqKnowledge; save it as text from AcqKnowledge"),
    ((".tdms",), (), "a LabVIEW file; export it as CSV"),
    ((".parquet",), (b"PAR1",), "a Parquet file; write it as CSV"),
    ((), (b"\x89HDF",), "an HDF5 file; write its columns as CSV, or save from MATLAB with save(…, '-v7')"),
    ((), (b"\xd0\xcf\x11\xe0",), "an old Office document; save the sheet as CSV"),
    ((".gz", ".bz2", ".xz", ".zst"), (b"\x1f\x8b",), "a compressed file; unpack it first"),
    ((), (b"PK\x03\x04",), "an FMU or another archive; give the recording, such as a CSV file"),
)  # fmt: skip


def read_table(path: str | os.PathLike[str], decimal: str | None = None) -> Table:
    """The columns of a file of any kind. decimal : mark of a text file, comma or point; by default found.

    Raises ValueError, one sentence that names the file, its content and the remedy.
    """
    path = Path(path)
    check_readable(path)
    try:
        with open(path, "rb") as stream:
            start = stream.read(16)
        for suffixes, starts, read in _KINDS:
            if path.suffix.lower() in suffixes or start.startswith(starts):
                if isinstance(read, str):
                    noun, _, advice = read.partition("; ")
                    raise InputError(f"{path}: {noun}, which is not read; {advice}.")
                return read(path, decimal)
        return read_text_table(path, decimal)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the path.") from None
