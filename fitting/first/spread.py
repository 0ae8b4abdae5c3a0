"""How far the numbers of a first model may be off: the prior of a study that uses one."""

from __future__ import annotations

import numpy as np

from solver.network.description import Network
from solver.quantities.coordinate import SCALE, Coordinate

from ..inference.prior import Calibrated, along
from .text import REFERENCE
from .tubes import keyed

# standard deviations of the logarithms, whatever fits the mean beat best: judgement. They are wider than those between
# the walls of one species, since lengths and viscosities are not measured at all
_SPREAD = keyed(L=0.5, R0=0.25, E=0.3, phi0=1.0, R1=0.3, C=0.3, R2=0.1)


def is_first(network: Network) -> bool:
    """Whether a network is a first model, edited or not: its reference says so."""
    return network.reference.startswith(REFERENCE)


def spread(network: Network) -> Calibrated:
    """The unknowns of a first model: lengths, walls and Windkessels, independent of each other."""
    sds = {
        name: _SPREAD[key]
        for name, value in network.parameters().items()
        if (key := name.rpartition(".")[2]) in _SPREAD and value > 0.0
    }
    coordinates = [Coordinate(name, SCALE, ((name, 1.0),), -np.inf, np.inf) for name in sds]
    return along(coordinates, np.diag(np.array(list(sds.values())) ** 2), network)
