"""What pythonfmu leaves out of modelDescription.xml: units, types, ranges, initial unknowns, dependencies."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element, SubElement

from solver.quantities.quantity import Quantity
from solver.quantities.units import base_units, display_factor, display_units

from ..host import PACKAGES, PYTHONS
from .variable import Variable


def complete(root: Element, table: tuple[Variable, ...], version: str, python: bool = True) -> Element:
    """Add to a description of the same variables, as pythonfmu makes it, and return it. python : whether the host
    needs one."""
    root.set("generationTool", f"arterial-fmu {version} with {root.get('generationTool')}")
    root.attrib.pop("generationDateAndTime", None)  # so that the same input builds the same FMU, byte for byte
    after = list(root).index(root.find("CoSimulation")) + 1  # type: ignore[arg-type]
    root.insert(after, unit_definitions(table))
    if any(variable.choices for variable in table):
        root.insert(after + 1, type_definitions(table))
    variables = root.find("ModelVariables")
    assert variables is not None
    if python:
        root.insert(list(root).index(variables), _annotations())
    for node, variable in zip(variables, table, strict=True):
        if variable.quantity is not None:
            # 17 digits where needed: the start value is the network's, bit for bit
            start = {} if variable.start is None else {"start": repr(variable.start)}
            node[0].attrib |= {**unit(variable.quantity), **start, **limits(variable.quantity)}
        else:
            node[0].tag = "Enumeration"
            node[0].set("declaredType", type_name(variable))
    structure = root.find("ModelStructure")
    assert structure is not None
    for child in list(structure):
        structure.remove(child)
    index_of = {variable.name: i for i, variable in enumerate(table, start=1)}
    outputs, unknowns = SubElement(structure, "Outputs"), SubElement(structure, "InitialUnknowns")
    for index, variable in enumerate(table, start=1):
        if variable.causality == "output":
            # an output changes only by a step: no direct feedthrough from any input
            SubElement(outputs, "Unknown", index=str(index), dependencies="", dependenciesKind="")
            sources = sorted(index_of[name] for name in variable.sources)
            kinds = " ".join(["dependent"] * len(sources))
            SubElement(
                unknowns, "Unknown", index=str(index), dependencies=" ".join(map(str, sources)), dependenciesKind=kinds
            )
    return root


def _annotations() -> Element:
    """What the host needs, for programs that look before they load: ``<Host python="3.10 to 3.13" …/>``."""
    annotations = Element("VendorAnnotations")
    tool = SubElement(annotations, "Tool", name="arterial-fmu")
    SubElement(tool, "Host", python=PYTHONS, packages=PACKAGES)
    return annotations


def unit_definitions(table: tuple[Variable, ...], *further: str) -> Element:
    """The units of the variables and further ones, and in which others each is shown."""
    quantities = [v.quantity for v in table if v.quantity is not None]
    definitions = Element("UnitDefinitions")
    for name in sorted({*further, *(q.unit for q in quantities)}):
        asked = {q.display for q in quantities if q.unit == name and q.display}
        node = SubElement(definitions, "Unit", name=name)
        SubElement(node, "BaseUnit", {base: str(power) for base, power in base_units(name).items()})
        for display in sorted(asked.union(display_units(name)), key=str.lower):
            SubElement(node, "DisplayUnit", name=display, factor=repr(display_factor(display)))
    return definitions


def type_definitions(table: tuple[Variable, ...]) -> Element:
    """An Enumeration for every variable with choices."""
    definitions = Element("TypeDefinitions")
    for variable in table:
        if variable.choices:
            simple = SubElement(definitions, "SimpleType", name=type_name(variable))
            enumeration = SubElement(simple, "Enumeration")
            for choice in variable.choices:
                SubElement(enumeration, "Item", name=choice, value=str(variable.number(choice)))
    return definitions


def type_name(variable: Variable) -> str:
    """network.elastic_law -> NetworkElasticLaw, which is no name of a variable."""
    return "".join(part.capitalize() for part in variable.name.replace(".", "_").split("_"))


def unit(quantity: Quantity) -> dict[str, str]:
    """The unit and the display unit, as attributes."""
    return {"unit": quantity.unit, **({"displayUnit": quantity.display} if quantity.display else {})}


def limits(quantity: Quantity) -> dict[str, str]:
    """The range and the nominal value, as attributes; none for an infinite end."""
    numbers = {"min": quantity.low, "max": quantity.high, "nominal": quantity.nominal}
    return {key: repr(float(value)) for key, value in numbers.items() if math.isfinite(value)}
