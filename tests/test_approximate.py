"""Models that are only approximately right: each hypothesis with the model error that its own residual shows."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from test_first import N, beats, ejection, line
from test_nearest import FREE, bent, loop

from discrepancy import thresholds as at
from discrepancy.name.approximate import compared_first_model, compared_with_errors
from discrepancy.name.model_selection import name, name_together
from discrepancy.name.scoring import Compared
from discrepancy.name.verdict import Naming
from fitting.calibrate.network_calibration import calibrate
from fitting.first.fitted import ACCURACY, accuracy, spread
from fitting.first.model import first_model
from fitting.inference.fit import Member
from fitting.inference.hypothesis import PlacedEffect, candidates
from fitting.inference.joint.joint_record import Several
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.network_record import network_problem
from fitting.inference.runs import Runs
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.channels.noise import pulses
from solver import load
from solver.quantities.units import INFLOW, MMHG

T = 0.8
PER_ML = MMHG / 1e-6


def recorded(late: float, bump: float = 0.0, T: float = T) -> Beats:
    """A textbook tube with a Windkessel under beats of a duration, its flow ``late`` [s]. bump : as of :func:`tube`."""
    Q = ejection(T, 75e-6)
    P, _ = line(Q, T, 0.06 * PER_ML, 0.05, (0.06 * PER_ML, 1.0 * PER_ML), 1.2e-6 / MMHG)
    P = P + bump * P.std() * np.sqrt(2.0) * np.cos(10.0 * np.pi * np.arange(N) / N)
    return beats(T, 1, inlet_Q=np.roll(Q, round(late / T * N)), Ao_P=P)


@cache
def tube(late: float, bump: float = 0.0, T: float = T) -> tuple[NetworkProblem, tuple[PlacedEffect, ...]]:
    """The tube compared with the first model of its beats of T. bump : an error of the fifth harmonic of the pressure
    that no model has, as a fraction of the pulsation."""
    record, network = recorded(late, bump, T), first_model(recorded(late, bump)).network
    names = ("Ao.P",)
    problem = network_problem(record, network, names, prior=spread(network), accuracy=accuracy(network))
    return problem, candidates(network, (*names, INFLOW), None, spread(network).free)


@cache
def named(late: float, bump: float = 0.0, T: float = T) -> Naming:
    problem, terms = tube(late, bump, T)
    return name(problem, terms, Runs())


def delay(naming: Naming) -> float:
    """The delay [s] of the flow behind the pressure, by the best name, a lag of either."""
    (term,), fit = naming.best.fit.terms, naming.best.fit
    (lag,) = (u.moves[0][1] * x for u, x in zip(fit.unknowns, fit.x, strict=True) if u in term.unknowns)
    return -lag if term.place == "Ao.P" else lag


def test_the_accuracy_of_a_first_model_is_in_its_weights() -> None:
    """C' = C + (ACCURACY σ)² 1 at every harmonic, σ the rms of the pulsation; no other network has such an error."""
    problem, _ = tube(0.0)
    exact = NetworkProblem.of(problem.beats, problem.simulator, Member((), (), np.zeros(0)), 0.0 * problem.error)
    added = problem.target.covariance - exact.target.covariance
    assert added[1:].real.ravel() == pytest.approx(
        (ACCURACY * pulses(problem.beats, problem.signals)[0]) ** 2, rel=0.05
    )
    assert accuracy(problem.network) == ACCURACY and accuracy(load("sheep")) == 0.0


@pytest.mark.deep
@pytest.mark.parametrize("late", [0.02, -0.02])
def test_a_late_flow_is_named(late: float) -> None:
    """One pressure cannot tell a late flow from an early pressure: the class holds both and nothing else. Size within 3
    ms, as the first model's tube takes up a part."""
    naming = named(late)
    assert naming.verdict == "ambiguous"
    assert {n.label for n in naming.members} == {f"channel_lag at {c}" for c in ("Ao.P", INFLOW)}
    assert delay(naming) == pytest.approx(late, abs=0.003)
    assert naming.confidence <= at.SUREST["partial"]


@pytest.mark.parametrize("bump", [pytest.param(0.0, marks=pytest.mark.deep), 0.003])
def test_nothing_is_missing_within_the_accuracy(bump: float) -> None:
    """A true model, and one that lacks 0.3 % of the pulsation, several times the noise: nothing, with its accuracy."""
    naming = named(0.0, bump)
    assert (naming.verdict, naming.accuracy, naming.members) == ("none", ACCURACY, ())
    assert naming.confidence == at.SUREST["partial"]


@pytest.mark.deep
def test_recordings_with_a_late_flow() -> None:
    """Two heart rates: a late flow delays each pressure by the same time, as an early pressure does. The lag within 0.5
    ms of the truth (0.2; alone 2.4 and 1.1 ms); each recording alone and both together have the same class."""
    each = [tube(0.02), tube(0.02, T=0.6)]
    alone = [named(0.02), named(0.02, T=0.6)]
    whole = Several(tuple(problem for problem, _ in each), ("slow", "fast")).individual()
    naming = name_together(whole, alone, each[0][1], Runs())
    assert naming.verdict == "ambiguous"
    assert {n.label for n in naming.members} == {n.label for a in alone for n in a.members}
    assert delay(naming) == pytest.approx(0.02, abs=5e-4)


@pytest.mark.deep
def test_recordings_in_which_nothing_is_missing() -> None:
    """Two heart rates of the tube that the first model is."""
    each = [tube(0.0), tube(0.0, T=0.6)]
    whole = Several(tuple(problem for problem, _ in each), ("slow", "fast")).individual()
    naming = name_together(whole, [named(0.0), named(0.0, T=0.6)], each[0][1], Runs())
    assert (naming.verdict, naming.accuracy, naming.members) == ("none", ACCURACY, ())


@pytest.mark.deep
def test_what_no_law_has_is_unknown() -> None:
    """A tenth of the pulsation at one harmonic alone."""
    naming = named(0.0, 0.1)
    assert naming.verdict == "unknown" and not naming.base.explains and not naming.members


@pytest.mark.deep
def test_the_model_without_effect_is_that_of_a_calibration() -> None:
    """A real record that one tube does not explain, from bent walls: rms of both pressures within 0.3 mmHg of those of
    a calibration, whose priors differ; and the error that the residual shows, which the noise does not."""
    measured, network, problem = loop()
    last = compared_with_errors(Compared.of(problem, [bent()], {}, ()), Runs())
    found, (none,) = last, last.approximate
    calibrated = calibrate(align(measured), network, FREE)
    best = np.array([calibrated.rms[each] for each in problem.signals])
    assert problem.rms(found.none.fit.z) == pytest.approx(best, abs=0.3 * MMHG)
    assert none.errors is not None and not found.none.explains
    assert none.fit.chi2 == pytest.approx(len(none.fit.z), rel=0.3)


@pytest.mark.deep
def test_hypotheses_with_their_errors() -> None:
    """From one with an effect that leaves more than noise: each once, best first in ranks as in evidence, and the one
    with the least error of them all explains most."""
    problem, terms = tube(0.0, 0.1)
    (none,) = problem.individual().refit([()])
    assert none is not None
    lag = next(t for t in terms if t.label == "channel_lag at Ao.P")
    (fit,) = problem.individual().refit([(lag,)], none)
    assert fit is not None
    last = compared_with_errors(Compared.of(problem.individual(), [none, fit], {}, terms), Runs())
    keys = [n.key for n in last.approximate]
    assert len(set(keys)) == len(keys) and {"", lag.label} <= set(keys)
    assert [n.score for n in last.approximate] == sorted(n.score for n in last.approximate)
    assert [n.key for n in last.ranked] == [key for key in keys if key]
    scores = [n.score for n in last.approximate if n.key]
    assert [n.above_best for n in last.ranked] == pytest.approx([x - scores[0] for x in scores], abs=1e-9)
    assert last.complete


def test_time_is_over() -> None:
    """The model without effect is fitted, whatever the limit; the comparison is not complete."""
    problem, terms = tube(0.0, 0.1)
    (none,) = problem.individual().refit([()])
    assert none is not None
    last = compared_with_errors(Compared.of(problem.individual(), [none], {}, terms), Runs(deadline=-1.0))
    assert [n.key for n in last.approximate] == [""] and not last.complete


def test_one_that_leaves_a_little_more_than_noise_competes() -> None:
    """χ² within four standard deviations needs no error; what its low harmonics leave may be no noise all the same. It
    has no exact score then, but one as something else, of its price."""
    problem, terms = tube(0.0, 0.05)
    last = compared_first_model(problem.individual(), terms, Runs())
    none = last.none
    assert not none.explains and at.MISFIT < none.misfit < 4.0
    (own,) = (n for n in last.approximate if not n.key)
    assert own.errors is not None and not own.errors.any()
    assert own.score == pytest.approx(none.score + (at.SECOND - at.PART))
