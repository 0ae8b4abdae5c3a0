"""The pythonfmu slave of a reservoir of veins."""

from __future__ import annotations

from typing import Any

from pythonfmu import DefaultExperiment

from solver.lumped.body import EXCHANGES, Body, BodyComponent, Reservoir

from ..variables.variable import PRESSURE, VOLUME, Variable, input_variable, output_variable, parameters, with_starts
from .base import ComponentSlave, Subject


class BodySlave(ComponentSlave):
    """A reservoir, whose numbers are in ``resources/body.json``."""

    data_file = "body.json"

    @classmethod
    def subject(cls, data: Any) -> Subject:
        """The body and its variables."""
        numbers = data["body"]
        body = Body(numbers["name"], numbers["reference"], Reservoir(**numbers["body"]))
        return Subject(
            name=body.name,
            description=f"Veins, right heart and lungs as one elastic reservoir. {body.reference}",
            version=data["version"],
            experiment=DefaultExperiment(0.0, 5.0, 1e-3),
            table=with_starts(table(body), data["starts"]),
            make=lambda: BodyComponent(body),
        )


def table(body: Body) -> tuple[Variable, ...]:
    """Inputs, then parameters, then outputs."""
    when = "for which end of a step the inputs are that are set before it: its end (a master that runs the body last), "
    inputs = [
        input_variable("arteries.V", VOLUME, "volume that has left the arteries since the start", 0.0),
        input_variable("heart.V", VOLUME, "volume that the heart has taken since the start", 0.0),
    ]
    exchange = Variable(
        "body.exchange", "parameter", "fixed",
        f"{when}or its start (a master that runs all side by side)", "end", None, EXCHANGES,
    )  # fmt: skip
    known = parameters({"body": body.body})
    sources = [variable.name for variable in (*inputs, *known)]
    return (
        *inputs,
        *known,
        exchange,
        output_variable("P", PRESSURE, "pressure of the reservoir", sources),
        output_variable("V", VOLUME, "volume of the reservoir", sources),
    )
