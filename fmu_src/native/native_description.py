"""modelDescription.xml of FMUs that need no Python, for both versions of FMI, from the table of variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from ..compiler import FLAGS
from ..variables.model_description import complete, limits, type_definitions, type_name, unit, unit_definitions
from ..variables.variable import Variable

AUTHOR, LICENCE, COPYRIGHT = "arterial-fmu contributors", "MIT", "© 2026 arterial-fmu contributors"
_CATEGORIES = ("Warning", "Discard", "Error", "Fatal")
# a name of ours that the host also has, as glibc has ``step``, would otherwise be the host's
OPTIONS = " ".join(flag for flag in FLAGS if flag.startswith(("-O", "-f")))


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


def fmi2(about: About, table: Sequence[Variable], files: Sequence[str]) -> bytes:
    """The description for FMI 2.0. files : the C files in ``sources/``."""
    names = {"fmiVersion": "2.0", "modelName": about.name, "guid": about.guid}
    root = Element("fmiModelDescription", {**names, **_common(about)})
    flags = ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate",
             "canNotUseMemoryManagementFunctions", "providesDirectionalDerivative")  # fmt: skip
    can = dict.fromkeys(flags, "true")
    kind = SubElement(root, "CoSimulation", can, modelIdentifier=about.name, needsExecutionTool="false")
    sources = SubElement(kind, "SourceFiles")
    for file in files:
        SubElement(sources, "File", name=file)
    _categories(root, 2)
    _experiment(root, about)
    variables = SubElement(root, "ModelVariables")
    for vr, variable in enumerate(table):
        node = SubElement(variables, "ScalarVariable", _facts(vr, variable))
        if variable.quantity is None:
            SubElement(node, "Integer", start=_item(variable))
        else:
            SubElement(node, "Real")
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
        **{"parameter": {"initial": "exact"}, "output": {"initial": "calculated"}}.get(variable.causality, {}),
    }


def _item(variable: Variable) -> str:
    """The number of the item that an Enumeration starts with."""
    return str(variable.number(str(variable.start)))


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
    sources = SubElement(configuration, "SourceFileSet", language="C99", compilerOptions=OPTIONS)
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
    root.append(unit_definitions(tuple(table), "s"))  # of time
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


def _variable3(variables: Element, vr: int, variable: Variable) -> None:
    attributes, quantity = _facts(vr, variable), variable.quantity
    if quantity is None:
        SubElement(variables, "Enumeration", attributes, declaredType=type_name(variable), start=_item(variable))
        return
    start = {} if variable.start is None else {"start": repr(float(variable.start))}
    SubElement(variables, "Float64", {**attributes, **unit(quantity), **limits(quantity), **start})
