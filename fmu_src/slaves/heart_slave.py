"""The pythonfmu slave of a left heart."""

from __future__ import annotations

from typing import Any, get_type_hints

from pythonfmu import DefaultExperiment

from solver.lumped.heart import INPUTS, OUTPUTS, HeartComponent
from solver.lumped.heart_parts import Chamber, Heart
from solver.quantities.quantity import quantities

from ..variables.variable import (
    FLOW,
    FRACTION,
    IMPEDANCE,
    INTERCEPT,
    MEMORY,
    PRESSURE,
    VOLUME,
    Variable,
    input_variable,
    output_variable,
    parameters,
    with_starts,
)
from .base import ComponentSlave, Subject

_MEANINGS = {
    "aorta.Q": (FLOW, "flow from the ventricle into the aorta"),
    "aorta.P": (PRESSURE, "pressure at the root of the aorta, as the port of the arteries gives it"),
    "aorta.V": (VOLUME, "volume that has left to the aorta since the start"),
    "venous.V": (VOLUME, "volume taken from the veins since the start"),
    "venous.Q": (FLOW, "flow from the veins into the atrium"),
    "left_ventricle.P": (PRESSURE, "pressure in the left ventricle"),
    "left_ventricle.V": (VOLUME, "volume of the left ventricle"),
    "left_atrium.P": (PRESSURE, "pressure in the left atrium"),
    "left_atrium.V": (VOLUME, "volume of the left atrium"),
    "mitral_valve.Q": (FLOW, "flow from the atrium into the ventricle"),
    "mitral_valve.opening": (FRACTION, "how far the mitral valve is open, 0 to 1"),
    "aortic_valve.opening": (FRACTION, "how far the aortic valve is open, 0 to 1"),
    "heart.phase": (FRACTION, "part of the beat that has passed; at 0 the ventricle begins to contract"),
}
# initial dependencies of the outputs, when the chambers are at venous.P and the valves are closed
_SOURCES = {
    "aorta.P": ("aorta.P_0",),
    "left_ventricle.P": ("venous.P",),
    "left_ventricle.V": ("venous.P", "heart.contractility", *(f"left_ventricle.{key}" for key in quantities(Chamber))),
    "left_atrium.P": ("venous.P",),
    "left_atrium.V": ("venous.P", *(f"left_atrium.{key}" for key in quantities(Chamber))),
}


class HeartSlave(ComponentSlave):
    """A left heart, whose numbers are in ``resources/heart.json``."""

    data_file = "heart.json"

    @classmethod
    def subject(cls, data: Any) -> Subject:
        """The heart and its variables; an experiment of five beats."""
        kinds = get_type_hints(Heart)
        heart = Heart(**{key: kinds[key](**x) if isinstance(x, dict) else x for key, x in data["heart"].items()})
        return Subject(
            name=heart.name,
            description=f"Left heart with time-varying elastance and two valves. {heart.reference}",
            version=data["version"],
            experiment=DefaultExperiment(0.0, 5 / heart.heart.rate, 1e-3),
            table=with_starts(table(heart), data["starts"]),
            make=lambda: HeartComponent(heart),
        )


def table(heart: Heart) -> tuple[Variable, ...]:
    """Inputs, then parameters, then outputs."""
    inputs = {
        "aorta.P_0": (
            INTERCEPT,
            "P_0 of the arteries' port: their pressure is P_0 + Z_0 Q(t) + Z Q(t+h)",
            heart.P_aorta,
        ),
        "aorta.Z": (IMPEDANCE, "Z of the arteries' port; 0 means that their pressure is held at P_0", 0.0),
        "aorta.Z_0": (MEMORY, "Z_0 of the arteries' port", 0.0),
        "venous.P": (PRESSURE, "pressure of the veins, or of the source that fills the heart", heart.P_venous),
    }
    return (
        *(input_variable(name, *inputs[name]) for name in INPUTS),
        *parameters(heart.groups),
        *(output_variable(name, *_MEANINGS[name], _SOURCES.get(name, ())) for name in OUTPUTS),
    )
