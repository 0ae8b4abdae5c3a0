"""What is typed: numbers with their units, FMUs where a network is asked for, and start values for ``run``."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from refused import refused
from test_command import run

from build_fmu import build_model
from fitting.results.parameter_set import ParameterSet, Value, write_set
from fmu_src.contents.models import heart_model
from solver import load
from solver.errors import InputError
from solver.io.exit_codes import ExitCode
from solver.network.files import read_network
from solver.quantities.text import assignments, typed_quantity


@pytest.fixture(scope="module")
def folder(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """sheep.fmu and human_heart.fmu."""
    folder = tmp_path_factory.mktemp("typed")
    shutil.copy(fmus["sheep"], folder)
    build_model(heart_model("human"), folder)
    return folder


# --- units ----------------------------------------------------------------------------------------------------------


def test_a_number_carries_its_unit() -> None:
    """0, times in seconds and numbers without unit need none; others are refused with the unit people read them in."""
    assert [typed_quantity(*each, "x") for each in (("0", "m"), ("2e-3", "s"), ("0.3", "1"), ("2 mm", "m"))] == [
        0.0, 2e-3, 0.3, 2e-3,
    ]  # fmt: skip
    refused(lambda: typed_quantity("0.38", "m", "--h"), "--h = 0.38", ['it has no unit; write one, such as "0.38 mm".'])
    refused(lambda: typed_quantity("4", "Pa", "E", "MPa"), "E = 4", ['such as "4 MPa"'])
    refused(lambda: typed_quantity("x", "m", "--h"), '--h = "x"', ["must be a number in m"])


def test_assignments() -> None:
    """Numbers in SI, other names as texts; a later one counts."""
    units: dict[str, tuple[str, str | None]] = {"CA.phi0": ("Pa.s", "kPa.s"), "CA.E": ("Pa", "MPa")}
    given = ["CA.phi0 = 2 kPa*s", "inlet.interpolation=linear", "CA.E=4 MPa", "CA.E=5 MPa"]
    assert assignments(given, units) == {"CA.phi0": 2e3, "inlet.interpolation": "linear", "CA.E": 5e6}
    refused(lambda: assignments(["CA.phi0"], units), "--set CA.phi0", ["must look like NAME=VALUE"])


@pytest.mark.parametrize(
    ("line", "proposed"),
    [
        ("solve sheep --set CA.E=4", "--set CA.E = 4: it has no unit; write one, such as \"4 MPa\"."),
        ("build sheep --set CA.phi0=3", '"3 kPa*s"'),
        ("build heart --set heart.rate=1", '"1 Hz"'),
        ("run sheep.fmu --set CA.phi0=3", '"3 kPa*s"'),
        ("solve sheep --element-length 0.05", '"0.05 mm"'),
        ("study sheep --vary CA.phi0=10..120 --out o", '"10..120kPa*s"'),
        ("study sheep.fmu --inflow sheep --vary CA.E=1..2 --out o", '"1..2MPa"'),
    ],
)  # fmt: skip
def test_one_rule_for_all(line: str, proposed: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every command that takes a number with a unit refuses it without one."""
    monkeypatch.chdir(folder)
    done = run(*line.split())
    assert done.exit_code == ExitCode.BAD_INPUT and "it has no unit" in done.stderr and proposed in done.stderr
    assert not (folder / "o").exists()


# --- an FMU where a network is asked for ----------------------------------------------------------------------------


def test_the_network_of_an_fmu(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is the network that the FMU was built of: solved, exported, and built into the same FMU byte for byte."""
    assert read_network(folder / "sheep.fmu") == load("sheep")
    assert run("solve", folder / "sheep.fmu", "--dt", "5 ms", "-q").exit_code == 0
    assert run("build", folder / "sheep.fmu", "--out", tmp_path, "-q").exit_code == 0
    assert (tmp_path / "sheep.fmu").read_bytes() == (folder / "sheep.fmu").read_bytes()
    monkeypatch.setattr(
        "fitting.calibrate.multistart.calibrate_from", lambda *_, **__: pytest.fail("there is no record")
    )
    done = run("calibrate", tmp_path / "no.csv", folder / "sheep.fmu", "--free", "all.E")
    assert done.exit_code == ExitCode.BAD_INPUT and "no.csv: cannot be read" in done.stderr


def test_an_fmu_without_a_network(folder: Path, tmp_path: Path) -> None:
    """A heart, a file that is no archive, and an archive where text is asked for: what was given is said."""
    heart = folder / "human_heart.fmu"
    refused(lambda: read_network(heart), heart, ["it contains no network of arteries"])
    (tmp_path / "text.fmu").write_text("no archive")
    refused(lambda: read_network(tmp_path / "text.fmu"), tmp_path, ["not an FMU, or damaged"])
    done = run("cohort", heart, "--out", tmp_path / "c")
    assert done.exit_code == ExitCode.BAD_INPUT and "an FMU or another archive, where text was expected" in done.stderr


# --- run ------------------------------------------------------------------------------------------------------------


def starts(monkeypatch: pytest.MonkeyPatch, *options: object) -> dict[str, Any]:
    """The start values that ``run sheep.fmu`` sets with these options; the FMU is not run."""
    found: dict[str, Any] = {}

    def run_fmu(*_: Any, start_values: dict[str, Any], **__: Any) -> None:
        found.update(start_values)
        raise InputError("not run.")

    monkeypatch.setattr("arterial_fmu.cli.run.run_fmu", run_fmu)
    assert "not run." in run("run", *options).stderr
    return found


def test_start_values_of_a_fit(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A parameter set, a plain object, and --set, which comes after both."""
    fitted = ParameterSet(
        "AA", {"AA.E": Value(1.5e6, "Pa", (1e6, 2e6)), "network.eta": Value(0.5, "1")}, {"network.elastic_law": "beta"}
    )
    path, fmu = tmp_path / "AA.json", folder / "sheep.fmu"
    write_set(fitted, path)
    assert starts(monkeypatch, fmu, "--start-values", path) == fitted.start_values()
    write_set(fitted, tmp_path / "AA.ssv")
    assert starts(monkeypatch, fmu, "--start-values", tmp_path / "AA.ssv") == fitted.start_values()
    changed = starts(monkeypatch, fmu, "--start-values", path, "--set", "AA.E=2 MPa", "--set", "CA.phi0=0")
    assert changed == fitted.start_values() | {"AA.E": 2e6, "CA.phi0": 0.0}
    edited = json.loads(path.read_text()) | {"values": {"AA.E": {"value": 1.5, "unit": "MPa"}}}
    path.write_text(json.dumps(edited))
    assert starts(monkeypatch, fmu, "--start-values", path)["AA.E"] == 1.5e6
    path.write_text('{"AA.E": 2e6}')
    assert starts(monkeypatch, fmu, "--start-values", path) == {"AA.E": 2e6}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("sheep.fmu", "--set", "CA.phi=0"), "CA.phi: sheep.fmu has no such variable"),
        (("sheep.fmu", "--set", "CA.phi=0"), "(did you mean CA.phi0?)"),
        (("human_heart.fmu",), "human_heart.fmu: it has no inlet, so it is no FMU of arteries and is not run alone"),
    ],
)
def test_run_refuses(options: tuple[str, ...], said: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    done = run("run", *options)
    assert done.exit_code == ExitCode.BAD_INPUT and said in done.stderr


# --- help -----------------------------------------------------------------------------------------------------------


def test_help_of_build() -> None:
    """The options of a network stand there, though its word may be left out."""
    shown = run("build", "--help").stdout
    assert all(option in shown for option in ("--set", "--inlet", "--out", "--no-execution-tool", "heart"))
