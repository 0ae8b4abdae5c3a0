"""Several recordings of one animal in `discover`: the joint model, what may be named, and which state to record next.

Records are of the independent generator (tests/states.py), but for the joint model, which is checked on a fork of three
vessels (tests/forked.py).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from forked import NETWORK, exact, record
from judged import few, value_of
from refused import refused
from rich.console import Console
from states import OTHER, REST, State, recorded
from truth.hide import Effect
from truth.records import Case
from typer.testing import CliRunner

import arterial_fmu.__main__
from arterial_fmu.cli.tables.study import gap_text, recordings_table
from discrepancy.assemble import ValidationRuns, _absorbed, sentence
from discrepancy.find.study import Study, prepare
from discrepancy.findings.recorded import Recorded
from discrepancy.findings.recorded import rows as rows_of
from discrepancy.name import model_selection
from discrepancy.name.confirmation import confirmed
from discrepancy.name.model_selection import name as name_one
from discrepancy.name.model_selection import name_together
from discrepancy.name.verdict import Naming
from discrepancy.plan.second_state import second_state, separations
from discrepancy.recordings import FreeRuns, Recordings, _named
from discrepancy.show.fmu_validation import Gap, Run, gap
from fitting.check.fmu_run import RunFailed
from fitting.inference.fit import Fit, Member
from fitting.inference.gauss_newton import Trial
from fitting.inference.joint.joint_record import Several
from fitting.inference.models.network_record import network_problem
from fitting.inference.runs import OutOfTime, Runs
from fitting.inference.unknown_text import parse_unknowns
from fitting.records.read.record import Record, write_record
from solver.network.files import read_network, write_network
from solver.quantities.units import MMHG

pytestmark = pytest.mark.usefixtures("one_process")

SITE = "CA"
RELAXATION = Case("bench", SITE, 27.0, (Effect("stress_relaxation", (SITE,), 0.006),))
BENT = Case("bench", SITE, 40.0, (Effect("nonlinear_elasticity", (SITE,), 2.0),))
HIGHER = {("B", "R_t"): 0.45, ("C", "R_t"): 0.25, ("B", "P_venous"): 300.0, ("C", "P_venous"): 300.0}


# --- the joint model --------------------------------------------------------------------------------------------------


@cache
def fork(varies: tuple[str, ...] = ("*.R_t", "*.P_venous")) -> Several:
    """Two recordings of a stiffer fork: under more flow R_t and the venous pressure are higher."""
    stiff = NETWORK.with_parameters({f"{s.name}.E": 1.1 * s.E for s in NETWORK.segments})
    other = stiff.with_parameters({f"{end}.outlet.{key}": x for (end, key), x in HIGHER.items()})
    beats = [record(exact(1.0, stiff), 8, 0.01, seed=1), record(exact(1.3, other), 8, 0.01, seed=2)]
    parts = tuple(network_problem(each, NETWORK) for each in beats)
    return Several(parts, ("rest", "effort"), varies, tuple((each, each) for each in beats))


@pytest.mark.parametrize("individual", [False, True])
def test_jacobian(individual: bool) -> None:
    """Derivatives of the joint residual are its central differences, to 2 %, at a point with an effect in it; those of
    a recording by what another has of its own are 0."""
    whole = fork().individual() if individual else fork()
    (term,) = (t for t in terms_of(whole) if t.label == "external_pressure at A")
    unknowns = whole.hypothesis((term,))
    x = 0.1 * np.random.default_rng(3).normal(size=len(unknowns))
    names = [u.name for u in unknowns]
    assert {"all.outlet.R_t of rest", "all.outlet.R_t of effort"} <= set(names) and "all.outlet.R_t" not in names
    assert sum("P_venous of" in name for name in names) == 2 and "A.P_ext" in names

    def z(at: np.ndarray) -> np.ndarray:
        trial = Trial(Member((term,), unknowns, at), np.arange(0), None, 0.0 * at)
        (point,) = whole.points([trial], Runs())
        assert point is not None
        return point.z

    (point,) = whole.points([Trial(Member((term,), unknowns, x), np.arange(len(x)), None, 0.0 * x)], Runs())
    assert point is not None
    size = np.array([u.typical_sd for u in unknowns])
    for i, name in enumerate(names):
        step = 0.01 * size[i] * np.eye(len(x))[i]
        difference = (z(x + step) - z(x - step)) / (0.02 * size[i])
        off = np.linalg.norm(point.J[:, i] - difference)
        assert off <= 0.02 * np.linalg.norm(difference) + 1e-9, name
        for label, rows in zip(whole.labels, whole.rows, strict=True):
            if " of " in name and "its own" not in name.rpartition(" of ")[2] and not name.endswith(f" of {label}"):
                assert not point.J[rows, i].any()


def terms_of(whole: Several) -> Sequence[Any]:
    from fitting.inference.hypothesis import candidates

    return candidates(whole.network, whole.first.signals)


def test_in_common_and_of_its_own() -> None:
    """E is found from both recordings, R_t and the venous pressure of each its own: what makes them, to 4 sd."""
    whole = fork()
    (found,) = whole.refit([()])
    assert found is not None and found.chi2 < 1.3 * len(found.z)
    sd = np.sqrt(np.diag(found.covariance))
    known = {u.name: (u, float(x), float(s)) for u, x, s in zip(found.unknowns, found.x, sd, strict=True)}
    for name, truth in (("all.E", np.log(1.1)), ("B+C.outlet.P_venous of rest", 0.0)):
        u, x, s = known[name]
        assert abs(x * u.moves[0][1] - truth) < 4.0 * s * u.moves[0][1]
    u, x, s = known["B+C.outlet.P_venous of effort"]
    assert u.moves[0][0] == "B.outlet.P_venous of effort" and abs(x * u.moves[0][1] - 300.0) < 4.0 * s * u.moves[0][1]
    alone = whole.of(found, 1)
    assert [u.name for u in alone.unknowns] == [u.name for u in whole.of(found, 0).unknowns]
    assert alone.x[[u.name for u in alone.unknowns].index("B+C.outlet.P_venous")] == x
    assert len(alone.z) == whole.rows[1].stop - whole.rows[1].start


def test_what_varies_is_a_number_of_the_network() -> None:
    refused(lambda: fork(("*.R2",)).added, "--varies *.R2", ["names no number of fork", "*.E"])


# --- naming -----------------------------------------------------------------------------------------------------------


@cache
def named(case: Case, seed: int, states: tuple[State, ...] = (REST, OTHER)) -> tuple[list[Study], list[Naming], Naming]:
    """Studies of the recordings, the naming of each, and that of all together."""
    studies = [prepare(each, case.network()) for each in recorded(case, seed, states)]
    alone = [name_one(s.problem, s.terms, Runs()) for s in studies]
    return studies, alone, name_together(whole_of(studies), alone, studies[0].terms, Runs())


def whole_of(studies: Sequence[Study]) -> Several:
    parts, beats = tuple(s.problem for s in studies), tuple((s.fitted, s.held_out) for s in studies)
    return Several(parts, tuple("ABC"[: len(parts)]), (), beats)


@pytest.mark.deep
def test_two_recordings_leave_one_name() -> None:
    """Relaxation at 27 dB: at rest alone a class of three, a lag of the pressure among it; with another rate and
    pressure it is named, and tau is in its interval of 4 sd, which is narrower than that of one recording."""
    _, (rest, _), found = named(RELAXATION, 1)
    assert rest.verdict == "ambiguous" and {"channel_lag", "stress_relaxation"} <= {t.effect for t in _all(rest)}
    assert found.verdict == "effect" and [t.effect for t in _all(found)] == ["stress_relaxation"] and found.complete
    (_, s), (both, sd) = _tau(rest), _tau(found)
    assert abs(both - 0.006) < 4.0 * sd and sd < 0.7 * s


def _all(naming: Naming) -> list[Any]:
    return [t for n in naming.members for t in n.fit.terms]


def _tau(naming: Naming) -> tuple[float, float]:
    """tau [s] and its standard deviation."""
    fit = next(n.fit for n in naming.members if n.fit.terms[0].effect == "stress_relaxation")
    i, u = next((i, u) for i, u in enumerate(fit.unknowns) if u.name.endswith(".tau"))
    value = value_of(u, float(fit.x[i]), float(np.sqrt(fit.covariance[i, i])))
    return value.value, 0.5 * (value.ci95[1] - value.ci95[0])


@pytest.mark.deep
def test_no_name_where_nothing_is_hidden() -> None:
    assert named(Case("bench", SITE, 40.0), 1)[2].verdict == "none"


@pytest.mark.deep
def test_what_pressure_tells() -> None:
    """A bent elasticity, one recording: none or a class; two at other pressures: its name."""
    _, alone, found = named(BENT, 2)
    assert [n.verdict for n in alone] == ["ambiguous", "none"] and found.verdict == "effect"
    assert _all(found)[0].effect == "nonlinear_elasticity"


@pytest.mark.deep
def test_time_that_is_over_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the model without effect is refitted to all: not complete, and no surer than not; before: no verdict."""
    studies, alone, _ = named(RELAXATION, 1)

    def over(*_: Any) -> Any:
        raise OutOfTime("over")

    monkeypatch.setattr(model_selection, "_refitted", over)
    found = name_together(whole_of(studies), alone, studies[0].terms, Runs())
    assert not found.complete and found.confidence <= 0.5
    with pytest.raises(OutOfTime):
        name_together(whole_of(studies), alone, studies[0].terms, Runs(deadline=time.monotonic() - 1.0))
    cut = [replace(n, complete=False) for n in alone]
    monkeypatch.undo()
    assert not name_together(whole_of(studies), cut, studies[0].terms, Runs()).complete


# --- the second state -------------------------------------------------------------------------------------------------


@pytest.mark.deep
def test_the_state_that_separates() -> None:
    """Of a bent wall and a springpot another pressure makes more than another rate, and recorded it does."""
    _, (one, _), found = named(BENT, 2)
    d = separations(one)
    assert min(d["mean pressure + 30 %"], d["mean pressure − 30 %"]) > 10.0 > d["heart rate × 1.5"]
    said = second_state(one)
    assert said.startswith("A second recording at mean pressure") and "nonlinear elasticity at CA from" in said
    assert second_state(found) == ""


@pytest.mark.deep
def test_no_state_separates() -> None:
    """Relaxation and a catheter that is as slow: the least d' counts, and the sentence says that none is enough."""
    said = second_state(named(RELAXATION, 1)[1][0])
    assert said.startswith("No second state that was simulated would separate the class (d′ below 6: ")
    assert "pulse pressure × 1.5" in said


def test_states_of_a_network() -> None:
    """Two hypotheses of a fork with walls of their own: an effect and none. The states are simulated; what varies is as
    uncertain as its prior again, so that no state separates better than where it were known."""
    sizes = []
    for varies in (("*.R_t",), ()):
        whole = fork(varies).individual()
        (term,) = (t for t in terms_of(whole) if t.label == "wall_viscosity at C")
        none, effect = whole.refit([(), (term,)])
        assert none is not None and effect is not None
        i = [u.name for u in effect.unknowns].index(term.unknowns[0].name)
        effect = replace(effect, x=np.where(np.arange(len(effect.x)) == i, 1.0, effect.x))
        naming: Any = type("N", (), {})()
        naming.problem, naming.members = whole, [type("M", (), {"fit": f, "label": "x at C"})() for f in (effect, none)]
        d = separations(naming)
        assert set(d) == {"heart rate × 1.5", "mean pressure + 30 %", "mean pressure − 30 %", "inflow × 1.5"}
        assert all(np.isfinite(each) and each > 0.0 for each in d.values())
        sizes.append(d)
    assert all(sizes[0][words] <= 1.001 * sizes[1][words] for words in sizes[0])


# --- what may be named ------------------------------------------------------------------------------------------------

BEFORE, AFTER = Gap((9.0, 5.0), {}), Gap((2.0, 1.2), {})


def one(label: str, fallen: float, d: float, fitted: bool = True) -> Recorded:
    """A recording whose χ² falls by so much, ± 10."""
    return Recorded(label, f"{label}.csv", "", 20, 0.5, fitted, (9.0, 5.0), {}, (2.0, 1.2), {}, d, fallen, 10.0)


@pytest.mark.parametrize(
    ("each", "words"),
    [
        ([one("A", 100.0, 20.0), one("B", 50.0, 20.0)], None),
        ([one("A", 100.0, 20.0), one("B", 5.0, 11.0)], None),  # hardly seen there
        ([one("A", 100.0, 20.0), one("B", 5.0, 12.0)], "in B chi2 falls by 5"),
        ([one("A", 100.0, 20.0), one("B", -17.0, 1.0)], "in B chi2 rises by 17"),
        ([one("A", 11.0, 5.0), one("B", 11.0, 5.0)], "over A, B chi2 falls by 22"),
        ([one("A", 100.0, 20.0), one("C", 100.0, 20.0, False)], None),
        ([one("A", 100.0, 20.0), one("C", 3.0, 5.0, False)], "over C chi2 falls by 3"),
        ([one("A", 100.0, 20.0), one("C", 90.0, 20.0, False), one("D", -20.0, 9.0, False)], "in D chi2 rises by 20"),
    ],
)
def test_the_rule_of_several(each: Sequence[Recorded], words: str | None) -> None:
    """χ² of held-out beats falls over all, in each that shows the effect, and rises in none; held-out ones likewise. In
    a gap of noise nothing is missing unless it does."""
    naming = named(RELAXATION, 1)[2]
    found = confirmed(naming, each, BEFORE, AFTER)
    if words is None:
        assert found is naming
    else:
        assert found.verdict == "unknown" and words in (found.reason or "") and found.confidence <= 0.5
    small = Gap((1.0, 0.9), {})
    nothing = confirmed(naming, each, small, AFTER)
    if words is None:
        assert nothing is naming
        return
    assert nothing.verdict == "none" and "no more than noise" in (nothing.reason or "")
    assert sentence(nothing, (), small, None).startswith("Nothing is missing that held-out beats show: ")


def test_names_of_own_numbers_are_whole() -> None:
    """A name longer than its column goes on in the next line."""
    each = replace(one("effort", 1.0, 1.0), rms_after={"CA.P": 100.0}, own={"CA.outlet.P_venous": 700.0})
    outcome: Any = SimpleNamespace(recordings=(each,))
    with (console := Console(width=60)).capture() as said:
        console.print(recordings_table(outcome))
    assert "…" not in said.get() and "5.25" in said.get()


def test_own_numbers_are_of_the_model_that_stands() -> None:
    """Where the FMUs do not bear the name out, a recording's own numbers are those without the effect."""
    each = replace(one("A", 3.0, 20.0), own={"CA.E": 2e6}, own_before={"CA.E": 1e6})
    runs = [Run(np.zeros((1, 1)), {}, gap) for gap in (BEFORE, AFTER)]
    several: Any = SimpleNamespace(each=lambda *_: ([(each, *runs)], []), warnings=(), alone=False, studies=())
    base: Any = object()
    naming, shown = Recordings.judged(several, named(RELAXATION, 1)[2], base, FreeRuns(base, base, runs))
    (found,) = shown.recordings
    assert naming.verdict == "unknown" and shown.after is None and shown.gaps is not None and shown.gaps[1] is None
    assert found.own == {"CA.E": 1e6} and found.gap_after is None


def test_own_numbers_stand_beside_their_own_prior() -> None:
    """A venous pressure that recordings have of their own moves in Pa, with a prior in Pa or none: not one of 1 Pa, of
    which a change by 1.4 mmHg would be 190 spreads."""
    unknowns = parse_unknowns(["C.outlet.P_venous:2 mmHg", "B.outlet.P_venous:none", "all.E:0.2"], NETWORK)
    fit = Fit((), unknowns, np.array([-190.0, 7.0, 0.1]), np.zeros(3), np.eye(3), *2 * [np.zeros(3, int)])
    found = _absorbed(fit)
    assert [each.prior_sd for each in found] == pytest.approx([2.0 * MMHG, 0.0, 0.2])
    assert [each.x for each in found] == [-190.0, 7.0, 0.1] and not any(each.far for each in found)


def test_an_fmu_that_does_not_run_bears_no_name_out() -> None:
    """The record is as good as it was: the name is withdrawn with the FMU's sentence, and the numbers of the model
    without it stay. Of two recordings, one that fails is enough."""
    ran, failed = (
        one("A", 100.0, 20.0),
        replace(one("B", 0.0, 0.0), gap_after=None, failed="its FMU does not run: supercritical."),
    )
    runs = [Run(np.zeros((1, 1)), {}, gap) for gap in (BEFORE, AFTER)]
    base: Any = object()

    def judged(each: list[tuple[Recorded, Run, Run | None]]) -> tuple[Naming, ValidationRuns]:
        several: Any = SimpleNamespace(each=lambda *_: (each, []), warnings=(), alone=False, studies=())
        return Recordings.judged(several, named(RELAXATION, 1)[2], base, FreeRuns(base, base, runs))

    for each in ([(failed, runs[0], None)], [(ran, *runs), (failed, runs[0], None)]):
        naming, found = judged(each)
        assert naming.verdict == "unknown" and naming.confidence <= 0.5
        assert found.before is runs[0] and found.after is None and found.gaps == (found.before.gap, None)
        assert not found.warnings
        assert "cannot be judged: its FMU does not run: supercritical." in (naming.reason or "")
    stands_in = [(failed, replace(runs[0], stands_in="the file as it is"), None)]  # for that without effect
    (said,) = judged(stands_in)[1].warnings
    assert "supercritical. The gap is that of the file as it is" in said


def test_walls_with_which_no_fmu_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit without effect has walls with which the FMU breaks down: its periodic solution takes the place of the
    run, and the effect is judged against it. Without a solution the run of the file does, and nothing of an effect is
    run; an effect whose FMU breaks down leaves the run without it."""
    (study, *_), (naming, *_), _ = named(RELAXATION, 1)
    own = Recordings((Record("a.csv", "ab", np.zeros(1), {}, {}),), (study,))
    X = study.problem.repeated(study.fitted, study.fitted, study.problem.K)
    fit, run = naming.base.fit, Run(X, {}, gap(study, X))

    def breaks(*_: object) -> Run:
        raise RunFailed("x.fmu: supercritical.")

    def through(before: Any, after: Any, given: Sequence[Run]) -> tuple[Recorded, Run, Run | None]:
        return own._through(0, study, fit, naming.best.fit, FreeRuns(before, after, given))

    recorded, first, last = through(breaks, pytest.fail, [run])  # a bench has no such solution
    assert first.stands_in == "the file as it is" and np.array_equal(first.X, X) and last is None
    monkeypatch.setattr(type(study.problem), "answer", lambda *_: 0.5 * X)
    recorded, first, last = through(breaks, lambda *_: run, [])
    assert (
        np.array_equal(first.X, 0.5 * X)
        and first.stands_in == "the periodic solution"
        and last is run
        and recorded.gap_after == run.gap.total
    )
    assert "with the walls that were fitted: x.fmu" in recorded.failed
    assert confirmed(naming, [recorded], first.gap, run.gap) is naming
    monkeypatch.undo()
    with pytest.raises(RunFailed):
        through(breaks, pytest.fail, [])
    recorded, first, last = through(lambda *_: run, breaks, [])
    assert first is run and last is None and "its FMU does not run with this record: x.fmu" in recorded.failed


def test_all_is_all() -> None:
    """Numbers that are the same are said together; as those of all only where no other differs."""
    two = {"B.outlet.P_venous": 133.322, "C.outlet.P_venous": 133.322}
    (row,) = rows_of([replace(one("A", 1.0, 1.0), own=two)])
    assert row[-1] == "all.outlet.P_venous 1 mmHg"
    (row,) = rows_of([replace(one("A", 1.0, 1.0), own=two | {"A.outlet.P_venous": 266.645})])
    assert row[-1] == "B+C.outlet.P_venous 1 mmHg, A.outlet.P_venous 2 mmHg"


def test_rms_beside_a_gap_of_all_is_not_of_one() -> None:
    """The gap is over both recordings, so that no RMS of the first stands beside it; of one that was fitted it does."""
    channel = SimpleNamespace(name="CA.P", gap_before=(9.0, 5.0), rms_before=(300.0, 300.0), rms_after=None)
    each = [one("A", 1.0, 1.0), one("B", 1.0, 1.0), one("C", 1.0, 1.0, False)]
    outcome: Any = SimpleNamespace(gap_before=(9.0, 5.0), gap_after=None, channels=(channel,), provenance={})
    outcome.recordings = each[::2]
    assert "held-out beats; rms with the means: 2.3 mmHg of CA.P" in gap_text(outcome)
    outcome.recordings = each
    assert "rms 2.3" not in gap_text(outcome)


# --- the command ------------------------------------------------------------------------------------------------------


def written(folder: Path, case: Case, states: Sequence[State]) -> None:
    for each in recorded(case, 1, states):
        units = {"P": "mmHg", "R": "mm", "Q": "mL/s"}
        write_record(folder / each.path, each.time, each.channels, {n: units[n[-1]] for n in each.channels})
    write_network(case.network(), folder / "base.toml")


# of the whole catalogue test_two_recordings_leave_one_name finds the same
FEW = ("nonlinear_elasticity", "nonlinear_wall_viscosity", "stress_relaxation", "catheter_resonance", "channel_lag")


@pytest.fixture
def among_few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches among few effects."""
    few(monkeypatch, *FEW)


def discovered(folder: Path, *more: object) -> Any:
    line = ["discover", folder / "A.csv", "--model", folder / "base.toml", "--out", folder / "out", *more]
    return CliRunner(env={"COLUMNS": "160"}).invoke(arterial_fmu.__main__.app, [str(each) for each in line])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("several")
    written(path, RELAXATION, (REST, OTHER, State(0.4, -15.0, 0.9)))
    text = (path / "B.csv").read_text().splitlines()
    rows = [[float(x) for x in line.split(",")] for line in text[1:]]
    (path / "big.csv").write_text(
        "\n".join([text[0], *(f"{t},{P},{4.0 + 9.0 * (R - 4.0)}" for t, P, R in rows)]) + "\n"
    )
    (path / "P.csv").write_text("\n".join(",".join(line.split(",")[:2]) for line in text) + "\n")
    (path / "Q.csv").write_text(
        "\n".join([text[0] + ",inlet.Q [mL/s]", *(f"{line},{line.split(chr(44))[1]}" for line in text[1:])]) + "\n"
    )
    return path


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        (["--varies", "*.E"], 2, "--varies *.E: there is one recording; give others with --and."),
        (["--and", "B.csv", "--varies", "*.outlet.R2"], 2, "--varies *.outlet.R2: it names no number of"),
        (["--and", "Q.csv"], 2, "it has no inlet.Q, which"),
        (["--and", "P.csv"], 3, "it has CA.P, but no inlet.Q"),
        (["--and", "no.csv"], 2, "no.csv"),
        (["--and", "big.csv", "--as-measured"], 3, "big.csv: the pulse of CA.R is"),
        (["--and", "B.csv", "--with", "C.csv"], 2, "--with: adds files to one recording"),
    ],
)
def test_refused(folder: Path, more: Sequence[str], code: int, words: str) -> None:
    """One sentence, before any search: what varies must be a number, and each recording fit for the comparison."""
    done = discovered(folder, *(folder / each if each.endswith(".csv") else each for each in more))
    assert done.exit_code == code and words in " ".join(done.output.split()), done.output


OF_NO_USE: Sequence[tuple[str, str, Callable[[float], float], str]] = (
    ("flat", "CA", lambda P: 80.0, "column 'CA.P [mmHg]': the channel is constant"),
    ("kPa", "CA", lambda P: P / 7.5, "CA.P: its mean is 10.6 mmHg"),
    ("other", "VA1", lambda P: P, "it is of VA1, and"),
)


@pytest.mark.deep
@pytest.mark.usefixtures("among_few")
def test_what_cannot_be_judged_is_said(folder: Path) -> None:
    """Recordings held out that are of no use leave the verdict of the others: one sentence for each says why."""
    head, *lines = (folder / "C.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines]
    held_out: list[object] = []
    for name, title, pressure, _ in OF_NO_USE:
        text = [head.replace("CA.", f"{title}."), *(f"{t},{pressure(float(P))},{R}" for t, P, R in rows)]
        (folder / f"{name}.csv").write_text("\n".join(text) + "\n")
        held_out += ["--hold-out", folder / f"{name}.csv"]
    done = discovered(folder, *held_out, "--time-limit", "20 s")
    assert done.exit_code == 0
    warnings = json.loads((folder / "out" / "verdict.json").read_text())["warnings"]
    for name, *_, words in OF_NO_USE:
        (said,) = (s for s in warnings if f"{name}.csv" in s)
        assert said.startswith(f"{folder / name}.csv: it was held out and cannot be compared: {words}")


@pytest.mark.deep
@pytest.mark.usefixtures("among_few")
def test_waves_of_another_animal_are_not_judged(folder: Path) -> None:
    """A recording held out whose radius is nine times the model's is refused as one that is fitted is; a law is still
    looked for, as one recording is fitted."""
    done = discovered(folder, "--hold-out", folder / "big.csv", "--as-measured", "--time-limit", "20 s")
    (said,) = (s for s in json.loads((folder / "out" / "verdict.json").read_text())["warnings"] if "big.csv" in s)
    assert done.exit_code == 0 and "it was held out and cannot be compared" in said and "the pulse of CA.R is" in said


def test_a_search_without_time_loses_no_other() -> None:
    """Where the time was over before one recording was refitted: how far the model is from it, and not complete."""
    study = prepare(recorded(RELAXATION, 1)[0], RELAXATION.network())
    found = _named(name_one, study, Runs(deadline=0.0, clock=lambda: 1.0), None)
    assert found.verdict == "unknown" and not found.complete and found.ranked == (found.base,)
    assert found.base.fit.terms == () and np.isfinite(found.base.fit.cost)


@pytest.mark.deep
@pytest.mark.usefixtures("among_few")
def test_command(folder: Path) -> None:
    """Alone: a class, and which second state would separate it. With B, and C held out: the name, what is left of each
    recording, E of each, and an FMU."""
    done = discovered(folder)
    told = json.loads((folder / "out" / "verdict.json").read_text())
    assert done.exit_code == 0 and told["verdict"] == "ambiguous" and told["recordings"] == {}
    assert "second state" in told["separating_measurement"] and "second state" in " ".join(done.output.split())
    assert "second state" in (folder / "out" / "report.html").read_text()
    more = ["--and", folder / "B.csv", "--hold-out", folder / "C.csv", "--varies", "*.E", "--jobs", "1"]
    done = discovered(folder, *more)
    told = json.loads((folder / "out" / "verdict.json").read_text())
    assert done.exit_code == 0 and told["verdict"] == "effect", done.output
    assert told["effects"][0]["name"] == "stress_relaxation" and told["complete"]
    assert list(told["recordings"]) == ["A", "B", "C"] and told["provenance"]["asked"]["varies"] == ["*.E"]
    assert [each["fitted"] for each in told["recordings"].values()] == [True, True, False]
    E = [each["own"][f"{SITE}.E"]["value"] for each in told["recordings"].values()]
    assert len(set(E)) == 3 and np.ptp(E) < 0.05 * E[0]  # the same artery
    for each in told["recordings"].values():
        assert each["gap"]["after"]["held_out"] < 0.5 * each["gap"]["before"]["held_out"]
        assert each["chi2_falls"]["value"] > 3.0 * each["chi2_falls"]["sd"] and each["d_prime"] > 12.0
    page = (folder / "out" / "report.html").read_text()
    assert "Each recording" in page and "C, not fitted" in page and "C, not fitted" in done.output
    assert read_network(folder / "out" / "model.toml").parameters()[f"{SITE}.E"] == pytest.approx(E[0], rel=1e-6)
    assert (folder / "out" / "model.fmu").exists()
