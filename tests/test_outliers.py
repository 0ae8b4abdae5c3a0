"""Numbers of arteries and outlets that stand out from the others of their kind: which do, and what becomes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forked import NETWORK
from small_network import terms
from test_discrepancy_network import beat_of, beats, record

from discrepancy.name.individual_walls import animal_without, implausible, standing_out, walls_of
from discrepancy.name.model_selection import name
from fitting.inference.fit import Fit
from fitting.inference.hypothesis import nuisances
from fitting.inference.models.network_record import network_problem
from fitting.inference.unknown import Unknown, absent, quantile

EFFECTS = ("wall_stiffness", "terminal_reflection", "channel_gain")


def kind(x: list[float], group: str = "E", stated: bool = False) -> tuple[list[Unknown], np.ndarray]:
    """Numbers of one kind with these deviations, in stated spreads."""
    unknowns = [Unknown(f"{i}.{group}", "scale", ((f"{i}.{group}", 0.08),), -25.0, 25.0) for i in range(len(x))]
    return [Unknown(**{**vars(u), "group": group, "stated": stated}) for u in unknowns], np.array(x)


OTHERS = [0.8, -1.1, 0.3, 1.4, -0.7, -0.2, 0.9, -1.2]


@pytest.mark.parametrize(
    ("x", "found"),
    [
        pytest.param([*OTHERS, 3.9], [], id="within four spreads"),
        pytest.param([*OTHERS, 5.1], [8], id="beyond them, and 5.6 root mean squares of the others"),
        pytest.param([*OTHERS, 11.5, -11.5], [8, 9], id="two that would hide each other: 4.3 of the others with one"),
        pytest.param([2.5 * x for x in [*OTHERS, 3.0]], [], id="an animal whose walls all spread wider"),
        pytest.param([0.0, 6.0], [1], id="two outlets"),
        pytest.param([6.0], [0], id="one outlet"),
    ],
)
def test_what_stands_out(x: list[float], found: list[int]) -> None:
    assert sorted(standing_out(*kind(x))) == [f"{i}.E" for i in found]


def test_what_a_calibration_left_uncertain_does_not() -> None:
    """Its directions have no kind."""
    assert standing_out(*kind([*OTHERS, 12.0], stated=True)) == {}


def test_how_often_a_healthy_animal_has_one() -> None:
    """Ten arteries with E, φ0 and R0 and six outlets with R_t, normal with w times the stated spreads, 2000 animals:
    the rates beside the threshold, 0.06, 2 and 6 % for w = 1, 1.5 and 2.5, within 4 standard deviations."""
    rng, n = np.random.default_rng(0), 2000
    kinds = [kind([0.0] * k)[0] for k in (10, 10, 10, 6)]
    for w, rate in ((1.0, 0.0006), (1.5, 0.02), (2.5, 0.06)):
        many = sum(
            any(standing_out(numbers, w * rng.standard_normal(len(numbers))) for numbers in kinds) for _ in range(n)
        )
        assert many / n == pytest.approx(rate, abs=4.0 * np.sqrt(rate / n)), w


@pytest.mark.parametrize(
    ("variable", "factor", "label"),
    [
        pytest.param("B.E", 2.5, "wall_stiffness at B", id="stiffer"),
        pytest.param("B.E", 0.4, "wall_stiffness at B", id="softer", marks=pytest.mark.deep),
    ],
)
def test_a_number_that_stands_out_is_named(variable: str, factor: float, label: str) -> None:
    """Every wall may differ by itself; E of B is 11 spreads off: the verdict was `none` with that number in its notes.
    What is left of its own deviations is within four spreads, and the animal without the effect leaves a gap."""
    value = NETWORK.parameters()[variable]
    problem = network_problem(record(beat_of(((variable, factor * value),)), 15, 0.01), NETWORK)
    found = name(problem, terms(*EFFECTS), walls="individual")
    assert (found.verdict, found.best.label, found.walls) == ("effect", label, "individual")
    walls = walls_of(NETWORK, found.best.fit, quantile(found.problem.dof_of_noise))
    assert all(abs(own.deviation) <= 4.0 for own in walls.arteries.values())
    alone = animal_without(found.problem, found.best.fit, found.base.fit)
    assert alone is not None and not alone.terms
    (X,) = found.problem.observe([alone.member])
    assert X is not None and np.mean(found.problem.residual(X) ** 2) > 100.0


@pytest.mark.deep
def test_which_of_two_outlets() -> None:
    """R_t of B is 0.3 above the file's, ten spreads, or what both have in common is and C below it: never `none`, and
    the class has B."""
    problem = network_problem(record(beat_of((("B.outlet.R_t", 0.7),)), 15, 0.01), NETWORK)
    found = name(problem, terms(*EFFECTS), walls="individual")
    assert found.verdict in ("effect", "ambiguous") and "terminal_reflection at B" in {n.label for n in found.members}


def test_nothing_stands_out_in_the_network_as_it_is() -> None:
    """None, and no animal without an effect to show."""
    found = name(network_problem(beats(), NETWORK), terms(*EFFECTS), walls="individual")
    assert found.verdict == "none" and animal_without(found.problem, found.base.fit, found.base.fit) is None
    assert implausible(found.base.fit) == {}


def test_an_odd_animal_is_no_model_without_the_effect() -> None:
    """A reflection that the search finds by itself is left out of the model before it, where the animal without effect
    has it as a number of its own, ten spreads off: with that one the gap fell from 1.52 to 1.51."""
    problem = network_problem(beats(), NETWORK).individual()
    (effect,) = (t for t in terms("terminal_reflection") if t.place == "B")
    unknowns, without = problem.hypothesis((effect,)), problem.hypothesis(())
    odd = np.array([10.0 if u.name == "B.outlet.R_t of its own" else 0.0 for u in without])
    fit = Fit(
        (effect,), unknowns, np.ones(len(unknowns)), np.zeros(2), np.zeros((2, len(unknowns))), *2 * [np.zeros(2)]
    )
    none = replace(fit, terms=(), unknowns=without, x=odd, J=np.zeros((2, len(without))))
    alone = animal_without(problem, fit, none)
    assert alone is not None and alone.terms == () and set(alone.unknowns) == set(unknowns) - set(effect.unknowns)
    assert implausible(none) == pytest.approx({"B.outlet.R_t of its own": 10.0})


@pytest.mark.parametrize(
    ("effect", "alone"), [("terminal_reflection", True), ("wall_stiffness", True), ("taper", False)]
)
def test_an_effect_that_is_a_parameter_has_a_subject_without_it(effect: str, alone: bool) -> None:
    """R_t and E of an artery act as its own R_t and E, whatever derivatives the search ended with; a taper as none."""
    problem = network_problem(beats(), NETWORK).individual()
    (added,) = (t for t in terms(effect) if t.place == "B")
    unknowns, n = problem.hypothesis((added,)), len(problem.entries[0])
    fit = Fit((added,), unknowns, absent(unknowns), np.zeros(n), np.zeros((n, len(unknowns))), *problem.entries)
    none = replace(fit, terms=(), unknowns=problem.hypothesis(()), x=absent(problem.hypothesis(())))
    assert (animal_without(problem, fit, none) is not None) == alone


@pytest.mark.parametrize(("x", "far"), [(3.9, {}), (-5.5, {"all.E": -5.5})])
def test_what_all_have_in_common_may_be_far_too(x: float, far: dict[str, float]) -> None:
    """Four stated spreads from the file's, whatever the others: there is no other animal to compare with."""
    unknowns = nuisances(NETWORK)
    at = np.array([x if u.name == "all.E" else 0.0 for u in unknowns])
    fit = Fit((), unknowns, at, np.zeros(2), np.zeros((2, len(unknowns))), *2 * [np.zeros(2)])
    assert implausible(fit) == pytest.approx(far)
