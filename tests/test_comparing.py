"""Which hypotheses are taken up again: beside the best, whatever the unit of their covariance."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from discrepancy import thresholds as at
from discrepancy.assemble import _bent, sentence
from discrepancy.findings.outcome import NamedEffect, OwnNumber, Walls
from discrepancy.name import approximate
from discrepancy.name.approximate import Approximate
from discrepancy.name.intervals import _lower
from discrepancy.name.scoring import Compared, Named, choice, ranked, shares
from discrepancy.name.verdict import Naming, _discrepancy_candidates, _exact_verdict, _partial, decided
from discrepancy.show.fmu_validation import Gap
from fitting.inference.fit import Fit
from fitting.inference.hypothesis import EVERY, PlacedEffect
from fitting.results.estimate import Estimate
from solver import load
from solver.network.description import Site


def named(effect: str, cost: float, log_volume: float) -> Named:
    """A hypothesis of one effect that leaves this cost beside ln det C."""
    nothing = np.zeros(1, int)
    fit = Fit((PlacedEffect(effect, "A", ("A",), ()),), (), np.zeros(0), np.array([math.sqrt(cost)]), np.zeros((1, 0)),
              nothing, nothing, log_volume=log_volume)  # fmt: skip
    return Named(fit, fit.cost, 10.0)


# --- two faults of sensors --------------------------------------------------------------------------------------------

LAG, SLOW, GAIN = ("channel_lag", "A.P"), ("catheter_resonance", "A.R"), ("channel_gain", "B.P")
WALL = ("wall_viscosity", "A")
SHEEP = load("sheep")
NETWORK = replace(SHEEP, sites=(*SHEEP.sites, Site("root", SHEEP.inlet.segment, 0.0)))


def pair(*effects: tuple[str, str]) -> Named:
    """A hypothesis of effects, each with its place."""
    one = named("none", 1.0, 0.0)
    return replace(one, fit=replace(one.fit, terms=tuple(PlacedEffect(e, place, (place,), ()) for e, place in effects)))


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ((LAG, SLOW), "ambiguous"),
        ((LAG, ("channel_gain", "A.P")), "ambiguous"),
        ((LAG, GAIN), "several"),
        ((LAG, WALL), "several"),
        ((("catheter_resonance", "inlet.Q"), ("catheter_resonance", "root.P")), "ambiguous"),
        ((("catheter_resonance", "inlet.Q"), LAG), "several"),
        ((LAG,), "effect"),
    ],
)
def test_two_faults_at_one_site_are_no_discovery(effects: tuple[tuple[str, str], ...], expected: str) -> None:
    """Of the sensors of one site, or of one of them twice; those of two sites, or beside a wall, are. The meter of the
    inflow is at a site at the inlet."""
    assert _exact_verdict(pair(*effects), (pair(*effects),), NETWORK) == expected


@pytest.mark.parametrize("verdict", ["ambiguous", "partial"])
@pytest.mark.parametrize("others", [0, 1])
def test_two_faults_at_one_site_are_said(verdict: str, others: int) -> None:
    """Beside an error of the model, too, and beside another candidate: that they can imitate other effects; of two
    sites it is not said. The model lacks nothing then."""
    gap = Gap((9.0, 9.0), {})

    def said(*effects: tuple[str, str]) -> str:
        best, problem = pair(*effects), SimpleNamespace(network=NETWORK, accuracy=0.0)
        members = (best, *[pair(LAG, GAIN)] * others)
        naming = Naming(verdict, problem, best, (best,), members, {}, (), 0.9, "RMS 3")  # type: ignore[arg-type]
        return sentence(naming, tuple(NamedEffect(e, (place,), {}, 0.9) for e, place in effects), gap, gap)

    one = said(LAG, SLOW)
    assert "such a pair can imitate many other effects: channel lag" in one
    assert "with both the gap" in one and "lacks" not in one
    assert ("but more than noise remains" in one) == (verdict == "partial")
    assert ("1 other candidate cannot be ruled out" in one) == (others == 1)
    assert "imitate" not in said(LAG, GAIN)


@pytest.mark.parametrize(("kind", "other"), [("network", "branches or other physics"), ("bench", "other physics")])
def test_a_part_is_not_said_to_be_what_the_model_lacks(kind: str, other: str) -> None:
    """While more than noise remains, the effect itself may stand for something else; of one that explains all, no."""
    gap, best, problem = Gap((9.0, 9.0), {}), pair(WALL), SimpleNamespace(network=NETWORK, accuracy=0.0)

    def said(verdict: str) -> str:
        naming = Naming(verdict, problem, best, (best,), (best,), {}, (), 0.6, "RMS 3")  # type: ignore[arg-type]
        return sentence(naming, (NamedEffect(WALL[0], (WALL[1],), {}, 0.6),), gap, gap, kind=kind)

    assert said("partial").startswith("Something acts like ") and f"it may stand for {other} that" in said("partial")
    assert said("effect").startswith("The model lacks ") and "may stand" not in said("effect")


# --- beside what is found ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("verdict", "complete", "deviation", "expected"),
    [
        ("unknown", True, 9.0, True),
        ("effect", False, 9.0, True),
        ("effect", True, 9.0, False),
        ("unknown", True, 1.0, False),
    ],
)
def test_walls_that_may_be_bent(verdict: str, complete: bool, deviation: float, expected: bool) -> None:
    """Nine spreads off is this animal's where the record is explained; it may make up for what is missing where it is
    not, or where the search did not end. An ordinary wall is nothing to warn of."""
    problem: Any = None
    naming = Naming(verdict, problem, pair(), (), (), {}, (), 0.9, complete=complete)
    walls = Walls("individual", {}, {"A.E": OwnNumber(1.0, Estimate(1.1, "Pa", (1.0, 1.2)), deviation)})
    assert _bent(walls, naming) is expected


class Lawless:
    """A bench on which no wall law holds where the hypotheses ended: no error of it can be estimated."""

    kind, site, signals, network, accuracy = "bench", "A", ("A.P", "A.R"), NETWORK, 0.0


def test_nothing_explains_the_record_and_no_error_can_be_estimated() -> None:
    """Nothing is weighed: unknown, at even odds; among no hypotheses nothing has a share."""
    assert shares(()) == []
    problem: Any = Lawless()
    none, best = (replace(pair(*e), misfit=99.0) for e in ((), (WALL,)))
    naming = decided(Compared(problem, none, (best,), {}, ()), lambda n: None)
    assert (naming.verdict, naming.confidence, naming.best) == ("unknown", 0.5, best)
    assert naming.reason is not None and "whitened RMS" in naming.reason


@pytest.mark.parametrize(("effects", "expected"), [((WALL,), "none"), ((WALL, GAIN), "ambiguous")])
def test_names_that_look_alike_share_their_probability(effects: tuple[tuple[str, str], ...], expected: str) -> None:
    """All explain the record, each effect at odds of 0.78 to 1 against none: one at 0.44 is not named; two have 0.61
    together, which is more than even, and share it."""
    problem: Any = Lawless()
    none = replace(pair(), misfit=1.0, score=100.0)
    named = tuple(replace(pair(each), misfit=1.0, score=100.5) for each in effects)
    naming = decided(Compared(problem, none, named, {}, ()), lambda n: None)
    assert naming.verdict == expected
    mine = (1.0 if expected == "none" else math.exp(-0.25)) / (1.0 + len(effects) * math.exp(-0.25))
    assert naming.confidence == pytest.approx(mine, rel=1e-12)


def test_a_name_is_one_whatever_its_sizes() -> None:
    """Stiffer walls of one size, and with a size for each wall, are one name: it has the probability of both, and is
    alone in the class; the fit of the better one stays."""
    problem: Any = Lawless()
    one, each = (
        replace(named, fit=replace(named.fit, terms=tuple(replace(t, where=("all",)) for t in named.fit.terms)))
        for named in (
            replace(pair((WALL[0], place)), misfit=1.0, score=score) for place, score in (("all", 90.0), (EVERY, 91.0))
        )
    )
    none = replace(pair(), misfit=1.0, score=95.0)
    naming = decided(Compared(problem, none, ranked([each, one]), {}, ()), lambda n: None)
    weights = [math.exp(-0.5 * score) for score in (90.0, 91.0, 95.0)]
    assert naming.verdict == "effect" and naming.best.key == one.key and len(naming.members) == 1
    assert naming.confidence == pytest.approx(sum(weights[:2]) / sum(weights), rel=1e-12)


def test_both_of_a_pair_are_weighed_alone() -> None:
    """A pair explains the record; each of its members is also held with an error of the model, however far down the
    list, and of the others the most probable few."""
    problem: Any = Lawless()
    single = [replace(pair((f"effect_{i}", "A")), misfit=9.0, score=float(i)) for i in range(at.FEW + 4)]
    both = replace(pair(("effect_0", "A"), (f"effect_{at.FEW + 2}", "A")), misfit=1.0, score=-9.0)
    none = replace(pair(), misfit=99.0, score=99.0)
    held = _discrepancy_candidates(Compared(problem, none, (both, *single), {}, ()), [both])
    assert [n.label for n in held[1:]] == [f"effect_{i} at A" for i in (*range(at.FEW), at.FEW + 2)]
    assert held[0] is none


def test_a_network_weighs_beside_free_sources_what_may_be_named() -> None:
    """Where nothing explains the record: no effect, the most probable effect, and of the others those that close half
    of the gap; where the best explains it, no effect and that one."""
    problem: Any = Lawless()
    problem.site = None
    none, left = replace(pair(), misfit=99.0, score=99.0), (0.9, 0.3, 0.8, 0.49)
    single = [replace(pair((f"effect_{i}", "A")), misfit=9.0, score=float(i)) for i in range(len(left))]
    single = [replace(n, fit=replace(n.fit, z=of * none.fit.z)) for n, of in zip(single, left, strict=True)]
    found = Compared(problem, none, tuple(single), {}, ())
    assert [n.label for n in _discrepancy_candidates(found, [])] == [
        none.label,
        *(f"effect_{i} at A" for i in (0, 1, 3)),
    ]
    assert _discrepancy_candidates(found, [single[0]]) == [none, single[0]]


def test_less_than_half_of_the_gap_is_no_part() -> None:
    """An effect that leaves 0.6 of the whitened residual closes 0.4 of the gap: unknown, with what comes nearest."""
    problem: Any = Lawless()
    none, wall = pair(), pair(WALL)
    wall = replace(wall, fit=replace(wall.fit, z=0.6 * none.fit.z))
    unknown = Naming("unknown", problem, none, (wall,), (), {}, (), 0.3)
    naming = _partial(unknown, Compared(problem, none, (wall,), {}, ()), (replace(wall, errors=np.ones(1)),), ())
    assert (naming.verdict, naming.confidence) == ("unknown", 0.7)
    assert naming.reason is not None and "comes nearest, but more remains: whitened RMS 0.6" in naming.reason


def test_a_name_that_explains_is_not_lost_to_one_that_closes_nothing() -> None:
    """An offset leaves only noise; a wall closes 0.4 of the gap and its model error the rest, at lower cost. The offset
    is named; alone, the wall would be nothing but what comes nearest."""
    problem: Any = Lawless()
    zero, wall, none = pair(("channel_offset", "B.P")), pair(WALL), replace(pair(), misfit=99.0, score=900.0)
    zero = replace(zero, misfit=1.0, score=100.0)
    wall = replace(wall, fit=replace(wall.fit, z=0.6 * none.fit.z), misfit=99.0, score=800.0)
    loose = (replace(wall, errors=np.ones(1), score=95.0), replace(none, errors=np.ones(1), score=110.0))
    found = Compared(problem, none, (zero, wall), {}, (), loose)
    naming = decided(found, lambda n: None)
    assert (naming.verdict, [n.label for n in naming.members]) == ("effect", [zero.label])
    naming = decided(replace(found, ranked=(wall,)), lambda n: None)
    assert naming.verdict == "unknown" and "comes nearest" in (naming.reason or "")


@pytest.mark.parametrize(("zero_left", "behind"), [(3.0, [0.0, 3.0]), (None, [0.0, -40.0])])
def test_odds_are_those_of_the_order(
    monkeypatch: pytest.MonkeyPatch, zero_left: float | None, behind: list[float]
) -> None:
    """Scores with model errors 0 and 3, by the noise alone 100 and 60: the former, by which they are in order. A fault
    that no record shows comes last, also if it leaves only noise and has no score with an error: then the latter."""
    wall, zero = replace(pair(WALL), score=100.0), replace(pair(LAG), score=60.0, shown=zero_left is not None)
    by = {id(n.fit): n for n in (wall, zero)}
    monkeypatch.setattr(approximate, "weighed", lambda problem, fit, terms: by[id(fit)])
    each = [Approximate(wall.fit, replace(wall, score=0.0)), Approximate(zero.fit)]
    if zero_left is not None:
        each[1] = Approximate(zero.fit, replace(zero, score=zero_left))
    problem: Any = Lawless()
    found = approximate._at_these_points(Compared(problem, pair(), (), {}, ()), each)
    assert [n.label for n in found.ranked] == [wall.label, zero.label]
    assert [n.above_best for n in found.ranked] == behind


def test_a_name_pays_for_the_choice_among_effects_and_places() -> None:
    """One of two effects, at one of its three places: a prior of 1/6, -2 ln of it."""
    terms = [PlacedEffect(*each, (), ()) for each in (("leak", "A"), ("leak", "B"), ("leak", "C"), WALL)]
    assert choice(terms[0], terms) == pytest.approx(2.0 * math.log(6.0), rel=1e-14)
    assert choice(terms[3], terms) == pytest.approx(2.0 * math.log(2.0), rel=1e-14)


# --- what a record cannot show ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lag", "expected"),
    [((1.0, "A.P"), ["channel_lag", "catheter_resonance"]), ((9.0, "A.P"), []), ((1.0, "B.P"), ["channel_lag"])],
)
def test_a_sensor_beyond_half_the_sampling_rate_is_of_a_class_at_most(
    lag: tuple[float, str], expected: list[str]
) -> None:
    """A catheter that rings at 140 Hz, sampled at 230 Hz, is more probable than a lag: it is no name, but beside the
    lag of the same sensor, which explains the record, too, it cannot be ruled out. The lag is then surely no sure name.
    Where no other fault of that sensor explains the record it does not count."""
    problem: Any = Lawless()
    misfit, channel = lag
    none = replace(pair(), misfit=99.0, score=200.0)
    late = replace(pair(("channel_lag", channel)), misfit=misfit, score=100.0)
    rings = replace(pair(("catheter_resonance", "A.P")), misfit=1.0, score=95.0, shown=False)
    found = Compared(problem, none, ranked([rings, late]), {}, ())
    naming = decided(found, lambda n: None)
    assert [n.fit.terms[0].effect for n in naming.members] == expected
    assert naming.best is not rings and (naming.verdict == "ambiguous") == (len(expected) > 1)
    if len(expected) > 1:
        assert naming.confidence < 0.2


@pytest.mark.parametrize(
    ("none", "lag", "verdict"), [(100.0, 98.0, "none"), (99.5, 95.0, "effect"), (99.0, 101.0, "none")]
)
def test_what_a_record_cannot_show_is_an_alias_where_nothing_is_missing(none: float, lag: float, verdict: str) -> None:
    """A resonance beyond half the sampling rate at score 97: its probability is that of the model without effect, which
    explains the record. A lag of that sensor is named only if it is more probable than both."""
    problem: Any = Lawless()
    late = replace(pair(("channel_lag", "A.P")), misfit=1.0, score=lag)
    rings = replace(pair(("catheter_resonance", "A.P")), misfit=1.0, score=97.0, shown=False)
    found = Compared(problem, replace(pair(), misfit=1.0, score=none), ranked([rings, late]), {}, ())
    naming = decided(found, lambda n: None)
    weight = {name: math.exp(-0.5 * score) for name, score in (("none", none), ("lag", lag), ("rings", 97.0))}
    nothing = (weight["none"] + weight["rings"]) / sum(weight.values())
    assert naming.verdict == verdict
    assert naming.confidence == pytest.approx(nothing if verdict == "none" else 1.0 - nothing, rel=1e-12)


@pytest.mark.parametrize(
    ("mine", "other", "taken"),
    [((9.0, True), (8.9, True), True), ((9.0, True), (8.99, True), False), ((9.0, False), (9.01, True), True),
     ((9.0, False), (8.99, False), False), ((9.0, False), (9.2, True), False)],
)  # fmt: skip
def test_which_of_two_searches_is_at_the_minimum(
    mine: tuple[float, bool], other: tuple[float, bool], taken: bool
) -> None:
    """One that gains less than 0.05 of the cost gains nothing; it is taken where it alone came to its end."""
    first, again = (replace(named("none", cost, 0.0).fit, converged=ended) for cost, ended in (mine, other))
    assert (_lower(first, [None, again]) is again) == taken
