"""Intervals of effects that were searched for: given that they were found."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from forked import NETWORK, clean, record
from scipy.special import ndtr, ndtri
from small_network import term

from discrepancy import thresholds
from discrepancy.name.intervals import conditioned, reach, stated
from discrepancy.name.scoring import Named, found_from, price
from discrepancy.name.verdict import Naming, both_show
from fitting.inference.extended_network import estimates
from fitting.inference.fit import Fit
from fitting.inference.hierarchy import LOG_RANGE
from fitting.inference.jackknife import without_groups
from fitting.inference.models.network_record import network_problem
from fitting.inference.unknown import quantile
from fitting.results.estimate import Estimate

HALF = 1.959963984540054
THRESHOLD = 4.7  # d' from which an effect is found


# --- given that it was found ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
def test_coverage_of_what_was_found(size: float) -> None:
    """x ~ N(size, 1), told where |x| > 4.7: the interval holds the size in 95 ± 1 % of 5000 (± 0.3 % is chance).

    Below the threshold in 97.5 %: it never ends below the value that is told, which is too large then.
    x ± 1.96 would hold a size of 2 never, and one of 5 in 96 %.
    """
    u = np.random.default_rng(int(size)).uniform(size=5000)
    x = size - ndtri(u * ndtr(size - THRESHOLD))  # above the threshold; below -4.7 it is with 1e-11
    assert x.min() > THRESHOLD
    ends = np.array([reach(d, THRESHOLD, HALF) for d in x])
    held = np.mean((x - ends[:, 0] <= size) & (size <= x + ends[:, 1]))
    assert held == pytest.approx(0.95 if size > THRESHOLD else 0.975, abs=0.01)


def test_far_above_the_threshold_selection_does_nothing() -> None:
    """± 1.96 from four standard deviations above it, and to 2 % at three and a half."""
    for d in (8.75, 20.0, 1000.0):
        assert reach(d, THRESHOLD, HALF) == (HALF, HALF)
    assert reach(THRESHOLD + 3.5, THRESHOLD, HALF) == pytest.approx((HALF, HALF), rel=0.02)


def test_near_the_threshold_it_is_smaller_than_it_looks() -> None:
    """At 4.8 the interval reaches nearly to zero, and hardly up."""
    toward, away = reach(4.8, THRESHOLD, HALF)
    assert toward > 4.0 and 0.0 <= away < HALF


@pytest.mark.parametrize("toward_low", [True, False])
def test_toward_where_the_effect_is_absent(toward_low: bool) -> None:
    """1.2 and 0.8 of a factor: the long end is that of 1."""
    value = 1.2 if toward_low else 0.8
    found = conditioned(Estimate(value, "1", (value - 0.1, value + 0.1)), toward_low, 5.0, THRESHOLD, HALF)
    toward, away = (0.1 * r / HALF for r in reach(5.0, THRESHOLD, HALF))
    expected = (value - toward, value + away) if toward_low else (value - away, value + toward)
    assert found.value == value and found.ci95 == pytest.approx(expected)


# --- what a study states -------------------------------------------------------------------------------------------


def naming(d: float) -> tuple[Naming, Named]:
    """B stiffer by one typical size, known to 1/d of it."""
    problem, stiff = network_problem(record(clean()), NETWORK), term("wall_stiffness", "B")
    unknowns = problem.hypothesis((stiff,))
    J, at = d * np.eye(len(unknowns)), [u in stiff.unknowns for u in unknowns]
    none = np.zeros(len(unknowns))
    stiffer = Named(Fit((stiff,), unknowns, np.where(at, 1.0, 0.0), none, J, none, none), 0.0, 1.0)
    return Naming("effect", problem, stiffer, (stiffer,), (stiffer,), {}, (stiff,), 0.9), stiffer


def test_an_interval_far_from_the_threshold_is_the_fit_s() -> None:
    """At d' = 50 it is that of the fit, to round-off."""
    found, common = naming(50.0)
    (stiff,) = found.terms
    assert found_from(found.terms, stiff, common) < 46.0
    plain = estimates(NETWORK, common.fit, stiff, quantile(found.problem.dof_of_noise))
    (told,) = stated(NETWORK, found, common, stiff).values()
    assert told.ci95 == pytest.approx(plain["B.E_scale"].ci95, rel=1e-12)


def test_an_interval_near_the_threshold_reaches_toward_none() -> None:
    """Just found: below the fit's interval, toward a factor of 1."""
    found, common = naming(50.0)
    found, common = naming(found_from(found.terms, term("wall_stiffness", "B"), common) + 0.3)
    (stiff,) = found.terms
    plain = estimates(NETWORK, common.fit, stiff, quantile(found.problem.dof_of_noise))["B.E_scale"]
    (told,) = stated(NETWORK, found, common, stiff).values()
    assert told.ci95[0] < plain.ci95[0] and told.ci95[1] < plain.ci95[1]


def beside(d: float) -> tuple[Naming, Named]:
    """B and C stiffer, each by one typical size that is known to 1/d of it, and the one without the other."""
    found, common = naming(d)
    both = (*found.terms, term("wall_stiffness", "C"))
    unknowns = found.problem.hypothesis(both)
    x = np.array([float(any(u in t.unknowns for t in both)) for u in unknowns])
    none = np.zeros(len(unknowns))
    pair = replace(common, fit=Fit(both, unknowns, x, none, d * np.eye(len(unknowns)), none, none))
    return replace(found, verdict="several", ranked=(pair,), members=(pair,), terms=both), pair


@pytest.mark.parametrize("d", [11.0, 12.5])
def test_each_of_two_effects_is_found_as_a_second_one(d: float) -> None:
    """-2 ln of the prior of both is by the price of a second effect above that of the other alone. Both are said only
    where they show with a d' of 12: at 12.5 the interval is that of a size of which this is known."""
    found, pair = beside(d)
    for mine in pair.fit.terms:
        (other,) = (t for t in pair.fit.terms if t is not mine)
        price_of_it = price(pair.fit, found.terms) - price(replace(pair.fit, terms=(other,)), found.terms)
        limit = found_from(found.terms, mine, pair)
        if d < thresholds.VISIBLE:  # the size of such an effect pays for its width
            assert limit**2 == pytest.approx(
                price_of_it + 2.0 * math.log(2.0 * limit * LOG_RANGE / math.sqrt(2 * math.pi))
            )
        else:
            assert limit == thresholds.VISIBLE
        half = quantile(found.problem.dof_of_noise)
        (plain,) = estimates(NETWORK, pair.fit, mine, half).values()
        (told,) = stated(NETWORK, found, pair, mine).values()
        sd = math.sqrt(float(np.diag(pair.fit.covariance)[pair.fit.unknowns.index(mine.unknowns[0])]))
        toward, away = reach(1.0 / sd, limit, half)
        expected = plain.value - toward / half * (plain.value - plain.ci95[0])
        assert told.ci95[0] == pytest.approx(expected) and (toward > 1.2 * half) == (d > thresholds.VISIBLE)


# --- without a site ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("site", "visible", "gain", "shown"),
    [
        (None, True, 13.0, True),
        (None, True, 10.3, False),  # a springpot beside a Windkessel: 88 in the linear model
        (None, False, 13.0, False),
        (None, True, None, True),  # the other was not fitted alone
        ("CA", True, 10.3, True),
        ("CA", False, 19.0, False),
        ("CA", False, 21.0, True),
        ("CA", False, None, False),
    ],
)
def test_both_of_a_pair_show(site: str | None, visible: bool, gain: float | None, shown: bool) -> None:
    """By the linear model, and by the costs of refits of each effect alone: 12 in a network, 20 on a bench."""

    def hypothesis(cost: float, *labels: str) -> Any:
        fit = SimpleNamespace(cost=cost, terms=[SimpleNamespace(label=label) for label in labels])
        return SimpleNamespace(fit=fit, visible=visible or len(labels) < 2, label=" + ".join(labels))

    pair, alone = hypothesis(600.0, "a", "b"), [hypothesis(5e4, "a")]
    alone += [] if gain is None else [hypothesis(600.0 + gain**2, "b")]
    found: Any = SimpleNamespace(ranked=[*alone, pair], problem=SimpleNamespace(site=site))
    assert both_show(found, pair) == shown and both_show(found, alone[0])


def test_a_site_is_left_out_with_all_that_it_says() -> None:
    """JᵀJ and Jᵀz without a site are Σ_k Dᴴ C_k⁻¹ D over the channels that stay, with their covariance, to round-off;
    rows of the whitened residual mix channels, and those called B's hold some of A's."""
    problem, stiff = network_problem(record(clean(), 8, 0.01), NETWORK), term("wall_stiffness", "B")
    rng, target = np.random.default_rng(2), problem.target
    n, unknowns = len(target.names) * (2 * problem.K + 1), problem.hypothesis((stiff,))
    white = rng.normal(size=(n, 1 + len(unknowns)))
    D, none = target.unwhiten(white), np.zeros(n, int)
    fit = Fit((stiff,), unknowns, np.zeros(len(unknowns)), white[:, 0], white[:, 1:], none, none)
    found = problem.without_each(fit)
    assert len(found) == 3
    for site, (J, z) in zip("ABC", found, strict=True):
        keep = [i for i, name in enumerate(target.names) if not name.startswith(site)]
        normal = np.zeros((white.shape[1], white.shape[1]))
        for k, (C, d) in enumerate(zip(target.covariance, D, strict=True)):
            part = d[keep].conj().T @ np.linalg.solve(C[np.ix_(keep, keep)], d[keep])
            normal += (1.0 if k == 0 else 2.0) * part.real
        own = np.column_stack([z, J])
        np.testing.assert_allclose(own.T @ own, normal, atol=1e-9 * np.abs(normal).max())
        rows = np.tile([i in keep for i in range(len(target.names))], 2 * problem.K + 1)
        mixed = white[rows].T @ white[rows]
        assert site == "C" or np.abs(mixed - normal).max() > 1e-3 * np.abs(normal).max()
    lag = replace(fit, terms=(stiff, term("channel_lag", "C.P")))
    assert len(problem.without_each(lag)) == 2  # the others say nothing of a sensor of C


def test_a_harmonic_is_left_out_with_all_that_it_says() -> None:
    """Nine data in three groups, with a covariance that has all of them in common: as by their own covariance."""
    rng = np.random.default_rng(6)
    L, d = np.tril(rng.normal(size=(9, 9))) + 3.0 * np.eye(9), rng.normal(size=(9, 3))
    C, group, none = L @ L.T, np.repeat([0, 1, 2], 3), np.zeros(9, int)
    white = np.linalg.solve(L, d)
    fit = Fit((), (), np.zeros(2), white[:, 0], white[:, 1:], none, none)
    for g, (J, z) in enumerate(without_groups(fit, group, L)):
        kept, own = group != g, np.column_stack([z, J])
        expected = d[kept].T @ np.linalg.solve(C[np.ix_(kept, kept)], d[kept])
        np.testing.assert_allclose(own.T @ own, expected, rtol=1e-9, atol=1e-12)
