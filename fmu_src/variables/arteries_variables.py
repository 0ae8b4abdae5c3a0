"""The variables of the FMU, derived from a network: one row each, in the order of their value references."""

from __future__ import annotations

import math
from dataclasses import replace

from solver.laws.wall_laws import ELASTIC_LAWS, VISCOUS_LAWS
from solver.network.description import Network
from solver.network.inlet import Inlet
from solver.quantities.quantity import Quantity, quantities
from solver.scheme.model import Settings

from ..cosimulation.drive import DRIVES
from ..cosimulation.ports import port_names
from .variable import Variable

STARTS = ("rest", "periodic")
INTERPOLATIONS = ("hold", "linear", "smooth")
INLETS = {
    "Q": Quantity("m^3/s", "flow into the network", -1.0, 1.0, nominal=1e-5, display="mL/s", input=True),
    "P": Quantity("Pa", "pressure at the inlet", -1e5, 1e6, nominal=1e4, display="mmHg", input=True),
}
SETTINGS = {f"solver.{key}": quantities(Settings)[key] for key in ("dt", "element_length")}
# what the periodic start is made for, by the causality of the inlet
_PULSES = {
    "flow": {
        "Q_mean": Quantity("m^3/s", "mean inflow", -1.0, 1.0, nominal=1e-5, display="mL/s", tunable=False),
        "T": Quantity("s", "period", 1e-3, 100.0, tunable=False),
    },
    "pressure": {
        "P_mean": Quantity("Pa", "mean pressure", -1e5, 1e6, nominal=1e4, display="mmHg", tunable=False),
    },
}
_PERIODIC = {
    "flow": "near the beats of {} of mean inlet.Q_mean and period inlet.T",
    "pressure": "in the steady state under inlet.P_mean",
}
_PERIODIC_OF_SEVERAL = "near the beats with the means Q_mean and P_mean of what is given at the inlets, and one period"
_OUTPUTS = {
    "P": Quantity("Pa", "pressure", -math.inf, math.inf, nominal=1e4, display="mmHg"),
    "Q": Quantity("m^3/s", "flow", -math.inf, math.inf, nominal=1e-5, display="mL/s"),
    "R": Quantity("m", "radius", 0.0, math.inf, nominal=1e-2, display="mm"),
}
_VOLUMES = {
    "network.V": Quantity("m^3", "blood in the arteries and Windkessels", -1.0, 1.0, nominal=1e-4, display="mL"),
    "venous.V": Quantity("m^3", "volume that has left to the veins", -math.inf, math.inf, nominal=1e-4, display="mL"),
    "venous.Q": replace(_OUTPUTS["Q"], description="mean flow to the veins over the last communication step"),
}
_PORTS = {
    "P_0": replace(_OUTPUTS["P"], description="after the next communication step, at no flow"),
    "Z": Quantity("Pa.s/m^3", "change per flow then", -1e15, 1e15, nominal=1e8, display="mmHg.s/mL"),
    "Z_0": Quantity("Pa.s/m^3", "change per flow at its start", -1e15, 1e15, nominal=1e8, display="mmHg.s/mL"),
    "Q_0": replace(_OUTPUTS["Q"], description="after the next communication step, at no pressure"),
    "Y": Quantity("m^3/(Pa.s)", "change per pressure then", -1e15, 1e15, nominal=1e-8),
    "Y_0": Quantity("m^3/(Pa.s)", "change per pressure at its start", -1e15, 1e15, nominal=1e-8),
}


def variable_table(network: Network, settings: Settings) -> tuple[Variable, ...]:
    """Inputs, then parameters, then outputs of the FMU of a network."""
    values, parameters, several = network.parameters(), list[Variable](), bool(network.further_inlets)
    inputs = [_input(inlet, network.P_0) for inlet in network.inlets]
    drives = [variable.name for variable in inputs]
    drove = " and ".join(drives)
    for name, quantity in network.parameter_quantities().items():
        if quantity.input:
            inputs.append(Variable(name, "input", "continuous", quantity.description, values[name], quantity))
        else:
            kind = "tunable" if quantity.tunable else "fixed"
            parameters.append(Variable(name, "parameter", kind, quantity.description, values[name], quantity))
    starts = {"solver.dt": settings.dt, "solver.element_length": settings.element_length}
    known, inlet = dict(SETTINGS), network.inlet
    for each in network.inlets:
        P_mean = network.P_0 if each.P_mean is None else each.P_mean
        for key, quantity in _PULSES[each.causality].items():
            name = "inlet.T" if key == "T" else each.variable(key)  # all have one period
            known[name], starts[name] = quantity, {"Q_mean": each.Q_mean, "P_mean": P_mean, "T": each.T}[key]
    for name, quantity in known.items():
        parameters.append(Variable(name, "parameter", "fixed", quantity.description, starts[name], quantity))
    periodic = _PERIODIC_OF_SEVERAL if several else _PERIODIC[inlet.causality].format(inlet.shape)
    texts = (
        ("network.elastic_law", "elastic law of the walls", network.elastic_law, tuple(ELASTIC_LAWS)),
        (
            "network.viscous_law",
            "viscous law of the walls where phiNL is not 0",
            network.viscous_law,
            tuple(VISCOUS_LAWS),
        ),
        (
            "inlet.interpolation",
            f"Interpolation of {drove} in a step: hold = constant; linear = the host sets the value at t + h; "
            "smooth = the host sets that at t, and the FMU extrapolates",
            "hold",
            INTERPOLATIONS,
        ),
        (
            "inlet.drive",
            f"{drove} as the host sets it; or what the network file gives, and then that input is ignored",
            "input",
            DRIVES,
        ),
        (
            "network.start",
            f"at rest under network.P_0; or {periodic}",
            "rest",
            STARTS,
        ),
    )
    for name, description, start, choices in texts:
        parameters.append(
            Variable(name, "parameter", "fixed", f"{description}: {' or '.join(choices)}", start, None, choices)
        )
    everything = tuple(variable.name for variable in (*inputs, *parameters))
    at_start = tuple(name for name in everything if name not in (*drives, "inlet.interpolation", "inlet.drive"))
    outputs = []
    for name in network.output_units():
        place, kind = name.rsplit(".", 1)
        text = f"{_OUTPUTS[kind].description} at {place}"
        outputs.append(Variable(name, "output", "continuous", text, None, _OUTPUTS[kind], sources=at_start))
    for name, quantity in _VOLUMES.items():
        sources = at_start if name == "network.V" else ()
        outputs.append(Variable(name, "output", "continuous", quantity.description, None, quantity, sources=sources))
    for name in port_names(network):
        outputs.append(_port(name, everything))
    return (*inputs, *parameters, *outputs)


def _input(inlet: Inlet, P_0: float) -> Variable:
    """What drives an inlet."""
    kind = inlet.drive[-1]
    quantity = (
        INLETS[kind]
        if inlet.first
        else replace(INLETS[kind], description=f"{_OUTPUTS[kind].description} at {inlet.name}")
    )
    text = f"{quantity.description}; a host that never sets it runs at rest, unless inlet.drive = network"
    return Variable(inlet.drive, "input", "continuous", text, {"Q": 0.0, "P": P_0}[kind], quantity)


def _port(name: str, sources: tuple[str, ...]) -> Variable:
    """A variable of :mod:`~fmu_src.cosimulation.ports`."""
    place, kind = name.rsplit(".", 1)
    quantity = _PORTS[kind]
    signal = f"P_venous of {place}"
    if place.endswith("inlet"):
        at = "the inlet" if place == "inlet" else place
        signal = f"flow at {at}" if kind in ("Q_0", "Y", "Y_0") else f"pressure at {at}"
    text = f"port: {signal}, {quantity.description}"
    return Variable(name, "output", "continuous", text, None, quantity, sources=sources, late=True)
