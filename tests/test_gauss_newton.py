"""Searches of many hypotheses together, on problems of two unknowns whose least squares are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from fitting.inference.fit import Member
from fitting.inference.gauss_newton import Point, Rules, Search, Trial, continued, search
from fitting.inference.unknown import Unknown, penalty
from solver.quantities.coordinate import SHIFT

Array = np.ndarray

UNKNOWNS = tuple(Unknown(f"x{i}", SHIFT, ((f"v{i}", 1.0),), -50.0, 50.0, prior_sd=1e3) for i in range(2))
RULES = Rules(gain=0.02, fresh=4)


@dataclass
class Problem:
    """A residual z(x); counts the simulations without derivatives."""

    z: Callable[[Array], Array]
    simulated: int = 0

    def points(self, trials: Sequence[Trial]) -> list[Point | None]:
        self.simulated += sum(not len(t.by) for t in trials)
        return [Point(self.z(t.member.x), self.derivatives(t.member.x)[:, t.by]) for t in trials]

    def derivatives(self, x: Array) -> Array:
        return np.stack([(self.z(x + 1e-6 * e) - self.z(x)) / 1e-6 for e in np.eye(2)], axis=1)


def found(problem: Problem, start: Array, rules: Rules = RULES) -> Search:
    one = Search(Member((), UNKNOWNS, start), rules)
    search(problem.points, [one])
    return one


def test_a_linear_problem_takes_a_step() -> None:
    """z = A x - b: the least squares after one step no longer than the longest allowed, 2 in x, to the prior's 1e-6."""
    A, b = np.array([[2.0, 1.0], [0.0, 1.0], [1.0, -1.0]]), np.array([1.0, 0.5, 0.2])
    problem = Problem(lambda x: A @ x - b)
    one = found(problem, np.array([-0.3, 0.4]))
    assert one.converged and problem.simulated == 1
    np.testing.assert_allclose(one.x, np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-6)


def test_a_search_that_loses_its_derivatives_ends_where_it_is() -> None:
    """z = (10 (x1 - x0²), 1 - x0) from (-1.2, 1), whose valley takes more than four steps: where no derivatives can be
    found anew, a member beside it having no residual, the search ends below its start and has not failed."""

    class Lost(Problem):
        def points(self, trials: Sequence[Trial]) -> list[Point | None]:
            anew = [len(t.by) > 0 and t.before is not None for t in trials]
            return [None if lost else p for lost, p in zip(anew, super().points(trials), strict=True)]

    problem = Lost(lambda x: np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]))
    one = found(problem, np.array([-1.2, 1.0]))
    assert one.ended and not one.failed and not one.converged
    assert problem.simulated == RULES.fresh and one.cost < one.history[0]


def test_what_is_as_good_as_broken_down_says_nothing() -> None:
    """Beyond x0 = 1 the residual is 1e160, whose square overflows: shorter steps from where it was, and no warning."""

    def z(x: Array) -> Array:
        return np.array([x[0] - 1.5, x[1] - 1.0, 0.1 * x[0]]) * (1e160 if x[0] > 1.0 else 1.0)

    problem = Problem(z)
    one = found(problem, np.zeros(2))
    assert not one.failed and 0.0 < one.x[0] <= 1.0
    assert one.cost == pytest.approx(float(z(one.x) @ z(one.x)) + penalty(one.prior, one.x))
    assert one.cost < float(z(np.zeros(2)) @ z(np.zeros(2)))


def test_a_point_whose_neighbour_breaks_down_is_not_taken() -> None:
    """With derivatives in every step: the first one ends at x0 = 1, where the residual is small; beyond it is 1e160."""

    def z(x: Array) -> Array:
        return np.array([x[0] - 1.5, x[1] - 1.0, 0.1 * x[0]]) * (1e160 if x[0] > 1.0 else 1.0)

    start = np.array([-1.0, 1.0])
    one = found(Problem(z), start, replace(RULES, fresh=0))
    assert not one.failed and start[0] < one.x[0] < 1.0 and np.abs(one.here.J).max() == pytest.approx(1.0)


def test_gaussian_priors_and_bounds() -> None:
    """|A x - b|² + |x|²/s² with x1 at most 0.1: ridge regression of x0 with x1 held at its end, to 1e-9."""
    A, b, sd = np.array([[2.0, 1.0], [0.0, 1.0], [1.0, -1.0]]), np.array([1.0, 0.5, 0.2]), 0.5
    unknowns = [replace(u, prior_sd=sd, high=high) for u, high in zip(UNKNOWNS, (50.0, 0.1), strict=True)]
    one = Search(Member((), tuple(unknowns), np.zeros(2)), Rules(gain=1e-12, tails=np.inf))
    search(Problem(lambda x: A @ x - b).points, [one])
    assert one.converged and one.x[1] == 0.1
    assert one.x[0] == pytest.approx(A[:, 0] @ (b - 0.1 * A[:, 1]) / (A[:, 0] @ A[:, 0] + sd**-2), abs=1e-9)


def test_a_curved_valley() -> None:
    """H. H. Rosenbrock's function (Comput. J. 3 (1960) 175) from (-1.2, 1), J at every point: (1, 1) to 1e-5."""
    problem = Problem(lambda x: np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]))
    one = found(problem, np.array([-1.2, 1.0]), Rules(gain=1e-12))
    assert one.converged and all(np.diff(one.history) < 0.0)
    np.testing.assert_allclose(one.x, 1.0, atol=1e-5)


@pytest.mark.parametrize(("afar", "known", "simulated"), [(False, 0.0, 1), (True, 0.0, 4), (True, np.inf, None)])
def test_a_hopeless_search_ends(afar: bool, known: float, simulated: int | None) -> None:
    """The curved valley with 400 left at its bottom, where a hypothesis of cost 0 is known: one step; from
    afar for the four steps after which derivatives would be found anew. Without one known it goes to the end."""
    problem = Problem(lambda x: np.array([100.0 * (x[1] - x[0] ** 2), 10.0 * (1.0 - x[0]), 20.0]))
    one = Search(Member((), UNKNOWNS, np.array([-1.2, 1.0])), replace(RULES, afar=afar))
    search(problem.points, [one], known)
    assert problem.simulated == simulated or (simulated is None and problem.simulated > 8)
    assert one.converged == (known == np.inf)


def test_a_search_goes_on_from_derivatives_of_its_point() -> None:
    """The curved valley: its end has derivatives of its point only if they were computed there. A continued search then
    computes none; from updated ones it computes all, at the same point to 1e-3."""
    problem = Problem(lambda x: np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]))
    one = found(problem, np.array([-1.2, 1.0]))
    updated = one.fit(np.arange(2), np.zeros(2, int))
    assert not updated.derived
    again = continued(updated, RULES)
    search(problem.points, [again])
    assert again.here is not None
    np.testing.assert_allclose(again.here.J, problem.derivatives(again.x), atol=1e-3)
    whole = Search(Member((), UNKNOWNS, np.ones(2)), RULES)
    search(problem.points, [whole])
    fit = whole.fit(np.arange(2), np.zeros(2, int))
    assert fit.derived and not replace(fit, x=fit.x + 0.1).derived
    computed = list[int]()

    def counted(trials: Sequence[Trial]) -> list[Point | None]:
        computed.extend(len(t.by) for t in trials)
        return problem.points(trials)

    search(counted, [continued(fit, RULES)])
    assert not sum(computed)
