"""A system of FMUs in SSP 1.0: heart, arteries and body, how they are connected, and their parameters as SSV 1.0."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from solver.lumped.body import Body
from solver.lumped.heart_parts import Heart
from solver.network.description import Network
from solver.network.files import find_network, read_network
from solver.quantities.units import base_units
from solver.scheme.model import Settings

from ..cosimulation.arteries import CoSimulation
from ..cosimulation.ports import INLET_PORTS
from ..variables.arteries_variables import variable_table
from ..variables.variable import Variable, with_starts

_SSP = "http://ssp-standard.org/SSP1/"
_SPACES = {"ssd": f"{_SSP}SystemStructureDescription", "ssv": f"{_SSP}SystemStructureParameterValues",
           "ssc": f"{_SSP}SystemStructureCommon"}  # fmt: skip
_SET = "start"  # ecos applies the parameter set whose name it is told
Wire = tuple[str, str, str, str]  # component and variable from, component and variable to


@dataclass(frozen=True)
class Part:
    """One component. fmu : its name, without ending. values : parameters and inputs that it starts with, by name."""

    name: str
    fmu: str
    table: tuple[Variable, ...]
    values: Mapping[str, float | str] = field(default_factory=dict)

    def variable(self, name: str) -> Variable:
        """A variable by its name."""
        return next(v for v in self.table if v.name == name)


# The outlets of the bundled network human are made for another inflow; with these factors the heart keeps 120/80 mmHg
_HUMAN_OUTLETS = {"C": 2.0, "R2": 1.03}


def start_values(
    network: Network, heart: Heart, body: Body, parallel: bool = True
) -> dict[str, dict[str, float | str]]:
    """What each part of the system starts with, by component and variable.

    parallel : for a master that runs all side by side; else for one that runs heart, arteries and body in this order.
    """
    P_venous = body.body.P_start
    given = network.parameters()
    factors = _HUMAN_OUTLETS if network == read_network(find_network("human")) else {}
    outlets = {
        name: given[name] * factors[name.rsplit(".", 1)[-1]]
        for name in given
        if ".outlet." in name and name.rsplit(".", 1)[-1] in factors
    }
    venous = {name: P_venous for name, q in network.parameter_quantities().items() if q.input}
    return {
        "heart": {"heart.rate": 1.0 / network.inlet.T, "aorta.P_0": network.P_0, "venous.P": P_venous},
        "arteries": {"inlet.interpolation": "smooth" if parallel else "linear", **venous, **outlets},
        "body": {"body.exchange": "start" if parallel else "end", "body.P_start": P_venous},
    }


def first_port(network: Network, starts: Mapping[str, float | str]) -> dict[str, float]:
    """What the arteries tell the heart at the start: for masters that exchange nothing before the first step (FMPy)."""
    table = with_starts(variable_table(network, Settings()), starts)
    arteries = CoSimulation(network, Settings())
    arteries.initialize(0.0, {variable.name: variable.start for variable in table})
    ports = arteries.ports()
    return {f"aorta.{key}": ports[f"inlet.{key}"] for key in INLET_PORTS["flow"]}


def circulation(heart: Part, arteries: Part, body: Part) -> list[Wire]:
    """How heart, arteries and body are connected: see :mod:`~solver.lumped.heart` and :mod:`~solver.lumped.body`."""
    port = [(arteries.name, f"inlet.{key}", heart.name, f"aorta.{key}") for key in INLET_PORTS["flow"]]
    veins = [
        (body.name, "P", arteries.name, v.name)
        for v in arteries.table
        if v.causality == "input" and v.name.endswith(".P_venous")
    ]
    return [
        (heart.name, "aorta.Q", arteries.name, "inlet.Q"),
        *port,
        (arteries.name, "venous.V", body.name, "arteries.V"),
        (heart.name, "venous.V", body.name, "heart.V"),
        (body.name, "P", heart.name, "venous.P"),
        *veins,
    ]


def files(name: str, parts: Sequence[Part], wires: Sequence[Wire], stop_time: float, version: str) -> dict[str, bytes]:
    """The XML files of the system by their path in the archive; the FMUs belong beside, ``resources/<fmu>.fmu``."""
    texts = {f"resources/{part.name}.ssv": _parameters(part, version) for part in parts if part.values}
    return {"SystemStructure.ssd": _structure(name, parts, wires, stop_time, version), **texts}


def _structure(name: str, parts: Sequence[Part], wires: Sequence[Wire], stop_time: float, version: str) -> bytes:
    root = _root("ssd", "SystemStructureDescription", name, version)
    system = _sub(root, "ssd:System", name=name)
    elements = _sub(system, "ssd:Elements")
    for part in parts:
        wired = {w[1] for w in wires if w[0] == part.name} | {w[3] for w in wires if w[2] == part.name}
        connected = [v for v in part.table if v.name in wired or (v.causality == "output" and not v.late)]
        component = _sub(
            elements, "ssd:Component", name=part.name, type="application/x-fmu-sharedlibrary",
            source=f"resources/{part.fmu}.fmu",
        )  # fmt: skip
        connectors = _sub(component, "ssd:Connectors")
        for v in connected:
            assert v.quantity is not None
            connector = _sub(connectors, "ssd:Connector", name=v.name, kind=v.causality)
            _sub(connector, "ssc:Real", unit=v.quantity.unit)
        if part.values:
            bindings = _sub(component, "ssd:ParameterBindings")
            _sub(bindings, "ssd:ParameterBinding", source=f"resources/{part.name}.ssv")
    connections = _sub(system, "ssd:Connections")
    for start, output, end, given in wires:
        _sub(
            connections, "ssd:Connection", startElement=start, startConnector=output, endElement=end, endConnector=given
        )
    _units(root, "ssd:Units", {v.quantity.unit for part in parts for v in part.table if v.quantity is not None})
    _sub(root, "ssd:DefaultExperiment", startTime="0.0", stopTime=repr(stop_time))
    return _text(root)


def _parameters(part: Part, version: str) -> bytes:
    root = _root("ssv", "ParameterSet", _SET, version)
    parameters = _sub(root, "ssv:Parameters")
    units = set()
    for name, value in part.values.items():
        variable = part.variable(name)
        if variable.choices:  # libcosim knows no Enumerations; they are start values of the FMU itself
            continue
        parameter = _sub(parameters, "ssv:Parameter", name=name)
        assert variable.quantity is not None
        units.add(variable.quantity.unit)
        _sub(parameter, "ssv:Real", value=repr(float(value)), unit=variable.quantity.unit)
    _units(root, "ssv:Units", units)
    return _text(root)


def _root(space: str, kind: str, name: str, version: str) -> Element:
    root = Element(f"{{{_SPACES[space]}}}{kind}", version="1.0", name=name)
    root.set("generationTool", f"arterial-fmu {version}")
    return root


def _sub(parent: Element, tag: str, **attributes: str) -> Element:
    space, kind = tag.split(":")
    return SubElement(parent, f"{{{_SPACES[space]}}}{kind}", attributes)


def _units(root: Element, tag: str, units: Iterable[str]) -> None:
    node = _sub(root, tag)
    for name in sorted(units):
        unit = _sub(node, "ssc:Unit", name=name)
        _sub(unit, "ssc:BaseUnit", **{base: str(power) for base, power in base_units(name).items()})


def _text(root: Element) -> bytes:
    for prefix, space in _SPACES.items():
        ElementTree.register_namespace(prefix, space)
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="utf-8") + b"\n"
