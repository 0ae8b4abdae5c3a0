"""The result of ``arterial-fmu calibrate`` as the prior of a network: values and covariance."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver.errors import InputError
from solver.network.description import Network
from solver.quantities.coordinate import SCALE, SHIFT, Coordinate

from ..inference.hypothesis import Calibrated, along
from ..records.read.record import Array, Record
from ..results.parameter_set import ParameterSet, read_set

_AGAIN = "give the .json file that arterial-fmu calibrate --out wrote, as it wrote it"
_ASYMMETRY = 1e-9  # of a covariance's largest entry: round-off


@dataclass(frozen=True)
class Prior:
    """The network with the values of a calibration, and unknowns along its uncertain directions.

    source : the file; sha256 : of the records of the calibration, joined by " + ", "" if unknown.
    """

    network: Network
    calibrated: Calibrated
    source: str = ""
    sha256: str = ""

    def doubts(self, record: Record) -> tuple[str, ...]:
        """Warnings, in sentences, for the comparison of a record with this prior."""
        if not self.sha256 or record.sha256 not in self.sha256.split(" + "):
            return ()
        return (
            f"{self.source}: it was calibrated with {record.path} itself, so that this record counts twice, unless "
            "another part of the file was used: intervals are too narrow and effects may be taken for walls; calibrate "
            "with another record of this animal, or another --part.",
        )


def read_prior(path: str | os.PathLike[str], network: Network) -> Prior:
    """The prior from a calibration file.

    Raises ValueError, one sentence, for a file that is not a calibration, one without covariance, one of another
    network, and for parameters that the network does not have.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file; {_AGAIN}.")
    if Path(path).suffix.lower() != ".json":  # an .ssv file contains only values
        raise InputError(f"{path}: is not a .json file, and other files contain no covariance; {_AGAIN}.")
    found = read_set(path)
    origin = found.provenance
    if origin.get("method") != "network calibration":
        raise InputError(f"{path}: is not the result of a calibration of a network, and has no covariance; {_AGAIN}.")
    if origin.get("network") != network.name:
        raise InputError(
            f"{path}: is the calibration of network {origin.get('network')}, not of {network.name}; give the network "
            f"that was calibrated, or the calibration of this one."
        )
    foreign = [name for name in found.values if name not in network.parameters()]
    if foreign:
        raise InputError(
            f"{path}: {foreign[0]} is no parameter of network {network.name}; give the network that was calibrated."
        )
    if not found.values and origin.get("zeros"):
        raise InputError(f"{path}: only zeros of sensors were calibrated; make these known by --filter, as it says.")
    try:
        coordinates, covariance = _unknowns_of(found)
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(f"{path}: holds no covariance of what was calibrated, or a broken one; {_AGAIN}.") from None
    moved = {variable for c in coordinates for variable, _ in c.moves}
    if not moved <= set(found.values):
        raise InputError(
            f"{path}: its covariance is of {min(moved - set(found.values))}, which has no value; {_AGAIN}."
        )
    try:
        here = found.apply(network)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    values = here.parameters()
    flat = [v for c in coordinates if c.kind == SCALE for v, _ in c.moves if not values[v] > 0.0]
    if flat:
        raise InputError(f"{path}: {flat[0]} = {values[flat[0]]:g} has no logarithm to be uncertain by; {_AGAIN}.")
    return Prior(here, along(coordinates, covariance, here), os.fspath(path), str(origin.get("sha256", "")))


def _unknowns_of(found: ParameterSet) -> tuple[list[Coordinate], Array]:
    """The unknowns of a calibration and their covariance. Raises any of several errors if these are invalid."""
    unknowns: Mapping[str, Any] = found.provenance["unknowns"]
    coordinates = []
    for name, each in unknowns.items():
        moves = tuple((str(variable), float(step)) for variable, step in each["moves"].items())
        if each["kind"] not in (SCALE, SHIFT) or not moves:
            raise ValueError
        coordinates.append(Coordinate(name, each["kind"], moves, -np.inf, np.inf))
    covariance = np.array(found.provenance["covariance"], float)
    n, largest = len(coordinates), np.abs(covariance).max()
    if covariance.shape != (n, n) or not np.isfinite(largest) or largest <= 0.0:
        raise ValueError
    if (
        np.abs(covariance - covariance.T).max() > _ASYMMETRY * largest
        or np.linalg.eigvalsh(covariance)[0] < -_ASYMMETRY * largest
    ):
        raise ValueError
    return coordinates, covariance
