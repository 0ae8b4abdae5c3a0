"""Evidence against integrals, widths and errors of the model against what they were drawn from."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fitting.inference.fit import Fit
from fitting.inference.hierarchy import APART, DECADES, LARGE, LOG_RANGE, Linear, beforehand, score, with_widths
from fitting.inference.hypothesis import PlacedEffect
from fitting.inference.jackknife import jackknife
from fitting.inference.model_discrepancy import Block, estimated, widened
from fitting.inference.source_maps.source_evidence import marginal
from fitting.inference.unknown import TAILS, Unknown
from solver.quantities.coordinate import SHIFT

Array = np.ndarray


def unknown(name: str, group: str = "", prior_sd: float = 1.0, of_size: bool = False) -> Unknown:
    return Unknown(name, SHIFT, ((name, 1.0),), -1e3, 1e3, prior_sd=prior_sd, group=group, of_size=of_size)


def fitted(J: Array, y: Array, unknowns: tuple[Unknown, ...], terms: tuple[PlacedEffect, ...] = ()) -> Fit:
    """The linear problem y + J x at its most probable x under Gaussian priors; those of effects are flat."""
    prior = np.array([0.0 if u.of_size else u.prior_sd**-2.0 for u in unknowns if u.prior_sd])
    x = -np.linalg.solve(J.T @ J + np.diag(prior), J.T @ y)
    nothing = np.zeros(len(y), int)
    return Fit(terms, unknowns, x, y + J @ x, J, nothing, nothing)


def test_evidence_is_the_marginal_likelihood() -> None:
    """Of a linear problem with Gaussian priors: -2 ln N(y; 0, 1 + Σ w² J Jᵀ) to round-off, whatever the widths."""
    rng = np.random.default_rng(1)
    J, y = rng.normal(size=(30, 6)), rng.normal(size=30) * 2.0
    unknowns = tuple(unknown(f"a{i}", "E" if i < 4 else "R0") for i in range(6))
    linear = Linear.of(fitted(J, y, unknowns))

    def exact(widths: dict[str, float]) -> float:
        w = np.array([widths[u.group] for u in unknowns])
        C = np.eye(30) + (J * w) @ (J * w).T
        return float(-2.0 * multivariate_normal(np.zeros(30), C).logpdf(y)) - 30 * math.log(2.0 * math.pi)

    for widths in ({"E": 1.0, "R0": 1.0}, {"E": 0.3, "R0": 2.0}, {"E": 0.0, "R0": 0.0}):
        assert linear.at(widths) == pytest.approx(exact(widths), abs=1e-9)


def test_an_unknown_at_the_end_of_its_range_still_pays_its_prior() -> None:
    """x held at 2 where the data ask for 10: -2 ln p = (2 - 10)² + ν ln(1 + 2²/ν), to round-off."""
    held = replace(unknown("all.phi0"), low=-2.0, high=2.0)
    linear = Linear.of_columns(np.array([-8.0]), np.array([[1.0]]), np.array([2.0]), [held])
    assert linear.at() == pytest.approx(8.0**2 + TAILS * math.log1p(2.0**2 / TAILS), abs=1e-12)


@pytest.mark.parametrize("asks", [-6.0, 0.0, 12.0])
def test_the_tails_of_a_prior_are_integrated(asks: float) -> None:
    """One nuisance of a Student prior, of which the data say ``asks`` standard deviations with an error of a third:
    -2 ln ∫ exp(-z²/2 - penalty/2) dx/√2π, to 0.06 (0.047 measured, at -6)."""
    J, y = 3.0, -3.0 * asks
    grid = np.linspace(-40.0, 40.0, 400001)
    cost = (y + J * grid) ** 2 + TAILS * np.log1p(grid**2 / TAILS)
    x = np.array([grid[cost.argmin()]])
    found = Linear.of_columns(y + J * x, np.array([[J]]), x, [unknown("nu")]).at()
    exact = -2.0 * math.log(float(np.trapezoid(np.exp(-0.5 * cost), grid)) / math.sqrt(2.0 * math.pi))
    assert found == pytest.approx(exact, abs=0.06)


@pytest.mark.parametrize(("low", "signs"), [(0.5, 1.0), (-0.5, 2.0)])
def test_a_size_that_is_fixed_pays_as_if_it_equalled_its_error(low: float, signs: float) -> None:
    """Equal bounds: |z|² + 2 ln(signs ln 1000/√2π), whatever the data's error; two signs where it may be below 0."""
    fixed = replace(unknown("size", of_size=True), low=low, high=low)
    for slope in (1.0, 30.0):
        found = Linear.of_columns(np.array([-4.0]), np.array([[slope]]), np.array([low]), [fixed]).at()
        assert found == pytest.approx(16.0 + 2.0 * math.log(signs * LOG_RANGE / math.sqrt(2.0 * math.pi)), abs=1e-12)


def test_what_widths_are_beforehand() -> None:
    """No deviations are as likely as those of the stated spread, at even odds; the widths of an outlier are equally
    likely, and together certain."""
    assert beforehand(0.0) == beforehand(1.0) == pytest.approx(2.0 * math.log(2.0), rel=1e-15)
    assert sum(math.exp(-0.5 * beforehand(width, apart=True)) for width in APART) == pytest.approx(1.0, rel=1e-15)


@pytest.mark.parametrize("size", [0.16, 16.0, 160.0])
def test_size_of_an_effect_is_integrated_over_its_logarithm(size: float) -> None:
    """One number of d' = 8, in typical sizes: ∫ N(z) dx/(2 |x| (1 + (x/10)²) ln 1000) over both signs. Laplace's value
    is off by 0.03 of -2 ln where x is small, and by 0.23 where it is many typical sizes, which are unlikely."""
    J, y = np.array([[8.0 / size]]), np.array([-8.0])
    term = PlacedEffect("toy", "here", ("here",), (unknown("size", of_size=True),))
    found = score(fitted(J, y, term.unknowns, (term,)))
    x = size * np.linspace(1e-2, 2.5, 200001)
    density = np.exp(-0.5 * (y[0] + J[0, 0] * x) ** 2) / (2.0 * x * (1.0 + (x / LARGE) ** 2) * DECADES * math.log(10.0))
    exact = -2.0 * math.log(float(np.trapezoid(density, x)))
    assert found == pytest.approx(exact, abs=0.05 if size < 1.0 else 0.25)


@pytest.mark.parametrize("d", [4.0, 1.0, 0.1, -0.1, -1.0, -4.0])
def test_a_size_of_one_sign_is_integrated_over_its_range(d: float) -> None:
    """x >= 0 where the data ask for d standard deviations: ∫ N(z) dx/(max(x, sd) (1 + (x/10)²) ln 1000) over the range,
    to 0.3 in ln (0.26 measured, at d = 1); held at 0 or not. The whole of a Gaussian would be 0.8 too much at 0, 2.4
    at -4."""
    size = replace(unknown("size", of_size=True), low=0.0)
    J, y = np.array([[50.0]]), np.array([-d])
    x = max(d, 0.0) / 50.0
    found = Linear.of_columns(y + J[0] * x, J, np.array([x]), [size]).at()
    t = np.linspace(0.0, 1.0, 200001)
    density = np.exp(-0.5 * (y[0] + J[0, 0] * t) ** 2) / (
        np.maximum(t, 0.02) * (1.0 + (t / LARGE) ** 2) * DECADES * math.log(10.0)
    )
    assert -0.5 * found == pytest.approx(math.log(float(np.trapezoid(density, t))), abs=0.3)


@pytest.mark.parametrize("width", [0.0, 0.25, 1.0, 2.0])
def test_widths_are_those_that_walls_were_drawn_with(width: float) -> None:
    """Forty deviations of one width, each known to 0.05: the width is found, to the neighbour in the list."""
    rng = np.random.default_rng(7)
    J = 20.0 * np.eye(40)
    y = -J @ (width * rng.normal(size=40)) + rng.normal(size=40)
    found = Linear.of(fitted(J, y, tuple(unknown(f"a{i}", "E") for i in range(40)))).inferred()
    assert found.of["E"] == pytest.approx(width, abs=0.01 + 0.41 * width)


@pytest.mark.parametrize("width", [0.0, 0.5, 1.0, 1.4])
def test_intervals_go_by_the_width_that_walls_have(width: float) -> None:
    """Fitted with deviations of spread 1 where they have ``width``: variances of estimate - truth over 20 000 draws, to
    5 %. By the stated spread some would be 3.4 times too large at width 0, and 0.6 of that at 1.4."""
    rng = np.random.default_rng(11)
    J = rng.normal(size=(5, 5))
    unknowns = (*(unknown(f"a{i}", "E") for i in range(4)), unknown("size", prior_sd=10.0, of_size=True))
    prior = np.diag([u.prior_sd**-2.0 for u in unknowns if u.prior_sd])
    truth = np.column_stack([width * rng.normal(size=(20000, 4)), 10.0 * rng.normal(size=20000)])
    data = truth @ J.T + rng.normal(size=(20000, 5))
    error = data @ J @ np.linalg.inv(J.T @ J + prior) - truth
    none = np.zeros(5, int)
    fit = Fit((), unknowns, np.zeros(5), np.zeros(5), J, none, none, widths={"E": width})
    np.testing.assert_allclose(np.diag(fit.covariance), error.var(axis=0), rtol=0.05)
    if width == 1.0:
        np.testing.assert_allclose(fit.covariance, replace(fit, widths={}).covariance, rtol=1e-12)


def test_widths_of_a_fit_are_those_of_its_evidence() -> None:
    """Forty walls without deviations, each known to 0.05: width below 0.05; of what no datum tells, 0.82, the mean of
    what it is beforehand."""
    rng = np.random.default_rng(12)
    J = np.vstack([20.0 * np.eye(40), np.ones((1, 40))])
    found = fitted(J, rng.normal(size=41), tuple(unknown(f"a{i}", "E") for i in range(40)))
    told = with_widths(found)
    assert Linear.of(found).inferred().of == {"E": 0.0} and told.widths["E"] < 0.05
    blind = fitted(np.zeros((5, 4)), np.zeros(5), tuple(unknown(f"a{i}", "E") for i in range(4)))
    assert with_widths(blind).widths["E"] == pytest.approx(0.82, abs=0.01)
    own = np.eye(40) / (1.0 + found.x**2 / TAILS)
    A = np.linalg.inv(J.T @ J + own)
    np.testing.assert_allclose(told.covariance, A @ (J.T @ J + told.widths["E"] ** 2 * own) @ A, rtol=1e-10)


# --- errors of the model ----------------------------------------------------------------------------------------------


def blocks(rng: np.random.Generator, n: int) -> list[Block]:
    """n blocks of six entries with errors of two parts, not diagonal."""
    mix = [rng.normal(size=(6, 6)) * 10.0 for _ in range(n)]
    return [Block(6 * i + np.arange(6), B, np.array([0, 0, 0, 1, 1, 1])) for i, B in enumerate(mix)]


def test_errors_of_the_model_are_found() -> None:
    """Errors of 0.3 and 0 of unit size beside noise of 1, 300 entries and five unknowns: 0.3 to 10 %, and none."""
    rng = np.random.default_rng(3)
    found = blocks(rng, 50)
    J, noise = rng.normal(size=(300, 5)) * 30.0, rng.normal(size=300)
    y = noise + J @ rng.normal(size=5)
    for b in found:
        y[b.rows] += b.B @ (np.array([0.3, 0.3, 0.3, 0.0, 0.0, 0.0]) * rng.normal(size=6))
    fit = fitted(J, y, tuple(unknown(f"a{i}", prior_sd=10.0) for i in range(5)))
    parts = estimated(fit, found, 2)
    assert parts[0] == pytest.approx(0.3, rel=0.1)
    assert parts[1] < 0.03
    wide = widened(fit, found, parts)
    assert wide.chi2 / len(y) == pytest.approx(1.0, abs=0.1)
    C = np.eye(300)
    for b in found:
        C[np.ix_(b.rows, b.rows)] += (b.B * parts[b.part]) @ (b.B * parts[b.part]).T
    assert wide.log_volume == pytest.approx(float(np.linalg.slogdet(C)[1]), rel=1e-9)
    assert score(wide) < score(fit) - 100.0


@pytest.mark.deep
def test_noise_has_no_errors_of_the_model() -> None:
    """Where the residual is noise, an error of the model is worth its price in less than one record of a hundred.

    Of a part of an error that is not there, half the gains are 0 and half χ² of one degree of freedom: above the price
    of one, 10, in 0.1 % of all; 40 draws have none or one.
    """
    from discrepancy.thresholds import PART, SECOND

    rng = np.random.default_rng(5)
    gains = []
    for _ in range(40):
        found = blocks(rng, 50)
        fit = fitted(rng.normal(size=(300, 1)), rng.normal(size=300), (unknown("a"),))
        parts = estimated(fit, found, 2)
        gains.append(score(fit) - score(widened(fit, found, parts)) - (SECOND - PART) - PART * np.count_nonzero(parts))
    assert sum(gain > 0.0 for gain in gains) <= 1


def test_what_unknowns_take_up_is_no_error() -> None:
    """An error that the unknowns take up whole is not told, and comes out as none."""
    rng = np.random.default_rng(9)
    B = np.vstack([np.eye(6), np.zeros((294, 6))])
    free = Block(np.arange(300), B * 10.0, np.zeros(6, int))
    J = B * 100.0
    fit = fitted(
        J, rng.normal(size=300) + J @ rng.normal(size=6), tuple(unknown(f"a{i}", prior_sd=5.0) for i in range(6))
    )
    assert estimated(replace(fit), [free], 1)[0] < 0.05


def test_jackknife_is_the_covariance_where_errors_are_independent() -> None:
    """One number from 600 data of unit noise in 20 groups: its standard deviation, 1/|J|, to the 16 % of 20 groups; and
    three times as much where the errors of a group are alike (√(1 + 29 · 0.28) = 3.0)."""
    rng = np.random.default_rng(4)
    group, J = np.repeat(np.arange(20), 30), np.ones((600, 1))
    ratios = []
    for share in (0.0, 0.28):
        found = []
        for _ in range(40):
            alike = math.sqrt(share) * rng.normal(size=20)[group] + math.sqrt(1.0 - share) * rng.normal(size=600)
            fit = fitted(J, alike, (unknown("a", prior_sd=100.0),))
            without = [(J[group != g], fit.z[group != g]) for g in range(20)]
            found.append(jackknife(fit, without)[0] * math.sqrt(600.0))
        ratios.append(float(np.mean(found)))
    assert ratios[0] == pytest.approx(1.0, abs=0.08)
    assert ratios[1] == pytest.approx(3.0, rel=0.08)


def test_evidence_where_sources_leave_round_off() -> None:
    """Normal equations a little below 0, of a direction that sources took up: as with no information there; else as by
    the Cholesky factor, to 1e-12."""
    rng = np.random.default_rng(0)
    J = rng.normal(size=(40, 6))
    J[:, 0] = 0.0
    exact = J.T @ J
    rounded = exact.copy()
    rounded[0, 0] = -2.0
    sd = np.array([1.0, 0.3, 2.0, 1.0, 0.1])
    assert np.isclose(marginal(rounded, sd), marginal(exact, sd), rtol=1e-12)
    both = marginal(np.stack([rounded, exact]), sd)
    assert np.allclose(both, marginal(exact, sd), rtol=1e-12)
