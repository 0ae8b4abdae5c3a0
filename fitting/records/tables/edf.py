"""EDF and BDF files as tables, by pyEDFlib (extra ``edf``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver.errors import InputError

from .table import Column, Place, Table


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
