"""Which hypotheses are taken up again: beside the best, whatever the unit of their covariance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from discrepancy import thresholds as at
from discrepancy.compare import Compared, _firsts, along
from discrepancy.weigh import Named, ranked
from fitting.inference.fit import Fit
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term


def named(effect: str, cost: float, log_volume: float) -> Named:
    """A hypothesis of one effect that leaves this cost beside ln det C."""
    nothing = np.zeros(1, int)
    fit = Fit((Term(effect, "A", ("A",), ()),), (), np.zeros(0), np.array([math.sqrt(cost)]), np.zeros((1, 0)),
              nothing, nothing, log_volume=log_volume)  # fmt: skip
    return Named(fit, fit.cost, 10.0)


@pytest.mark.parametrize("log_volume", [-500.0, 0.0, 500.0])
def test_near_the_best_whatever_the_unit(log_volume: float) -> None:
    """Costs of 20, 40 and 80, and ln det C of -500, 0 and 500, as the unit has it: with the first two a second effect
    is tried, three times the best cost at most; along the segment up to thirty times, not at 700."""
    placed: list[str] = []

    class Problem:
        @staticmethod
        def placed(fit: Fit, term: Term) -> None:
            placed.append(term.effect)

    hypotheses = ranked([named(*each, log_volume) for each in (("a", 20.0), ("b", 40.0), ("c", 80.0), ("d", 700.0))])
    problem: Any = Problem()
    found = Compared(problem, (), hypotheses, {}, ())
    assert (at.BRANCH_COST, at.ALONG_COST) == (3.0, 30.0)
    assert [f.terms[0].effect for f in _firsts(found, set(), 6)] == ["a", "b"]
    assert along(found, Runs()) == [] and placed == ["a", "b", "c"]
