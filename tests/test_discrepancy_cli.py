"""``discover`` and ``isolability``: words, output and files for every kind of outcome, and its exit codes."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import refused_in_one_sentence
from forked import NETWORK
from judged import few
from rich.console import Console
from typer.testing import CliRunner

from arterial_fmu.__main__ import app
from arterial_fmu.cli.tables.study import effects_table, plan_table
from build_fmu import build
from discrepancy import workflow
from discrepancy.findings.isolability import isolability
from discrepancy.findings.outcome import Isolability, NamedEffect, Outcome, OwnNumber, Walls
from discrepancy.plan.sensor_plan import Gain, SensorPlan, plan_json, plan_sensors
from fitting.check.fmu_build import build_fmu
from fitting.inference.fit import Fit
from fitting.inference.hypothesis import PlacedEffect
from fitting.inference.models.bench_network import on_bench
from fitting.parallel.workers import cores
from fitting.records.read.record import write_record
from fitting.records.virtual import jarvik_pressure, measured, pressure_at, solve_radius, table_wall
from fitting.results.estimate import Estimate
from solver import load, read_network
from solver.laws.effects import ALL
from solver.network.files import write_network

T, BEATS, SAMPLES = 0.5, 20, 100


def run(*arguments: object) -> Any:
    return CliRunner(env={"COLUMNS": "160"}).invoke(app, [str(each) for each in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual bench recording of a viscous AA at 200 Hz, 20 beats, 40 dB, and the sheep with elastic walls."""
    path = tmp_path_factory.mktemp("cli")
    wall, p = table_wall("AA", phiNL=0.0, elastic="beta"), jarvik_pressure(T)
    P = pressure_at(p, T, np.arange(SAMPLES) * T / SAMPLES)
    R = solve_radius(wall, p, T, SAMPLES)
    rng = np.random.default_rng(3)
    channels = {name: measured(np.tile(x, BEATS), rng, 40.0) for name, x in (("AA.P", P), ("AA.R", R))}
    write_record(path / "virtual_AA.csv", np.arange(BEATS * SAMPLES) * T / SAMPLES, channels)
    sheep = load("sheep")
    write_network(sheep.with_parameters({f"{s.name}.phi0": 0.0 for s in sheep.segments}), path / "elastic.toml")
    write_network(on_bench(sheep, "AA"), path / "bench.toml")
    return path


@pytest.mark.slow
@pytest.mark.usefixtures("one_process")
def test_a_bench_record_end_to_end(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The record alone as first word; the viscosity of AA is named with its value, and the model gets it.

    25.451 kPa·s is the truth, from an integrator that shares nothing with the workflow.
    """
    few(monkeypatch, "wall_viscosity", "stress_relaxation", "catheter_resonance", "channel_lag", "channel_gain")
    record, model = folder / "virtual_AA.csv", folder / "elastic.toml"
    done = run("discover", record, "--model", model, "--out", folder / "out", "--period", "0.5 s")
    assert done.exit_code == 0, done.output
    assert "The model lacks wall viscosity at AA" in done.stdout
    assert "AA.phi0" in done.stdout and "gap (1 = noise)" in done.stdout
    verdict = json.loads((folder / "out" / "verdict.json").read_text(encoding="utf-8"))
    assert verdict["verdict"] == "effect"
    assert verdict["effects"][0]["parameters"]["AA.phi0"]["value"] == pytest.approx(25.451e3, rel=0.02)
    assert read_network(folder / "out" / "model.toml").segment("AA").phi0 == pytest.approx(25.451e3, rel=0.02)
    for name in ("report.html", "verdict.json", "model.toml", "model.fmu"):
        assert f"wrote {folder / 'out' / name}" in done.stdout
        assert (folder / "out" / name).stat().st_size > 100


VISCOSITY, LAG = ("wall_viscosity", ("CA",)), ("channel_lag", ("CA.P",))


def outcome(**changes: Any) -> Outcome:
    """An outcome with numbers that are made up."""
    fields: dict[str, Any] = {
        "verdict": "ambiguous",
        "sentence": "A sentence.",
        "record": "r.csv",
        "model": "m.toml",
        "kind": "network",
        "effects": (
            NamedEffect("wall_viscosity", ("CA",), {"CA.phi0": Estimate(7.7e4, "Pa.s", (7.1e4, 8.3e4))}, 0.62),
        ),
        "members": ((VISCOSITY,), (LAG,)),
        "separating_measurement": "Calibrate CA.P.",
        "gap_before": (9.1, 9.3),
        "gap_after": (1.01, 1.04),
        "warnings": ("few beats",),
    }
    return Outcome(**{**fields, **changes})


@pytest.fixture
def found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], None]:
    """Lets the workflow come to an outcome, or to an exception, at once; in a folder with the record of STUDY."""
    (tmp_path / STUDY[1]).touch()
    monkeypatch.chdir(tmp_path)

    def set_outcome(what: Any) -> None:
        def discover(*_: Any, **__: Any) -> Outcome:
            if isinstance(what, BaseException):
                raise what
            return what

        monkeypatch.setattr(workflow, "discover", discover)

    return set_outcome


STUDY = ("discover", "r.csv", "--model", "sheep", "--out", "o")


def test_an_ambiguous_outcome(found: Callable[[Any], None]) -> None:
    """Sentence, best of the class in display units, gap, class and what would separate it; exit code 0."""
    found(outcome())
    done = run(*STUDY)
    assert done.exit_code == 0, done.output
    for text in (
        "A sentence.",
        "best of the class",
        "77.0 kPa·s",
        "71.0 … 83.0",
        "62 %",
        "gap (1 = noise): 9.10 -> 1.01 on the fitted beats, 9.30 -> 1.04 on the held-out beats",
        "not distinguishable: wall viscosity at CA; channel lag at CA.P",
        "Calibrate CA.P.",
        "Note: few beats",
    ):
        assert text in done.stdout
    assert run(*STUDY, "--quiet").output == ""
    assert run("discover", "--model", "sheep", "--out", "o", "r.csv").stdout == done.stdout


@pytest.mark.parametrize("verdict", ["ambiguous", "several", "partial"])
def test_a_class_with_a_pair(found: Callable[[Any], None], verdict: str) -> None:
    """The effects of one hypothesis stand together, whatever the verdict; a single pair is no class, but two faults."""
    gain = ("channel_gain", ("FA.P",))
    found(outcome(verdict=verdict, members=((VISCOSITY, gain), (LAG,))))
    done = run(*STUDY)
    assert "not distinguishable: wall viscosity at CA with channel gain at FA.P; channel lag at CA.P" in done.stdout
    assert ("best of the class" in done.stdout) == (verdict == "ambiguous")
    found(outcome(verdict=verdict, members=((VISCOSITY, LAG),)))
    done = run(*STUDY)
    assert "distinguishable" not in done.stdout and "of the class" not in done.stdout


def test_tables_fit_eighty_columns() -> None:
    """The longest names: no number is cut or wrapped, and no word of a heading."""
    found = NamedEffect(
        "nonlinear_wall_viscosity", ("CA",), {"CA.phiNL": Estimate(-21570, "Pa.s^2", (-22100, -21040))}, 1
    )
    lines = io.StringIO()
    Console(file=lines, width=80).print(effects_table(outcome(effects=(found,))), plan_table(plan()))
    told = lines.getvalue()
    assert "CA.phiNL" in told and "−21.57 kPa·s²" in told and "−22.10 … −21.04" in told and "confidence" in told
    assert "…" not in told.replace(" … ", "") and max(map(len, told.splitlines())) <= 80


def test_walls_are_said(found: Callable[[Any], None]) -> None:
    """Common; individual with the spreads that were found; a partial answer's table, and what is odd as a note."""
    found(outcome(walls=Walls()))
    assert (
        "walls: common, one change for all arteries (the record gives no evidence for individual walls)"
        in run(*STUDY).stdout
    )
    own = {"CA.E": OwnNumber(4e6, Estimate(5e6, "Pa", (4.5e6, 5.5e6)), 2.5)}
    walls = Walls("individual", {"E": (0.08, 0.11)}, own)
    found(outcome(verdict="partial", walls=walls, notes=("CA.E: 25 % above the file's.",)))
    said = run(*STUDY).stdout
    assert (
        "walls: individual, one change for each artery (the record is more probable with individual walls). Standard "
        "deviations between arteries, relative: E 0.11 (stated 0.08)."
    ) in said
    assert "a part of the gap looks like it" in said and "Note: CA.E: 25 % above the file's." in said


def test_options_reach_the_workflow(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Walls, prior, processes and time limit, with a unit or in seconds; five minutes and all cores by default."""
    given: list[dict[str, Any]] = []
    (tmp_path / STUDY[1]).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(workflow, "discover", lambda *_, **options: given.append(options) or outcome())
    prior = tmp_path / "prior.json"
    options = ("--walls", "individual", "--prior", prior, "--time-limit", "2 min", "--jobs", 3)
    assert run(*STUDY, *options).exit_code == run(*STUDY).exit_code == 0
    assert [run(*STUDY, "--time-limit", text).exit_code for text in ("5", "5min")] == [0, 0]
    found = [[each[key] for key in ("walls", "prior", "time_limit", "jobs")] for each in given]
    assert found[:2] == [["individual", prior, 120.0, 3], [None, None, 300.0, cores()]]
    assert [each[2] for each in found[2:]] == [5.0, 300.0]


def test_none_adds_nothing(found: Callable[[Any], None]) -> None:
    """No table, and a gap before alone."""
    found(outcome(verdict="none", effects=(), members=(), gap_after=None, separating_measurement=None))
    done = run(*STUDY)
    assert done.exit_code == 0
    assert "gap (1 = noise): 9.10 on the fitted beats, 9.30 on the held-out beats\n  A gap is the RMS" in done.stdout
    found(outcome(provenance={"beats": {"fitted": 18, "held_out": 2}}))
    assert "The mean of 2 held-out beats is noisier than that of 18 fitted beats" in run(*STUDY).stdout
    assert "gives a gap 3 times smaller there" in run(*STUDY).stdout
    assert "effect" not in done.stdout


def test_how_sure_and_what_remains(found: Callable[[Any], None]) -> None:
    """That nothing is missing, as the page says it; of unknown and partial what remains."""
    changes = {"effects": (), "members": (), "gap_after": None, "confidence": 0.998}
    found(outcome(verdict="none", **changes))
    assert "probability that nothing is missing: > 99 %" in run(*STUDY).stdout
    found(outcome(verdict="unknown", reason="whitened RMS 1.3", **changes))
    said = run(*STUDY).stdout
    assert "residual: whitened RMS 1.3 (over all fitted data; 1 is noise)" in said and "99 %" not in said


def test_a_search_that_was_cut_short(found: Callable[[Any], None]) -> None:
    """What the limit was, in seconds as a bare number is read, and the option; not where all was compared."""
    asked = {"asked": {"time_limit": {"value": 5.0, "unit": "s"}}}
    found(outcome(complete=False, provenance=asked))
    assert "again with a longer --time-limit than 5 s: not all candidates were compared." in run(*STUDY).stdout
    found(outcome(provenance=asked))
    assert "--time-limit" not in run(*STUDY).stdout


def test_unusable_is_exit_code_3(found: Callable[[Any], None]) -> None:
    """The reason is said."""
    found(outcome(verdict="unusable", effects=(), gap_before=None, gap_after=None, reason="too short."))
    done = run(*STUDY)
    assert done.exit_code == 3
    assert "too short." in done.stdout
    quiet = run(*STUDY, "-q")
    assert quiet.exit_code == 3 and "Unusable: too short." in quiet.stderr and quiet.stdout == ""


def test_interrupted_is_exit_code_130(found: Callable[[Any], None]) -> None:
    """One sentence that says how to go on."""
    found(KeyboardInterrupt())
    done = run(*STUDY)
    assert done.exit_code == 130
    assert done.stderr.strip() == (
        "Interrupted: finished stages are kept; run the same command to continue from the stage that was interrupted."
    )


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("discover", "virtual_AA.csv", "--model", "nosuch", "--out", "o"), "nosuch"),
        (
            ("discover", "virtual_AA.csv", "--model", "virtual_AA.csv", "--out", "o"),
            "virtual_AA.csv: not a network file but a rec",
        ),
        (
            ("discover", "virtual_AA.csv", "--model", "sheep", "--out", "virtual_AA.csv"),
            "virtual_AA.csv: is a file, not a folder",
        ),
        (("discover", "virtual_AA.csv", "--model", "sheep", "--out", "o", "--period", "5 kg"), "--period"),
        (("discover", "virtual_AA.csv", "--model", "sheep", "--out", "o", "--time-limit", "5 kg"), "--time-limit"),
        (
            ("discover", "virtual_AA.csv", "--model", "sheep", "--out", "o", "--time-limit", "-1 s"),
            "time limit -1 s: must be above",
        ),
        (
            ("discover", "virtual_AA.csv", "--model", "sheep", "--out", "o", "--jobs", "0"),
            "jobs 0: must be a whole number",
        ),
        (
            ("discover", "virtual_AA.csv", "--model", "sheep", "--out", "o", "--walls", "thick"),
            "must be common or individual",
        ),
        (
            ("discover", "virtual_AA.csv", "--model", "sheep", "--out", "o", "--prior", "no.json"),
            "no.json: there is no such file; give the .json file that",
        ),
        (
            ("discover", "virtual_AA.csv", "--model", "sheep", "--out", "o", "--prior", "bench.toml"),
            "bench.toml: is not a .json file, and other files contain no cov",
        ),
        (("discover", "no.csv", "--model", "sheep", "--out", "."), "no.csv"),
        (("isolability", "nosuch", "--channels", "AA.P"), "nosuch"),
        (("isolability", "sheep", "--channels", "XX.P"), "channel XX.P"),
        (("isolability", "sheep", "--channels", "AA.P XX.R"), "channel XX.R"),
        (("isolability", "bench.toml", "--channels", "AA.P"), "without flow no sensor sees anything"),
        (("isolability", "sheep", "--channels", ","), "none given"),
        (("isolability", "sheep", "--channels", "AA.P", "--dB", "nan"), "dB = nan"),
        (("isolability", "sheep", "--channels", "AA.P", "--beats", "3"), "beats = 3"),
        (("isolability", "sheep", "--channels", "AA.P", "--out", "no/p.json"), "no folder no"),
    ],
)
def test_one_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], sentence: str) -> None:
    """Exit code 2, one sentence on the error stream that names the thing, and nothing new in the folder."""
    monkeypatch.chdir(folder)
    refused_in_one_sentence(app, arguments, sentence, folder)


def test_an_unusable_record_leaves_a_report(folder: Path) -> None:
    """A bench record of a site that the network has not: exit code 3, the reason, and no model."""
    text = (folder / "virtual_AA.csv").read_text().replace("AA.", "XX.", 2)
    (folder / "virtual_XX.csv").write_text(text)
    done = run("discover", folder / "virtual_XX.csv", "--model", folder / "elastic.toml", "--out", folder / "xx")
    assert done.exit_code == 3, done.output
    assert "has no segment XX" in done.stdout
    assert not (folder / "xx" / "model.toml").exists()
    assert (folder / "xx" / "report.html").exists()


# --- isolability ------------------------------------------------------------------------------------------------------


def plan() -> SensorPlan:
    """A plan with numbers that are made up: a and b cannot be told apart, d is invisible."""
    labels = ("wall_viscosity", "channel_lag", "taper", "side_branch")
    separation = np.array([[0, 2, 50, 1], [2, 0, 40, 1], [50, 40, 0, 1], [1, 1, 1, 0]], float)
    visibility = np.array([36.4, 20.0, 60.0, 1.0])
    table = Isolability(labels, separation, visibility, ("side_branch",))
    return SensorPlan(("AA.P",), table, (Gain("AA.R", ("side_branch",), 1), Gain("CA.Q", (), 0)))


def test_isolability_is_shown(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Table, what is invisible, what to add; the same as JSON."""
    given: list[Any] = []
    monkeypatch.setattr("discrepancy.plan.sensor_plan.plan_sensors", lambda *each: given.append(each) or plan())
    out = tmp_path / "plan.json"
    done = run("isolability", "sheep", "--channels", "AA.P, CA.P", "--dB", 30, "--beats", 12, "--out", out)
    assert done.exit_code == 0, done.output
    assert given[0][1:4] == (["AA.P", "CA.P"], 30.0, 12)
    assert "wall viscosity" in done.stdout and "36.4" in done.stdout
    assert "Invisible (d′ below 3): side branch." in done.stdout
    both = "wall viscosity from channel lag; channel lag from wall viscosity"
    assert f"Not distinguishable (separation below 6): {both}." in done.stdout
    assert "Add AA.R (reveals side branch; separates 1 more pair)." in done.stdout
    data = json.loads(out.read_text(encoding="utf-8"))
    assert data == plan_json(plan())
    assert data["effects"][0] == {
        "name": "wall_viscosity",
        "visibility": 36.4,
        "nearest": "channel_lag",
        "separation": 2.0,
        "cannot_be_told_from": ["channel_lag"],
    }
    assert data["invisible"] == ["side_branch"]


@pytest.mark.slow
def test_the_meter_of_the_inflow_is_a_sensor_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan for one pressure of the fork: its faults and those of inlet.Q are candidates, of no sensor that is not
    there. All of the inflow's show in that pressure."""
    judged: list[dict[str, float]] = []

    def kept(base: Fit, columns: Mapping[str, np.ndarray], seen: Sequence[PlacedEffect]) -> Isolability:
        sensors = [t.label for t in seen if t.is_sensor]
        judged.append({label: float(np.linalg.norm(columns[label])) for label in sensors})
        return isolability(base, columns, seen)

    monkeypatch.setattr("discrepancy.plan.sensor_plan.isolability", kept)
    plan_sensors(NETWORK, ("B.P",), beats=8)
    own = min(judged, key=len)  # without a further sensor
    assert {label.rpartition(" at ")[2] for label in own} == {"B.P", "inlet.Q"} and len(own) == 8
    assert min(own.values()) > 1.0


def test_plan_of_a_fork() -> None:
    """Two pressures: every effect but known filters has a column, the outlet that becomes a Windkessel, too; a third
    sensor helps."""
    found = plan_sensors(NETWORK, ("A.P", "B.P"))
    known, learned = {"low_pass", "known_zero", "known_delay"}, {"learned_wall", "learned_outlet"}
    assert set(found.table.labels) == {effect.name for effect in ALL} - known - learned
    assert found.table.visibility.min() > 0.0
    assert "terminal_compliance" not in found.table.invisible
    assert found.gains[0].separable > 0
    assert {gain.channel for gain in found.gains}.isdisjoint(found.channels)


def test_import_is_cheap() -> None:
    """``import discrepancy`` loads no solver, no NumPy; the workflow comes with its name."""
    code = (
        "import sys, discrepancy; assert not {'numpy', 'matplotlib', 'fmpy', 'solver'} & set(sys.modules); "
        "from discrepancy import discover; print(discover.__module__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, "discrepancy.workflow", "")


@pytest.mark.slow
def test_an_fmu_from_a_process_of_its_own(folder: Path, tmp_path: Path) -> None:
    """Byte for byte the FMU that is built here; what that process refuses is an error with its sentence."""
    fmu = build_fmu(folder / "bench.toml", tmp_path)
    assert fmu.read_bytes() == build(read_network(folder / "bench.toml"), tmp_path / "here").read_bytes()
    (tmp_path / "BAD.toml").write_text("name = ")
    with pytest.raises(ValueError, match=r"^.*BAD\.toml: not valid TOML: "):
        build_fmu(tmp_path / "BAD.toml", tmp_path)
