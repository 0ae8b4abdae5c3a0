"""Every benchmark runs, with the least work that runs all of it, and prints what it is for. Nothing is timed here."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BENCHMARKS = ROOT / "benchmarks"
EXAMPLES = ROOT / "examples"
PARTS = {"__init__", "table"}  # no programs of their own
ELSEWHERE = {  # run by tests of their own
    "hidden_effects": "test_hidden_bank.py",
    "real_pressure": "test_real_pressure.py",
}
RUNS = {
    "speed": (["--small"], "viscoelastic beat, the same within 1e-4"),
    "balance": (["--small"], "elastic, batch of 1, in time"),
    "native": (["--small"], "measure"),  # or why it does not
    "native_fmu": (["--small"], "measure"),  # or why it does not
    "fmu": (["--small"], "doStep of 1 ms where ports are read"),
    "fit_speed": (["--small"], "large record: fit one site"),
    "wall_fits": (["--seeds", "2"], "CA"),
    "schemes": (["--small", "--rows", "rows.json", "--figure", "schemes.png"], "neumann"),
    "calibrations": (["--tubes", "2", "--json", "rows.json"], "intervals that hold the truth"),
    "late_flow": (["--animals", "1", "--delays", "0", "--json", "rows.json"], "calibrate says so"),
    "first_model_nulls": (["--first", "5", "--animals", "1"], "something is named in 0 of 1"),
    "periods": (["--recordings", "40", "--json", "rows.json"], "peaks 3"),
    "convergence": (["--small", "--rows", "rows.json", "cca"], "CPU time and error"),
    "openbf": (["--figure", "openbf.png"], "the same, time: 0.6 ms later"),
    "mock_loop": ([str(EXAMPLES / "data" / "mock-loop"), "--network", str(EXAMPLES / "mock_loop.toml"),
                   "--free", "chamber.E:1", "--free", "end.E:1", "--set", "rise.L=10.9cm",
                   "--fit", "2", "--judge", "10"],
                  "error of the mean"),
    "mutations": (["1"], "test_wall"),
}  # fmt: skip


def test_none_is_forgotten() -> None:
    assert {path.stem for path in BENCHMARKS.glob("*.py")} - PARTS - set(ELSEWHERE) == set(RUNS)
    for name, file in ELSEWHERE.items():
        assert (ROOT / "tests" / file).is_file(), name


def test_make_bench_runs_them() -> None:
    """Every line of make bench is a benchmark that is run here."""
    lines = [line.split()[-1] for line in (ROOT / "Makefile").read_text().splitlines() if "/python benchmarks/" in line]
    assert lines and {Path(line).stem for line in lines} <= set(RUNS)


# less than five seconds; the others are run before a release
SHORT = ("speed", "balance", "native", "native_fmu", "mutations", "periods")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n in SHORT else pytest.mark.endurance) for n in RUNS]
)
def test_it_runs(name: str, tmp_path: Path) -> None:
    """As by hand, in a folder of its own: exit code 0, and the last of its rows."""
    options, expected = RUNS[name]
    line = [sys.executable, str(BENCHMARKS / f"{name}.py"), *options]
    done = subprocess.run(
        line, cwd=tmp_path, capture_output=True, text=True, timeout=500, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert done.returncode == 0, done.stderr
    assert expected in done.stdout
    for file in (option for option in options if option.endswith((".png", ".json"))):
        assert (tmp_path / file).stat().st_size > 0


@pytest.mark.slow
def test_each_starts() -> None:
    """Every program of the folder can be imported: its options are valid, and what it uses exists."""
    names = sorted(p.stem for p in BENCHMARKS.glob("*.py") if p.stem not in {*PARTS, "mutations"})
    code = "\n".join(["import sys", "sys.path.append('benchmarks')", *(f"import benchmarks.{name}" for name in names)])
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
