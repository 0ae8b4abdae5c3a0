"""Statistics of the discrepancy: misfit, false discoveries, the z map, angles between effects; and who imports whom."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from forked import NETWORK, clean, record
from scipy.optimize import lsq_linear
from scipy.stats import kstest, norm

from discrepancy import thresholds
from discrepancy.find.disagreement import find, mass_balances, wall_balances
from discrepancy.findings.isolability import DETECTABLE, isolability, smallest
from fitting.inference.fit import Fit, misfit, projected
from fitting.inference.gauss_newton import bounded_step
from fitting.inference.hypothesis import PlacedEffect
from fitting.inference.unknown import Unknown, precision

# --- misfit ----------------------------------------------------------------------------------------------------------

K = 20


def residual(z: np.ndarray, signals: int) -> Fit:
    """A fit without unknowns whose whitened residual is z : ((2K + 1) signals,), mean first, harmonic by harmonic."""
    n = len(z) // signals
    order = np.tile((np.arange(n) + 1) // 2, signals)
    signal = np.repeat(np.arange(signals), n)
    empty = np.zeros(0)
    return Fit((), (), empty, z, np.zeros((len(z), 0)), order, signal)


@pytest.mark.parametrize(
    ("signals", "K"),
    [(1, 5), (2, 15), *(pytest.param(*each, marks=pytest.mark.deep) for each in ((1, 20), (1, 40), (9, 20)))],
)
def test_misfit_of_white_noise(signals: int, K: int) -> None:
    """P(misfit > x) = 1 - Φ(x), whatever the number of channels and harmonics: z² ~ χ² of one degree of freedom, known
    noise, 6000 residuals; at 1.3 to 30 % (chance: 4 %), at 2.3 to a half (12 %). At most 0.4 % reach the threshold.

    One channel is one group of data: all of them are no second one.
    """
    rng = np.random.default_rng(1)
    z = np.sqrt(rng.chisquare(1.0, (6000, signals * (2 * K + 1))))
    found = np.array([misfit(residual(each, signals), 1e9) for each in z])
    assert np.mean(found > 1.3) == pytest.approx(norm.sf(1.3), rel=0.3)
    assert np.mean(found > 2.3) == pytest.approx(norm.sf(2.3), rel=0.5)
    assert np.mean(found > thresholds.MISFIT) <= 0.004


def test_misfit_when_the_noise_is_hardly_known() -> None:
    """Noise estimated from 20 degrees of freedom, common to all entries: still at most 2 % pass."""
    rng = np.random.default_rng(2)
    scale = np.sqrt(20.0 / rng.chisquare(20, 4000))
    found = [misfit(residual(s * rng.normal(size=2 * K + 1), 1), 20.0) for s in scale]
    assert np.mean(np.array(found) > thresholds.MISFIT) <= 0.02


@pytest.mark.parametrize("signals", [1, 9])
def test_misfit_sees_a_bump_at_low_harmonics(signals: int) -> None:
    """5 standard deviations in both parts of harmonic 1 of one channel: found in 95 % of 300; χ² over all would not be.

    Of 369 entries the global sum moves by 50/√738, less than two standard deviations.
    """
    rng = np.random.default_rng(3)
    found = []
    for _ in range(300):
        z = rng.normal(size=signals * (2 * K + 1))
        z[1:3] += 5.0
        found.append(misfit(residual(z, signals), 1e9))
    assert np.mean(np.array(found) > thresholds.MISFIT) >= 0.95


# --- the z map ---------------------------------------------------------------------------------


def noise_of(C: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Coefficients (K + 1, m) with E[x x†] = C : (K + 1, m, m); the mean is real."""
    L = np.linalg.cholesky(C)
    x = (rng.normal(size=C.shape[:2]) + 1j * rng.normal(size=C.shape[:2])) / np.sqrt(2.0)
    x[0] = rng.normal(size=C.shape[1])
    return np.einsum("kij,kj->ki", L, x)


def covariance(m: int, rng: np.random.Generator) -> np.ndarray:
    B = rng.normal(size=(K + 1, m, m)) + 1j * rng.normal(size=(K + 1, m, m))
    B[0] = B[0].real
    return np.einsum("kij,klj->kil", B, B.conj()) + 0.1 * np.eye(m)


def test_z_of_noise() -> None:
    """Correlated complex noise, 400 records: |z|² has mean 1, global p-values uniform, at most 5 % locate anything."""
    rng = np.random.default_rng(5)
    C = covariance(3, rng)
    found = [find(("A.P", "A.Q", "B.P"), noise_of(C, rng), C) for _ in range(400)]
    assert np.mean([f.z**2 for f in found]) == pytest.approx(1.0, abs=0.02)
    assert kstest([f.p_value for f in found], "uniform").pvalue > 1e-3
    assert np.mean([bool(f.located) for f in found]) <= 0.05


def test_a_loud_entry_is_located() -> None:
    """One coefficient of B.P at harmonic 3 lies 9 standard deviations off at 60°: it comes first, and p < 1e-6."""
    rng = np.random.default_rng(6)
    C = covariance(3, rng)
    x = 0.1 * noise_of(C, rng)
    x[3, 2] = 9.0 * np.sqrt(C[3, 2, 2].real) * np.exp(1j * np.pi / 3.0)
    found = find(("A.P", "A.Q", "B.P"), x, C)
    first = found.located[0]
    assert (first.site, first.signal, first.harmonic) == ("B", "P", 3)
    assert first.z == pytest.approx(9.0) and first.phase == pytest.approx(60.0)
    assert found.p_value < 1e-6 and len(found.located) == 1 < thresholds.FEW


def test_mass_balances() -> None:
    """A flow sensor of B 5 % too high: junction A loses mass by that, in noise units; the inlet's balance stays."""
    waves = clean()
    honest = {b.where: b.z for b in mass_balances(record(waves, 15, 0.01), NETWORK)}
    assert set(honest) == {"A", "junction A"}
    # a site is at the middle of its segment: walls of the mean beat store nothing
    assert max(abs(z) for z in honest.values()) <= 4.0
    wrong = {b.where: b.z for b in mass_balances(record(waves | {"B.Q": 1.05 * waves["B.Q"]}, 15, 0.01), NETWORK)}
    samples = 15 * len(waves["B.Q"])
    sd = 0.01 * np.sqrt(sum(waves[f"{s}.Q"].var() for s in "ABC") / samples)
    assert wrong["junction A"] == pytest.approx(honest["junction A"] - 0.05 * waves["B.Q"].mean() / sd, rel=0.3)
    assert wrong["A"] == pytest.approx(honest["A"], abs=1.0)


@pytest.mark.parametrize("name", ["B", "probe"])
def test_wall_balance_of_a_site_with_a_name_of_its_own(name: str) -> None:
    """The wall of B as its model has it, P and R measured at a site that is called as its segment or otherwise: noise
    alone, to a sixth (the RMS of 41 numbers N(0, 1) is 1 ± 0.11), and the same to the last bit."""
    waves = clean()
    own = {f"{name}.{kind}": waves[f"B.{kind}"] for kind in "PR"}
    sites = tuple(replace(s, name=name) if s.name == "B" else s for s in NETWORK.sites)
    found = {b.where: b.z for b in wall_balances(record(own, 15, 0.01), replace(NETWORK, sites=sites))}
    assert found.keys() == {name}
    assert found[name] == wall_balances(record({f"B.{k}": waves[f"B.{k}"] for k in "PR"}, 15, 0.01), NETWORK)[0].z
    assert found[name] == pytest.approx(1.0, abs=0.35)


# --- angles between effects ------------------------------------------------------------------------------------------


def term(effect: str, place: str = "A") -> PlacedEffect:
    return PlacedEffect(effect, place, (place,), (Unknown(f"{place}.{effect}", "shift", ((effect, 1.0),), -9.0, 9.0),))


def base(nuisances: np.ndarray, prior: float) -> Fit:
    """A perfect fit of 50 data with nuisance columns (50, p) under a prior precision."""
    p = nuisances.shape[1]
    unknowns = tuple(Unknown(f"n{i}", "shift", (), -9.0, 9.0, prior_sd=prior**-0.5) for i in range(p))
    z = np.zeros(50)
    return Fit((), unknowns, np.zeros(p), z, nuisances, np.zeros(50, int), np.zeros(50, int))


def test_isolability_of_columns_made_by_hand() -> None:
    """In an orthonormal basis e: d' and separations of known lengths and angles, to round-off.

    a = 20 e1 + 300 e0 with e0 a free nuisance: d' = 20. b = 30 (cos 10° e1 + sin 10° e2): from a it is 30 sin 10° = 5.2
    away, a from b 20 sin 10° = 3.5, both below 6: each is taken for the other. c = 40 e3 is apart, d = 2 e4 invisible.
    """
    e = np.linalg.qr(np.random.default_rng(7).normal(size=(50, 50)))[0].T
    ten = np.radians(10.0)
    columns = {
        "a at A": (20.0 * e[1] + 300.0 * e[0])[:, None],
        "b at A": (30.0 * (np.cos(ten) * e[1] + np.sin(ten) * e[2]))[:, None],
        "c at A": (40.0 * e[3])[:, None],
        "d at A": (2.0 * e[4])[:, None],
    }
    terms = tuple(term(name) for name in "abcd")
    fit = base(1e6 * e[:1].T, 1.0)
    table = isolability(fit, columns, terms)
    assert table.labels == ("a", "b", "c", "d")
    np.testing.assert_allclose(table.visibility, [20.0, 30.0, 40.0, 2.0], rtol=1e-6)
    assert table.invisible == ("d",)
    assert table.separation[0, 1] == pytest.approx(20.0 * np.sin(ten), rel=1e-6)
    assert table.separation[1, 0] == pytest.approx(30.0 * np.sin(ten), rel=1e-6)
    assert table.separation[0, 2] == pytest.approx(20.0, rel=1e-6)
    assert np.all(np.diag(table.separation) == 0.0)
    assert [table.confused(each) for each in "abcd"] == [("b",), ("a",), (), ("a", "b", "c")]
    (size,) = {t.unknowns[0].size for t in terms}
    assert {name: least.change / size for name, least in smallest(fit, columns, terms).items()} == pytest.approx(
        {f"{name} at A": DETECTABLE / d for name, d in zip("abcd", table.visibility, strict=True)}
    )


def test_smallest_sizes_are_within_what_is_allowed() -> None:
    """d' of 20, 4 and 10 per x: x = 5/d'. a may only be negative; b, up to 1, would need 1.25 and shows nowhere; of c
    place A would need 0.5 of 0.2 allowed, place B 1. The second unknown of d shows more, and is the one that is told.
    """
    e = np.eye(50)
    columns = {
        "a at A": 20.0 * e[:, :1],
        "b at A": 4.0 * e[:, :1],
        "c at A": 10.0 * e[:, :1],
        "c at B": 5.0 * e[:, :1],
        "d at A": np.stack([2.0 * e[0], 25.0 * e[1]], axis=1),
    }
    ranges = {"a at A": (-9.0, 0.0), "b at A": (0.0, 1.0), "c at A": (0.0, 0.2), "c at B": (0.0, 9.0)}
    terms = []
    for label in columns:
        made = term(*label.split(" at "))
        low, high = ranges.get(label, (-9.0, 9.0))
        terms.append(replace(made, unknowns=(replace(made.unknowns[0], low=low, high=high),)))
    second = replace(terms[-1].unknowns[0], name="A.second")
    terms[-1] = replace(terms[-1], unknowns=(*terms[-1].unknowns, second))
    found = smallest(base(np.zeros((50, 0)), 1.0), columns, terms)
    (size,) = {u.size for t in terms for u in t.unknowns}
    sizes = {label: least.change / size for label, least in found.items()}
    expected = {"a at A": -0.25, "b at A": np.nan, "c at B": 1.0, "d at A": 0.2}
    assert sizes == pytest.approx(expected, nan_ok=True)
    assert found["d at A"].parameter == second.name


def test_effects_without_a_column_are_said_not_to_be_judged() -> None:
    """b breaks down everywhere, a at one of its places: b is no row, nor among the invisible."""
    columns = {"a at A": 20.0 * np.eye(50)[:, :1]}
    table = isolability(base(np.zeros((50, 0)), 1.0), columns, (term("a"), term("a", "B"), term("b")))
    assert (table.labels, table.invisible, table.not_judged) == (("a",), (), ("b",))


def test_isolability_takes_the_nearest_place() -> None:
    """b at B lies beside a, b at A does not: effects are as near as their nearest places, and as visible as at best."""
    e = np.eye(50)
    columns = {"a at A": 20.0 * e[:, :1], "b at A": 50.0 * e[:, 1:2], "b at B": 10.0 * (e[:, :1] + 0.1 * e[:, 2:3])}
    table = isolability(base(np.zeros((50, 0)), 1.0), columns, (term("a"), term("b"), term("b", "B")))
    assert table.visibility.tolist() == [20.0, 50.0]
    assert table.separation[0, 1] == pytest.approx(20.0 * 0.1 / np.sqrt(1.01), rel=1e-9)
    assert table.separation[1, 0] == pytest.approx(50.0, rel=1e-9)
    assert table.confused("b") == ()  # b, where it is most visible, is no a


@pytest.mark.parametrize("prior", [1e-4, 1.0, 1e4])
def test_a_prior_limits_what_a_nuisance_absorbs(prior: float) -> None:
    """A nuisance column n = 5 e0 of prior precision π and an effect 7 e0: what stays is 7/√(1 + 25/π), exactly."""
    e = np.eye(50)
    left = projected(5.0 * e[:, :1], np.array([prior]), 7.0 * e[:, :1])
    assert np.linalg.norm(left) == pytest.approx(7.0 / np.sqrt(1.0 + 25.0 / prior), rel=1e-9)


def test_bounded_step_against_scipy() -> None:
    """min |z + J s|² + Σ w (x + s)² in a tight box: never outside, and the minimum of SciPy's lsq_linear to 1e-13.

    Of 4 or 20 unknowns, of columns that differ in size by up to 1e4; a quarter of their bounds are equal. In a wide box
    the two agree to 2e-10.
    """
    rng = np.random.default_rng(8)
    for p in [4] * 50 + [20] * 50:
        J = rng.normal(size=(30, p)) * 10.0 ** rng.uniform(-2, 2, p)
        z, x = rng.normal(size=30), 0.1 * rng.normal(size=p)
        prior, bound = rng.uniform(0.1, 3, p), rng.random(p) < 0.25
        low, high = (np.where(bound, x, x + side * rng.uniform(0.01, 0.2, p)) for side in (-1.0, 1.0))
        w = np.sqrt(precision(prior, x))
        A = np.concatenate([J, np.diag(w)])
        b = -np.concatenate([z, w * x])
        free = bounded_step(J, z, prior, x, np.full(p, -np.inf), np.full(p, np.inf))
        np.testing.assert_allclose(free, np.linalg.lstsq(A, b)[0], rtol=2e-10)
        box = (low - x)[~bound], (high - x)[~bound]
        best = lsq_linear(A[:, ~bound], b, box, method="bvls", tol=1e-15, max_iter=1000).cost
        step = bounded_step(J, z, prior, x, low, high)
        assert np.all(x + step >= low - 1e-12) and np.all(x + step <= high + 1e-12)
        assert 0.5 * np.sum((A @ step - b) ** 2) <= best * (1.0 + 1e-13)
        assert np.all(step[bound] == 0.0)


def test_covariance_of_a_fit() -> None:
    """(JᵀJ + w)⁻¹ with w = π/(1 + π x²/ν), and cost = |z|² + Σ ν ln(1 + π x²/ν), ν = 15: priors of Student's t."""
    e = np.eye(50)
    fit = replace(base(3.0 * e[:, :2], 16.0), x=np.array([1.0, -2.0]), z=2.0 * e[0])
    w = 16.0 / (1.0 + 16.0 * np.array([1.0, 4.0]) / 15.0)
    np.testing.assert_allclose(fit.covariance, np.diag(1.0 / (9.0 + w)), atol=1e-15)
    assert fit.cost == pytest.approx(4.0 + 15.0 * (np.log1p(16.0 / 15.0) + np.log1p(64.0 / 15.0)))


# --- architecture ----------------------------------------------------------------------------------------------------

ROOT = Path(__file__).parents[1]
ALLOWED = {
    "solver": set(),
    "fmu_src": {"solver"},
    "fitting": {"solver"},
    "discrepancy": {"solver", "fitting"},
}


@pytest.mark.parametrize("package", ALLOWED)
def test_imports_run_one_way(package: str) -> None:
    """solver <- fmu_src; solver <- fitting <- discrepancy, which meet the FMU through FMPy alone; tests by nobody."""
    ours = {*ALLOWED, "build_fmu", "benchmarks", "tests", "hidden", "examples"}
    for path in sorted((ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            foreign = {name.partition(".")[0] for name in names} & ours - ALLOWED[package] - {package}
            assert not foreign, f"{path.relative_to(ROOT)} imports {', '.join(foreign)}"
