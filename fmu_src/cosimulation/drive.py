"""The drives of the inlets: inputs from a host, or the network's own beats (``inlet.drive``)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from solver.errors import InputError
from solver.network.description import Network
from solver.network.inlet import Inlet

Array = np.ndarray

DRIVES = ("input", "network")
_MEANS = {"flow": "Q_mean", "pressure": "P_mean"}  # the variable of what is given, by causality


def inlet_with(inlet: Inlet, values: Mapping[str, Any]) -> Inlet:
    """An inlet with the mean and the period in values of variables; without them its own."""
    mean = values.get(inlet.variable(_MEANS[inlet.causality]), inlet.mean)
    return inlet.with_mean(mean, values.get("inlet.T", inlet.T))


def own_drive(network: Network, values: Mapping[str, Any]) -> Callable[[Array], Array]:
    """The network's own drives of its inlets at times t : (n, 4) [s], as (n, n_inlets, 4) [m³/s or Pa].

    Raises ValueError for a pressure inlet without a pressure in the network.
    """
    inlets = [inlet_with(inlet, values) for inlet in network.inlets]
    for inlet in inlets:
        if inlet.given is None:
            raise InputError(
                f"inlet.drive = network: network {network.name} gives no curve of {inlet.drive}; add one to the "
                "network file and build the FMU anew, or take inlet.drive = input and set it."
            )
    given = [inlet.given for inlet in inlets if inlet.given]
    return lambda t: np.stack([each(t) for each in given], axis=1)
