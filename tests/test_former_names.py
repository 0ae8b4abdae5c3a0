"""Former names of modules: each leads to the module of today, with a DeprecationWarning that says its name."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec

import pytest

from solver.former_names import MOVED

EXAMPLES = [
    # the first one with nothing imported before it
    ("fmu_src.run", "run_fmu", "fmu_src.importer.run"),
    ("solver.outlets", "Windkessel", "solver.laws.outlets"),
    ("fitting.records.record", "read_record", "fitting.records.read.record"),
    ("discrepancy.command_tables", "gap_text", "arterial_fmu.cli.tables.study"),
    # whose names are packages today
    ("solver.laws", "ELASTIC_LAWS", "solver.laws.wall_laws"),
    ("fitting.wall", "fit", "fitting.wall.site_fit"),
    ("fitting.calibrate", "calibrate", "fitting.calibrate.network_calibration"),
    ("fitting.check", "check", "fitting.check.fmu_check"),
]


def test_every_module_of_today_is_there() -> None:
    """The table leads to modules, not to further former names."""
    assert [new for new in MOVED.values() if find_spec(new) is None or new in MOVED.keys() - set(MOVED.values())] == []


def test_the_same_object() -> None:
    """The object of today and its module's own name, and a warning at the line that asks for it."""
    code = ""
    for i, (former, name, now) in enumerate(EXAMPLES):
        code += f"from {former} import {name} as found{i}; import {now} as now{i}; "
        code += f"assert found{i} is now{i}.{name} and now{i}.__spec__.name == {now!r}\n"
    line = [sys.executable, "-W", "default::DeprecationWarning", "-c", code]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = [each for each in done.stderr.splitlines() if "DeprecationWarning" in each]
    assert len(told) == len(EXAMPLES)
    for i, (each, (former, _, now)) in enumerate(zip(told, EXAMPLES, strict=True), 1):
        assert each.startswith(f"<string>:{i}: DeprecationWarning: {former}") and f"is {now}" in each
        assert "version 0.3" in each


def test_unknown_names() -> None:
    """What never was is an ordinary error."""
    with pytest.raises(ModuleNotFoundError, match=r"No module named 'solver\.nothing'"):
        import_module("solver.nothing")
    with pytest.raises(AttributeError, match=r"module 'solver\.laws' has no attribute 'nothing'"):
        _ = import_module("solver.laws").nothing


@pytest.mark.parametrize(
    ("line", "command"),
    [("solver", "solve"), ("solver list", "list"), ("fitting fit", "fit"), ("fitting", "[OPTIONS] COMMAND"),
     ("discrepancy", "discover"), ("discrepancy isolability", "isolability"), ("fmu_src.run", "run")],
)  # fmt: skip
def test_commands(line: str, command: str) -> None:
    """``python -m`` of a former command line runs the command of today."""
    words = [sys.executable, "-m", *line.split(), "--help"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and f"Usage: arterial-fmu {command}" in done.stdout, done.stderr
