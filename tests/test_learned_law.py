"""Laws that are learned: from records of the independent generator, none from nulls, and what is said and written."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from forked import CHANNELS, NETWORK, N, T, exact, inflow, record
from judged import few
from test_source_map_report import LEAK, SQUEEZED, found, shown
from truth.anatomy import anatomy
from truth.beat import Beat, at_phase
from truth.hide import Effect, hide
from truth.network import Balance
from truth.records import Case, Made, hidden_model, make, truth_channels, write
from truth.sensors import clock, measured, pulsatile
from truth.shapes import arteries, ejection

from discrepancy import discover
from discrepancy.add.learning import Learnt, described, in_range, learns, learnt, stands, tables_of
from discrepancy.checkpoint import Journal
from discrepancy.find.study import Study, prepare
from discrepancy.findings.outcome import LearnedLaw, Outcome, law_json, verdict_json
from discrepancy.findings.recorded import Recorded
from discrepancy.findings.shown_map import beat_of
from discrepancy.name.scoring import weighed
from discrepancy.name.verdict import Naming
from discrepancy.report.page import TABLE, learned_files
from discrepancy.report.verdict_text import DESCRIBED, MODEL, law_text, with_law
from discrepancy.show.fmu_validation import Run, compared
from fitting.inference.models.bench import Bench
from fitting.inference.models.network_record import network_problem
from fitting.inference.places import Place
from fitting.inference.runs import Runs
from fitting.inference.source_maps.source_map import source_map
from fitting.records.read.record import Record, write_record
from fitting.results.estimate import Estimate
from solver.laws.effect import CHANNEL
from solver.network.curve import Curve
from solver.network.files import read_network, write_network
from solver.network.table_source import TableSource

SITE = "AA"


def judged(study: Study, verdict: str = "unknown") -> Naming:
    """As if no effect explained the record."""
    (base,) = study.problem.refit([()])
    assert base is not None
    none = weighed(study.problem, base, study.terms)
    return Naming(verdict, study.problem, none, (none,), (), {}, study.terms, 0.5)


def bench(hidden: tuple[Effect, ...], seed: int, dB: float = 40.0) -> tuple[Made, Study]:
    made = make(Case("bench", SITE, dB, hidden), seed)
    return made, prepare(Record("made", "", made.time, made.channels, {}), made.base)


# --- what is learned --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hidden", "size", "key"),
    [("cubic_rate", 2.0, "learned_cubic"), ("strain_viscosity", 15.0, "learned_rise")],
)
def test_the_law_of_the_generator_is_found(hidden: str, size: float, key: str) -> None:
    """One term, and no other; the held-out beats keep a noise of 21 data; φ3 to 4 standard deviations, and to 20 %."""
    made, study = bench((Effect(hidden, (SITE,), size),), 1)
    naming = judged(study)
    law = learnt(study, naming, Runs())
    assert law is not None and law.keys == (key,) and law.term.place == SITE
    own = in_range(study.problem, law.ranges)
    ((before, n),) = study.problem.held_out(study.held_out, study.fitted).predict([naming.base.fit])
    ((after, _),) = own.held_out(study.held_out, study.fitted).predict([law.fit])
    assert before / n > 9.0 and after / n < 2.0
    assert law.score < naming.base.score - 50.0
    if hidden == "cubic_rate":
        model = hidden_model(made.case, anatomy(made.base), made.nuisance)
        true = model.vessel(SITE).phi3
        unknown, x, sd = law.term.unknowns[0], law.fit.x[-1], np.sqrt(law.fit.covariance[-1, -1])
        assert abs(unknown.size * x - true) <= 4.0 * unknown.size * sd
        assert 2.0 * unknown.size * sd < 0.2 * true


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_learned_of_a_null(seed: int) -> None:
    """Asked although nothing is hidden: no term is worth its price."""
    _, study = bench((), seed, (40.0, 30.0)[seed % 2])
    assert learnt(study, judged(study), Runs()) is None


def test_what_is_asked_of_which_verdict() -> None:
    """What is named in full, and what is met only with odd numbers, leaves nothing to learn."""
    _, study = bench((), 1)
    naming = judged(study)
    assert naming.base.explains and not learns(naming)
    lost = replace(naming, base=replace(naming.base, misfit=9.0))
    assert learns(lost) and learns(replace(naming, verdict="partial"))
    assert not any(learns(replace(lost, verdict=verdict)) for verdict in ("none", "effect", "several", "ambiguous"))


def test_a_range_changes_nothing() -> None:
    """A network that knows where a law would hold is the one without, to the last bit."""
    q = inflow(np.arange(N) * (T / N))
    problem = network_problem(record({"inlet.Q": q, "B.P": 1e4 + 1e8 * q}, 9, 1e-3), NETWORK, ("B.P",))
    own = in_range(problem, {"B.learned_low": 0.01, "B.learned_span": 0.1, "B.learned_rate": 2.0})
    (plain,), (ranged,) = (p.refit([()]) for p in (problem, own))
    assert plain is not None and ranged is not None and np.array_equal(plain.z, ranged.z)


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_learned_of_a_network_without_anything_hidden(seed: int) -> None:
    """The map of a null is empty, so that there is no place for a law and nothing to describe; its verdict is `none`,
    after which nothing is asked."""
    waves = exact()
    problem = network_problem(record(waves, 9, 1e-2, seed), NETWORK, CHANNELS).individual()
    found = source_map(problem)
    (base,) = problem.refit([()])
    assert base is not None and found.places == ()
    none = weighed(problem, base, ())
    study: Any = SimpleNamespace(problem=problem, terms=(), fitted=problem.beats)
    naming = Naming("unknown", problem, none, (none,), (), {}, (), 0.5, map=found)
    assert learnt(study, naming, Runs()) is None and not learns(replace(naming, verdict="none"))
    assert described(study, naming, *2 * (pytest.fail,)) is None  # type: ignore[arg-type]


def test_tables_of_a_map() -> None:
    """Every source of a place that is in the equations, with its g(t); sensors and numbers are none."""
    leak, wall = LEAK, SQUEEZED
    tables = list(tables_of(found(leak, wall), T))
    assert [(t.kind, t.segment) for t in tables] == [("outflow", "B"), *[("wall", "C")] * 3]
    assert [dict(t.how) for t in tables] == [{}, *({"degree": float(i)} for i in range(3))]
    time = np.linspace(0.0, T, 7)
    for table, g in zip(tables, [*leak.g.T, *wall.g.T], strict=True):
        expected = beat_of(g[:, None], time, T)[:, 0]
        np.testing.assert_allclose(table.curve.at(time / T), expected, atol=1e-12 * (1e-30 + np.abs(expected).max()))
    sensor = replace(leak, place=Place(CHANNEL, "B.P", (), (1.0,), channel="B.P"))
    assert list(tables_of(found(sensor), T)) == []


def test_a_law_survives_a_journal(tmp_path: Path) -> None:
    """An interrupted study goes on with the same law, bit by bit, or with none."""
    _, study = bench((Effect("cubic_rate", (SITE,), 2.0),), 1)
    law = learnt(study, judged(study), Runs())
    assert law is not None
    for name, made in (("learned", law), ("none", None)):
        Journal(tmp_path, []).stage(name, lambda made=made: made)
    again = Journal(tmp_path, []).stage("learned", pytest.fail)
    assert np.array_equal(again.fit.x, law.fit.x) and again.term == law.term
    assert (again.keys, again.ranges, again.seen, again.score) == (law.keys, law.ranges, law.seen, law.score)
    assert Journal(tmp_path, []).stage("none", pytest.fail) is None


# --- its FMU ----------------------------------------------------------------------------------------------------------


def test_a_law_must_shrink_the_gap() -> None:
    """A run that leaves what was left before, or less by chance, is none that stands; one that leaves noise does."""
    made, study = bench((Effect("cubic_rate", (SITE,), 2.0),), 1)
    naming = judged(study)
    law = learnt(study, naming, Runs())
    assert law is not None and isinstance(study.problem, Bench)
    own = replace(study, problem=in_range(study.problem, law.ranges))

    def run(fit: object, study: Study) -> Run:
        """As inference has R of a fit, P being given."""
        X = np.fft.rfft(np.stack([study.fitted.mean(n) for n in study.problem.signals], axis=1), axis=0, norm="forward")
        mean = np.fft.rfft(study.held_out.mean(f"{SITE}.R"), norm="forward")
        X[:, 1] = mean * (1.0 if fit is law.fit else 1.02)
        return compared(study, naming.base.fit, X)

    before = run(naming.base.fit, study)
    kept = stands(study, law, before, lambda own, network, fit: (run(fit, own), lambda: b"fmu"))
    assert kept is not None and kept.archive == b"fmu" and kept.after[1] < 0.5 * kept.before[1]
    assert kept.network.segment(SITE).terms["learned_cubic"] == pytest.approx(kept.parameters["AA.learned_cubic"].value)
    assert stands(study, law, before, lambda own, network, fit: (before, lambda: b"")) is None
    assert own.problem.site == SITE
    for fallen, sd in ((-50.0, 10.0), (10.0, 10.0), (50.0, 10.0)):  # of a recording that it has not seen
        each = [Recorded("b", "b.csv", "cd", 12, 0.5, False, (7.0, 6.0), {}, (2.0, 1.5), {}, 15.0, fallen, sd)]
        ran = stands(
            study, law, before, lambda own, network, fit: (run(fit, own), lambda: b""), lambda _, each=each: each
        )
        assert (ran is not None) == (fallen > 3.0 * sd)
        assert ran is None or (ran.elsewhere == {"b": (6.0, 1.5)} and ran.explains)


# --- words and files --------------------------------------------------------------------------------------------------


LAW = LearnedLaw(
    "learned_wall", ("B",), "σ = … + cubic ε̇³", (9.0, 8.0), (1.2, 1.04), ("b.csv", "ab12"), NETWORK, b"fmu",
    {"B.learned_cubic": Estimate(5.5e4, "Pa.s^3", (5e4, 6e4))}, {"B": (0.02, 0.081, 1.21)},
)  # fmt: skip


def test_a_law_is_said_with_range_and_source() -> None:
    text = law_text(LAW)
    outlet = replace(LAW, name="learned_outlet", where=("C",), seen={"C": (8e3, 12e3, 1e5)})
    assert "to the outlet of C describes" in law_text(outlet) and "pressures of 60 to 90 mmHg above" in law_text(outlet)
    assert law_json(outlet)["seen"] == {"C": {"pressure": [8e3, 12e3], "rate": 1e5}}
    assert text.startswith(
        "A law fitted to the wall of B describes this recording: σ = … + cubic ε̇³, B.learned_cubic = "
    )
    assert "gap to held-out beats of the same recording falls from 8 to 1.04 times the noise. " in text
    assert "B.learned_cubic = 55000 (50000 to 60000) Pa·s³" in text
    assert text.endswith("covers strains from 0.02 to 0.081 and rates up to 1.2/s.")
    assert " in place of stenosis at B describes" in law_text(replace(LAW, instead=("stenosis at B",)))
    assert ", beside stenosis at B, describes" in law_text(replace(LAW, beside=("stenosis at B",)))
    content = json.loads(json.dumps(law_json(LAW)))
    assert content["seen"] == {"B": {"strain": [0.02, 0.081], "rate": 1.21}}
    assert content["gap"]["after"] == {"fit": 1.2, "held_out": 1.04}


@pytest.mark.parametrize(("kind", "other"), [("network", "branches or other physics"), ("bench", "other physics")])
def test_a_law_of_one_recording_is_no_explanation(kind: str, other: str) -> None:
    """Said before any gap, and no closed part of the gap is; another recording that supports it makes it one."""
    law = replace(LAW, kind=kind)
    described = f"a description and no explanation: no other recording has tested it, and it may stand for {other} that"
    text = law_text(law)
    assert described in text and "%" not in text and text.index(described) < text.index("the gap")
    assert law_json(law)["explains"] is False and law_json(law)["elsewhere"] == {}
    tested = replace(law, elsewhere={"pacing": (7.0, 1.1)})
    assert "recordings that it has not seen: there the gap falls as well (pacing from 7 to 1.1)." in law_text(tested)
    assert "no explanation" not in law_text(tested) and law_json(tested)["explains"] is True
    assert law_json(tested)["elsewhere"] == {"pacing": {"before": 7.0, "after": 1.1}}
    tables = replace(tested, is_law=False)
    assert "describes this recording" in law_text(tables) and "explains nothing" in law_text(tables)
    assert law_json(tables)["explains"] is False


def test_files_of_a_law_or_of_the_map(tmp_path: Path) -> None:
    """The network reads back, with where its law comes from; else g(t) and its band in SI, or nothing."""
    files = learned_files(LAW, None)
    (tmp_path / MODEL).write_text(str(files[MODEL]), encoding="utf-8")
    assert read_network(tmp_path / MODEL) == NETWORK
    assert str(files[MODEL]).startswith("# A law fitted") and "# From b.csv (sha256 ab12)." in str(files[MODEL])
    table = list(csv.reader(io.StringIO(str(learned_files(None, shown(LEAK, SQUEEZED))[TABLE]))))
    assert table[0][:3] == ["time [s]", "a loss of flow along B [m^3/s]", "sd of a loss of flow along B [m^3/s]"]
    leak = shown(LEAK).acting[0]
    np.testing.assert_allclose([float(r[1]) for r in table[1:]], leak.mean, atol=1e-8 * leak.rms)
    assert learned_files(None, None) == learned_files(None, shown()) == {}
    outcome = with_law(Outcome("unknown", "Something is missing.", "b.csv", "m.toml", "network"), LAW)
    assert outcome.sentence.startswith("Something is missing. A law fitted")
    assert verdict_json(outcome)["learned"]["formula"] == LAW.formula
    assert found().explains  # of the map that this is beside


def another(made: Made, hidden: tuple[Effect, ...], seed: int = 9) -> Record:
    """Another recording of the same wall with what is hidden in it: another rate, waveform and noise."""
    rng, case = np.random.default_rng(seed), replace(made.case, effects=hidden)
    beat = Beat(0.42, made.beat.K, made.beat.samples)
    heart = ejection(rng, beat, 1.0)
    drive = arteries(rng, beat, heart).pressure(heart, beat.omega)
    clean, _ = truth_channels(case, anatomy(made.base), made.nuisance, drive, beat)
    at = clock(rng, beat.T, 20)
    noise = {name: pulsatile(clean[name]) * 10.0 ** (-case.dB / 20.0) for name in case.names}
    channels = {n: measured(rng, at_phase(clean[n], at.phase), at, noise[n], beat.T) for n in case.names}
    return Record("another", "", at.time, channels, {})


def studied(folder: Path, same: bool) -> Outcome:
    """The record on disk of a wall with φ3, and another that is held out whole, of the same wall or of one without."""
    cubic = (Effect("cubic_rate", (SITE,), 2.0),)
    made = make(Case("bench", SITE, 40.0, cubic), 1)
    write(made, folder / "aa.csv")
    other = another(made, cubic if same else ())
    write_record(folder / "other.csv", other.time, other.channels, {f"{SITE}.P": "mmHg", f"{SITE}.R": "mm"})
    write_network(made.base, folder / "aa.toml")
    return discover(folder / "aa.csv", folder / "aa.toml", folder / "out", hold_out=[folder / "other.csv"])


@pytest.mark.deep
@pytest.mark.usefixtures("one_process")
def test_a_study_offers_the_law(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the record on disk: beside the partial name, a law in its place, its network and FMU, and its numbers; and
    that it is valid for another recording of the wall, at another rate."""
    few(monkeypatch, "nonlinear_wall_viscosity", "nonlinear_elasticity", "stress_relaxation", "channel_lag")
    outcome = studied(tmp_path, same=True)
    assert outcome.verdict == "partial" and outcome.learned is not None
    law = outcome.learned
    assert law.after[1] < 1.3 < law.before[1] and law.instead and law.explains
    ((before, after),) = law.elsewhere.values()
    assert after < 1.5 < before and "recordings that it has not seen" in outcome.sentence
    held = read_network(tmp_path / "out" / MODEL).segment(SITE).terms
    assert held["learned_cubic"] == law.parameters[f"{SITE}.learned_cubic"].value
    assert (tmp_path / "out" / "model_learned.fmu").stat().st_size > 0
    assert json.loads((tmp_path / "out" / "verdict.json").read_text())["learned"]["instead"] == list(law.instead)
    assert isinstance(law.network.parameters()[f"{SITE}.learned_cubic"], float) and not isinstance(law, Learnt)


@pytest.mark.endurance  # what it depends on: test_a_law_must_shrink_the_gap
@pytest.mark.usefixtures("one_process")
def test_a_law_that_another_recording_contradicts(tmp_path: Path) -> None:
    """Where the other recording is of a wall without the law, it is not offered."""
    assert studied(tmp_path, same=False).learned is None


@pytest.mark.deep
@pytest.mark.usefixtures("one_process")
def test_a_study_offers_tables_where_there_is_no_law(tmp_path: Path) -> None:
    """A flow of harmonics 3 to 6 that leaves at the outlet of C: unknown, there; the table's FMU leaves noise of the
    held-out beats, says that it explains nothing, and the network reads back."""
    rng = np.random.default_rng(4)
    a, b = np.zeros((2, 6))
    a[2:], b[2:] = 1.5e-6 * rng.normal(size=(2, 4))
    leaving = TableSource("outlet", "C", Curve.series("Q", 0.0, a, b, T))
    acting = exact(network=replace(NETWORK, sources=(leaving,)))
    noise = np.random.default_rng(1)
    noisy = {n: np.tile(w, 20) + 1e-2 * w.std() * noise.normal(size=20 * N) for n, w in acting.items()}
    write_record(tmp_path / "fork.csv", np.arange(20 * N) * (T / N), noisy, {n: _UNITS[n[-1]] for n in noisy})
    write_network(NETWORK, tmp_path / "fork.toml")
    outcome = discover(tmp_path / "fork.csv", tmp_path / "fork.toml", tmp_path / "out")
    assert outcome.verdict == "unknown" and outcome.learned is not None and not outcome.learned.explains
    assert not outcome.learned.is_law
    law = outcome.learned
    assert law.name == "table_source" and "C" in law.where and law.before[1] > 2.0 and law.after[1] < 1.3
    assert "describes this recording by tables over the beat" in outcome.sentence
    assert read_network(tmp_path / "out" / DESCRIBED) == law.network and (tmp_path / "out" / TABLE).exists()
    assert (tmp_path / "out" / "model_described.fmu").stat().st_size > 0 and not (tmp_path / "out" / MODEL).exists()
    assert json.loads((tmp_path / "out" / "verdict.json").read_text())["learned"]["explains"] is False


_UNITS = {"P": "mmHg", "Q": "mL/s", "R": "mm"}


@pytest.mark.endurance  # the same stages as of a bench, above; laws of a network: test_learned_wall.py
def test_a_study_of_a_network_offers_the_law(tmp_path: Path) -> None:
    """B with φ0 ε̇ + 4 φ0 ε̇³ by the generator's waves of a fork: unknown, in the wall of B, which has most of the gap;
    the law there leaves noise of the held-out beats in its FMU, which is the model that was inferred."""
    K, base = 24, anatomy(NETWORK)
    hidden = hide(base, Effect("cubic_rate", ("B",), 4.0))
    q = np.fft.rfft(inflow(np.arange(256) * (T / 256)), norm="forward")[: K + 1]
    channels = Balance(hidden, Beat(T, K, N * 2), 14).solve(q).channels
    turn = np.exp(2j * np.pi * np.outer(np.arange(N) / N, np.arange(K + 1)))
    names = ["inlet.Q", *(f"{s}.{k}" for s in "ABC" for k in "PQR")]
    waves = {n: 2.0 * (turn @ channels[n]).real - channels[n][0].real for n in names}
    rng = np.random.default_rng(1)
    noisy = {n: np.tile(w, 20) + 2e-3 * w.std() * rng.normal(size=20 * N) for n, w in waves.items()}
    units = {"P": "mmHg", "Q": "mL/s", "R": "mm"}
    write_record(tmp_path / "fork.csv", np.arange(20 * N) * (T / N), noisy, {n: units[n[-1]] for n in names})
    write_network(NETWORK, tmp_path / "fork.toml")
    outcome = discover(tmp_path / "fork.csv", tmp_path / "fork.toml", tmp_path / "out")
    assert outcome.verdict == "unknown" and outcome.learned is not None and outcome.map is not None
    share, law = outcome.map.acting[0].share, outcome.learned
    assert outcome.map.acting[0].place.key == ("wall", "B", None) and share is not None and share > 0.9
    assert law.where == ("B",) and law.formula == "σ = … + cubic ε̇³" and law.before[1] > 2.0 and law.after[1] < 1.3
    assert law.parameters["B.learned_cubic"].value == pytest.approx(4.0 * base.vessel("B").phi0, rel=0.05)
    assert read_network(tmp_path / "out" / MODEL) == law.network
    assert (tmp_path / "out" / "model_learned.fmu").stat().st_size > 0 and not (tmp_path / "out" / TABLE).exists()
