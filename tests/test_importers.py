"""Networks in other formats: openBF's YAML, tables of vessels, and the command line for both."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from network_text import FORK
from refused import refused
from typer.testing import CliRunner

from arterial_fmu.__main__ import app
from build_fmu import build
from solver import Reflection, Windkessel, bundled, load, read_network
from solver.network.description import Network
from solver.network.files import bundled_names, from_sections, loads
from solver.network.importers.openbf import read_openbf
from solver.network.importers.sections import names
from solver.network.importers.sheet import read_sheet, to_sheet

YAML = """
project_name: fork
write_results: ["P"]
blood:
  rho: 1060.0
  mu: 4.0e-3
solver:
  Ccfl: 0.9
network:
  - label: 1-aorta
    sn: 1
    tn: 2
    L: 0.1
    E: 4e5
    Rp: 0.012
    Rd: 0.010
    gamma_profile: 9
  - label: left leg
    sn: 2
    tn: 3
    L: 0.2
    E: 5e5
    R0: 0.006
    h0: 1e-3
    gamma_profile: 9
    R1: 1e8
    Cc: 1e-9
  - label: right leg
    sn: 2
    tn: 4
    L: 0.2
    E: 5e5
    R0: 0.006
    h0: 1e-3
    gamma_profile: 9
    Rt: 0.5
"""
INFLOW = "0.0 1e-6\n0.3 5e-6\n0.2 9e-6\n1.0 1e-6\n"


def openbf(folder: Path, text: str = YAML, inflow: str = INFLOW, as_run: bool = False) -> Network:
    (folder / "fork_inlet.dat").write_text(inflow, encoding="utf-8")
    path = folder / "fork.yaml"
    path.write_text(text, encoding="utf-8")
    return from_sections(read_openbf(path, as_run=as_run), folder)


def test_numbers_of_openbf(tmp_path: Path) -> None:
    """Geometry, fluid, outlets and the inflow, which is put in order; R1 alone is split at Z = ρ c0/A0."""
    network = openbf(tmp_path)
    aorta, left, _ = network.segments
    assert [s.name for s in network.segments] == ["aorta", "left_leg", "right_leg"]
    assert (aorta.L, left.R0, left.h, left.E) == (0.1, 0.006, 1e-3, 5e5)
    assert aorta.R0 == pytest.approx(0.011, rel=1e-15)
    thickness = [R * (0.2802 * math.exp(-505.3 * R) + 0.1324 * math.exp(-11.14 * R)) for R in (0.012, 0.010)]
    assert aorta.h == pytest.approx(np.mean(thickness), rel=1e-7)
    assert (network.fluid.friction, network.fluid.alpha) == (22.0, 1.0)
    assert network.fluid.nu == pytest.approx(4e-3 / 1060.0, rel=1e-15)
    one, other = network.outlets
    Z = math.sqrt(1060.0 * 5e5 * 1e-3 / 0.75 / 0.006 / 2.0) / (math.pi * 0.006**2)
    assert isinstance(one, Windkessel)
    assert (one.R1, one.R1 + one.R2, one.C) == pytest.approx((Z, 1e8, 1e-9), rel=1e-7)
    assert other == Reflection("right_leg", R_t=0.5)
    assert [(j.inflow, j.outflow) for j in network.junctions] == [(("aorta",), ("left_leg", "right_leg"))]
    np.testing.assert_allclose(network.inlet.Q(np.array([0.1, 0.25])), [5e-6, 7e-6], rtol=1e-12)


def test_as_openbf_runs_it(tmp_path: Path) -> None:
    """--as-run: proximal radii, R1 kept beside R2 = R1 - Z, "gamma profile" not read."""
    network = openbf(tmp_path, YAML.replace("gamma_profile", "gamma profile"), as_run=True)
    assert network.segment("aorta").R0 == 0.012
    assert not network.segment("aorta").terms
    assert network.fluid.friction == 8.0
    one = network.outlets[0]
    assert isinstance(one, Windkessel)
    assert one.R1 == 1e8
    assert one.R2 < 1e8


def test_openbf_keeps_the_total_pressure_where_a_vessel_goes_on(tmp_path: Path) -> None:
    """--as-run: k = 1 where one vessel goes on as one other, 0 where it parts; as the file says, 0 everywhere."""
    knee = "  - label: shin\n    sn: 3\n    tn: 5\n    L: 0.1\n    E: 5.0e5\n    R0: 0.005\n    gamma_profile: 9\n"
    last = YAML.index("  - label: right leg")
    outlet = "    R1: 1e8\n    Cc: 1e-9\n"
    text = YAML[:last].replace(outlet, "") + knee + outlet + YAML[last:]
    for as_run, k in ((True, 1.0), (False, 0.0)):
        network = openbf(tmp_path, text, as_run=as_run)
        assert {j.name: j.k for j in network.junctions} == {"aorta": 0.0, "left_leg": k}


BAD_YAML = {
    "not YAML": ("blood:", "blood: [", ["not valid YAML, line", "correct it"]),
    "top key": ("solver:", "solvers:", ["unknown key 'solvers'", "did you mean solver?"]),
    "vessel key": ("    Rt: 0.5", "    Rx: 0.5", ["vessel right leg: unknown key 'Rx'"]),
    "no radius": ("    Rp: 0.012\n    Rd: 0.010\n", "", ["vessel 1-aorta", "no radius", "give R0"]),
    "negative radius": ("Rp: 0.012", "Rp: -0.012", ["vessel 1-aorta: Rp = -0.012 m is not allowed"]),
    "no length": ("    L: 0.1\n", "", ["vessel 1-aorta: the key L is missing"]),
    "text": ("L: 0.1", "L: long", ["vessel 1-aorta: L = 'long' must be a number"]),
    "no blood": ("  mu: 4.0e-3\n", "", ["blood: the key mu is missing"]),
    "two roots": ("sn: 2\n    tn: 4", "sn: 5\n    tn: 4", ["2 vessels begin", "vessel 1-aorta", "vessel right leg"]),
    "loop end": ("tn: 4", "tn: 3", ["vessel left leg", "node 3", "part their ends"]),
    "visco-elastic": ("Rt: 0.5", "visco-elastic: true", ["vessel right leg: visco-elastic", "C_v"]),
    "profiles": ("gamma_profile: 9\n    Rt", "gamma_profile: 2\n    Rt", ["gamma_profile: 9 in", "2 in right leg"]),
    "outlet": ("Rt: 0.5", "outlet: wk5", ["vessel right leg: outlet = 'wk5'", "wk2, wk3"]),
    "outlet inside": ("Rd: 0.010", "Rt: 0.5", ["vessel 1-aorta: Rt belongs to a vessel that ends"]),
    "small R1": ("R1: 1e8", "R1: 1e6", ["vessel left leg: R1 does not exceed", "check R1"]),
    "no compliance": ("    Cc: 1e-9\n", "", ["vessel left leg: the key Cc is missing"]),
    "list": (YAML, "- 1\n- 2\n", ["top level: must be keys"]),
    "nul": (YAML, "a: \0", ["not valid YAML", "#x0000"]),
    "date": (YAML, "a: 2020-13-41", ["not valid YAML", "month"]),
    "key twice": ("  rho: 1060.0", "  rho: 1060.0\n  rho: 900.0", ["not valid YAML, line 6", "rho occurs twice"]),
    "no density": ("rho: 1060.0", "rho: 0", ["blood: rho = 0 kg/m^3 is not allowed", "[1, 100000]"]),
    "negative modulus": ("E: 5e5", "E: -5e5", ["vessel left leg: E = -500000 Pa is not allowed"]),
    "wide vessel": ("R0: 0.006", "R0: 1e300", ["vessel left leg: R0 = 1e+300 m is not allowed", "[1e-05, 0.2] m"]),
    "no thickness": ("h0: 1e-3", "h0: 0", ["vessel left leg: h0 = 0 m is not allowed"]),
    "list of nodes": ("sn: 1\n", "sn: [1]\n", ["vessel 1: sn = [1] must be a number or text"]),
    "no label": ("label: 1-aorta", "label:", ["vessel 1: label = None"]),
    "label of signs": ("label: 1-aorta", "label: '***'", ["'***'", "letter from A to Z or a digit"]),
    "label twice": ("label: right leg", "label: left leg", ["vessel left leg: the name left_leg occurs 2 times"]),
    "ring": ("sn: 2\n    tn: 3", "sn: 2\n    tn: 2", ["vessel left leg", "same node, 2"]),
    "no root": ("sn: 1\n", "sn: 3\n", ["0 vessels begin where no other ends"]),
    "windkessel of nothing": ("Rt: 0.5", "outlet: wk3", ["right leg: outlet = 'wk3' with neither R1 nor Cc"]),
    "two outlets": ("R1: 1e8", "outlet: reflection\n    R1: 1e8", ["left leg: outlet = 'reflection' with R1, Cc"]),
    "project": ("project_name: fork", "project_name: [fork]", ["project_name = ['fork'] must be text"]),
    "inlet file": ("blood:", "inlet_file:\nblood:", ["inlet_file = None must be text"]),
    "no vessels": (YAML, "blood: {rho: 1060, mu: 4e-3}", ["network: must be a list of vessels"]),
}


@pytest.mark.parametrize("case", BAD_YAML)
def test_bad_yaml(case: str, tmp_path: Path) -> None:
    """One sentence with the file, and the line, the vessel or the key."""
    old, new, words = BAD_YAML[case]
    assert old in YAML
    refused(lambda: openbf(tmp_path, YAML.replace(old, new, 1)), f"{tmp_path / 'fork.yaml'}: ", words)


def test_bad_inflow(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"fork_inlet.dat, line 2: must hold a time and a flow, but is '0.3'"):
        openbf(tmp_path, inflow="0.0 1e-6\n0.3\n")
    with pytest.raises(ValueError, match=r"fork_inlet.dat, line 2: must hold a time and a flow, but is '0.3 nan';"):
        openbf(tmp_path, inflow="0.0 1e-6\n0.3 nan\n")
    with pytest.raises(ValueError, match="other_inlet.dat: cannot be read"):
        openbf(tmp_path, YAML.replace("project_name: fork", "project_name: other"))


def test_names() -> None:
    """Labels become names; those that would be equal without their number keep it."""
    labels = ["1-Ascending aorta", "2-ACA", "3-ACA", "7", "L. carotid", "v1"]
    assert names(labels) == ["Ascending_aorta", "v2_ACA", "v3_ACA", "v7", "L_carotid", "v1"]
    with pytest.raises(ValueError, match="'A-B' and 'A_B': both would be called A_B; rename one"):
        names(["A-B", "C", "A_B"])


# --- tables of vessels --------------------------------------------------------------------------------------------

SHEET = """\
# A table as papers print it
# name = "three"
# fluid.rho = "1050 kg/m^3"
# inlet.Q_max = "500 cm^3/s"
# junctions.v1.k = 1
id,parent,L,A0,h,beta,C_v,R_t
,,cm,cm^2,mm,Pa/cm,cm^2/s,-
1,,4.0,6.789,1.6,23000,3520,
2,1,2.0,5.011,1.2,24000,3170,0.5
3,1,3.4,1.535,0.8,49000,3630,0.6
"""


def sheet(folder: Path, text: str = SHEET) -> Network:
    path = folder / "vessels.csv"
    path.write_text(text, encoding="utf-8")
    return from_sections(read_sheet(path))


def test_table_of_a_paper(tmp_path: Path) -> None:
    """Units of the row below the names, a tree by parents, settings in the lines before; brackets say the same."""
    network = sheet(tmp_path)
    assert (network.name, network.fluid.rho, network.inlet.Q_max) == ("three", 1050.0, 500e-6)
    assert [s.name for s in network.segments] == ["v1", "v2", "v3"]
    first = network.segments[0]
    assert first.L == 0.04
    assert first.R0 == pytest.approx(math.sqrt(6.789e-4 / math.pi), rel=1e-15)
    assert first.E == pytest.approx(2.3e6 * 0.75 * 6.789e-4 / math.sqrt(math.pi) / 1.6e-3, rel=1e-14)
    assert (network.junctions[0].inflow, network.junctions[0].k) == (("v1",), 1.0)
    assert network.outlets == (Reflection("v2", R_t=0.5), Reflection("v3", R_t=0.6))
    head, units = SHEET.splitlines()[5:7]
    cells = zip(head.split(","), units.split(","), strict=True)
    brackets = ",".join(f"{n} [{u}]" if u and u != "-" else n for n, u in cells)
    assert sheet(tmp_path, SHEET.replace(f"{head}\n{units}", brackets)) == network


def in_order(network: Network) -> Network:
    """The network with its junctions and outlets in the order of their names."""
    junctions = tuple(replace(j, outflow=tuple(sorted(j.outflow))) for j in network.junctions)
    return replace(
        network,
        junctions=tuple(sorted(junctions, key=lambda j: j.name)),
        outlets=tuple(sorted(network.outlets, key=lambda o: o.segment)),
    )


@pytest.mark.parametrize("name", bundled_names())
def test_there_and_back(name: str, tmp_path: Path) -> None:
    """A network as a table of vessels is the network again, bit for bit, but for the order of its junctions."""
    network = load(name)
    assert in_order(sheet(tmp_path, to_sheet(network))) == in_order(network)


def test_terms_there_and_back(tmp_path: Path) -> None:
    """Terms, sites, channels, junctions with numbers of their own and sites that there are none of."""
    network = load("sheep").with_terms({"CA.tau": 0.02, "AA.junction.k": 1.0, "CA.P.lag": 1e-3})
    assert in_order(sheet(tmp_path, to_sheet(network))) == in_order(network)
    bare = loads(FORK + "\n[sites]\n", "fork.toml")
    assert sheet(tmp_path, to_sheet(bare)) == bare


BAD_SHEETS = {
    "column": ("R_t\n", "Rt\n", ["unknown key 'Rt'", "did you mean R_t?"]),
    "no names": ("id,", "tau,", ["no column name"]),
    "no parents": ("parent", "tau", ["columns from and to, or the column parent"]),
    "parent": ("2,1,2.0", "2,9,2.0", ["line 9: there is no vessel '9'", "column parent"]),
    "cell": ("5.011", "five", ["line 9", "A0", "five", "number"]),
    "cells": ("0.6\n", "0.6,7\n", ["line 10: 9 cells under 8 names"]),
    "unit": ("Pa/cm", "Pa", ["line 8", "beta", "Pa/m"]),
    "outlet inside": ("3520,", "3520,0.1", ["line 8: R_t belongs to a vessel that ends, v1 does not"]),
    "semicolons": (SHEET, SHEET.replace(",", ";"), ["separate them by commas"]),
    "no id": ("3,1,3.4", ",1,3.4", ["line 10: the vessel has no id"]),
    "id twice": ("3,1,3.4", "2,1,3.4", ["the name v2 occurs 2 times"]),
    "own parent": ("2,1,2.0", "2,2,2.0", ["same node, 2"]),
    "ring": ("1,,4.0", "1,3,4.0", ["0 vessels begin where no other ends"]),
    "junction": ("junctions.v1", "junctions.v9", ["# junctions.v9", "# junctions.NAME.k with one of v1"]),
    "junction's number": ("junctions.v1.k", "junctions.v1", ["# junctions.v1", "with one of v1"]),
    "no setting": ("fluid.rho", "fluids.rho", ['# fluids.rho = "1050 kg/m^3"', "no such setting"]),
    "setting": ('= "1050 kg/m^3"', "= 1050 kg/m^3", ["# key = value", "not valid TOML"]),
}


@pytest.mark.parametrize("case", BAD_SHEETS)
def test_bad_sheets(case: str, tmp_path: Path) -> None:
    """One sentence with the file, and the line or the column."""
    old, new, words = BAD_SHEETS[case]
    assert old in SHEET
    refused(lambda: sheet(tmp_path, SHEET.replace(old, new, 1)), tmp_path / "vessels.csv", words)


# --- the command line ---------------------------------------------------------------------------------------------


def test_commands(tmp_path: Path) -> None:
    """import writes a network file and its inflow, export a table, list shows all; a bad file is one sentence."""
    network, run = openbf(tmp_path), CliRunner().invoke
    out = tmp_path / "leg.toml"
    done = run(app, ["import", "openbf", str(tmp_path / "fork.yaml"), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "leg_inlet.csv").exists()
    assert read_network(out) == network
    table = tmp_path / "leg.csv"
    assert run(app, ["export", str(out), "--out", str(table)]).exit_code == 0
    again = tmp_path / "again.toml"
    assert run(app, ["import", "csv", str(table), "--out", str(again)]).exit_code == 0
    assert in_order(read_network(again)) == in_order(network)
    shown = run(app, ["list"]).output
    assert all(name in shown for name in ("adan56", "77", "wang55", "Boileau et al. (2015)", "Ghigo et al. (2017)"))
    for bad in ("openbf", "csv"):
        done = run(app, ["import", bad, "nowhere"])
        assert (done.exit_code, done.output) == (
            2,
            "Error: nowhere: cannot be read (No such file or directory); check the path.\n",
        )


def test_a_network_file_to_edit(tmp_path: Path) -> None:
    """export --out FILE.toml: an included network with its comments; one whose inflow is in a file, or that of an FMU,
    whole in one file."""
    run = CliRunner().invoke
    for name in ("sheep", "cca"):
        done = run(app, ["export", name, "--out", str(tmp_path / f"{name}.toml")])
        assert done.exit_code == 0, done.output
        assert read_network(tmp_path / f"{name}.toml") == load(name)
    assert (tmp_path / "sheep.toml").read_bytes() == bundled("sheep").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cca.toml", "sheep.toml"]
    fmu = build(load("cca"), tmp_path / "fmu")
    assert run(app, ["export", str(fmu), "--out", str(tmp_path / "again.toml")]).exit_code == 0
    assert read_network(tmp_path / "again.toml") == load("cca")


def test_a_table_of_another_folder(tmp_path: Path) -> None:
    """The network file lies elsewhere: its inflow is still found; of one without a word of the inlet a note says so."""
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "in" / "inflow.csv").write_text("t [s],Q [mL/s]\n0,5\n0.2,60\n0.4,20\n0.8,5\n", encoding="utf-8")
    text = SHEET.replace('# inlet.Q_max = "500 cm^3/s"', '# inlet.Q = "inflow.csv"')
    for name, lines in (("with", text), ("without", text.replace('# inlet.Q = "inflow.csv"\n', ""))):
        (tmp_path / "in" / f"{name}.csv").write_text(lines, encoding="utf-8")
        path = tmp_path / "out" / f"{name}.toml"
        done = CliRunner().invoke(app, ["import", "csv", str(tmp_path / "in" / f"{name}.csv"), "--out", str(path)])
        assert done.exit_code == 0, done.output
        assert ("the table does not define the inlet" in " ".join(done.output.split())) == (name == "without")
        assert read_network(path).inlet.T == pytest.approx(0.8 if name == "with" else 0.5)
