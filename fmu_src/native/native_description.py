"""modelDescription.xml of FMUs that need no Python, for both versions of FMI, from the table of variables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from solver.quantities.units import base_units, display_factor, display_units

from ..variables.model_description import complete, type_definitions, type_name, unit_names
from ..variables.variable import Variable

AUTHOR, LICENCE, COPYRIGHT = "arterial-fmu contributors", "MIT", "© 2026 arterial-fmu contributors"
_CATEGORIES = ("Warning", "Discard", "Error", "Fatal")


@dataclass(frozen=True)
class About:
    """What a description says beside its variables. stop, step [s], tolerance : of the default experiment."""

    name: str
    description: str
    version: str
    guid: str
    stop: float
    step: float
    tolerance: float | None


def fmi2(about: About, table: Sequence[Variable]) -> bytes:
    """The description for FMI 2.0."""
    names = {"fmiVersion": "2.0", "modelName": about.name, "guid": about.guid}
    root = Element("fmiModelDescription", {**names, **_common(about)})
    flags = ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate",
             "canNotUseMemoryManagementFunctions", "providesDirectionalDerivative")  # fmt: skip
    can = dict.fromkeys(flags, "true")
    SubElement(root, "CoSimulation", can, modelIdentifier=about.name, needsExecutionTool="false")
    _categories(root, 2)
    _experiment(root, about)
    variables = SubElement(root, "ModelVariables")
    for vr, variable in enumerate(table):
        initial = {"parameter": {"initial": "exact"}, "output": {"initial": "calculated"}}.get(variable.causality, {})
        node = SubElement(variables, "ScalarVariable", {**_facts(vr, variable), **initial})
        start = (
            {} if variable.start is None or variable.quantity else {"start": str(variable.number(str(variable.start)))}
        )
        SubElement(node, "Real" if variable.quantity else "Integer", start)
    SubElement(root, "ModelStructure")
    return _text(complete(root, tuple(table), about.version, python=False))


def _common(about: About) -> dict[str, str]:
    return {
        "generationTool": "its compiled engine",
        "variableNamingConvention": "structured",
        "description": about.description,
        "author": AUTHOR,
        "version": about.version,
        "copyright": COPYRIGHT,
        "license": LICENCE,
    }


def _categories(root: Element, fmi: int) -> None:
    categories = SubElement(root, "LogCategories")
    for status in _CATEGORIES:
        text = f"Log messages with fmi{fmi}{status} status."
        SubElement(categories, "Category", name=f"logStatus{status}", description=text)
    SubElement(categories, "Category", name="logAll", description="Log all messages.")


def _facts(vr: int, variable: Variable) -> dict[str, str]:
    """What both versions say of a variable."""
    return {
        "name": variable.name,
        "valueReference": str(vr),
        "causality": variable.causality,
        "variability": variable.variability,
        "description": variable.description,
    }


def _experiment(root: Element, about: About) -> None:
    numbers = {"startTime": 0.0, "stopTime": about.stop, "stepSize": about.step, "tolerance": about.tolerance}
    given = {key: repr(float(value)) for key, value in numbers.items() if value is not None}
    SubElement(root, "DefaultExperiment", given)


def _text(root: Element) -> bytes:
    indent(root, "\t")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, "unicode").encode() + b"\n"


def build_description(about: About, files: Sequence[str]) -> bytes:
    """``sources/buildDescription.xml``, for importers that compile."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=about.name)
    sources = SubElement(configuration, "SourceFileSet", language="C99", compilerOptions="-O3 -ffp-contract=off")
    for file in files:
        SubElement(sources, "SourceFile", name=file)
    return _text(root)


# --- FMI 3.0 ----------------------------------------------------------------------------------------------------------


def fmi3(about: About, table: Sequence[Variable]) -> bytes:
    """The description for FMI 3.0, of the same variables and value references; time has the last one."""
    common = {**_common(about), "generationTool": f"arterial-fmu {about.version} with its compiled engine"}
    names = {"fmiVersion": "3.0", "modelName": about.name, "instantiationToken": about.guid}
    root = Element("fmiModelDescription", {**names, **common})
    SubElement(
        root, "CoSimulation", modelIdentifier=about.name, needsExecutionTool="false", canGetAndSetFMUState="true",
        canSerializeFMUState="true", canHandleVariableCommunicationStepSize="true",
        providesDirectionalDerivatives="true",
    )  # fmt: skip
    _units3(root, table)
    types = type_definitions(tuple(table))
    definitions = SubElement(root, "TypeDefinitions") if len(types) else root
    for simple in types:
        kind = SubElement(definitions, "EnumerationType", name=simple.get("name", ""))
        for item in simple[0]:
            SubElement(kind, "Item", name=item.get("name", ""), value=item.get("value", ""))
    _categories(root, 3)
    _experiment(root, about)
    variables = SubElement(root, "ModelVariables")
    for vr, variable in enumerate(table):
        _variable3(variables, vr, variable)
    SubElement(variables, "Float64", name="time", valueReference=str(len(table)), causality="independent",
               variability="continuous", description="time", unit="s")  # fmt: skip
    structure = SubElement(root, "ModelStructure")
    outputs = [(vr, variable) for vr, variable in enumerate(table) if variable.causality == "output"]
    reference = {variable.name: vr for vr, variable in enumerate(table)}
    for vr, _ in outputs:
        SubElement(structure, "Output", valueReference=str(vr), dependencies="")
    for vr, variable in outputs:
        sources = " ".join(map(str, sorted(reference[name] for name in variable.sources)))
        SubElement(structure, "InitialUnknown", valueReference=str(vr), dependencies=sources)
    return _text(root)


def _units3(root: Element, table: Sequence[Variable]) -> None:
    definitions = SubElement(root, "UnitDefinitions")
    for name, asked in sorted({"s": set[str](), **unit_names(tuple(table))}.items()):  # s: of time
        unit = SubElement(definitions, "Unit", name=name)
        SubElement(unit, "BaseUnit", {base: str(power) for base, power in base_units(name).items()})
        for display in sorted(asked.union(display_units(name)), key=str.lower):
            SubElement(unit, "DisplayUnit", name=display, factor=repr(display_factor(display)))


def _variable3(variables: Element, vr: int, variable: Variable) -> None:
    initial = {"parameter": {"initial": "exact"}, "output": {"initial": "calculated"}}.get(variable.causality, {})
    attributes = {**_facts(vr, variable), **initial}
    quantity = variable.quantity
    if quantity is None:
        start = str(variable.number(str(variable.start)))
        SubElement(variables, "Enumeration", attributes, declaredType=type_name(variable), start=start)
        return
    numbers = {"min": quantity.low, "max": quantity.high, "nominal": quantity.nominal}
    attributes |= {"unit": quantity.unit, **({"displayUnit": quantity.display} if quantity.display else {})}
    attributes |= {key: repr(float(value)) for key, value in numbers.items() if math.isfinite(value)}
    attributes |= {} if variable.start is None else {"start": repr(float(variable.start))}
    SubElement(variables, "Float64", attributes)
