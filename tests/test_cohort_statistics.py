"""The mixed model of a cohort and its verdicts, against textbook formulas and by repeated drawing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import minimize

from fitting.cohort.claims import (
    constant_relaxation_time,
    holm,
    negligible_elastic_bend,
    nonlinear_viscosity,
    same_in_both_models,
    same_radius,
)
from fitting.cohort.mixed_model import RandomIntercept, random_intercept

SITES = ("AA", "PD", "MD", "DD", "BT", "CA", "FA")


def _cells(y: np.ndarray, there: np.ndarray | None = None) -> dict[tuple[str, str], float]:
    """Values by (animal, site) of y : (animals, sites)."""
    return {
        (f"S{i}", SITES[j]): float(y[i, j])
        for i in range(y.shape[0])
        for j in range(y.shape[1])
        if there is None or there[i, j]
    }


def _fitted(y: np.ndarray, there: np.ndarray | None = None) -> RandomIntercept:
    cells = _cells(y, there)
    return random_intercept(np.array(list(cells.values())), [s for _, s in cells], [a for a, _ in cells])


def _animals(
    rng: np.random.Generator, mu: np.ndarray, n: int = 11, shared: float = 0.09, own: float | np.ndarray = 0.09
) -> np.ndarray:
    """μ_j + a_i + e_ij : (n, J)."""
    return mu + rng.normal(0.0, shared, (n, 1)) + rng.normal(0.0, own, (n, len(mu)))


# --- the mixed model ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shared", [0.0, 0.02, 0.3])
def test_balanced_data_give_the_analysis_of_variance(shared: float) -> None:
    """σ² = MS_e, σ_a² = (MS_a - MS_e)/J, also where it is negative; F, and t with (n - 1)(J - 1) degrees of freedom."""
    y = _animals(np.random.default_rng(1), np.zeros(7), shared=shared, own=0.1)
    n, J = y.shape
    left = y - y.mean(axis=0) - y.mean(axis=1, keepdims=True) + y.mean()
    MS_e, MS_a = np.sum(left**2) / ((n - 1) * (J - 1)), J * y.mean(axis=1).var(ddof=1)
    MS_s = n * y.mean(axis=0).var(ddof=1)
    fit = _fitted(y)
    assert fit.residual == pytest.approx(MS_e, rel=1e-12)
    assert fit.shared == pytest.approx((MS_a - MS_e) / J, rel=1e-10)
    assert fit.means == pytest.approx(y.mean(axis=0), rel=1e-12)
    F, q, df, p = fit.f_test()
    assert (F, q, df) == pytest.approx((MS_s / MS_e, J - 1, (n - 1) * (J - 1)), rel=1e-10)
    assert p == pytest.approx(stats.f.sf(F, J - 1, (n - 1) * (J - 1)), rel=1e-10)
    one = fit.deviations()[2]
    assert (one.estimate, one.se, one.df) == pytest.approx(
        (y[:, 2].mean() - y.mean(), np.sqrt(MS_e / n * (1 - 1 / J)), (n - 1) * (J - 1)), rel=1e-10
    )
    overall = fit.overall()  # that of the animals' means
    assert (overall.se, overall.df) == pytest.approx((stats.sem(y.mean(axis=1)), n - 1), rel=1e-10)


def test_the_grid_covers_a_negative_shared_variance() -> None:
    """The case above with σ_a = 0 has MS_a < MS_e: bounded at 0 the standard errors would be too small."""
    assert _fitted(_animals(np.random.default_rng(1), np.zeros(7), shared=0.0, own=0.1)).shared < 0.0


def test_two_sites_are_the_paired_t_test() -> None:
    """Eleven animals at two sites: p and 90 % interval of scipy's paired t test, to rounding."""
    y = _animals(np.random.default_rng(2), np.array([0.0, 0.06]))
    paired = stats.ttest_rel(y[:, 1], y[:, 0])
    contrast = _fitted(y).contrast([-1.0, 1.0])
    assert contrast.p_value() == pytest.approx(paired.pvalue, rel=1e-10)
    assert contrast.interval(0.9) == pytest.approx(tuple(paired.confidence_interval(0.9)), rel=1e-10)


def _gaps(rng: np.random.Generator, n: int = 11, lost: float = 0.3) -> np.ndarray:
    there = rng.random((n, 7)) > lost
    there[0] = True
    return there


def test_unbalanced_data_against_the_likelihood_written_out() -> None:
    """Dense V, restricted log-likelihood maximised by a general optimiser; Satterthwaite from dense tr(P V_a P V_b)."""
    rng = np.random.default_rng(3)
    y, there = _animals(rng, np.linspace(-0.1, 0.1, 7)), _gaps(rng)
    i, j = np.nonzero(there)
    values, X, Z = y[there], np.eye(7)[j], np.eye(11)[i]

    def parts(log_own: float, shared: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        inverse = np.linalg.inv(np.exp(log_own) * np.eye(len(values)) + shared * Z @ Z.T)
        covariance = np.linalg.inv(X.T @ inverse @ X)
        return inverse, covariance, inverse - inverse @ X @ covariance @ X.T @ inverse

    def cost(x: np.ndarray) -> float:
        inverse, covariance, P = parts(x[0], x[1])
        return -np.linalg.slogdet(inverse)[1] - np.linalg.slogdet(covariance)[1] + values @ P @ values

    options = {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 4000}
    best = minimize(cost, [np.log(0.01), 0.01], method="Nelder-Mead", options=options).x
    fit = _fitted(y, there)
    assert fit.residual == pytest.approx(np.exp(best[0]), rel=1e-5)
    assert fit.shared == pytest.approx(best[1], rel=1e-5)
    order = [SITES.index(site) for site in fit.sites]
    inverse, covariance, P = parts(np.log(fit.residual), fit.shared)
    assert fit.means == pytest.approx((covariance @ X.T @ inverse @ values)[order], rel=1e-9)

    weights = (np.eye(7) - 1 / 7)[1]  # of PD
    derivatives = (fit.residual * np.eye(len(values)), Z @ Z.T)  # of V by log σ² and σ_a²
    information = 0.5 * np.array([[np.trace(P @ a @ P @ b) for b in derivatives] for a in derivatives])
    slope = X @ covariance @ weights
    gradient = np.array([slope @ inverse @ a @ inverse @ slope for a in derivatives])
    variance = weights @ covariance @ weights
    contrast = fit.contrast((np.eye(7) - 1 / 7)[fit.sites.index("PD")])
    assert contrast.se == pytest.approx(np.sqrt(variance), rel=1e-9)
    assert contrast.df == pytest.approx(2 * variance**2 / (gradient @ np.linalg.solve(information, gradient)), rel=1e-8)


@pytest.mark.deep
def test_intervals_of_unbalanced_data_cover() -> None:
    """90 % intervals of the deviations of all sites, a third of the cells lost: 90 ± 1.5 % of 300 × 7."""
    rng = np.random.default_rng(4)
    mu = np.linspace(-0.1, 0.1, 7)
    hits = []
    for _ in range(300):
        fit = _fitted(_animals(rng, mu), _gaps(rng))
        for site, deviation in zip(fit.sites, fit.deviations(), strict=True):
            low, high = deviation.interval(0.9)
            hits.append(low <= mu[SITES.index(site)] <= high)
    assert np.mean(hits) == pytest.approx(0.9, abs=0.02)


def test_data_that_cannot_separate_sites_from_animals() -> None:
    """Two values in a cell, or as many animals as values: one sentence."""
    with pytest.raises(ValueError, match="S1 has two values at site AA"):
        random_intercept(np.zeros(2), ["AA", "AA"], ["S1", "S1"])
    with pytest.raises(ValueError, match="4 values of 4 subjects at 2 sites cannot separate"):
        random_intercept(np.arange(4.0), ["AA", "PD", "AA", "PD"], ["1", "2", "3", "4"])


# --- verdicts -----------------------------------------------------------------------------------------------------


def test_equivalence_at_a_site_is_two_one_sided_t_tests() -> None:
    """same_radius is supported exactly where scipy's two one-sided tests both reject at 5 %, at every site."""
    rng, verdicts = np.random.default_rng(5), []
    for _ in range(200):
        y = rng.normal(rng.uniform(-0.02, 0.02), 0.015, (9, 2))
        above = stats.ttest_1samp(y, -np.log(1.02), alternative="greater").pvalue
        below = stats.ttest_1samp(y, np.log(1.02), alternative="less").pvalue
        verdicts.append((same_radius(_cells(np.exp(y))).verdict == "supported", np.maximum(above, below).max() < 0.05))
    assert all(mine == scipys for mine, scipys in verdicts)
    assert 30 < sum(mine for mine, _ in verdicts) < 170


def _share(verdict: str, mu: np.ndarray, runs: int, seed: int, own: float | np.ndarray = 0.09) -> float:
    """How often a cohort of eleven with log-ratios μ gets this verdict, by the mixed model."""
    rng = np.random.default_rng(seed)
    claims = (constant_relaxation_time(_cells(np.exp(_animals(rng, mu, own=own)))) for _ in range(runs))
    return float(np.mean([claim.verdict == verdict for claim in claims]))


@pytest.mark.deep
@pytest.mark.parametrize("own", [1.0, 2.0])
def test_error_of_the_first_kind_at_the_margin(own: float) -> None:
    """One site off by exactly 25 %: called constant in at most 5 % of cohorts, varying in fewer; 300 runs, 2 sd.

    Also where that site scatters twice as much as the others, which the mixed model does not know (it alone: 14 %).
    """
    mu = np.full(7, np.log(1.25) / 6)
    mu[1] = -np.log(1.25)
    scatter = 0.09 * np.where(np.arange(7) == 1, own, 1.0)
    assert 0.005 < _share("supported", mu, 300, 6, scatter) < 0.05 + 2 * np.sqrt(0.05 * 0.95 / 300)
    assert _share("refuted", mu, 100, 7, scatter) < 0.05


@pytest.mark.deep
def test_power() -> None:
    """Truly constant: always supported. One site at twice the ratio: always refuted. On the margin: 97 % neither."""
    assert _share("supported", np.zeros(7), 100, 8) == 1.0
    double = np.zeros(7)
    double[5] = np.log(2.0)
    assert _share("refuted", double, 100, 9) == 1.0
    edge = np.zeros(7)
    edge[5] = np.log(1.25) * 7 / 6  # on the margin, from the mean over sites
    assert _share("not decided", edge, 100, 10) == pytest.approx(0.97, abs=0.05)


def test_the_claim_says_what_it_found() -> None:
    """Two sites at ±12 %: supported at 25 % though F differs, also at the smallest margin; CA twice: refuted."""
    y = _animals(np.random.default_rng(11), np.array([0.0, -0.12, 0.0, 0.0, 0.0, 0.0, 0.12]))
    claim = constant_relaxation_time(_cells(0.017 * np.exp(y)))
    assert claim.verdict == "supported" and claim.n == 11 and claim.allowed == (0.8, 1.25)
    assert claim.numbers["mean"] == pytest.approx(0.017, rel=0.1)
    smallest = claim.smallest_margin
    assert smallest > max(max(1 / e.low, e.high) for e in claim.estimates) - 1 - 1e-12
    for margin, verdict in ((smallest + 1e-9, "supported"), (smallest - 1e-9, "not decided")):
        assert constant_relaxation_time(_cells(np.exp(y)), margin).verdict == verdict
    assert "p > 0.05 would not prove constancy" in claim.text
    assert claim.numbers["F_p"] < 1e-3  # significant differences, and yet within the margin
    double = constant_relaxation_time(_cells(np.exp(y + np.log(2.0) * (np.arange(7) == 5))))
    assert double.verdict == "refuted" and "wholly outside: CA." in double.text


def test_a_verdict_that_hangs_on_equal_scatter_is_not_given() -> None:
    """BT scatters five times as much as the others: the pooled scatter would let it pass, its own does not."""
    own, mu = np.where(np.arange(7) == 4, 0.25, 0.05), np.where(np.arange(7) == 4, 0.14, 0.0)
    claim = constant_relaxation_time(_cells(np.exp(_animals(np.random.default_rng(20), mu, own=own))))
    assert all(0.8 < e.low and e.high < 1.25 for e in claim.estimates)
    assert claim.verdict == "not decided" and claim.smallest_margin > 0.25
    assert "(the mixed model alone says supported, each site's own scatter does not). Margin" in claim.text
    assert "; the data do not decide at BT." in claim.text


def test_own_scatter_of_balanced_data_is_that_of_the_paired_deviations() -> None:
    """The site's t interval from y_ij less the animal's mean, by scipy, where it is the wider one."""
    y = _animals(np.random.default_rng(17), np.linspace(-0.05, 0.05, 7), own=np.linspace(0.05, 0.1, 7))
    d = y - y.mean(axis=1, keepdims=True)
    ends = stats.t.interval(0.9, 10, d.mean(axis=0), stats.sem(d))
    claim = constant_relaxation_time(_cells(np.exp(y)))
    assert claim.smallest_margin == pytest.approx(np.expm1(np.abs(ends).max()), rel=1e-9)
    assert claim.smallest_margin > max(max(1 / e.low, e.high) for e in claim.estimates) - 1


def test_one_animal_decides_nothing() -> None:
    """One animal in all, or one alone at CA: every claim is not decided, without an error."""
    cells = _cells(np.exp(_animals(np.random.default_rng(12), np.zeros(7), n=1)))
    for claim in (constant_relaxation_time(cells), same_radius(cells), nonlinear_viscosity(cells)):
        assert claim.verdict == "not decided" and claim.n == 1
    y = _cells(np.exp(_animals(np.random.default_rng(12), np.zeros(7), own=0.001)))
    some = {cell: v for cell, v in y.items() if cell[1] != "CA" or cell[0] == "S0"}  # CA from one animal
    claim = same_radius({cell: v / v for cell, v in some.items()})
    assert claim.verdict == "not decided" and "do not decide at CA" in claim.text and claim.smallest_margin is None


def test_nonlinear_viscosity_by_site() -> None:
    """t tests of scipy, Holm; a site near 0 refutes only if its interval shows that it is near 0."""
    rng = np.random.default_rng(13)
    y = np.array([-0.9, -1.0, -0.9, -1.0, -1.4, 0.5, -0.4]) * np.exp(rng.normal(0.0, 0.3, (11, 7)))
    claim = nonlinear_viscosity(_cells(y))
    assert claim.verdict == "supported"
    expected = holm([float(p) for p in stats.ttest_1samp(y, 0.0).pvalue])
    assert [e.p for e in claim.estimates] == pytest.approx(expected, rel=1e-9)
    ends = stats.t.interval(0.95, 10, y.mean(axis=0), stats.sem(y))
    assert [e.low for e in claim.estimates] == pytest.approx(ends[0])
    assert [e.high for e in claim.estimates] == pytest.approx(ends[1])
    y[:, 6] = rng.normal(0.0, 0.3, 11)
    assert nonlinear_viscosity(_cells(y)).verdict == "not decided"
    y[:, 6] *= 0.1
    near = nonlinear_viscosity(_cells(y))
    assert near.verdict == "refuted" and "within ±0.05 s of 0 at FA" in near.text


def test_holm() -> None:
    """By hand: 0.01·4, 0.02·3, max(0.06, 0.03·2), 0.5; never above 1."""
    assert holm([0.03, 0.01, 0.5, 0.02]) == pytest.approx([0.06, 0.04, 0.5, 0.06])
    assert holm([0.6, 0.7]) == [1.0, 1.0]


def test_elastic_bend_and_models() -> None:
    """E_NL ε/E of 0.15 %, 8 % and of scatter 20 % against a margin of 5 %; models 4 % and 20 % apart against 10 %."""
    rng = np.random.default_rng(14)
    small, large = rng.normal(0.0015, 0.01, (11, 3)), rng.normal(0.08, 0.01, (11, 3))
    assert negligible_elastic_bend(_cells(small)).verdict == "supported"
    assert negligible_elastic_bend(_cells(large)).verdict == "refuted"
    assert negligible_elastic_bend(_cells(small + rng.normal(0.0, 0.2, (11, 3)))).verdict == "not decided"
    E, phi0 = _cells(np.exp(rng.normal(-0.04, 0.02, (11, 3)))), _cells(np.exp(rng.normal(0.03, 0.02, (11, 3))))
    close = same_in_both_models({"E": E, "phi0": phi0}, ("linear", "nonlinear"))
    assert close.verdict == "supported" and [e.label for e in close.estimates][2:4] == ["MD E", "AA phi0"]
    far = {cell: 0.8 * v for cell, v in phi0.items()}
    apart = same_in_both_models({"E": E, "phi0": far}, ("linear", "nonlinear"))
    assert apart.verdict == "refuted" and "wholly outside: AA phi0, PD phi0, MD phi0" in apart.text
