"""A calibration as prior: its directions, its file, and what a network problem makes of it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forked import NETWORK, N, T, clean, record

from discrepancy import discover, workflow
from discrepancy.find.study import Unusable
from discrepancy.findings.outcome import Outcome
from discrepancy.options import Asked
from fitting.calibrate.calibration_prior import read_prior
from fitting.first.options import FirstOptions
from fitting.inference.fit import Member
from fitting.inference.hierarchy import with_widths
from fitting.inference.hypothesis import CALIBRATION, Calibrated, along, candidates, deviations, possible
from fitting.inference.models.network_record import network_problem
from fitting.inference.unknown import values
from fitting.inference.unknown_text import parse_unknowns
from fitting.records.read.record import Record, read_record, write_record
from fitting.results.parameter_set import ParameterSet, Value, unit_of, write_set
from solver.network.files import write_network

TEXTS = ("all.E", "B.phi0", "C.phi0", "C.outlet.R_t")
COVARIANCE = np.array(
    [[0.04, 0.01, 0.0, 0.0], [0.01, 0.09, -0.02, 0.0], [0.0, -0.02, 0.02, 0.0], [0.0, 0.0, 0.0, 0.0025]]
)
MOVED = {"A.E": 7e5, "B.E": 8e5, "C.E": 11e5, "B.phi0": 11e3, "C.phi0": 16e3, "C.outlet.R_t": 0.25}


def calibrated() -> Calibrated:
    return along(parse_unknowns(TEXTS, NETWORK), COVARIANCE, NETWORK)


def plain(**changes: Any) -> dict[str, Any]:
    """The provenance of a calibration of the fork."""
    unknowns = {u.name: {"kind": u.kind, "moves": dict(u.moves)} for u in parse_unknowns(TEXTS, NETWORK)}
    kept = {"method": "network calibration", "network": "fork", "unknowns": unknowns}
    return {**kept, "covariance": COVARIANCE.tolist(), **changes}


def written(folder: Path, moved: dict[str, float] = MOVED, **changes: Any) -> Path:
    told = {name: Value(value, unit_of(name)) for name, value in moved.items()}
    write_set(ParameterSet("calibrated", told, {}, plain(**changes)), folder / "set.json")
    return folder / "set.json"


def test_directions_have_the_covariance() -> None:
    """Σ over unknowns of moves movesᵀ = S Σ Sᵀ, with S what the calibration's unknowns move: to round-off."""
    found = calibrated().unknowns
    names = [name for name in MOVED if not name.endswith("R_t")]
    moves = np.array([[dict(u.moves).get(name, 0.0) for name in names] for u in found if u.kind == "scale"])
    S = np.array([[dict(u.moves).get(name, 0.0) for u in parse_unknowns(TEXTS[:3], NETWORK)] for name in names])
    np.testing.assert_allclose(moves.T @ moves, S @ COVARIANCE[:3, :3] @ S.T, rtol=1e-12, atol=1e-16)
    (shift,) = (u for u in found if u.kind == "shift")
    assert dict(shift.moves) == {"C.outlet.R_t": pytest.approx(0.05)}


@pytest.mark.parametrize("end", ["low", "high"])
def test_directions_stay_in_the_ranges(end: str) -> None:
    """At either end of an unknown every variable is inside its range; none is far beyond the calibration."""
    known = NETWORK.parameter_quantities()
    for u in calibrated().unknowns:
        moved = values([u], np.array([getattr(u, end)]), NETWORK.parameters())
        for name, value in moved.items():
            q = known[name]
            assert q.low - 1e-9 * abs(q.low) <= value <= q.high * (1.0 + 1e-9), (u.name, name)


def test_factors_have_a_limit_as_other_nuisances() -> None:
    """A modulus 1000 times the file's may be in the range of its quantity, but it is no subject's. A factor ends at
    e^±2, or at 4 standard deviations of a calibration that is less certain than that."""
    for sd, most in ((0.3, 2.0), (1.0, 4.0)):
        (u,) = along(parse_unknowns(["C.phi0"], NETWORK), np.array([[sd**2]]), NETWORK).unknowns
        ends = [values([u], np.array([x]), NETWORK.parameters())["C.phi0"] for x in (u.low, u.high)]
        np.testing.assert_allclose(np.log(np.array(ends) / NETWORK.parameters()["C.phi0"]), [-most, most])


def test_what_was_calibrated_has_no_other_prior() -> None:
    """φ0 of B and C were asked for by themselves, E only in common: φ0 of A and E of all keep their stated spread; the
    common scale of E is the calibration's, those of φ0 and R_t, of which it moved a part, remain."""
    found = possible(NETWORK, calibrated())
    stated = {u.name for u in found} & {u.name for u in deviations(NETWORK)}
    assert {"A.E of its own", "B.E of its own", "A.phi0 of its own", "B.outlet.R_t of its own"} <= stated
    assert not {"B.phi0 of its own", "C.phi0 of its own", "C.outlet.R_t of its own"} & stated
    problem = network_problem(record(clean()), NETWORK, prior=calibrated())
    common = {u.name for u in problem.individual().hypothesis(()) if not u.group}
    assert "all.E" in {u.name for u in problem.hypothesis(())} and "all.E" not in common
    assert {"all.phi0", "all.outlet.R_t"} <= common


def test_the_width_of_its_prior_is_given() -> None:
    """E of B known to 0.2 % before, which a record of 1 % noise does not better: 0.20 % after, where a width that the
    record tells would be 0, with E of B as given and no interval at all. The other spreads are told by the record."""
    known = along(parse_unknowns(("B.E",), NETWORK), np.array([[0.002**2]]), NETWORK)
    problem = network_problem(record(clean(), 10, 0.01, 1), NETWORK, prior=known).individual()
    (fit,) = problem.refit([()])
    assert fit is not None
    fit = with_widths(fit)
    i = next(i for i, u in enumerate(fit.unknowns) if u.group == CALIBRATION)
    assert np.sqrt(fit.covariance[i, i]) == pytest.approx(1.0, abs=0.02)
    assert set(fit.widths) == {u.group for u in fit.unknowns} - {CALIBRATION, ""}


def test_of_an_outlet_that_is_replaced() -> None:
    """R_t of B and C were calibrated together, and B gets a Windkessel: R_t of C keeps its variance, 0.004, nothing
    moves R_t of B any more, and the network is simulated. Where directions went as a whole, that of C went, too."""
    covariance = np.array([[0.04, 0.0, 0.0], [0.0, 0.0025, 0.001], [0.0, 0.001, 0.004]])
    both = along(parse_unknowns(("all.E", "B.outlet.R_t", "C.outlet.R_t"), NETWORK), covariance, NETWORK)
    problem = network_problem(record(clean()), NETWORK, prior=both).individual()
    (windkessel,) = (t for t in candidates(NETWORK, ()) if t.rewires and t.place == "B")
    unknowns = problem.hypothesis((windkessel,))
    moves = [dict(u.moves).get("C.outlet.R_t", 0.0) for u in unknowns]
    assert sum(step**2 for step in moves) == pytest.approx(0.004, rel=1e-12)
    assert not {"B.outlet.R_t"} & {variable for u in unknowns for variable in u.variables}
    assert "all.outlet.R_t" not in {u.name for u in unknowns}
    x = np.array([0.5 if u.group else 0.0 for u in unknowns])
    (X,) = problem.observe([Member((windkessel,), unknowns, x)])
    assert X is not None and np.isfinite(X).all()


def test_a_file_read_back(tmp_path: Path) -> None:
    """Values are the network's, directions those of the covariance about them."""
    found = read_prior(written(tmp_path), NETWORK)
    parameters = found.network.parameters()
    assert {name: parameters[name] for name in MOVED} == MOVED
    assert parameters["A.phi0"] == NETWORK.parameters()["A.phi0"]
    assert [u.moves for u in found.calibrated.unknowns] == [u.moves for u in calibrated().unknowns]


def test_a_record_that_counts_twice(tmp_path: Path) -> None:
    """The record that was calibrated with, by its hash, is doubted in one sentence; another, or an unknown one, is not.

    A study says so among its warnings, here one that ends at once, for want of beats.
    """
    monday = Record("monday.csv", "ab12", np.zeros(2), {}, {})
    found = read_prior(written(tmp_path, sha256="ab12"), NETWORK)
    (doubt,) = found.doubts(monday)
    assert "calibrated with monday.csv itself" in doubt and doubt.startswith(f"{tmp_path / 'set.json'}: ")
    assert found.doubts(Record("friday.csv", "cd34", np.zeros(2), {}, {})) == ()
    assert read_prior(written(tmp_path), NETWORK).doubts(Record("", "", np.zeros(2), {}, {})) == ()
    made = {name: np.tile(wave, 3) for name, wave in clean().items()}
    write_record(tmp_path / "r.csv", np.arange(len(made["A.P"])) * T / N, made)
    write_network(NETWORK, tmp_path / "fork.toml")
    prior = written(tmp_path, sha256=read_record(tmp_path / "r.csv").sha256)
    outcome = discover(tmp_path / "r.csv", tmp_path / "fork.toml", tmp_path / "out", prior=prior)
    assert outcome.verdict == "unusable" and "calibrated with" in outcome.warnings[0]
    assert outcome.provenance["asked"]["prior"]["file"] == str(prior)


@pytest.mark.parametrize("removed", [True, False])
def test_a_file_that_is_gone_in_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, removed: bool) -> None:
    """Removed or written anew while the study is under way: it ends, and states the hash of what it began with."""
    write_record(tmp_path / "r.csv", np.arange(N) * T / N, clean())
    write_network(NETWORK, tmp_path / "fork.toml")
    prior = written(tmp_path)
    sha256 = hashlib.sha256(prior.read_bytes()).hexdigest()

    class Work:
        def __init__(self, *_: Any) -> None:
            pass

        def run(self) -> tuple[Outcome, None]:
            prior.unlink() if removed else prior.write_bytes(b"abc")
            return Outcome("none", "", "r.csv", "fork.toml", "network"), None

    monkeypatch.setattr(workflow, "check_record", lambda _: None)
    monkeypatch.setattr(workflow, "_Work", Work)
    outcome = discover(tmp_path / "r.csv", tmp_path / "fork.toml", tmp_path / "out", prior=prior)
    assert outcome.verdict == "none" and outcome.provenance["asked"]["prior"]["sha256"] == sha256
    told = json.loads((tmp_path / "out" / "verdict.json").read_text(encoding="utf-8"))
    assert told["provenance"]["asked"]["prior"] == {"file": str(prior), "sha256": sha256}


def test_no_file_for_a_record_of_no_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The calibration is read before the record is judged: a sentence, where the study ended in a traceback."""
    monkeypatch.setattr(workflow, "_read", lambda *_: Unusable("r.csv: it is too short."))
    write_network(NETWORK, tmp_path / "fork.toml")
    with pytest.raises(ValueError, match=r"no\.json: there is no such file"):
        discover("r.csv", tmp_path / "fork.toml", tmp_path / "out", prior=tmp_path / "no.json")


def test_what_was_asked_is_plain(tmp_path: Path) -> None:
    """By default, and with all that may be asked: a calibration has its file's hash, and means individual walls."""
    default = {"walls": "by evidence", "period": "found", "time_limit": {"value": 300.0, "unit": "s"}}
    assert Asked().plain == default
    small = Asked(first=FirstOptions(mass=7.0, distances={"FA": 0.1}, paths=("Ao,FA",))).plain["first"]
    assert small == {
        "mass": {"value": 7.0, "unit": "kg"}, "distances": {"FA": {"value": 0.1, "unit": "m"}}, "paths": ["Ao,FA"],
    }  # fmt: skip
    path = tmp_path / "set.json"
    path.write_bytes(b"abc")
    sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # of "abc", FIPS 180-2
    assert Asked(0.5, None, path, 5.0).plain == {
        "walls": "individual",
        "period": {"value": 0.5, "unit": "s"},
        "time_limit": {"value": 5.0, "unit": "s"},
        "prior": {"file": str(path), "sha256": sha256},
    }


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"method": "wall fit"}, "not the result of a calibration of a network"),
        ({"network": "sheep"}, "calibration of network sheep, not of fork"),
        ({"covariance": None}, "no covariance"),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "no covariance"),
        ({"unknowns": {"all.E": {"x": 0.1}}}, "no covariance"),
    ],
)
def test_wrong_files(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    """One sentence that begins with the file's name."""
    path = written(tmp_path, **changes)
    with pytest.raises(ValueError, match=said) as caught:
        read_prior(path, NETWORK)
    told = str(caught.value)
    assert told.startswith(f"{path}: ") and told.endswith(".") and "\n" not in told


def test_wrong_parameters(tmp_path: Path) -> None:
    """A parameter that the network has not; a covariance of one without value, or of the logarithm of 0; no parameter
    set at all."""
    with pytest.raises(ValueError, match=r"D\.E is no parameter of network fork"):
        read_prior(written(tmp_path, {**MOVED, "D.E": 1e6}), NETWORK)
    with pytest.raises(ValueError, match=r"covariance is of B\.phi0, which has no value"):
        read_prior(written(tmp_path, {n: v for n, v in MOVED.items() if n != "B.phi0"}), NETWORK)
    with pytest.raises(ValueError, match=r"B\.phi0 = 0 has no logarithm"):
        read_prior(written(tmp_path, {**MOVED, "B.phi0": 0.0}), NETWORK)
    (tmp_path / "other.json").write_text(json.dumps({"values": {}}), encoding="utf-8")
    with pytest.raises(ValueError, match="not a parameter set"):
        read_prior(tmp_path / "other.json", NETWORK)


def test_what_cannot_be_asked(tmp_path: Path) -> None:
    """Other walls, no time, common walls with a calibration, a calibration for a bench record: a sentence each."""
    path = written(tmp_path)
    for asked, said in (
        (Asked(walls="thick"), "must be common or individual"),
        (Asked(time_limit=0.0), "must be above 0 s"),
        (Asked(time_limit=float("inf")), "finite"),
        (Asked(walls="common", prior=path), "ask for one of the two"),
    ):
        with pytest.raises(ValueError, match=said):
            asked.check()
    bench = Record("r.csv", "", np.zeros(2), {"A.P": np.zeros(2), "A.R": np.zeros(2)}, {})
    with pytest.raises(ValueError, match=r"r\.csv has no inlet\.Q .*leave the calibration out"):
        Asked(prior=path).known(NETWORK, bench)
    assert Asked(prior=path).chosen == "individual" and Asked().chosen is None
