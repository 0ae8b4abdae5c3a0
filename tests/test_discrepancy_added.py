"""What is added to a network: the values of the fit, in the file and in the verdict."""

from __future__ import annotations

import numpy as np
import pytest
from forked import NETWORK
from small_network import NAMES, term

from fitting.inference.extended_network import estimates, extended
from fitting.inference.fit import Fit
from fitting.inference.hypothesis import PlacedEffect, candidates, followers, nuisances
from fitting.inference.unknown import interval
from solver.laws import effects
from solver.network.files import dumps, loads

RATIOS = {"wall_viscosity": "E", "nonlinear_wall_viscosity": "phi0", "nonlinear_elasticity": "E"}


def test_extended_has_the_values_of_the_fit() -> None:
    """value = nominal exp(step x) or nominal + step x, written by hand for E, φ0, R_t, a wall and a sensor."""
    problem_terms = (term("wall_stiffness", "B"), term("channel_lag", "A.P"))
    unknowns = (*nuisances(NETWORK), *(u for t in problem_terms for u in t.unknowns))
    x = np.array([0.5, -0.3, 0.25, 0.8, 1.5])
    network = extended(NETWORK, Fit(problem_terms, unknowns, x, x, x, x, x))
    found, before = network.parameters(), NETWORK.parameters()
    for segment in "ABC":
        assert found[f"{segment}.E"] == pytest.approx(before[f"{segment}.E"] * np.exp(0.2 * 0.5))
        assert found[f"{segment}.phi0"] == pytest.approx(before[f"{segment}.phi0"] * np.exp(-0.2 * 0.3))
    for segment in "BC":
        assert found[f"{segment}.outlet.R_t"] == pytest.approx(before[f"{segment}.outlet.R_t"] + 0.2 * 0.25)
    assert found["B.E_scale"] == pytest.approx(np.exp(0.3 * 0.8))
    assert {c.name: c.terms for c in network.channels} == {"A.P": {"lag": pytest.approx(4.5e-3)}}
    moved = {"E", "phi0", "R_t", "E_scale"}
    same = [n for n in before if n.rpartition(".")[2] not in moved]
    assert [found[n] for n in same] == [before[n] for n in same]


@pytest.mark.parametrize("t", candidates(NETWORK, ("A.P", "C.R")), ids=lambda t: t.label)
def test_verdict_and_model_have_the_same_values(t: PlacedEffect) -> None:
    """Every term at x = 0.3 beside nuisances at 0.1, 0.2, -0.3: what verdict.json says is in the extended network."""
    fit = moved(t)
    network = extended(NETWORK, fit)
    found = network.parameters() | {f"{c.name}.{k}": v for c in network.channels for k, v in c.terms.items()}
    for variable, told in estimates(NETWORK, fit, t, 2.0).items():
        if variable.startswith("all.") and variable not in found:
            key = variable.rpartition(".")[2]
            if t.effect in RATIOS:
                expected = {found[f"{s}.{key}"] / found[f"{s}.{RATIOS[t.effect]}"] for s in "ABC"}
            else:
                expected = {value for name, value in found.items() if name.rpartition(".")[2] == key}
        else:
            expected = {found[variable]}
        assert all(told.value == pytest.approx(value, rel=1e-12) for value in expected), variable
        assert told.ci95[0] < told.value < told.ci95[1]


def moved(t: PlacedEffect) -> Fit:
    """The term at 0.3 with the nuisances moved, each known to a hundredth of its unit."""
    unknowns, x = (*nuisances(NETWORK), *t.unknowns), np.concatenate([[0.1, 0.2, -0.3], np.full(len(t.unknowns), 0.3)])
    if t.rewires:
        unknowns, x = (*nuisances(NETWORK)[:2], *t.unknowns), np.delete(x, 2)
    none = np.zeros(len(x))
    return Fit((t,), unknowns, x, none, 100.0 * np.eye(len(x)), none, none)


@pytest.mark.parametrize("t", candidates(NETWORK, ("A.P", "C.R")), ids=lambda t: t.label)
def test_every_term_survives_the_file(t: PlacedEffect) -> None:
    """Each candidate at x = 0.3 with the nuisances moved: written as TOML and read back, it is the same network."""
    network = extended(NETWORK, moved(t))
    assert network != NETWORK
    again = loads(dumps(network), "again.toml")
    assert again.parameters() == pytest.approx(network.parameters(), rel=1e-14)
    assert {c.name: dict(c.terms) for c in again.channels} == {c.name: dict(c.terms) for c in network.channels}
    assert set(again.parameters()) == set(network.parameters())
    if t.is_sensor:
        assert [c.name for c in again.channels] == [t.place]


def test_candidates_are_every_effect_at_every_place() -> None:
    """Walls at three segments and everywhere, two outlets, one junction, six channels; none twice, none forgotten but
    filters and zeros, which are known, and what is learned."""
    found = candidates(NETWORK, NAMES)
    labels = [t.label for t in found]
    assert len(set(labels)) == len(labels)
    known, learned = {"low_pass", "known_zero", "known_delay"}, {"learned_wall", "learned_outlet"}
    assert {t.effect for t in found} == {e.name for e in effects.ALL} - known - learned
    assert [t.place for t in found if t.effect == "wall_stiffness"] == ["A", "B", "C"]
    assert sorted(t.place for t in found if t.effect == "terminal_compliance") == ["B", "C"]
    assert [t.place for t in found if t.effect == "junction_loss"] == ["A"]
    assert [t.place for t in found if t.effect == "channel_lag"] == list(NAMES)


def test_followers_of_viscosity() -> None:
    """Elastic walls have nothing to bend or to delay; once B has viscosity, both may act there, and only there."""
    elastic = NETWORK.with_parameters({f"{s}.phi0": 0.0 for s in "ABC"})
    first = candidates(elastic, ())
    assert not {"nonlinear_wall_viscosity", "stress_relaxation"} & {t.effect for t in first}
    viscous = elastic.with_parameters({"B.phi0": 13e3})
    added = {t.label for t in followers(viscous, None, first)}
    assert added >= {"nonlinear_wall_viscosity at B", "stress_relaxation at B"}
    assert {place for _, _, place in (label.partition(" at ") for label in added)} <= {"B", "all"}


def test_estimates_stay_in_their_range() -> None:
    """A viscosity of 0.5 ± 1 typical sizes, two standard deviations: the interval ends at 0, not below."""
    elastic = NETWORK.with_parameters({f"{s}.phi0": 0.0 for s in "ABC"})
    t = next(t for t in candidates(elastic, ()) if t.label == "wall_viscosity at B")
    phi0 = elastic.parameter_quantities()["B.phi0"]
    told = interval(t.unknowns, "B.phi0", 0.0, phi0, np.array([0.5]), np.eye(1), 2.0)
    assert told.ci95[0] == 0.0
    assert told.value == pytest.approx(0.5 * 0.017 * 9e5)
    assert told.ci95[1] == pytest.approx(2.5 * 0.017 * 9e5)
