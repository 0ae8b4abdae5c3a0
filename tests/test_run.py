"""Running an FMU with inputs known in advance, from Python and from the command line in a fresh process.

The oracles are the driver itself on the same inputs, and an integrator of SciPy for one wall.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import in_process, without_progress
from compare import relative_error
from fmus import COARSE, Store
from native_fmus import needs_compiler
from scipy.integrate import solve_ivp

from arterial_fmu.cli.run import main, ranges_table
from arterial_fmu.study.models import FMUModel, read_model
from build_fmu import build, build_native
from fmu_src.importer.run import run_fmu
from solver import Inlet, Network, Pressure, Settings, Site, load

Array = np.ndarray
MMHG = 133.322387415
ROOT = Path(__file__).resolve().parents[1]


def one_wall() -> Network:
    """A millimetre of artery AA under a prescribed pressure: R follows P by the wall law alone."""
    wall = replace(load("sheep").segment("AA"), L=1e-3, ENL=2e5)
    return Network(
        "one_wall",
        (wall,),
        Inlet("AA", Q_max=0.0),
        outlets=(Pressure("AA"),),
        sites=(Site("AA", "AA"),),
        elastic_law="regression",
    )


def pressure(t: Array) -> Array:
    """A smooth pulse of 2 Hz on the bench: 9.7 to 13.9 kPa."""
    x = 4 * np.pi * np.asarray(t)
    return 11e3 + 2e3 * np.sin(x) + 0.6e3 * np.sin(2 * x + 1.0)


def radius(t: Array) -> Array:
    """R(t) [m] of `sheep_pressure_radius` with E_NL, from rest under P(0), by DOP853 to 1e-12."""
    wall = one_wall().segment("AA")
    K_h = wall.h / (0.75 * wall.R0)

    def strain_rate(at: float, s: Array) -> Array:
        elastic = wall.E * (s - 1.0) + wall.ENL * (s - 1.0) ** 2
        return (pressure(at) * s / K_h - elastic) / wall.phi0

    p, e = pressure(0.0) / K_h / wall.E, wall.ENL / wall.E  # s p = x + e x² with s = 1 + x
    start = 1.0 + (-(1.0 - p) + np.sqrt((1.0 - p) ** 2 + 4.0 * e * p)) / (2.0 * e)
    solution = solve_ivp(strain_rate, (0.0, t[-1]), [start], "DOP853", t, rtol=1e-12, atol=1e-14)
    return wall.R0 * solution.y[0]


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(one_wall(), tmp_path_factory.mktemp("wall"))


@pytest.fixture(scope="module")
def coarse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sheep network with a tube of prescribed pressure at CA."""
    sheep = load("sheep")
    outlets = tuple(Pressure("CA", P_venous=300.0) if o.segment == "CA" else o for o in sheep.outlets)
    network = replace(sheep, outlets=outlets)
    return build(network, tmp_path_factory.mktemp("fmu"), Settings(dt=2e-3, element_length=0.1))


def command(*arguments: str | os.PathLike[str]) -> subprocess.CompletedProcess[str]:
    """In a process of its own."""
    line = [sys.executable, "-m", "arterial_fmu.cli.run", *map(os.fspath, arguments)]
    return subprocess.run(line, capture_output=True, text=True, cwd=ROOT)


def table(path: Path) -> dict[str, Array]:
    """The columns of a result by title."""
    titles = path.read_text(encoding="utf-8").split("\n", 1)[0].split(",")
    return dict(zip(titles, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


# --- further inputs -----------------------------------------------------------------------------------------------


def radius_error(fmu: Path, h: float) -> float:
    """Largest error of R in one second, relative to its pulse."""
    starts = {"solver.dt": h, "network.P_0": float(pressure(0.0))}
    result = run_fmu(fmu, np.zeros_like, 1.0, step=h, start_values=starts, inputs={"AA.outlet.P_venous": pressure})
    expected = radius(result["time"])
    return float(np.abs(result["AA.R"] - expected).max() / np.ptp(expected))


def test_driven_pressure(wall: Path) -> None:
    """A pressure driven at the middle of each step: R to 4e-5 of its pulse at 1 ms, second order in the step."""
    errors = [radius_error(wall, h) for h in (4e-3, 2e-3, 1e-3)]
    print(*(f"{error:.2e}" for error in errors))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert errors[-1] <= 5e-5
    assert (np.abs(orders - 2.0) <= 0.1).all()


def test_driven_pressure_is_reported(wall: Path) -> None:
    """The input itself is among the results, at the communication points; the outlet stands at the step's middle."""
    inputs = {"AA.outlet.P_venous": pressure}
    result = run_fmu(wall, np.zeros_like, 0.1, start_values={"network.P_0": float(pressure(0.0))}, inputs=inputs)
    assert list(result)[:3] == ["time", "inlet.Q", "AA.outlet.P_venous"]
    assert (result["AA.outlet.P_venous"] == pressure(result["time"])).all()
    middle = pressure(result["time"][1:] - 0.5e-3)
    assert np.abs(result["AA.outlet.P"][1:] - middle).max() <= 1e-9 * 11e3


def test_constant_input_is_its_start_value(coarse: Path) -> None:
    """An input that is constant gives the run that has it as start value, bit for bit."""
    inflow = Inlet("AA").Q
    by_start = run_fmu(coarse, inflow, 0.05, start_values={"CA.outlet.P_venous": 500.0})
    by_input = run_fmu(coarse, inflow, 0.05, inputs={"CA.outlet.P_venous": lambda t: np.full(t.shape, 500.0)})
    assert all((by_start[name] == by_input[name]).all() for name in by_start)
    assert relative_error("CA.Q", by_start["CA.Q"], run_fmu(coarse, inflow, 0.05)["CA.Q"]) > 1e-2


def test_inputs_refused(coarse: Path) -> None:
    """Names that are no inputs, the inflow twice, the wrong number of values."""
    with pytest.raises(
        ValueError, match=r"CA\.P: not an input of .*\.fmu; use one of inlet\.Q, CA\.outlet\.P_venous, "
    ):
        run_fmu(coarse, np.zeros_like, 0.01, inputs={"CA.P": np.zeros_like})
    with pytest.raises(ValueError, match=r"inlet\.Q: it is an input of its own; give it as inflow\."):
        run_fmu(coarse, np.zeros_like, 0.01, inputs={"inlet.Q": np.zeros_like})
    with pytest.raises(ValueError, match=r"CA\.outlet\.P_venous: for 11 times it gave shape \(2,\); it must give one "):
        run_fmu(coarse, np.zeros_like, 0.01, inputs={"CA.outlet.P_venous": lambda t: np.zeros(2)})


# --- command line -------------------------------------------------------------------------------------------------


def test_command(coarse: Path, tmp_path: Path) -> None:
    """Inputs in mL/s and mmHg and start values from files: the driver's own result, to the last bit."""
    time = np.linspace(0.0, 0.06, 7)
    Q, P = 50.0 * np.sin(2 * np.pi * time), 2.0 + 10.0 * time
    rows = [f"{t!r},{q!r},{p!r}" for t, q, p in zip(time.tolist(), Q.tolist(), P.tolist(), strict=True)]
    (tmp_path / "in.csv").write_text("\n".join(["time [s],inlet.Q [mL/s],CA.outlet.P_venous [mmHg]", *rows, ""]))
    starts: dict[str, float | str] = {"CA.phi0": 0, "network.elastic_law": "regression"}
    (tmp_path / "starts.json").write_text(json.dumps(starts))
    done = command(
        *(coarse, "--inputs", tmp_path / "in.csv", "--start-values", tmp_path / "starts.json"),
        *("--stop-time", "60 ms", "--step", "2 ms", "--out", tmp_path / "out.csv"),
    )
    assert (done.returncode, without_progress(done.stderr)) == (0, "")
    result = table(tmp_path / "out.csv")
    assert list(result)[:4] == ["time [s]", "inlet.Q [m^3/s]", "CA.outlet.P_venous [Pa]", "inlet.P [Pa]"]
    expected = run_fmu(
        coarse,
        lambda t: np.interp(t, time, Q * 1e-6),
        0.06,
        step=2e-3,
        start_values=starts,
        inputs={"CA.outlet.P_venous": lambda t: np.interp(t, time, P * MMHG)},
    )
    assert [title.split(" ")[0] for title in result] == list(expected)
    for title, values in result.items():
        name = title.split(" ")[0]
        # the unit's factor is rounded once in either
        assert np.abs(values - expected[name]).max() <= 1e-13 * np.abs(expected[name]).max()


def test_command_without_inputs(coarse: Path, tmp_path: Path) -> None:
    """No inputs: the network's own inflow; start values may ask for rest under P_0. --quiet says nothing."""
    (tmp_path / "starts.json").write_text('{"inlet.drive": "input"}')
    for more, pulse in (((), True), (("--start-values", tmp_path / "starts.json"), False)):
        done = in_process(main, [coarse, "--stop-time", "0.05 s", "--out", tmp_path / "out.csv", "--quiet", *more])
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
        result = table(tmp_path / "out.csv")
        assert result["time [s]"][-1] == 0.05
        assert "inlet.Q [m^3/s]" not in result
        assert bool(np.ptp(result["AA.P [Pa]"]) > 100.0) is pulse


IN = "time [s],inlet.Q [m^3/s]\n0,0\n1,1e-5\n"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", 'in.csv: must begin with the line "time [s],inlet.Q [m^3/s]", each name once, then numbers.'),
        ("t,inlet.Q\n0,0\n", 'in.csv: must begin with the line "time [s],inlet.Q [m^3/s]", each name once'),
        ("time,inlet.Q,inlet.Q\n0,0,0\n", "in.csv: must begin with the line"),
        (IN + "2,x\n", "in.csv: line 4: must hold 2 finite numbers; correct it."),
        (IN + "2,nan\n", "in.csv: line 4: must hold 2 finite numbers; correct it."),
        (IN + "2\n", "in.csv: line 4: must hold 2 finite numbers; correct it."),
        (IN + "1,0\n", "in.csv: line 4: the time must increase; sort it."),
        ("time [s],inlet.Q [Pa]\n0,0\n1,1\n", "the unit Pa does not convert to the expected m^3/s"),
        ("time [s],CA.Q\n0,0\n1,1\n", "CA.Q: not an input of"),
        (
            "time [ms],inlet.Q\n0,0\n1,1\n",
            "in.csv: covers 0 s to 0.001 s, but the run is from 0 to 0.01 s; give inputs",
        ),
        ("time [s],inlet.Q\n0,0\n1,2\n", "the flow is supercritical (|Q/A| >= c); lower"),
    ],
)
def test_command_refuses_inputs(coarse: Path, tmp_path: Path, text: str, sentence: str) -> None:
    """Exit code 2, one sentence, no result."""
    (tmp_path / "in.csv").write_text(text)
    stop = "1 s" if "1,2" in text else "0.01 s"
    arguments = ("--inputs", tmp_path / "in.csv", "--stop-time", stop, "--out", tmp_path / "out.csv", "-q")
    done = in_process(main, [coarse, *arguments])
    assert (done.returncode, done.stdout) == (2, "")
    assert sentence in done.stderr
    said = without_progress(done.stderr)
    assert (said.startswith("Error: "), said.count("\n")) == (True, 1)
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--stop-time", "3 mm"], "the unit mm does not convert to the expected s"),
        (["--step", "0 s"], "step = 0.0 s: must be a positive, finite number."),
        (["--inputs", "nowhere.csv"], "nowhere.csv: cannot be read (No such file or directory); check the path."),
        (["--start-values", "BAD"], "bad.json: not valid JSON"),
        (["--start-values", "LIST"], "list.json: must be a JSON object of numbers and texts"),
        (["--start-values", "UNKNOWN"], "XX.E: "),
        (["--out", "nowhere/out.csv"], "nowhere/out.csv: cannot be written"),
    ],
)
def test_command_refuses(coarse: Path, tmp_path: Path, options: list[str], sentence: str) -> None:
    """Exit code 2 and one sentence."""
    for name, text in (("bad", "{"), ("list", "[1]"), ("unknown", '{"XX.E": 1}')):
        (tmp_path / f"{name}.json").write_text(text)
    options = [os.fspath(tmp_path / f"{o.lower()}.json") if o.isupper() else o for o in options]
    out = [] if "--out" in options else ["--out", os.fspath(tmp_path / "out.csv")]
    done = in_process(main, [coarse, "--stop-time", "0.01 s", *out, *options, "-q"])
    assert (done.returncode, done.stdout) == (2, "")
    assert sentence in done.stderr
    said = without_progress(done.stderr)
    assert (said.startswith("Error: "), said.count("\n")) == (True, 1)


def test_command_describes_itself(tmp_path: Path) -> None:
    """--help names every option; a file that is no FMU is refused."""
    done = in_process(main, ["--help"])
    assert done.returncode == 0
    assert all(option in done.stdout for option in ("--inputs", "--start-values", "--stop-time", "--step", "--out"))
    assert "not an FMU; build one with arterial-fmu build." in in_process(main, [__file__]).stderr
    with zipfile.ZipFile(tmp_path / "human.ssp", "w") as file:
        file.writestr("SystemStructure.ssd", "<System/>")
    assert (
        "a system of FMUs (SSP); run it in a simulator that reads SSP"
        in in_process(main, [tmp_path / "human.ssp"]).stderr
    )


def test_a_table_of_ranges() -> None:
    """In the units that people read; of many variables the first ones, and how many there are."""
    found = {f"S{i}.P": {"unit": "Pa", "min": 80.0 * MMHG, "max": 120.0 * MMHG, "mean": 1e4} for i in range(30)}
    table = ranges_table("some.fmu", found, 2.5, {})
    assert table.row_count == 24 and table.title == "some.fmu: 2.5 s, first 24 of 30 variables"
    assert [next(iter(column.cells)) for column in table.columns] == ["S0.P", "mmHg", "80.00", "120.0", "75.01"]
    volume = {"network.V": {"unit": "m^3", "min": 0.0, "max": 2e-6, "mean": 1e-6}}  # which has no usual one
    shown = ranges_table("some.fmu", volume, 2.5, {"network.V": "mL"})
    assert [next(iter(column.cells)) for column in shown.columns] == ["network.V", "mL", "0", "2.000", "1.000"]


@needs_compiler
def test_units_of_start_values_for_fmi_3(stored: Store, tmp_path: Path) -> None:
    """Numbers are of the type Float64 there: --set takes units, and a study finds the parameters."""
    file = stored(build_native, load("sheep"), settings=COARSE, fmi=3)
    found = []
    for given in ("2 kPa*s", "2000 Pa*s", "80 kPa*s"):
        options = ["--set", f"CA.phi0={given}", "--stop-time", "0.05 s", "--out", tmp_path / "out.csv", "-q"]
        assert in_process(main, [file, *options]).returncode == 0
        found.append(table(tmp_path / "out.csv")["CA.P [Pa]"])
    assert np.array_equal(found[0], found[1]) and np.abs(found[2] - found[0]).max() > 1.0  # Pa
    model = read_model(os.fspath(file), "sheep", "2.5 ms", None, 1e-4)
    assert isinstance(model, FMUModel) and model.known["CA.phi0"].unit == "Pa.s"
