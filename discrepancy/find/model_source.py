"""The model of a study: a network file, an FMU that contains one, or a first model made from the record."""

from __future__ import annotations

import os
from pathlib import Path

from fitting.check.fmu_run import read_fmu
from fitting.first.model import first_model
from fitting.first.options import FirstOptions
from fitting.records.alignment.align import align
from fitting.records.plausible import check_plausible
from fitting.records.read.record import Record
from fitting.records.read.sensors import UnusableRecord
from solver.errors import InputError
from solver.io.writing import check_new, write_whole
from solver.network.description import Network
from solver.network.files import find_network, read_network

FILE = "first.toml"
OF_FIRST = (
    "the model is a first one: its lengths, radii, tapers, walls and Windkessels may be off by a third, and the "
    "viscosity by a factor of 3, before anything counts as missing; an effect of its walls may stand for vessels that "
    "it leaves out."
)


def read_model(path: str | os.PathLike[str]) -> Network:
    """The network of a TOML file, of a bundled network's name, or of an FMU. Raises ValueError, one sentence."""
    network = read_network(find_network(path))
    if Path(path).suffix.lower() != ".fmu":
        return network
    starts = read_fmu(path).starts
    for name, value in {**network.parameters(), "network.elastic_law": network.elastic_law}.items():
        if starts[name] != value:
            raise InputError(
                f"{path}: {name} starts at {starts[name]} in its description, and is {value} in its network file; "
                "build it anew, with --set where a value was changed."
            )
    return network


def first_of(
    record: Record | UnusableRecord, folder: Path, period: float | None, as_measured: bool, options: FirstOptions
) -> tuple[Path, list[str]]:
    """Write the first model of a record into the folder of the study; returns its file, a sentence about the
    model, and the notes of ``first`` about the record.

    period : of the beat [s], estimated by default. as_measured : accept values that are implausible for an artery.
    Raises ValueError for an unusable record, one without flow and pressure at the root, and an existing file that was
    edited.
    """
    if isinstance(record, UnusableRecord):
        raise record
    if not as_measured:
        check_plausible(record, {})
    found, path = first_model(align(record, period), **vars(options)), folder / FILE
    try:
        check_new({path: found.text}, force=False)
    except InputError:
        raise InputError(
            f"{path}: is there and is not what this record and these options give; if you edited it, give it: --model "
            f"{path}, else remove it or choose another --out."
        ) from None
    write_whole(path, found.text)
    animal = "the stated animal" if {"like", "mass"} & options.given.keys() else "a mammal of this stroke volume"
    note = (
        f"no model was given: {path} was made from the record, with values of {animal} where the record says nothing "
        "(--like, --mass); arterial-fmu first shows how each number was found."
    )
    return path, [note, *found.notes]
