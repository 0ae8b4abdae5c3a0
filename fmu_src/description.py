"""What pythonfmu leaves out of modelDescription.xml: units, ranges, initial unknowns, dependencies."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element, SubElement

from solver import effects
from solver.network import Network
from solver.units import base_units, display_factor, display_units

from .variables import Variable


def description(network: Network) -> str:
    """One line on what the FMU is, for its ``description`` attribute."""
    text = f"1D blood flow in the arterial network {network.name}. {network.reference}"
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())  # XML has no control characters


def complete(root: Element, table: tuple[Variable, ...], version: str) -> Element:
    """Add to the description that pythonfmu made of the same variables, and return it."""
    root.set("generationTool", f"arterial-fmu {version} with {root.get('generationTool')}")
    root.attrib.pop("generationDateAndTime", None)  # so that the same input builds the same FMU, byte for byte
    root.insert(list(root).index(root.find("CoSimulation")) + 1, _unit_definitions(table))  # type: ignore[arg-type]
    for node, variable in zip(root.find("ModelVariables"), table, strict=True):  # type: ignore[arg-type]
        if variable.quantity is not None:
            _add_range(node[0], variable)
    structure = root.find("ModelStructure")
    assert structure is not None
    for child in list(structure):
        structure.remove(child)
    outputs, unknowns = SubElement(structure, "Outputs"), SubElement(structure, "InitialUnknowns")
    for index, variable in enumerate(table, start=1):
        if variable.causality == "output":
            # an output changes only by a step: no direct feedthrough from any input
            SubElement(outputs, "Unknown", index=str(index), dependencies="", dependenciesKind="")
            sources = _initial_sources(variable.name, table)
            kinds = " ".join(["dependent"] * len(sources))
            SubElement(
                unknowns, "Unknown", index=str(index), dependencies=" ".join(map(str, sources)), dependenciesKind=kinds
            )
    return root


def _unit_definitions(table: tuple[Variable, ...]) -> Element:
    definitions = Element("UnitDefinitions")
    quantities = [v.quantity for v in table if v.quantity is not None]
    for name in sorted({q.unit for q in quantities}):
        unit = SubElement(definitions, "Unit", name=name)
        SubElement(unit, "BaseUnit", {base: str(power) for base, power in base_units(name).items()})
        asked = {q.display for q in quantities if q.unit == name and q.display}
        for display in sorted(asked.union(display_units(name)), key=str.lower):
            SubElement(unit, "DisplayUnit", name=display, factor=repr(display_factor(display)))
    return definitions


def _add_range(real: Element, variable: Variable) -> None:
    quantity = variable.quantity
    assert quantity is not None
    real.set("unit", quantity.unit)
    if quantity.display:
        real.set("displayUnit", quantity.display)
    if variable.start is not None:
        real.set("start", repr(variable.start))  # 17 digits where needed: the start value is the network's, bit for bit
    if math.isfinite(quantity.low):
        real.set("min", repr(float(quantity.low)))
    if math.isfinite(quantity.high):
        real.set("max", repr(float(quantity.high)))
    real.set("nominal", repr(float(quantity.nominal)))


def _initial_sources(output: str, table: tuple[Variable, ...]) -> list[int]:
    """Indices of the parameters on which an output depends at the start: rest under P_0."""
    place, kind = output.rsplit(".", 1)
    if kind == "Q":
        return []
    # P is P_0 up to round-off through the wall law and back; R follows from it by the wall of the site's segment,
    # which the table does not name: all walls are listed
    names = {"network.P_0"}
    if kind == "R":
        names |= {"network.P_ref", "network.eta", "network.elastic_law"}
        walls = ("R0", "h", "E", *(key for effect in effects.ALL if effect.at_rest for key in effect.terms))
        names |= {v.name for v in table if v.causality == "parameter" and v.name.rsplit(".", 1)[-1] in walls}
    return [i for i, v in enumerate(table, start=1) if v.name in names]
