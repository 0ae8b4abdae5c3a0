"""The kinds of file that a record may come in: text, MATLAB by SciPy, EDF and BDF by pyEDFlib (extra ``edf``); and
advice for kinds that cannot be read.

A further kind is a function from a path to a :class:`.table.Table`, and a line of ``_KINDS``.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from solver.errors import InputError

from ..recordings import check_readable
from .table import Array, Column, Place, Table
from .text import read_text_table


def read_matlab(path: Path, decimal: str | None) -> Table:
    """A file of ``save(…, "-v7")`` or older; titles of vectors, columns of matrices and those in structs
    as MATLAB spells them: P, data.P, data(:,1).

    Vectors of another length than most are columns without values. Raises ValueError, one sentence.
    """
    from scipy.io import loadmat

    source = str(path)
    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        raise InputError(f"{source}: a MATLAB file of version 7.3; save it with save(…, '-v7').") from None
    except OSError:
        raise
    except Exception as error:  # its reader raises whatever a broken file leads it to
        raise InputError(f"{source}: not a whole MATLAB file ({type(error).__name__}); save it again.") from None
    vectors = dict(_vectors({name: value for name, value in content.items() if not name.startswith("__")}))
    if not vectors:
        raise InputError(f"{source}: there are no vectors of numbers; save time and channels as vectors of one length.")
    lengths = Counter(len(values) for values in vectors.values())
    length = max(lengths, key=lambda n: (lengths[n], n))
    columns = [
        Column(title, values.astype(float))
        if len(values) == length
        else Column(title, np.empty(0), problem=f"it has {len(values)} samples where most columns have {length}")
        for title, values in vectors.items()
    ]
    return Table(Place(source), columns, "MATLAB file")


def _vectors(content: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Array]]:
    for name, value in content.items():
        title = f"{prefix}{name}"
        if hasattr(value, "_fieldnames") and not prefix:
            yield from _vectors({field: getattr(value, field) for field in value._fieldnames}, f"{title}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
            if value.ndim == 1 and len(value) > 1:
                yield title, value
            elif value.ndim == 2 and value.size:
                down = value.shape[0] >= value.shape[1]
                for i, column in enumerate(value.T if down else value, start=1):
                    yield (f"{title}(:,{i})" if down else f"{title}({i},:)"), column


def read_edf(path: Path, decimal: str | None) -> Table:
    """The signals of the highest rate, and their time; the others are columns without values.

    Raises ValueError, one sentence.
    """
    source = str(path)
    try:
        import pyedflib
    except ImportError:
        raise InputError(
            f"{source}: an EDF file, and the reader of such files is not installed; run "
            "pip install 'arterial-fmu[edf]', or export CSV."
        ) from None
    try:
        with pyedflib.EdfReader(source) as reader:
            rates, titles = reader.getSampleFrequencies(), reader.getSignalLabels()
            units = [reader.getPhysicalDimension(i) for i in range(len(titles))]
            rate = max(rates, default=0.0)
            signals = [reader.readSignal(i) if each == rate else None for i, each in enumerate(rates)]
    except OSError as error:
        raise InputError(f"{source}: not a whole EDF file ({error}); export it again, or as CSV.") from None
    longest = max((len(each) for each in signals if each is not None), default=0)
    columns = [Column("time [s]", np.arange(longest) / rate if longest else np.empty(0))]
    for title, unit, values, own in zip(titles, units, signals, rates, strict=True):
        if values is None:
            columns.append(Column(title, np.empty(0), unit, f"it is sampled at {own:g} Hz, others at {rate:g} Hz"))
        else:
            columns.append(Column(title, values, unit))
    return Table(Place(source), columns, f"EDF file, {rate:g} Hz")


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
