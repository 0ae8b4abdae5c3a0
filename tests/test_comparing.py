"""Which hypotheses are taken up again: beside the best, whatever the unit of their covariance."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from discrepancy.compare import Compared
from discrepancy.outcome import NamedEffect, OwnNumber, Walls
from discrepancy.show import Gap
from discrepancy.summary import _bent, sentence
from discrepancy.verdict import Naming, _said, _without, decided
from discrepancy.weigh import Named, shares
from fitting.estimate import Estimate
from fitting.inference.fit import Fit
from fitting.inference.misfit import Block
from fitting.inference.terms import Term
from fitting.inference.unknown import Unknown
from solver.coordinate import SHIFT


def named(effect: str, cost: float, log_volume: float) -> Named:
    """A hypothesis of one effect that leaves this cost beside ln det C."""
    nothing = np.zeros(1, int)
    fit = Fit((Term(effect, "A", ("A",), ()),), (), np.zeros(0), np.array([math.sqrt(cost)]), np.zeros((1, 0)),
              nothing, nothing, log_volume=log_volume)  # fmt: skip
    return Named(fit, fit.cost, 10.0)


# --- two faults of sensors --------------------------------------------------------------------------------------------

LAG, SLOW, GAIN = ("channel_lag", "A.P"), ("catheter_resonance", "A.R"), ("channel_gain", "B.P")
WALL = ("wall_viscosity", "A")


def pair(*effects: tuple[str, str]) -> Named:
    """A hypothesis of effects, each with its place."""
    one = named("none", 1.0, 0.0)
    return replace(one, fit=replace(one.fit, terms=tuple(Term(e, place, (place,), ()) for e, place in effects)))


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ((LAG, SLOW), "ambiguous"),
        ((LAG, ("channel_gain", "A.P")), "ambiguous"),
        ((LAG, GAIN), "several"),
        ((LAG, WALL), "several"),
        ((LAG,), "effect"),
    ],
)
def test_two_faults_at_one_site_are_no_discovery(effects: tuple[tuple[str, str], ...], expected: str) -> None:
    """Of the sensors of one site, or of one of them twice; those of two sites, or beside a wall, are."""
    assert _said(pair(*effects), (pair(*effects),)) == expected


@pytest.mark.parametrize("verdict", ["ambiguous", "partial"])
@pytest.mark.parametrize("others", [0, 1])
def test_two_faults_at_one_site_are_said(verdict: str, others: int) -> None:
    """Beside an error of the model, too, and beside another candidate: that they can imitate much else; of two sites
    it is not said. The model lacks nothing then."""
    gap = Gap((9.0, 9.0), {})

    def said(*effects: tuple[str, str]) -> str:
        best, problem = pair(*effects), None
        members = (best, *[pair(LAG, GAIN)] * others)
        naming = Naming(verdict, problem, best, (best,), members, {}, (), 0.9, "RMS 3")  # type: ignore[arg-type]
        return sentence(naming, tuple(NamedEffect(e, (place,), {}, 0.9) for e, place in effects), gap, gap)

    one = said(LAG, SLOW)
    assert "The sensors of one site seem to have two faults, which together can imitate much else: channel lag" in one
    assert "with both the gap" in one and "lacks" not in one
    assert ("but more than noise remains" in one) == (verdict == "partial")
    assert ("1 other candidate cannot be ruled out" in one) == (others == 1)
    assert "imitate" not in said(LAG, GAIN)


# --- beside what is found ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("own_chi2", "individual", "expected"),
    [(100.0, True, False), (30.0, True, True), (100.0, False, False)],
    ids=["walls that differ were not found", "walls that differ", "walls with all in common"],
)
def test_without_effect_is_no_farther_off_than_need_be(own_chi2: float, individual: bool, expected: bool) -> None:
    """χ² of 40 with walls in common: what a name gains is counted from there where the search for walls that differ
    ended at 100, and from these at 30."""
    own = Unknown("A.E of its own", SHIFT, (("A.E", 1.0),), -1.0, 1.0, group="E")

    def walls(hypothesis: Named, differ: bool) -> Named:
        return replace(hypothesis, fit=replace(hypothesis.fit, unknowns=(own,) if differ else ()))

    nones = [walls(replace(pair(), fit=replace(named("", chi2, 0.0).fit, terms=())), differ)
             for chi2, differ in ((40.0, False), (own_chi2, True))]  # fmt: skip
    best = walls(named("stenosis", 1.0, 0.0), individual)
    problem: Any = None
    assert _without(Compared(problem, tuple(nones), (best,), {}, ()), best).individual is expected


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

    kind, site, signals = "bench", "A", ("A.P", "A.R")

    def blocks(self, fit: Fit) -> list[Block]:
        return []


def test_nothing_explains_the_record_and_no_error_can_be_estimated() -> None:
    """Nothing is weighed: unknown, at even odds; among no hypotheses nothing has a share."""
    assert shares(()) == []
    problem: Any = Lawless()
    none, best = (replace(pair(*e), misfit=99.0) for e in ((), (WALL,)))
    naming = decided(Compared(problem, (none,), (best,), {}, ()), ())
    assert (naming.verdict, naming.confidence, naming.best) == ("unknown", 0.5, best)
    assert naming.reason is not None and "whitened RMS" in naming.reason
