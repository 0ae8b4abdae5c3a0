"""How far the numbers of a first model may be off: the prior of a study that uses one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver.laws.effects import ExternalPressure
from solver.network.description import Network
from solver.quantities.coordinate import SCALE, SHIFT, Coordinate

from ..inference.prior import Calibrated, along
from .fitted import ACCURACY
from .text import REFERENCE
from .tubes import TAPER_ERROR, TAPERED, keyed

# standard deviations of the logarithms, whatever fits the mean beat best: judgement. They are wider than those between
# the walls of one species, since lengths and viscosities are not measured at all
_SPREAD = keyed(L=0.5, R0=0.25, E=0.3, phi0=1.0, R1=0.3, C=0.3, R2=0.1)


def is_first(network: Network) -> bool:
    """Whether a network is a first model, edited or not: its reference says so."""
    return network.reference.startswith(REFERENCE)


def accuracy(network: Network) -> float:
    """The stated error of a network at each harmonic, as a fraction of a channel's pulsation; 0 unless it is a first
    model."""
    return ACCURACY if is_first(network) else 0.0


def spread(network: Network) -> Calibrated:
    """The unknowns of a first model: lengths, walls, tapers and Windkessels, independent of each other."""
    known = network.parameters()
    scales = {name: sd for name, x in known.items() if (sd := _SPREAD.get(name.rpartition(".")[2])) and x > 0.0}
    tapered = {s.name: s.L for s in network.segments if TAPERED in s.terms}
    shifts = {f"{name}.{TAPERED}": TAPER_ERROR * L / max(tapered.values()) for name, L in tapered.items()}
    coordinates = [
        Coordinate(name, kind, ((name, 1.0),), -np.inf, np.inf)
        for kind, names in ((SCALE, scales), (SHIFT, shifts))
        for name in names
    ]
    found = along(coordinates, np.diag(np.array([*scales.values(), *shifts.values()]) ** 2), network)
    # R0 and E are those of the mean pressure, and how the walls stiffen about it is not known: nor is another pressure
    outside = {f"{s.name}.{key}" for s in network.segments for key in ExternalPressure.terms}
    return replace(found, free=found.single | outside)
