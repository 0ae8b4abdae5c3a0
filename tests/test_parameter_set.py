"""Parameter sets: JSON and SSV there and back, as other readers see them, the bundled sets, every refusal.

Oracles: FMPy's and pyssp_standard's readers with the schema of the standard, the network files, an FMU.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssv
from hypothesis import given
from hypothesis import strategies as st

from fitting.results.parameter_set import ParameterSet, Value, read_set, unit_of, write_set
from fmu_src.importer.run import run_fmu
from solver import Network, load

E = Value(1.539e6, "Pa", (1.52e6, 1.56e6))
LAWS = {"network.elastic_law": "regression", "network.viscous_law": "monotone"}
PROVENANCE = {"record": "AA.csv", "sha256": "0f" * 32, "gamma": 0.02, "kept": [1, 2, 3], "software": "é <&> \x07"}
FULL = ParameterSet(
    "ewe 7",
    {"AA.E": E, "AA.phi0": Value(25451.0, "Pa.s"), "CA.outlet.R_t": Value(0.3, "1", (0.1, 0.7))},
    LAWS,
    PROVENANCE,
)
FINITE = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture(scope="module")
def fmu(fmus: dict[str, Path]) -> Path:
    """The sheep network, coarse."""
    return fmus["coarse sheep"]


# --- there and back -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["json", "ssv"])
def test_round_trip(tmp_path: Path, suffix: str) -> None:
    """Names, values, intervals, laws and provenance come back equal, and the file as it was; nothing is left aside."""
    write_set(FULL, tmp_path / f"set.{suffix}")
    first = (tmp_path / f"set.{suffix}").read_bytes()
    assert read_set(tmp_path / f"set.{suffix}") == FULL
    write_set(read_set(tmp_path / f"set.{suffix}"), tmp_path / f"set.{suffix}")
    assert (tmp_path / f"set.{suffix}").read_bytes() == first
    assert [path.name for path in tmp_path.iterdir()] == [f"set.{suffix}"]


@pytest.mark.parametrize("suffix", ["json", "ssv"])
def test_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, suffix: str) -> None:
    """Any finite doubles, -0.0 and subnormal ones too, come back bit for bit."""
    path = tmp_path_factory.mktemp("sets") / f"set.{suffix}"

    @given(FINITE, st.tuples(FINITE, FINITE))
    def there_and_back(value: float, ends: tuple[float, float]) -> None:
        written = ParameterSet("any", {"AA.phiNL": Value(value, "Pa.s^2", (min(ends), max(ends)))})
        write_set(written, path)
        read = read_set(path).values["AA.phiNL"]
        assert read.ci95 is not None
        assert [x.hex() for x in (read.value, *read.ci95)] == [x.hex() for x in (value, min(ends), max(ends))]

    there_and_back()


def test_json_is_readable(tmp_path: Path) -> None:
    """One parameter a line, in SI, with its unit."""
    write_set(FULL, tmp_path / "set.json")
    lines = (tmp_path / "set.json").read_text(encoding="utf-8").splitlines()
    assert '    "AA.E": {"value": 1539000.0, "unit": "Pa", "ci95": [1520000.0, 1560000.0]},' in lines
    assert '    "AA.phi0": {"value": 25451.0, "unit": "Pa.s"},' in lines


@pytest.mark.parametrize(
    ("name", "entry", "expected"),
    [
        ("AA.E", {"value": 1.539, "unit": "MPa", "ci95": [1.52, 1.56]}, E),
        ("AA.phi0", {"value": 25.451, "unit": "kPa.s"}, Value(25451.0, "Pa.s")),
        ("AA.h", {"value": 0.38, "unit": "mm"}, Value(0.38e-3, "m")),
        ("CA.outlet.R_t", {"value": 30, "unit": "percent"}, Value(0.3, "1")),
        ("CA.outlet.R1", {"value": 1, "unit": "mmHg*s/mL"}, Value(133.322387415e6, "Pa.s/m^3")),
    ],
)
def test_units_are_converted(tmp_path: Path, name: str, entry: dict[str, Any], expected: Value) -> None:
    """A value in another unit is read in SI, and its interval with it."""
    (tmp_path / "set.json").write_text(json.dumps({**EMPTY, "values": {name: entry}}))
    read = read_set(tmp_path / "set.json").values[name]
    assert (read.unit, read.ci95) == (expected.unit, expected.ci95)
    assert read.value == pytest.approx(expected.value, rel=2e-16)


# --- as others read it --------------------------------------------------------------------------------------------


def test_ssv_is_valid(tmp_path: Path) -> None:
    """Both schema validators accept it; both readers find every name, value, unit and text; the units are defined."""
    from pyssp_standard.ssv import SSV

    write_set(FULL, tmp_path / "set.ssv")
    by_fmpy = {p.name: (p.type, p.value, p.unit) for p in read_ssv(os.fspath(tmp_path / "set.ssv")).parameters}
    expected: dict[str, Any] = {n: ("Real", repr(v.value), v.unit) for n, v in FULL.values.items()}
    expected |= dict.fromkeys(LAWS, ("Integer", "2", None))  # the number in the FMU's Enumeration
    assert by_fmpy == expected
    with SSV(tmp_path / "set.ssv") as ssv:
        ssv.__check_compliance__()
        by_pyssp = {p["name"]: p["type_value"].parameter for p in ssv.parameters}
        units = {unit.name: unit.base_unit.to_dict() for unit in ssv.units}
    assert {n: (float(p["value"]), p["unit"]) for n, p in by_pyssp.items() if n in FULL.values} == {
        name: (value.value, value.unit) for name, value in FULL.values.items()
    }
    assert {name: int(by_pyssp[name]["value"]) for name in LAWS} == dict.fromkeys(LAWS, 2)
    assert units == {"1": {}, "Pa": {"kg": "1", "m": "-1", "s": "-2"}, "Pa.s": {"kg": "1", "m": "-1", "s": "-1"}}


@pytest.mark.parametrize("kind", ["String", "Enumeration"])
def test_ssv_of_another_tool(tmp_path: Path, kind: str) -> None:
    """Made with pyssp_standard: units converted, none taken as the variable's, no intervals, laws by name."""
    from pyssp_standard.ssv import SSV

    with SSV(tmp_path / "set.ssv", "w", name="other") as ssv:
        ssv.ssv_elem.name = "other"
        ssv.add_parameter("AA.E", "Real", value=1.539, unit="MPa")
        ssv.add_parameter("AA.phi0", "Real", value=25451, unit="Pa.s")
        ssv.add_parameter("network.elastic_law", "String", value="beta")
        ssv.add_unit("MPa", {"kg": 1, "m": -1, "s": -2, "factor": 1e6})
    text = (tmp_path / "set.ssv").read_text(encoding="utf-8")
    assert ' unit="Pa.s"' in text
    text = text.replace(' unit="Pa.s"', "").replace("ssv:String", f"ssv:{kind}")
    (tmp_path / "set.ssv").write_text(text, encoding="utf-8")
    expected = {"AA.E": Value(1.539e6, "Pa"), "AA.phi0": Value(25451.0, "Pa.s")}
    assert read_set(tmp_path / "set.ssv") == ParameterSet("other", expected, {"network.elastic_law": "beta"})


def test_changed_ssv_loses_the_interval(tmp_path: Path) -> None:
    """A value that was edited in the file has no interval any more; the others keep theirs."""
    write_set(FULL, tmp_path / "set.ssv")
    text = (tmp_path / "set.ssv").read_text(encoding="utf-8").replace('value="1539000.0"', 'value="2e6"')
    (tmp_path / "set.ssv").write_text(text, encoding="utf-8")
    values = read_set(tmp_path / "set.ssv").values
    assert (values["AA.E"], values["CA.outlet.R_t"]) == (Value(2e6, "Pa"), FULL.values["CA.outlet.R_t"])


@pytest.mark.parametrize("name", ["sheep_table1", "sheep_table1_nonlinear"])
def test_fmu_accepts_it(fmu: Path, tmp_path: Path, name: str) -> None:
    """The start values, through SSV and FMPy's reader, are the set's own and those the FMU has after its start."""
    written = read_set(name)
    write_set(written, tmp_path / "set.ssv")
    starts = {
        p.name: int(p.value) if p.type == "Integer" else float(p.value)
        for p in read_ssv(os.fspath(tmp_path / "set.ssv")).parameters
    }
    numbers = {"beta": 1, "regression": 2, "quadratic": 1, "monotone": 2}
    assert starts == {n: numbers[v] if isinstance(v, str) else v for n, v in written.start_values().items()}
    assert len(starts) == 52
    expected = run_fmu(fmu, lambda t: 1e-5 * np.sin(t), 0.02, start_values=written.start_values())
    result = fmpy.simulate_fmu(os.fspath(fmu), stop_time=0.02, start_values=starts, output=list(starts)[:50])
    assert all(result[name][-1] == starts[name] for name in result.dtype.names[1:])
    assert len(result.dtype.names) == 51
    assert expected["time"][-1] == result["time"][-1] == 0.02


def test_units_are_the_fmus(fmu: Path) -> None:
    """unit_of agrees with modelDescription.xml for every parameter and input of the network."""
    variables = fmpy.read_model_description(os.fspath(fmu)).modelVariables
    units = {v.name: v.unit for v in variables if v.causality != "output" and v.type == "Real"}
    own = {name: unit for name, unit in units.items() if not name.startswith(("solver.", "inlet."))}
    assert len(own) == 92
    assert {name: unit_of(name) for name in own} == own


# --- bundled sets -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "network"), [("sheep_table1", "sheep"), ("sheep_table1_nonlinear", "sheep_nonlinear")]
)
def test_bundled_sets(name: str, network: str) -> None:
    """The paper's Table 1: R0, h, E, phi0, phiNL of all ten segments are the network file's, to the last bit."""
    table, published = read_set(name), load(network)
    assert {n: v.value for n, v in table.values.items()} == {
        n: value for n, value in published.parameters().items() if n.endswith((".R0", ".h", ".E", ".phi0", ".phiNL"))
    }
    assert "Ghigo" in table.provenance["source"]
    assert "Table 1" in table.provenance["source"]


def test_apply(sheep: Network) -> None:
    """Values and laws reach the network; what the set does not name stays."""
    changed = FULL.apply(sheep)
    assert changed.parameters() == sheep.parameters() | {"AA.E": 1.539e6, "AA.phi0": 25451.0, "CA.outlet.R_t": 0.3}
    assert (changed.elastic_law, changed.viscous_law) == ("regression", "monotone")
    only = ParameterSet("only", {"AA.E": Value(2e6, "Pa")}).apply(sheep)
    assert (only.elastic_law, only.segment("AA").E) == (sheep.elastic_law, 2e6)


def test_apply_refuses(sheep: Network) -> None:
    """A segment that the network has not, and a value outside its range."""
    with pytest.raises(ValueError, match=r"XX\.E: not a parameter of network sheep; "):
        ParameterSet("other", {"XX.E": Value(1e6, "Pa")}).apply(sheep)
    with pytest.raises(ValueError, match=r"AA\.phi0 = -1 Pa\.s is not allowed: "):
        ParameterSet("negative", {"AA.phi0": Value(-1.0, "Pa.s")}).apply(sheep)


# --- refusals -----------------------------------------------------------------------------------------------------

EMPTY = {"format": "arterial-fmu parameter set 1", "name": "x", "values": {}}
PA = {"value": 1.0, "unit": "Pa"}


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"AA.G": PA}, r"AA\.G: no segment has a parameter 'G'; use one of L, R0, h, E, phi0, "),
        ({"AA.phi": PA}, r"AA\.phi: no segment .* \(did you mean phi0\?\)\.$"),
        ({"E": PA}, r"E: no segment has a parameter 'E'"),
        ({"CA.outlet.C1": PA}, r"CA\.outlet\.C1: no outlet has a parameter 'C1'; use one of P_venous, R_t, "),
        ({"network.Q": PA}, r"network\.Q: no network has a parameter 'Q'; use one of eta, P_ref, P_0"),
        ({"AA.E": {"value": 1.0}}, r'AA\.E: its unit is missing; add "unit": "Pa" or the one the value is in\.$'),
        ({"AA.E": {"value": 1.0, "unit": 3}}, r"AA\.E: its unit is missing"),
        ({"AA.E": {"value": 1.0, "unit": "mm"}}, r"AA\.E = .*: the unit mm does not convert to the expected Pa; "),
        ({"AA.E": {"value": 1.0, "unit": "quatloo"}}, r"AA\.E = .*: the unit quatloo is not known; expected Pa"),
        ({"AA.E": {"value": "1", "unit": "Pa"}}, r"AA\.E = '1': must be a finite number; "),
        ({"AA.E": {"value": True, "unit": "Pa"}}, r"AA\.E = True: must be a finite number; "),
        ({"AA.E": {"value": None, "unit": "Pa"}}, r"AA\.E = None: must be a finite number; "),
        ({"AA.E": {**PA, "sd": 3}}, r"AA\.E: unknown key 'sd'; use one of value, unit, ci95\.$"),
        ({"AA.E": {**PA, "ci95": [1]}}, r"AA\.E: ci95 = \[1\] must be two numbers, low and high\.$"),
        ({"AA.E": {**PA, "ci95": [2, 1]}}, r"AA\.E: ci95 = \[2, 1\] Pa must be low before high; swap them\.$"),
        ({"AA.E": {**PA, "ci95": [2, "x"]}}, r"AA\.E ci95 = 'x': must be a finite number; "),
        ({"AA.E": 1.0}, r'AA\.E: must be an object such as \{"value": 1, "unit": "Pa"\}\.$'),
    ],
)
def test_refused_values(tmp_path: Path, values: dict[str, Any], sentence: str) -> None:
    """One sentence that starts with the file."""
    (tmp_path / "set.json").write_text(json.dumps({**EMPTY, "values": values}))
    with pytest.raises(ValueError, match=r"set\.json: " + sentence):
        read_set(tmp_path / "set.json")


HEAD = '{"format": "arterial-fmu parameter set 1", '


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", r"not valid JSON: Expecting value in line 1; correct that line\.$"),
        (HEAD + '\n"name": "x",,', r"not valid JSON: .* in line 2; correct that line\.$"),
        ("[]", r'not a parameter set: it must be a JSON object with "format": "arterial-fmu parameter set 1"\.$'),
        ('{"name": "x"}', r"not a parameter set: "),
        (HEAD + '"name": "x", "valves": {}}', r"top level: unknown key 'valves'; .* \(did you mean values\?\)\.$"),
        (HEAD + '"name": "x"}', r"the key values is missing; add it\.$"),
        (HEAD + '"values": {}}', r"the key name is missing; add it\.$"),
        (HEAD + '"name": "x", "values": []}', r"values: must be a JSON object, such as \{\}\.$"),
        (HEAD + '"name": "", "values": {}}', r"parameter set name '': must be one printable line; rename it\.$"),
        (HEAD + '"name": "x", "values": {"AA.E": {"value": NaN, "unit": "Pa"}}}', r"NaN is not a finite number; "),
        (HEAD + '"name": "x", "values": {"AA.E": {"value": 1e999, "unit": "Pa"}}}', r"AA\.E = inf: must be a finite "),
        (HEAD + '"name": "x", "values": {"AA.E": 1, "AA.E": 2}}', r"the key 'AA\.E' occurs twice; keep one\.$"),
        (HEAD + '"name": "x", "values": {}, "texts": {"law": "beta"}}', r"law: not a text of a parameter set; "),
        (
            HEAD + '"name": "x", "values": {}, "texts": {"network.elastic_law": "hooke"}}',
            r"network\.elastic_law = 'hooke': must be one of beta, regression\.$",
        ),
        ("[" * 100000, r"its lists are nested too deeply; correct it\.$"),
    ],
)
def test_refused_json(tmp_path: Path, text: str, sentence: str) -> None:
    """One sentence that starts with the file."""
    (tmp_path / "set.json").write_text(text)
    with pytest.raises(ValueError, match=r"set\.json: " + sentence):
        read_set(tmp_path / "set.json")


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("</ssv:ParameterSet>", "", r"not valid XML: no element found: line \d+, column \d+; correct that line\.$"),
        ('version="1.0" ', 'version="2.0" ', r"not a parameter set of SSV 1: "),
        ("SystemStructureParameterValues", "Other", r"not a parameter set of SSV 1: "),
        ('value="25451.0"', 'value="many"', r'AA\.phi0 = "many Pa\.s": must be a number in Pa\*s; '),
        ('value="25451.0"', 'value="NaN"', r'AA\.phi0 = "NaN Pa\.s": must be a number in Pa\*s'),
        ('unit="Pa.s"', 'unit="mm"', r"AA\.phi0 = .*: the unit mm does not convert to the expected Pa\*s; "),
        ('name="AA.phi0"', 'name="AA.E"', r"the parameter 'AA\.E' occurs twice; keep one\.$"),
        ('name="AA.phi0"', 'name="AA.tao"', r"AA\.tao: no segment has a parameter 'tao'; "),
        ("ssv:Real", "ssv:Integer", r"AA\.E = '1539000\.0': must be a Real\.$"),
        ("ssv:Real", "ssv:Boolean", r"AA\.E: must be a Real, or an Integer or a name for a law; there are no other"),
        ('ssv:Integer value="2"', 'ssv:Integer value="3"', r"network\.elastic_law = '3': must be 1 \(beta\) or 2 "),
        ('{"value_and_ci95": ', '{"value_and_ci95": 3, "x": ', r"its annotation .* is damaged; "),
        ('"AA.E": [', '"AA.E": [2, ', r"its annotation .* is damaged; "),
    ],
)
def test_refused_ssv(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    """One sentence that starts with the file."""
    write_set(FULL, tmp_path / "set.ssv")
    text = (tmp_path / "set.ssv").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "set.ssv").write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ValueError, match=r"set\.ssv: " + sentence):
        read_set(tmp_path / "set.ssv")


def test_refused_files(tmp_path: Path) -> None:
    """A name that nothing has, another suffix, a directory, bytes that are no text, a place that does not exist."""
    with pytest.raises(
        ValueError, match=r"sheep: neither a file nor a bundled .* sheep_table1, sheep_table1_nonlinear"
    ):
        read_set("sheep")
    (tmp_path / "set.toml").write_text("")
    with pytest.raises(
        ValueError, match=r"set\.toml: a parameter set is a \.json or an \.ssv file; give one whose name ends so\."
    ):
        read_set(tmp_path / "set.toml")
    with pytest.raises(
        ValueError, match=r"set\.txt: a parameter set is a \.json or an \.ssv file; give one whose name ends so\."
    ):
        write_set(FULL, tmp_path / "set.txt")
    (tmp_path / "folder.json").mkdir()
    with pytest.raises(ValueError, match=r"folder\.json: cannot be read \(Is a directory\); check the path\."):
        read_set(tmp_path / "folder.json")
    (tmp_path / "set.json").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"set\.json: not UTF-8 text \(byte 0\); save it as UTF-8\."):
        read_set(tmp_path / "set.json")
    with pytest.raises(ValueError, match=r"cannot be written \(No such file or directory\)"):
        write_set(FULL, tmp_path / "nowhere" / "set.json")


def test_refused_in_python() -> None:
    """The same checks where no file is involved."""
    with pytest.raises(ValueError, match=r"AA\.E: the unit MPa must be Pa, that of the FMU variable; convert"):
        ParameterSet("x", {"AA.E": Value(1.5, "MPa")})
    with pytest.raises(ValueError, match=r"AA\.E = nan: must be a finite number; "):
        ParameterSet("x", {"AA.E": Value(math.nan, "Pa")})
    with pytest.raises(ValueError, match=r"provenance: cannot be written as JSON \(.*\); keep to texts and numbers\."):
        ParameterSet("x", {}, {}, {"record": np.zeros(3)})
    with pytest.raises(ValueError, match=r"parameter set name 'a\\nb': must be one printable line"):
        ParameterSet("a\nb", {})
