"""What an FMU says of itself: names, units, start values, structure; FMPy finds no problem in it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pint
import pytest
from fmpy.validation import validate_fmu
from fmus import TEXTS, Instance, mixed

from solver import Network, load

# --- description --------------------------------------------------------------------------------------------------

NAMES = ["sheep", "sheep_nonlinear", "mixed"]


@pytest.mark.parametrize("name", NAMES)
def test_valid(fmus: dict[str, Path], name: str) -> None:
    """FMPy finds no problem: schema, names, structure, start values, units."""
    assert validate_fmu(os.fspath(fmus[name])) == []


def test_valid_on_the_command_line(fmus: dict[str, Path]) -> None:
    """``fmpy validate`` agrees."""
    done = subprocess.run(
        [sys.executable, "-m", "fmpy", "validate", os.fspath(fmus["mixed"])], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "No problems found" in done.stdout


def xml(fmu: Path) -> ElementTree.Element:
    import zipfile

    with zipfile.ZipFile(fmu) as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml"))


def find(parent: ElementTree.Element, path: str) -> ElementTree.Element:
    node = parent.find(path)
    assert node is not None
    return node


def test_head_of_the_description(fmus: dict[str, Path]) -> None:
    """Names, versions, licence, flags and default experiment; nothing that changes from build to build."""
    root = xml(fmus["sheep"])
    assert root.attrib["variableNamingConvention"] == "structured"
    assert root.attrib["generationTool"].startswith("arterial-fmu 0.")
    assert "with PythonFMU 0." in root.attrib["generationTool"]
    assert {"modelName": "sheep", "license": "MIT", "fmiVersion": "2.0"}.items() <= root.attrib.items()
    assert root.attrib["version"] and root.attrib["author"]
    host = find(root, "VendorAnnotations/Tool[@name='arterial-fmu']/Host")
    assert host.attrib == {"python": "3.10 to 3.13", "packages": "numpy"}
    assert "doi:10.1115/1.4034832" in root.attrib["description"]
    assert "generationDateAndTime" not in root.attrib
    slave = find(root, "CoSimulation").attrib
    assert slave["canHandleVariableCommunicationStepSize"] == slave["needsExecutionTool"] == "true"
    assert slave["canGetAndSetFMUstate"] == slave["canSerializeFMUstate"] == "true"
    assert slave["canInterpolateInputs"] == "false"
    assert slave["canBeInstantiatedOnlyOncePerProcess"] == "false"
    experiment = {key: float(value) for key, value in find(root, "DefaultExperiment").attrib.items()}
    assert experiment == {"startTime": 0.0, "stopTime": 2.5, "stepSize": 1e-3, "tolerance": 3e-5}


# what the FMU promises: (causality, variability, unit, display unit) by the end of the name
KINDS = {
    ".L": ("parameter", "fixed", "m", "cm"),
    ".R0": ("parameter", "fixed", "m", "mm"),
    ".h": ("parameter", "fixed", "m", "mm"),
    ".E": ("parameter", "tunable", "Pa", "MPa"),
    ".ENL": ("parameter", "tunable", "Pa", "MPa"),
    ".phi0": ("parameter", "tunable", "Pa.s", "kPa.s"),
    ".phiNL": ("parameter", "tunable", "Pa.s^2", "kPa.s^2"),
    ".outlet.R_t": ("parameter", "tunable", "1", None),
    ".outlet.R1": ("parameter", "tunable", "Pa.s/m^3", "mmHg.s/mL"),
    ".outlet.C": ("parameter", "tunable", "m^3/Pa", "mL/mmHg"),
    ".outlet.R2": ("parameter", "tunable", "Pa.s/m^3", "mmHg.s/mL"),
    ".outlet.R": ("parameter", "tunable", "Pa.s/m^3", "mmHg.s/mL"),
    ".junction.k": ("parameter", "tunable", "1", None),
    ".outlet.P_venous": ("input", "continuous", "Pa", "mmHg"),
    "fluid.rho": ("parameter", "fixed", "kg/m^3", None),
    "fluid.nu": ("parameter", "fixed", "m^2/s", None),
    "fluid.alpha": ("parameter", "fixed", "1", None),
    "fluid.friction": ("parameter", "fixed", "1", None),
    "network.eta": ("parameter", "fixed", "1", None),
    "network.P_ref": ("parameter", "fixed", "Pa", "mmHg"),
    "network.P_0": ("parameter", "fixed", "Pa", "mmHg"),
    "solver.dt": ("parameter", "fixed", "s", "ms"),
    "solver.element_length": ("parameter", "fixed", "m", "cm"),
    "inlet.Q_mean": ("parameter", "fixed", "m^3/s", "mL/s"),
    "inlet.T": ("parameter", "fixed", "s", None),
    "inlet.Q": ("input", "continuous", "m^3/s", "mL/s"),
    ".P": ("output", "continuous", "Pa", "mmHg"),
    ".Q": ("output", "continuous", "m^3/s", "mL/s"),
    ".R": ("output", "continuous", "m", "mm"),
    ".V": ("output", "continuous", "m^3", "mL"),
    ".P_0": ("output", "continuous", "Pa", "mmHg"),
    ".Z": ("output", "continuous", "Pa.s/m^3", "mmHg.s/mL"),
    ".Z_0": ("output", "continuous", "Pa.s/m^3", "mmHg.s/mL"),
}


def expected_names(network: Network) -> list[str]:
    outlets = {"Reflection": ["R_t"], "Windkessel": ["R1", "C", "R2"], "Resistance": ["R"], "Pressure": []}
    names = ["inlet.Q", "inlet.P", "inlet.P_0", "inlet.Z", "inlet.Z_0", "network.V", "venous.V", "venous.Q"]
    names += ["solver.dt", "solver.element_length", "inlet.Q_mean", "inlet.T", *TEXTS]
    names += [
        "network.eta",
        "network.P_ref",
        "network.P_0",
        *(f"fluid.{k}" for k in ("rho", "nu", "alpha", "friction")),
    ]
    names += [f"{s.name}.{k}" for s in network.segments for k in ("L", "R0", "h", "E", "ENL", "phi0", "phiNL")]
    names += [f"{o.segment}.outlet.{k}" for o in network.outlets for k in outlets[type(o).__name__]]
    names += [f"{o.segment}.outlet.{k}" for o in network.outlets for k in ("P_venous", "P", "Q", "P_0", "Z")]
    names += [f"{j.name}.junction.k" for j in network.junctions]
    return names + [f"{site.name}.{k}" for site in network.sites for k in "PQR"]


def test_variables(fmus: dict[str, Path]) -> None:
    """Every variable of the network and no other, with unit, range, nominal, description and initial."""
    root = xml(fmus["mixed"])
    variables = {node.attrib["name"]: node for node in find(root, "ModelVariables")}
    types = {node.attrib["name"]: node[0] for node in find(root, "TypeDefinitions")}
    assert not variables.keys() & types.keys()
    assert sorted(variables) == sorted(expected_names(mixed()))
    for name, node in variables.items():
        assert node.attrib["description"]
        if name in TEXTS:
            choices = {item.attrib["value"]: item.attrib["name"] for item in types[node[0].attrib["declaredType"]]}
            assert (node[0].tag, choices[node[0].attrib["start"]]) == ("Enumeration", TEXTS[name])
            assert sorted(choices) == [str(i) for i, _ in enumerate(choices, start=1)]
            assert (node.attrib["causality"], node.attrib["variability"]) == ("parameter", "fixed")
            continue
        kind = next((KINDS[end] for end in sorted(KINDS, key=len, reverse=True) if name.endswith(end)), None)
        real = node[0].attrib
        found = node.attrib["causality"], node.attrib["variability"], real["unit"], real.get("displayUnit")
        assert found == kind, name
        initial = {"parameter": "exact", "output": "calculated", "input": None}[found[0]]
        assert node.attrib.get("initial") == initial
        assert float(real["nominal"]) > 0.0
        if found[0] == "output":
            assert "start" not in real
        else:
            assert float(real["min"]) <= float(real["start"]) <= float(real["max"])
    assert [int(node.attrib["valueReference"]) for node in variables.values()] == list(range(len(variables)))


@pytest.mark.parametrize("name", NAMES)
def test_start_values_are_exact(fmus: dict[str, Path], name: str) -> None:
    """Start values are the network's and the settings', bit for bit."""
    network = mixed() if name == "mixed" else load(name)
    starts = {n.attrib["name"]: n[0].attrib.get("start") for n in find(xml(fmus[name]), "ModelVariables")}
    for key, value in {**network.parameters(), "solver.dt": 1e-3, "solver.element_length": 0.05}.items():
        assert float(starts[key] or "nan").hex() == float(value).hex(), key
    assert starts["network.viscous_law"] == {"quadratic": "1", "monotone": "2"}[network.viscous_law]


def test_units(fmus: dict[str, Path]) -> None:
    """Base units and display factors are pint's, to round-off (1e-12)."""
    registry: pint.UnitRegistry[Any] = pint.UnitRegistry()
    short = {"meter": "m", "kilogram": "kg", "second": "s"}
    definitions = find(xml(fmus["mixed"]), "UnitDefinitions")
    displays = 0
    for unit in definitions:
        parsed = registry.parse_expression(unit.attrib["name"].replace(".", "*")) * registry.dimensionless
        base = parsed.to_base_units()
        assert base.magnitude == pytest.approx(1.0, rel=1e-12)
        powers = {short[str(key)]: int(power) for key, power in base.unit_items()}
        assert powers == {key: int(power) for key, power in find(unit, "BaseUnit").attrib.items()}
        for display in unit.findall("DisplayUnit"):
            factor = parsed.to(display.attrib["name"].replace(".", "*")).magnitude
            assert float(display.attrib["factor"]) == pytest.approx(factor, rel=1e-12)
            assert "offset" not in display.attrib
            displays += 1
    assert displays == 11


@pytest.mark.parametrize("name", NAMES)
def test_structure(fmus: dict[str, Path], name: str) -> None:
    """Outputs depend on no input directly, so no master sees an algebraic loop; all outputs are initial unknowns."""
    root = xml(fmus[name])
    kinds = [node.attrib["causality"] for node in find(root, "ModelVariables")]
    outputs = [str(i) for i, kind in enumerate(kinds, start=1) if kind == "output"]
    unknowns = find(root, "ModelStructure/Outputs")
    assert [node.attrib for node in unknowns] == [
        {"index": i, "dependencies": "", "dependenciesKind": ""} for i in outputs
    ]
    initial = find(root, "ModelStructure/InitialUnknowns")
    assert [node.attrib["index"] for node in initial] == outputs
    for node in initial:
        assert {kinds[int(i) - 1] for i in node.attrib["dependencies"].split()} <= {"parameter", "input"}


@pytest.mark.parametrize("start", ["rest", pytest.param("periodic", marks=pytest.mark.slow)])
def test_initial_dependencies_are_complete(
    instantiate: Callable[..., Instance], fmus: dict[str, Path], start: str
) -> None:
    """An initial output changes with a parameter or input only if the description lists it; starting near the
    periodic state, whatever has sources changes with some of them. Each one is changed by 1 %, in initialization mode.
    """
    root = xml(fmus["mixed"])
    names = [node.attrib["name"] for node in find(root, "ModelVariables")]
    declared = {
        names[int(node.attrib["index"]) - 1]: {names[int(i) - 1] for i in node.attrib["dependencies"].split()}
        for node in find(root, "ModelStructure/InitialUnknowns")
    }
    instance = instantiate("mixed")
    outputs = [*instance.outputs, *(name for name in instance.others if name.endswith(".V"))]
    instance.slave.setupExperiment(startTime=0.0)
    instance.set({"network.P_0": 12e3, "network.start": start})
    instance.slave.enterInitializationMode()
    before = dict(zip(outputs, instance.get(outputs), strict=True))
    changed: dict[str, set[str]] = {name: set() for name in outputs}
    for name in names:
        if name in TEXTS or name in (*instance.outputs, *instance.others):
            continue
        (value,) = instance.get([name])
        instance.set({name: value * 0.99 if value else 1e-3})
        for output, now in zip(outputs, instance.get(outputs), strict=True):
            if abs(now - before[output]) > 1e-9 * abs(before[output]):
                changed[output].add(name)
        instance.set({name: value})
    for output, sources in changed.items():
        assert sources <= declared[output], output
        assert start == "rest" or (declared[output] == set()) == (sources == set())
