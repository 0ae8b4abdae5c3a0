"""A fault of the program is no verdict: only what somebody gave is told in a sentence, all else is a traceback."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forked import NETWORK, clean, record
from small_network import term
from test_house import MODULES
from truth.records import Case, make, write

import arterial_fmu.__main__
import discrepancy.find.disagreement
import fitting.calibrate.multistart
import fitting.cohort.fits
from arterial_fmu.study.models import NetworkModel
from discrepancy import workflow
from discrepancy.find.study import Unusable
from fitting.cohort.file import Entry
from fitting.inference.fit import Member
from fitting.inference.models.batches import simulated
from fitting.inference.models.loop import NoFit
from fitting.inference.models.network_record import network_problem
from fitting.inference.models.simulator import Simulator
from fitting.inference.runs import Runs
from fitting.records.read.sensors import UnusableRecord
from fmu_src.slaves.saving import sentence
from solver import InputError, NonPhysicalState, Settings, load
from solver.io.exit_codes import ExitCode
from solver.network.files import write_network
from solver.periodic.harmonic_balance import NoSteadyState

Breaks = Callable[[str], None]

# where another library, or Python, says of something given that it is wrong, or a host must not be killed
OTHERS = {
    "solver.io.saved", "solver.io.tables", "solver.quantities.text", "solver.network.files",
    "solver.network.importers.openbf", "solver.io.exit_codes",
    "solver.network.validation",
    "fitting.records.read.numbers",  # NumPy's reader, of a file that may be anything
    "fitting.records.read.kinds", "fitting.parallel.cluster", "fitting.results.parameter_set",
    "fitting.calibrate.calibration_prior",
    "fitting.inference.unknown_text", "arterial_fmu.study.store",
    "fmu_src.wrapper", "fmu_src.slaves.saving", "fmu_src.slaves.base", "fmu_src.importer.interpreter",
    "fmu_src.importer.doctor", "fmu_src.host",
    "fmu_src.importer.run", "arterial_fmu.cli.run",  # of a file that may be anything
    "discrepancy.report.page",  # of a verdict.json that may be anything
    "solver.io.writing",  # which tidies up, and raises it again
    "arterial_fmu.cli.terminal.console", "arterial_fmu.__main__",  # the door of faults
}  # fmt: skip
WIDE = {"ValueError", "ArithmeticError", "ZeroDivisionError", "Exception", "BaseException"}


@pytest.fixture(params=[ValueError, ZeroDivisionError, KeyError, np.linalg.LinAlgError], ids=lambda e: e.__name__)
def fault(request: pytest.FixtureRequest) -> type[Exception]:
    kind: type[Exception] = request.param
    return kind


@pytest.fixture
def breaks(fault: type[Exception], monkeypatch: pytest.MonkeyPatch) -> Breaks:
    """Put a fault into a function of the program."""

    def broken(*_: Any, **__: Any) -> Any:
        raise fault("operands could not be broadcast")

    return lambda where: monkeypatch.setattr(where, broken)


# --- the types ------------------------------------------------------------------------------------------------------


def test_who_catches_value_errors_catches_them_still() -> None:
    """And all that are told to users are of one type."""
    assert issubclass(InputError, ValueError)
    assert all(issubclass(e, InputError) for e in (Unusable, UnusableRecord, NoFit, NoSteadyState))
    with pytest.raises(ValueError, match="nowhere.toml: neither a file") as error:
        load("nowhere.toml")
    assert type(error.value) is InputError


def test_sentences_are_input_errors_and_nobody_catches_more() -> None:
    """Of the source: no sentence is raised as another ValueError, and what is caught widely is a library's."""
    raised, caught = set(), set()
    for module, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                raised |= {module} if ast.unparse(node.exc.func) in WIDE else set()
            elif isinstance(node, ast.ExceptHandler) and node.type is not None:
                named = {ast.unparse(each) for each in ast.walk(node.type) if isinstance(each, ast.expr)}
                caught |= {module} if named & WIDE else set()
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == "suppress":
                caught |= {module} if {ast.unparse(each) for each in node.args} & WIDE else set()
    assert raised == {"fmu_src.slaves.saving"}  # to the wrapper, which tells the host its type
    assert caught <= OTHERS


# --- deep inside ----------------------------------------------------------------------------------------------------


def test_in_a_study(fault: type[Exception], breaks: Breaks, tmp_path: Path) -> None:
    """While the comparison is set up: no unusable record, and no file but the place for stages."""
    made = make(Case("bench", "CA", 40.0), 5)
    write(made, tmp_path / "record.csv")
    write_network(made.base, tmp_path / "base.toml")
    breaks("discrepancy.find.study.bench")
    with pytest.raises(fault, match="broadcast") as error:
        workflow.discover(tmp_path / "record.csv", tmp_path / "base.toml", tmp_path / "out")
    assert type(error.value) is fault
    assert [p.name for p in (tmp_path / "out").rglob("*")] == [".state"]


def test_in_a_balance_of_a_study(fault: type[Exception], breaks: Breaks) -> None:
    """A wall that no law carries has no balance; a fault is none of these."""
    beats = record({f"B.{kind}": clean()[f"B.{kind}"] for kind in "PR"}, 15, 0.01)
    breaks("discrepancy.find.disagreement.bench")
    with pytest.raises(fault, match="broadcast"):
        discrepancy.find.disagreement.wall_balances(beats, NETWORK)


def test_in_a_batch(fault: type[Exception], breaks: Breaks) -> None:
    """Of a parameter study: no set "broke down". A matrix without inverse is one of that set's state."""
    model = NetworkModel(NETWORK, Settings(), 1e-3)
    breaks("arterial_fmu.study.models.repeating_beat")
    numbers = {"A.E": np.array([8e5, 9e5])}
    if fault is np.linalg.LinAlgError:
        assert model.run(numbers) == ["operands could not be broadcast"] * 2
        return
    with pytest.raises(fault, match="broadcast"):
        model.run(numbers)


def test_in_a_search(fault: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a hypothesis: not one that cannot be simulated."""
    problem, stiff = network_problem(record(clean(), 8, 0.01), NETWORK), term("wall_stiffness", "B")
    unknowns = problem.hypothesis((stiff,))
    member = Member((stiff,), unknowns, np.zeros(len(unknowns)))

    def broken(*_: Any) -> Any:
        raise fault("operands could not be broadcast")

    monkeypatch.setattr(Simulator, "coefficients", broken)
    if fault is np.linalg.LinAlgError:
        assert simulated(problem.simulator, [member], Runs()) == [None]
        return
    with pytest.raises(fault, match="broadcast"):
        simulated(problem.simulator, [member], Runs())


@pytest.mark.parametrize("where", ["align", "fit"])
def test_in_a_cohort(fault: type[Exception], breaks: Breaks, tmp_path: Path, where: str) -> None:
    """Of one recording: not a recording that could not be fitted."""
    made = make(Case("bench", "CA", 40.0), 5)
    write(made, tmp_path / "record.csv")
    entry = Entry("one", "CA", tmp_path / "record.csv", 0.6e-3)
    breaks(f"fitting.cohort.fits.{where}")
    with pytest.raises(fault, match="broadcast"):
        fitting.cohort.fits._fit(entry, ("linear",), ("beta",), 0.5, None, False)


# --- the door -------------------------------------------------------------------------------------------------------


def test_a_command(
    fault: type[Exception], breaks: Breaks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Its own exit code, the traceback, and the request to report it; no file."""
    out = tmp_path / "beat.csv"
    monkeypatch.setattr(sys, "argv", ["arterial-fmu", "solve", "sheep", "--out", str(out)])
    breaks("arterial_fmu.cli.solve.simulate_periodic")
    with pytest.raises(SystemExit) as ended:
        arterial_fmu.__main__.main()
    said = capsys.readouterr()
    assert ended.value.code == ExitCode.FAULT == 70 and said.out == ""
    assert "Traceback (most recent call last)" in said.err and f"{fault.__name__}: " in said.err
    assert said.err.rstrip().endswith("No file was left half written.") and "please report it" in said.err
    assert not list(tmp_path.iterdir())


def test_what_was_given_is_one_sentence(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Through the same door: exit code 2, without a traceback."""
    monkeypatch.setattr(sys, "argv", ["arterial-fmu", "solve", "nowhere.toml"])
    with pytest.raises(SystemExit) as ended:
        arterial_fmu.__main__.main()
    said = capsys.readouterr()
    assert ended.value.code == ExitCode.BAD_INPUT
    assert said.err.startswith("Error: ") and "Traceback" not in said.err


def test_in_an_fmu(fault: type[Exception]) -> None:
    """The host's log has all of a fault, and one sentence of what was set; the status is the same."""
    for error, ours in ((fault("broadcast"), True), (InputError("CA.E = 0 Pa"), False),
                        (NonPhysicalState("Q is not finite", "CA", 0.0, 0.0, "step less"), False)):  # fmt: skip
        try:
            raise error
        except Exception as raised:
            said = sentence("sheep", raised, "stepping")
        assert ("internal error while stepping\nTraceback" in said) is ours


def test_a_start_of_a_calibration(fault: type[Exception], breaks: Breaks) -> None:
    """Not a start that leads nowhere."""
    breaks("fitting.calibrate.multistart.calibrate")
    with pytest.raises(fault, match="broadcast"):
        fitting.calibrate.multistart._calibrated(None, beats=[record(clean(), 8, 0.01)], network=NETWORK, unknowns=())
