"""The whole workflow on a bench record: verdict, rebuilt FMU, gap; and a study that was killed goes on."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from checked import bench_set
from fmpy import read_model_description
from judged import judge, value_of
from scipy.stats import kstest
from truth.hide import Effect
from truth.records import Case, Made, make, write

from discrepancy import workflow
from discrepancy.assemble import ValidationRuns, fmu_warnings, global_p, sentence, summary, unusable
from discrepancy.checkpoint import Journal
from discrepancy.find.model_source import read_model
from discrepancy.find.study import Study as Prepared
from discrepancy.find.study import Unjudged, Unusable, prepare
from discrepancy.findings.outcome import Outcome, verdict_json
from discrepancy.name.model_selection import name
from discrepancy.name.scoring import Named
from discrepancy.name.verdict import Naming
from discrepancy.options import Asked
from discrepancy.recordings import Recordings
from discrepancy.report import page as report
from discrepancy.show.fmu_validation import Gap, Run, compared, parity
from discrepancy.workflow import discover
from fitting.check.fmu_run import RunFailed
from fitting.inference.hypothesis import PlacedEffect
from fitting.inference.models.bench_network import bench_network, on_bench
from fitting.inference.runs import Runs
from fitting.records.read.record import Record
from fitting.records.read.sensors import UnusableRecord
from solver import load
from solver.io.saved import Kind, to_bytes
from solver.network.files import read_network, write_network

pytestmark = pytest.mark.usefixtures("one_process")

SITE = "CA"
HIDDEN = Effect("nonlinear_elasticity", (SITE,), 4.0)


@dataclass(frozen=True)
class Study:
    """A study that was killed once and went on."""

    made: Made
    folder: Path
    outcome: Outcome
    verdict: dict[str, Any]
    stages: list[str]
    namings: int
    kept: list[str]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """E_NL = 4 E is hidden in a record of CA at 40 dB. The first run is interrupted while the extended FMU runs."""
    folder = tmp_path_factory.mktemp("study")
    made = make(Case("bench", SITE, 40.0, (HIDDEN,)), 5)
    write(made, folder / "record.csv")
    write_network(made.base, folder / "base.toml")
    arguments = (folder / "record.csv", folder / "base.toml", folder / "out")
    calls: list[Any] = []
    real_name, real_run = workflow.name, workflow.free_run

    def counted(*given: Any) -> Naming:
        calls.append("name")
        return real_name(*given)

    def killed(fmu: Path, *given: Any) -> Run:
        if "extended" in fmu.parts:
            raise KeyboardInterrupt
        return real_run(fmu, *given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workflow, "name", counted)
        patch.setattr(workflow, "free_run", killed)
        with pytest.raises(KeyboardInterrupt):
            discover(*arguments)
        kept = sorted(p.name for p in (folder / "out").rglob("*"))
        patch.setattr(workflow, "free_run", real_run)
        stages: list[str] = []
        outcome = discover(*arguments, progress=lambda fraction, label: stages.append(label))
    verdict = json.loads((folder / "out" / "verdict.json").read_text(encoding="utf-8"))
    return Study(made, folder, outcome, verdict, stages, len(calls), kept)


# --- a killed study --------------------------------------------------------------------------------------------------


def test_a_killed_study_goes_on(study: Study) -> None:
    """Nothing but its state is there after Ctrl-C; the second run does not name again; then the state is gone."""
    assert study.kept == [".state", "naming.stage", "run_before.stage", "run_given.stage"]
    assert study.namings == 1
    assert not (study.folder / "out" / ".state").exists()
    assert not [p for p in (study.folder / "out").rglob("*") if p.suffix in (".part", ".tmp")]


def test_the_same_answer_as_in_one_go(study: Study) -> None:
    """Find and name anew, without journal or files: verdict, confidence and value are the killed study's."""
    record = Record("record.csv", "", study.made.time, study.made.channels, {})
    naming = judge(record, study.made.base)[1]
    assert naming.verdict == study.verdict["verdict"]
    (told,) = study.verdict["effects"]
    assert naming.confidence == pytest.approx(told["confidence"], rel=1e-9)
    (unknown,) = naming.best.fit.terms[0].unknowns
    value = value_of(unknown, float(naming.best.fit.x[-1])).value
    # the file holds samples in mm and mmHg, which read back to round-off
    assert told["parameters"][f"{SITE}.ENL"]["value"] == pytest.approx(value, rel=1e-6)


def test_stages_are_told(study: Study) -> None:
    """Progress names every stage in order, the last one "done"."""
    assert study.stages[-1] == "done"
    naming = "naming, time limit 300 s"
    wanted = ["cutting the beats", naming, "rebuilding the FMU", "running the extended FMU",
              "comparing the extended FMU with the solver", "comparing the candidates with the held-out beats",
              "writing the report"]  # fmt: skip
    assert [s for s in study.stages if s in wanted] == wanted


# --- what is written -------------------------------------------------------------------------------------------------


def test_verdict_json(study: Study) -> None:
    """The schema: every key with its kind; the true effect with the truth in its interval; numbers only, no NaN."""
    v = study.verdict
    assert v["verdict"] == "effect" and v["provenance"]["FMUs run"].startswith("arterial-fmu ")
    (effect,) = v["effects"]
    assert (effect["name"], effect["where"]) == (HIDDEN.name, [SITE])
    assert 0.85 < effect["confidence"] <= 1.0
    ((name, told),) = effect["parameters"].items()
    truth = study.made.truth["effects"][0]["parameters"]
    assert {name: told["unit"]} == {f"{SITE}.ENL": "Pa"} and set(truth) == {name}
    assert told["ci95"][0] <= truth[name] <= told["ci95"][1]
    assert abs(told["value"] / truth[name] - 1.0) < 0.15
    assert v["class"] == [[{"name": HIDDEN.name, "where": [SITE]}]]
    assert {"site", "signal", "harmonic", "z"} <= set(v["located"][0]) and v["located"][0]["site"] == SITE
    zs = [at["z"] for at in v["located"]]
    assert zs == sorted(zs, reverse=True) and zs[0] > 4.0
    assert v["separating_measurement"] is None and v["reason"] is None
    assert isinstance(v["invisible"], list) and v["not_judged"] == [] and v["seconds"] > 0.0
    assert 0.0 <= v["global_p_value"] < 1e-6
    text = (study.folder / "out" / "verdict.json").read_text(encoding="utf-8")
    assert "NaN" not in text and "Infinity" not in text


def test_the_gap_shrinks(study: Study) -> None:
    """Held-out beats: R from more than 2 to less than 1.4 times the noise; P drives, and stays as it was."""
    gap = study.verdict["gap"]
    assert set(gap["before"]) == set(gap["after"]) == {"fit", "held_out"}
    assert set(gap["channels"]) == {f"{SITE}.P", f"{SITE}.R"}
    R, P = gap["channels"][f"{SITE}.R"], gap["channels"][f"{SITE}.P"]
    assert R["before"] > 2.0 and R["after"] < 1.4
    assert P["after"] == pytest.approx(P["before"], rel=1e-9)
    assert gap["after"]["held_out"] < gap["before"]["held_out"]
    assert gap["after"]["fit"] < 1.2


def test_model_toml_reads_back(study: Study) -> None:
    """The network file is the outcome's network, with the new value in it and the nuisances refitted."""
    network = read_network(study.folder / "out" / "model.toml")
    told = study.verdict["effects"][0]["parameters"][f"{SITE}.ENL"]["value"]
    assert network.parameters()[f"{SITE}.ENL"] == pytest.approx(told, rel=1e-9)
    assert study.outcome.network_after is not None
    assert network.parameters() == pytest.approx(study.outcome.network_after.parameters(), rel=1e-12)
    assert study.made.base.segment(SITE).ENL == 0.0
    assert network.segment("FA") == study.made.base.segment("FA")


def test_model_fmu_has_the_parameter(study: Study) -> None:
    """modelDescription.xml of the rebuilt FMU starts CA.ENL at the fitted value; it carries the network file, too."""
    path = study.folder / "out" / "model.fmu"
    variables = {v.name: v for v in read_model_description(path).modelVariables}
    told = study.verdict["effects"][0]["parameters"][f"{SITE}.ENL"]["value"]
    assert float(variables[f"{SITE}.ENL"].start) == pytest.approx(told, rel=1e-6)
    assert read_model(path).parameters() == read_network(study.folder / "out" / "model.toml").parameters()


def test_the_global_p_value_of_healthy_benches() -> None:
    """Twelve records that nothing is missing in: p-values of the global χ² as a uniform number has them."""
    values = []
    for seed in range(1, 13):
        made = make(Case("bench", SITE, 40.0), seed)
        study = prepare(Record("made", "", made.time, made.channels, {}), made.base)
        naming = name(study.problem, ())
        values.append(global_p(study, naming, np.nan))
    assert kstest(values, "uniform").pvalue > 0.01


def coarse(case: Case, seed: int) -> Naming:
    """What is said of a bench whose radius has steps of 3.7 µm."""
    made, step = make(case, seed), 3.7e-6
    R = step * np.round(made.channels[f"{SITE}.R"] / step)
    return judge(Record("made", "", made.time, {**made.channels, f"{SITE}.R": R}, {}), made.base)[1]


@pytest.mark.parametrize(
    "seed",
    [
        *(pytest.param(seed, marks=pytest.mark.deep) for seed in (0, 5, 200, 203)),
        *(pytest.param(seed, marks=pytest.mark.endurance) for seed in (1, 2, 3, 4, 201, 202, 204, 205)),
    ],
)
def test_healthy_benches_of_few_steps(seed: int) -> None:
    """Nothing hidden, 3 to 9 steps of the converter in the pulse of CA.R: none."""
    assert coarse(Case("bench", SITE, 40.0), seed).verdict == "none"


@pytest.mark.deep
@pytest.mark.parametrize("seed", [0, 5])
def test_a_missing_viscosity_of_few_steps(seed: int) -> None:
    """A viscous wall, 24 ms, of an elastic model, 6 and 8 steps in the pulse: it tops the class."""
    naming = coarse(Case("bench", SITE, 40.0, (Effect("wall_viscosity", (SITE,), 0.024),), "elastic"), seed)
    assert naming.verdict in ("effect", "ambiguous") and naming.best.label == f"wall_viscosity at {SITE}"


def test_the_fmu_of_a_bench_is_run(study: Study) -> None:
    """model.fmu, which no bench record drives, over two beats under its network's own inflow: the solver to round-off.
    That of another network differs, and more than a thousandth is warned about, as is one that does not run."""
    assert study.verdict["fmu_against_solver"] < 1e-9 and study.verdict["warnings"] == []
    page = (study.folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "over two beats with the network’s own inflow" in page
    other = parity(study.folder / "out" / "model.fmu", study.made.base)
    assert other > 1e-3
    pressed = replace(study.made.base, inlet=replace(study.made.base.inlet, causality="pressure"))
    with pytest.raises(ValueError, match="driven by a pressure"):
        parity(study.folder / "out" / "model.fmu", pressed)
    run = Run(np.zeros((1, 1)), {}, Gap((1.0, 1.0), {}))
    assert "differs from the direct solver by" in fmu_warnings(ValidationRuns(run, run, parity=other))[0]
    assert fmu_warnings(ValidationRuns(run, run, parity=1e-9)) == fmu_warnings(ValidationRuns(run, run)) == ()
    assert "does not run with its network's own inflow: why" in fmu_warnings(ValidationRuns(run, run, failure="why"))[0]


def test_an_fmu_at_rest_is_not_compared(fast_fmu: Callable[..., Path]) -> None:
    """One artery closed at its inlet, under no inflow: it and any other artery stay at rest, and nothing is told."""
    network = bench_network("AA", bench_set())
    fmu = fast_fmu(network, None)
    assert parity(fmu, network) is None
    assert parity(fmu, bench_network("AA", bench_set(E=1e6))) is None
    run = Run(np.zeros((1, 1)), {}, Gap((1.0, 1.0), {}))
    (said,) = fmu_warnings(ValidationRuns(run, run, network=network, archive=b""))
    assert said.startswith("model.fmu has no inflow of its own, as of an artery on a bench")
    assert "the same wall was run as an FMU under the recorded pressure" in said


def test_report_and_figures_are_there(study: Study) -> None:
    """One page and its figures; no half-written file beside them. Page and verdict.json say what was asked."""
    asked = {"walls": "by evidence", "period": "found", "time_limit": {"value": 300.0, "unit": "s"}}
    assert study.verdict["provenance"]["asked"] == asked
    assert "time limit: 300 s" in (study.folder / "out" / "report.html").read_text(encoding="utf-8")
    names = {p.name for p in (study.folder / "out").iterdir()}
    assert names == {"verdict.json", "report.html", "figures", "model.toml", "model.fmu"}
    assert "nonlinear elasticity" in (study.folder / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.deep
@pytest.mark.parametrize("stage", ["report", "moving"])
def test_an_interrupt_while_files_are_written(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    """Over an earlier study: until all is made, that is untouched; later no verdict is there that others contradict.
    The state stays, and the study ends as it would have."""
    out = tmp_path / "out"
    shutil.copytree(study.folder / "out", out)
    before = {p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    made = make(Case("bench", SITE, 40.0), 6)
    write(made, tmp_path / "record.csv")
    arguments = (tmp_path / "record.csv", study.folder / "base.toml", out)

    def killed(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        if stage == "report":
            patch.setattr(report, "report_files", killed)
        else:
            real = os.replace
            patch.setattr(os, "replace", lambda old, new: (killed if new == out / "report.html" else real)(old, new))
        with pytest.raises(KeyboardInterrupt):
            discover(*arguments)
    after = {p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.is_file() and ".state" not in p.parts}
    assert after == before if stage == "report" else not (out / "verdict.json").exists()
    assert "naming.stage" in {p.name for p in (out / ".state").iterdir()} and not (out / ".state" / "out").exists()
    verdict = discover(*arguments).verdict
    assert verdict == json.loads((out / "verdict.json").read_text(encoding="utf-8"))["verdict"] == "none"
    assert {p.name for p in out.iterdir()} == {"verdict.json", "report.html", "figures"}


@pytest.mark.parametrize(("name", "folder"), [(".state", False), ("figures", False), ("model.fmu", True)])
def test_something_in_the_way(study: Study, tmp_path: Path, name: str, folder: bool) -> None:
    """A file where a study has a folder, or the other way round: one sentence, before any work; it stays as it was."""
    (tmp_path / name).mkdir() if folder else (tmp_path / name).write_text("mine")
    with pytest.raises(ValueError, match=rf"{name}: is a .* move it, or give another --out"):
        discover(study.folder / "record.csv", study.folder / "base.toml", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_bench_of_a_site() -> None:
    """A millimetre of the site's wall with a pressure at its end: the same wall, one segment, one outlet."""
    sheep = load("sheep")
    network = on_bench(sheep, SITE)
    assert [s.name for s in network.segments] == [SITE] and len(network.outlets) == 1
    assert {k: v for k, v in vars(network.segment(SITE)).items() if k != "L"} == {
        k: v for k, v in vars(sheep.segment(SITE)).items() if k != "L"
    }


# --- the time limit --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def healthy() -> tuple[Record, Prepared, Naming]:
    """A bench record that nothing is missing in."""
    made = make(Case("bench", SITE, 40.0), 3)
    record = Record("made", "", made.time, made.channels, {})
    return record, *judge(record, made.base)


def test_an_incomplete_search_is_said(healthy: tuple[Record, Prepared, Naming]) -> None:
    """A healthy bench whose search was cut short: summary, page and verdict.json say so; of a whole one none does."""
    _, study, naming = healthy
    assert (naming.verdict, naming.complete) == ("none", True)
    X = np.stack([np.fft.rfft(study.fitted.mean(n), norm="forward") for n in study.problem.signals], axis=1)
    run = compared(study, naming.base.fit, X)
    for complete in (True, False):
        outcome = summary("base.toml", study, replace(naming, complete=complete), ValidationRuns(run, run))
        said = verdict_json(outcome)
        incomplete = "The time limit ended the search before all candidates were compared."
        for text in (outcome.sentence, said["sentence"], report.page(outcome, {})):
            assert (incomplete in text) != complete
        assert outcome.complete == said["complete"] == complete


def test_unknown_is_said_as_far_as_the_search_went(healthy: tuple[Record, Prepared, Naming]) -> None:
    """The gap alone; only a whole search says what the catalogue has not."""
    gap = Gap((3.0, 1.89), {})
    whole, cut = (
        sentence(replace(healthy[2], verdict="unknown", reason="whitened RMS 1.3", complete=c), (), gap, None)
        for c in (True, False)
    )
    said = "the gap to held-out beats is 1.89 times the noise."
    assert whole == f"Something is missing, and no law of the catalogue explains it: {said}"
    assert cut.startswith(f"Something is missing, and none of the laws compared explains it: {said} The time limit ")


def test_a_bench_is_of_one_site() -> None:
    """What cannot be used and has no inflow is no bench for that."""
    for names, kind in ((("CA.P", "CA.R"), "bench"), (("CA.P", "FA.P"), "network"), (("inlet.Q", "CA.P"), "network")):
        record = Record("made", "", np.zeros(8), dict.fromkeys(names, np.zeros(8)), {})
        assert unusable(Unusable("why"), "r.csv", "m.toml", record).kind == kind


def test_a_time_limit_says_nothing_of_a_record() -> None:
    """That it cannot be used is not said where time ended; nor of a file that a reader refused is anything else."""
    record = Record("made", "", np.zeros(8), {"CA.P": np.zeros(8)}, {})
    late, never, read = (
        unusable(error("why"), "r.csv", "m.toml", record) for error in (Unjudged, Unusable, UnusableRecord)
    )
    assert late.sentence == "The time limit was over before this record was judged." and late.reason == "why"
    assert never.sentence == read.sentence == "This record cannot be used with this model."


@pytest.mark.parametrize(("limit", "last"), [(300.0, "00:03:30"), (45.0, "23:59:15"), (3600.0, "00:58:30")])
def test_when_naming_ends_at_the_latest(monkeypatch: pytest.MonkeyPatch, limit: float, last: str) -> None:
    """From 23:58:30 on: the time of day that is shown is the deadline, over midnight, too, and does not move with
    the clock. The bar goes to half of naming by 300 simulations, or in half of the time, and never beyond."""
    now = 1000.0
    told: list[tuple[float, str]] = []

    class Clock(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Clock:
            return cls(2026, 3, 1, 23, 58, 30) + timedelta(seconds=now - 1000.0)

    def named(_problem: Any, _terms: Any, runs: Runs, _walls: Any) -> str:
        nonlocal now
        assert runs.left == limit
        runs.meter.add(300)
        now += 0.75 * limit
        runs.meter.add(1)
        now += limit
        runs.meter.add(1)
        assert runs.left == pytest.approx(-0.75 * limit)
        return "named"

    monkeypatch.setattr(workflow, "monotonic", lambda: now)
    monkeypatch.setattr(workflow, "datetime", Clock)
    monkeypatch.setattr(workflow, "name", named)
    work: Any = object.__new__(workflow._Work)
    work.asked = Asked(time_limit=limit)
    one: Any = SimpleNamespace(problem=None, terms=())
    record: Any = SimpleNamespace(path="A.csv")
    work.recordings = Recordings((record,), (one,))
    work.progress = lambda fraction, label: told.append((fraction, label))
    work.journal = SimpleNamespace(stage=lambda stage, compute: compute())
    assert work._name() == "named"
    assert told[0][1] == f"naming, time limit {limit:g} s"
    assert [label for _, label in told[1:]] == [
        f"naming, {n} simulations, the search ends by {last}, then the FMUs run" for n in (300, 301, 302)
    ]
    assert [fraction for fraction, _ in told] == pytest.approx([0.2, 0.45, 0.575, 0.7])


# --- two effects ------------------------------------------------------------------------------------------------------


def two(naming: Naming) -> Named:
    """A hypothesis of two effects, with numbers that are made up."""
    terms = tuple(PlacedEffect(e, place, (place,), ()) for e, place in (("stenosis", "MD"), ("channel_gain", "CA.P")))
    return replace(naming.base, fit=replace(naming.base.fit, terms=terms))


def test_a_class_holds_hypotheses(healthy: tuple[Record, Prepared, Naming]) -> None:
    """Of two pairs that share an effect: which belong together is kept."""
    _, study, naming = healthy
    one = two(naming)
    other = replace(one, fit=replace(one.fit, terms=(PlacedEffect("taper", "PD", ("PD",), ()), one.fit.terms[1])))
    X = np.stack([np.fft.rfft(study.fitted.mean(n), norm="forward") for n in study.problem.signals], axis=1)
    run = compared(study, naming.base.fit, X)
    outcome = summary("base.toml", study, replace(naming, members=(one, other)), ValidationRuns(run, run))
    gain = ("channel_gain", ("CA.P",))
    assert outcome.members == ((("stenosis", ("MD",)), gain), (("taper", ("PD",)), gain))


def test_a_run_that_fails(
    healthy: tuple[Record, Prepared, Naming], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The FMU does not run with this record: that makes the record unusable, in the words of the FMU."""
    _, study, naming = healthy

    def free_run(*_: Any) -> Run:
        raise RunFailed("CA: Q is not finite.")

    monkeypatch.setattr(workflow, "free_run", free_run)
    work: Any = object.__new__(workflow._Work)
    work.journal = Journal(tmp_path, [])
    with pytest.raises(Unusable, match="the model does not run with this record: CA: Q is not finite"):
        work._free(tmp_path / "after.fmu", "after", naming.base.fit, np.zeros(1), {}, study)


# --- the journal -----------------------------------------------------------------------------------------------------


def _never() -> Any:
    raise AssertionError("it is there")


@pytest.mark.slow
def test_a_naming_survives_a_journal_bit_by_bit(tmp_path: Path) -> None:
    """Two effects, one of a sensor: written and read back: every number and every term is the same."""
    hidden = (Effect("nonlinear_elasticity", (SITE,), 3.0), Effect("catheter_resonance", (f"{SITE}.P",), 1 / 15, 0.1))
    made = make(Case("bench", SITE, 40.0, hidden), 5)
    among = ("nonlinear_elasticity", "catheter_resonance")
    study, naming = judge(Record("made", "", made.time, made.channels, {}), made.base, among=among)
    assert naming.verdict == "several"
    Journal(tmp_path, []).stage("naming", lambda: naming)
    again: Naming = Journal(tmp_path, []).stage("naming", _never)
    assert [again.ranked.index(n) for n in again.members] == [naming.ranked.index(n) for n in naming.members]
    assert all(any(n is each for each in again.ranked) for n in again.members)
    assert (again.verdict, again.reason, again.terms) == (naming.verdict, naming.reason, naming.terms)
    assert [n.label for n in again.members] == [n.label for n in naming.members]
    for a, b in zip((again.base, *again.ranked), (naming.base, *naming.ranked), strict=True):
        assert (a.score, a.misfit, a.probability, a.separation, a.above_best) == (
            b.score, b.misfit, b.probability, b.separation, b.above_best)  # fmt: skip
        assert a.fit.terms == b.fit.terms and a.fit.unknowns == b.fit.unknowns
        for key in ("x", "z", "J", "prior", "order", "signal"):
            assert np.array_equal(getattr(a.fit, key), getattr(b.fit, key)), key
        assert (a.fit.converged, a.fit.log_volume) == (b.fit.converged, b.fit.log_volume)
    assert set(again.columns) == set(naming.columns)
    assert all(np.array_equal(again.columns[k], naming.columns[k]) for k in naming.columns)


def test_a_run_survives_a_journal_bit_by_bit(tmp_path: Path) -> None:
    """Complex coefficients, beats and gaps."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(4, 2)) + 1j * rng.normal(size=(4, 2))
    run = Run(X, {"A.P": rng.normal(size=9)}, Gap((1.1, 2.2), {"A.P": (0.1 + 0.2, 1 / 3)}))
    Journal(tmp_path, []).stage("run", lambda: run)
    again: Run = Journal(tmp_path, []).stage("run", _never)
    assert np.array_equal(again.X, run.X) and again.gap == run.gap
    assert np.array_equal(again.beats["A.P"], run.beats["A.P"])


def test_stages_count_only_for_the_same_inputs(tmp_path: Path) -> None:
    """Computed once for one key; anew for another record, and anew where the file was cut off."""
    calls = []

    def stage(inputs: Any) -> int:
        def compute() -> int:
            calls.append(inputs)
            return len(calls)

        return Journal(tmp_path, inputs).stage("one", compute)

    assert [stage(["a"]), stage(["a"]), stage(["b"]), stage(["b"])] == [1, 1, 2, 2]
    file = tmp_path / ".state" / "one.stage"
    file.write_bytes(file.read_bytes()[:-3])
    assert stage(["b"]) == 3
    Journal(tmp_path, ["b"]).close()
    assert not list(tmp_path.iterdir())


class Poison:
    """Makes a file when a pickle of it is read."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.file,)


def test_a_poisoned_folder_runs_nothing(tmp_path: Path) -> None:
    """A pickle under the seal that its inputs make, and an object that a stage does not hold: both are made anew."""
    inputs, poison = ["a"], Poison(tmp_path / "ran")
    journal, content = Journal(tmp_path, inputs), pickle.dumps(poison)
    seal = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode() + b"\n" + content).hexdigest().encode()
    foreign = to_bytes(journal.key, poison, {Poison: Kind(lambda x: {"file": str(x.file)}, Poison)})
    for i, file in enumerate((content, seal + b"\n" + content, foreign)):
        for suffix in ("pickle", "stage"):
            (tmp_path / ".state" / f"{i}.{suffix}").write_bytes(file)
        assert journal.stage(str(i), lambda: "made anew") == journal.stage(str(i), _never) == "made anew"
    assert not (tmp_path / "ran").exists()
    pickle.loads(content)
    assert (tmp_path / "ran").exists()  # else this test says nothing
