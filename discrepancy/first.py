"""The model of a study that is given none: a first one, made of its record."""

from __future__ import annotations

from pathlib import Path

from fitting.first.model import first_model
from fitting.records.align import align
from fitting.records.plausible import check_plausible
from fitting.records.record import Record
from fitting.records.sensors import UnusableRecord
from solver.errors import InputError
from solver.writing import check_new, write_whole

FILE = "first.toml"


def first_of(
    record: Record | UnusableRecord, folder: Path, period: float | None, as_measured: bool
) -> tuple[Path, str]:
    """Write the first model of a record into the folder of the study; its file, and a sentence about it.

    period : of the beat [s], found by default. as_measured : values that no artery has are taken as they are. Raises
    ValueError for a record that cannot be used or lacks flow and pressure at the root, and for a file that is there and
    was edited.
    """
    if isinstance(record, UnusableRecord):
        raise record
    if not as_measured:
        check_plausible(record, {})
    found, path = first_model(align(record, period)), folder / FILE
    try:
        check_new({path: found.text}, force=False)
    except InputError:
        raise InputError(
            f"{path}: is there and is not what this record gives; if you edited it, give it: --model {path}, else "
            "remove it."
        ) from None
    write_whole(path, found.text)
    return path, (
        f"no model was given: {path} was made of the record, with a human's aorta for what a recording does not tell; "
        "arterial-fmu first says how each number was found, and makes others."
    )
