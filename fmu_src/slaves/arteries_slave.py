"""The pythonfmu slave of a network of arteries."""

from __future__ import annotations

from typing import Any

from pythonfmu import DefaultExperiment

from solver.network.description import Network, from_dict
from solver.scheme.model import Settings

from ..cosimulation.arteries import CoSimulation
from ..variables.arteries_variables import variable_table
from ..variables.variable import with_starts
from .base import ComponentSlave, Subject


class ArterialSlave(ComponentSlave):
    """A network of arteries, whose numbers and settings are in ``resources/network.json``."""

    data_file = "network.json"

    @classmethod
    def subject(cls, data: Any) -> Subject:
        """The network and its variables; an experiment of five beats."""
        network, settings = from_dict(data["network"]), Settings(**data["settings"])
        return Subject(
            name=network.name,
            description=in_one_line(network),
            version=data["version"],
            experiment=DefaultExperiment(0.0, 5 * network.inlet.T, settings.dt, settings.tolerance),
            table=with_starts(variable_table(network, settings), data["starts"]),
            make=lambda: CoSimulation(network, settings),
        )


def in_one_line(network: Network) -> str:
    text = f"1D blood flow in the arterial network {network.name}. {network.reference}"
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())  # XML has no control characters
