"""Animals of the generator whose walls differ one by one, and what of an effect such walls cannot absorb."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from judged import judge
from truth.anatomy import Anatomy, anatomy
from truth.animal import INDIVIDUAL, nuisance, priors, walls_of_its_own
from truth.detect import NetworkProblem, d_prime, detect, distance
from truth.hide import Effect
from truth.records import Case, make

from fitting.records.read.record import Record

NULL = Case("network", "three pressures", 40.0)


def test_every_wall_is_off_by_itself() -> None:
    """Over 2000 animals E, phi0, R0 and R_t scatter as stated, each by itself; all else is that of the seed."""
    base = anatomy(NULL.network())
    own = [of_its_own(seed, base) for seed in range(2000)]
    for key, sd in INDIVIDUAL.items():
        names = [name for name in priors("network", base, 1.0) if name.endswith(f".{key}")]
        x = np.array([[a[name] if key == "R_t" else np.log(a[name]) for name in names] for a in own])
        assert len(names) == (5 if key == "R_t" else 10)
        assert np.std(x) == pytest.approx(1.5 * sd, rel=0.02)
        assert np.abs(np.corrcoef(x.T) - np.eye(len(names))).max() < 0.1


def of_its_own(seed: int, base: Anatomy) -> dict[str, float]:
    """What one animal of the widest spread has of its own."""
    rng = np.random.default_rng(seed)
    return dict(walls_of_its_own(rng, nuisance(rng, "network"), base, 1.5).own)


def test_the_truth_tells_each_wall() -> None:
    """The same seed without and with walls of their own: the same period and common scales, other waves."""
    alike, apart = make(NULL, 7), make(replace(NULL, walls=1.0), 7)
    assert alike.truth["period"] == apart.truth["period"]
    assert apart.truth["nuisance"]["E"] == alike.truth["nuisance"]["E"]
    own = apart.truth["nuisance"]["own"]
    assert len(own) == 35 and not alike.truth["nuisance"]["own"]
    vessel, model = anatomy(apart.base).vessel("CA"), apart.nuisance.applied(anatomy(apart.base))
    assert model.vessel("CA").E == pytest.approx(vessel.E * apart.nuisance.E * own["CA.E"], rel=1e-14)
    assert model.vessel("CA").R0 == pytest.approx(vessel.R0 * own["CA.R0"], rel=1e-14)
    assert not np.allclose(alike.clean["CA.P"], apart.clean["CA.P"], rtol=1e-4)


@pytest.mark.deep
def test_walls_absorb_a_stiffness() -> None:
    """Beside walls of their own a stiffness of 20 % is at most ln 1.2/0.08 standard deviations, once and for all."""
    made = make(replace(NULL, walls=1.0, effects=(Effect("wall_stiffness", ("CA",), 0.2),)), 7)
    assert d_prime(NetworkProblem(made), []) <= np.log(1.2) / 0.08 + 0.05


@pytest.mark.deep
def test_a_number_that_is_far_off_is_no_farther_than_it_is() -> None:
    """The number of one wall or end, in standard deviations of this animal; that of a part, or of walls alike, is none.
    A softening of 56 % is at most 6.9 of these, where the refit alone ends at 15."""
    own = {"CA.E": 0.12, "CA.R_t": 0.03, "CA.R0": 0.02}
    assert distance(Effect("wall_stiffness", ("CA",), -0.564), own) == pytest.approx(6.92, abs=0.01)
    assert distance(Effect("terminal_reflection", ("CA",), -0.3), own) == pytest.approx(10.0)
    assert distance(Effect("wall_radius", ("CA",), 0.1), own) == pytest.approx(4.77, abs=0.01)
    assert distance(Effect("wall_stiffness", ("CA",), -0.564, length=0.1), own) == np.inf
    assert (
        distance(Effect("wall_stiffness", ("CA",), -0.564), {})
        == distance(Effect("taper", ("CA",), 0.1), own)
        == np.inf
    )
    case = replace(NULL, walls=1.5, effects=(Effect("wall_stiffness", ("MD",), -0.564),))
    assert detect(make(case, (20331106, 1, 15)), 1e9).d_prime == (pytest.approx(6.92, abs=0.01),)


@pytest.mark.deep
def test_walls_do_not_absorb_a_stenosis() -> None:
    """It shows less than with walls alike, and is told apart less; the derivatives at the truth serve all steps: the
    marginalised norm to 15 % (10 % measured, what bends with a wall of two standard deviations)."""
    narrow = make(replace(NULL, walls=1.0, effects=(Effect("stenosis", ("MD",), 2.0),)), 7)
    seen, alike = detect(narrow), detect(make(replace(NULL, effects=narrow.case.effects), 7))
    assert 6.0 < seen.d_prime[0] < alike.d_prime[0]
    assert seen.separation < alike.separation
    problem = NetworkProblem(narrow)
    delta = problem.residual(np.zeros(problem.nuisances), [])
    steps = 1e-3 * np.eye(problem.nuisances)
    S = np.stack([(problem.residual(x, []) - delta) / 1e-3 for x in steps], axis=1) * problem.prior
    exact = np.sqrt(delta @ np.linalg.solve(np.eye(len(delta)) + S @ S.T, delta))
    assert seen.d_prime[0] == pytest.approx(exact, rel=0.15)


@pytest.mark.deep
def test_a_windkessel_that_walls_had_absorbed() -> None:
    """A slow catheter and a Windkessel, individual walls, 30 dB: both are named, C to 1 %. The catheter alone explains
    the record with a radius 11 spreads off, and from there the Windkessel is not found."""
    hidden = (
        Effect("catheter_resonance", ("MD.Q",), 0.055262908184421915, 0.20115314470408702),
        Effect("terminal_compliance", ("VA3",), 0.14515518944265454, 0.5365713563106329),
    )
    made = make(Case("network", "all", 30.0, hidden, walls=0.5), (20331108, 1, 45))
    naming = judge(Record("made", "", made.time, made.channels, {}), made.base)[1]
    assert naming.verdict == "several" and {t.effect for t in naming.best.fit.terms} == {e.name for e in hidden}
    fit, (C,) = naming.best.fit, (u for u in naming.best.fit.unknowns if u.name == "VA3.outlet.C")
    found = C.nominal * np.exp(C.size * fit.x[fit.unknowns.index(C)])
    assert found == pytest.approx(float(made.truth["effects"][1]["parameters"]["VA3.C"]), rel=0.01)
