"""Files of MATLAB, by SciPy, and EDF and BDF files, by pyEDFlib (extra ``edf``), as tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from solver.errors import InputError

from .table import Array, Column, Place, Table


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
