"""Naming on a small network through the public API, and the parts that it is made of.

Three vessels and seven channels; the truth is simulated by the same solver on half the elements at a fifth of the step.
The bank judges with the independent generator.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from forked import NETWORK, N, T, inflow, record
from judged import value_of
from small_network import NAMES, term, terms

from discrepancy.checkpoint import Journal
from discrepancy.name.model_selection import name
from discrepancy.name.verdict import Naming
from fitting.inference.extended_network import estimates, extended
from fitting.inference.fit import Fit, Member
from fitting.inference.hypothesis import PlacedEffect, candidates, joins, sensor_effects
from fitting.inference.models.bench_observation import sense
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.network_record import network_problem
from fitting.inference.models.simulator import Simulator
from fitting.inference.runs import OutOfTime, Runs
from fitting.inference.unknown import quantile
from fitting.records.alignment.beats import Beats
from fitting.records.channels.noise import Target
from solver import NonPhysicalState, Settings, simulate_periodic
from solver.laws import catalogue, effects
from solver.laws.effect import Effect, Values
from solver.laws.wall import Wall
from solver.quantities.quantity import Quantity

EFFECTS = ("wall_stiffness", "terminal_reflection", "channel_gain")


def truth(E_scale: float) -> dict[str, np.ndarray]:
    """One beat with B stiffer by a factor, N samples without aliases."""
    return beat_of((("B.E", 9e5 * E_scale),))


@cache
def beat_of(parameters: tuple[tuple[str, float], ...]) -> dict[str, np.ndarray]:
    """One beat of the network with these values."""
    settings = Settings(dt=T / 200, element_length=Settings().element_length / 2.0, tolerance=1e-7)
    beat = simulate_periodic(NETWORK, inflow, T, parameters=dict(parameters), settings=settings, tolerance=1e-6)
    X = {n: np.fft.rfft(beat[n][:-1], norm="forward")[: N // 2 + 1] for n in ("inlet.Q", *NAMES)}
    return {n: np.fft.irfft(x, N, norm="forward") for n, x in X.items()}


def beats(E_scale: float = 1.0, noise: float = 0.01) -> Beats:
    """15 beats with white noise of 40 dB on every channel."""
    return record(truth(E_scale), 15, noise)


@pytest.fixture(scope="module")
def healthy() -> NetworkProblem:
    """A record of the network as it is."""
    return network_problem(beats(), NETWORK)


@pytest.fixture(scope="module")
def stiff() -> Naming:
    """A record in which B is 25 % stiffer and nothing else may differ, named among twelve candidates."""
    return name(network_problem(beats(1.25), NETWORK), terms(*EFFECTS), walls="common")


def at(problem: NetworkProblem, x: list[float], *added: PlacedEffect) -> Fit:
    """A hypothesis at a point, without data."""
    empty = np.zeros(0)
    return Fit(added, problem.hypothesis(added), np.array(x), empty, empty, empty, empty)


# --- naming ----------------------------------------------------------------------------------------------------------


def test_place_and_size_of_a_stiff_segment(stiff: Naming) -> None:
    """wall_stiffness at B, one name; 1.25 within its 95 % interval, which is ± 0.13 %."""
    assert stiff.verdict == "effect"
    assert stiff.best.label == "wall_stiffness at B" and stiff.confidence > 0.85
    fit = stiff.best.fit
    (unknown,) = stiff.best.fit.terms[0].unknowns
    x, sd = fit.x[-1], np.sqrt(fit.covariance[-1, -1])
    told = value_of(unknown, float(x), float(sd), quantile(stiff.problem.dof_of_noise))
    assert told.value == pytest.approx(1.25, rel=0.004)
    assert told.ci95[0] <= 1.25 <= told.ci95[1]
    assert np.all(np.abs(fit.x[:-1]) <= 4.0 * np.sqrt(np.diag(fit.covariance))[:-1])  # nuisances stay where they were


@pytest.mark.deep
@pytest.mark.parametrize("walls", ["common", None])
def test_viscosity_everywhere_that_is_not_the_same_everywhere(walls: str | None) -> None:
    """Elastic model; φ0/E = 10, 16 and 25 ms in the three walls: one effect, everywhere, with a size for each wall."""
    sizes = {"A": 0.010, "B": 0.016, "C": 0.025}
    viscous = {f"{s.name}.phi0": sizes[s.name] * s.E for s in NETWORK.segments}
    elastic = NETWORK.with_parameters(dict.fromkeys(viscous, 0.0))
    problem = network_problem(record(beat_of(tuple(viscous.items())), 15, 0.01), elastic)
    found = tuple(t for t in candidates(elastic, NAMES) if t.effect in ("wall_viscosity", "channel_lag"))
    naming = name(problem, found, walls=walls)
    assert naming.verdict == "effect"
    (told,) = naming.best.fit.terms
    assert (told.effect, told.where) == ("wall_viscosity", ("all",))
    values = estimates(elastic, naming.best.fit, told, quantile(naming.problem.dof_of_noise))
    assert set(values) == set(viscous)
    for variable, phi0 in viscous.items():
        assert values[variable].value == pytest.approx(phi0, rel=0.02)
    network = extended(elastic, naming.best.fit)
    assert all(network.parameters()[v] == pytest.approx(values[v].value, rel=1e-12) for v in viscous)


def test_the_wrong_places_do_not_explain_it(stiff: Naming) -> None:
    """Every rival that was refitted leaves more than noise and is far from the class."""
    rivals = stiff.ranked[1:]
    assert rivals
    assert not any(n.explains for n in rivals)
    assert min(n.separation for n in rivals) > 30.0
    assert not stiff.base.explains


def test_an_effect_of_a_hundredth_of_its_typical_size() -> None:
    """1.2 % stiffer (x = 0.04 of a typical size) in noise that shows 0.1 %: an effect, not what "none" absorbs."""
    naming = name(network_problem(beats(1.012), NETWORK), terms(*EFFECTS), walls="common")
    assert naming.best.label == "wall_stiffness at B"
    assert naming.base.fit.cost > naming.best.fit.cost + 40.0


def test_a_simpler_hypothesis_has_its_own_residual(stiff: Naming) -> None:
    """Searched from where wall_stiffness is, "no effect" comes to what it came to by itself, within 1 %."""
    problem = stiff.problem
    assert isinstance(problem, NetworkProblem)
    (none,) = problem.refit([()], stiff.best.fit)
    (alone,) = problem.refit([()])
    assert none is not None and alone is not None
    assert none.cost == pytest.approx(alone.cost, rel=0.01)
    assert none.cost > 10.0 * stiff.best.fit.cost


class Toy(Effect):
    """A wall that is stiffer toward its end, by two numbers."""

    name = "toy"
    equation = "K becomes K (1 + linear x/L + square (x/L)²)"
    owner = "segment"
    places = ("segment",)
    terms: ClassVar[dict[str, Quantity]] = {
        "linear": Quantity("1", "linear part", 0.0, 10.0, nominal=0.3),
        "square": Quantity("1", "quadratic part", 0.0, 10.0, nominal=0.3),
    }
    neutral: ClassVar[dict[str, float]] = {"linear": 0.0, "square": 0.0}
    signature = "none"
    confusable = ("taper",)
    separator = "none"

    def wall(self, wall: Wall, values: Values, x: np.ndarray) -> Wall:
        return replace(wall, K=wall.K * (1.0 + values["linear"] * x + values["square"] * x * x))


def test_a_new_effect_is_a_candidate(monkeypatch: pytest.MonkeyPatch) -> None:
    """One class of two numbers, appended to the catalogue, is named where it is hidden: B, K (1 + x/L)."""
    monkeypatch.setattr(effects, "ALL", (*effects.ALL, Toy()))
    hidden = NETWORK.with_terms({"B.linear": 1.0, "B.square": 0.0})
    settings = Settings(dt=T / 200, tolerance=1e-7)
    beat = simulate_periodic(hidden, inflow, T, settings=settings, tolerance=1e-6)
    X = {n: np.fft.rfft(beat[n][:-1], norm="forward")[: N // 2 + 1] for n in ("inlet.Q", *NAMES)}
    beats_ = record({n: np.fft.irfft(x, N, norm="forward") for n, x in X.items()}, 15, 0.01)
    found = tuple(t for t in candidates(NETWORK, NAMES) if t.effect in ("toy", "channel_gain"))
    naming = name(network_problem(beats_, NETWORK), found, walls="common")
    assert (naming.verdict, naming.best.label) == ("effect", "toy at B")
    told = estimates(NETWORK, naming.best.fit, naming.best.fit.terms[0], quantile(naming.problem.dof_of_noise))
    assert set(told) == {"B.linear", "B.square"}
    at_end = 1.0 + told["B.linear"].value + told["B.square"].value
    assert at_end == pytest.approx(2.0, rel=0.05)


def test_nothing_hidden(healthy: NetworkProblem) -> None:
    """The network as it is, on another mesh and step: none, and the residual's mean square is 1 within 3 sd."""
    naming = name(healthy, terms(*EFFECTS))
    assert naming.verdict == "none"
    z = naming.base.fit.z
    assert np.mean(z**2) == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / len(z)))


def read_back(naming: Naming, folder: Path) -> Naming:
    """Through the bytes of a journal."""
    journal = Journal(folder, [])
    journal.stage("naming", lambda: naming)
    return journal.stage("naming", pytest.fail)


def test_a_naming_read_back_has_its_problem(stiff: Naming, tmp_path: Path) -> None:
    """Through a journal: the same network, step and weights, bit by bit."""
    again = read_back(stiff, tmp_path)
    assert again.problem.hypothesis(()) == stiff.problem.hypothesis(())
    assert isinstance(again.problem, NetworkProblem) and isinstance(stiff.problem, NetworkProblem)
    assert again.problem.simulator.settings == stiff.problem.simulator.settings
    assert again.problem.network == stiff.problem.network
    for key in ("error", "response", "model_error"):
        assert np.array_equal(getattr(stiff.problem, key), getattr(again.problem, key)), key
    for key in ("X", "covariance", "whitener"):
        assert np.array_equal(getattr(stiff.problem.target, key), getattr(again.problem.target, key)), key
    assert again.best.label == stiff.best.label
    assert np.array_equal(again.best.fit.z, stiff.best.fit.z)


def test_a_problem_remembers_nothing_that_was_simulated(stiff: Naming, tmp_path: Path) -> None:
    """After naming and read back: the most probable beats, from rest, are the same bit by bit."""
    again = read_back(stiff, tmp_path)
    one, other = stiff.problem, again.problem
    assert isinstance(one, NetworkProblem) and isinstance(other, NetworkProblem)
    (X,), (Y,) = one.observe([stiff.best.fit.member]), other.observe([again.best.fit.member])
    assert X is not None and Y is not None and np.array_equal(X, Y)


# --- the residual ----------------------------------------------------------------------------------------------------


def test_columns_are_derivatives(healthy: NetworkProblem) -> None:
    """Columns at x = 0 of a wall, an outlet and a sensor against central differences of ±0.1: within 5 % of |a|."""
    none = replace(at(healthy, [0.0, 0.0, 0.0]), z=np.zeros(0))
    chosen = (term("wall_stiffness", "C"), term("terminal_reflection", "B"), term("channel_gain", "B.Q"))
    columns = healthy.columns(none, chosen)
    for t in chosen:
        unknowns = healthy.hypothesis((t,))
        pair = [Member((t,), unknowns, np.array([0.0, 0.0, 0.0, x])) for x in (0.1, -0.1)]
        up, down = (healthy.residual(x) for x in healthy.observe(pair) if x is not None)
        expected = (up - down) / 0.2
        assert np.linalg.norm(columns[t.label][:, 0] - expected) <= 0.05 * np.linalg.norm(expected), t.label


def test_a_sensor_needs_no_simulation(healthy: NetworkProblem) -> None:
    """Ten sizes of a channel's gain cost one simulation, and only that channel changes: by the gain, exactly."""
    t = term("channel_gain", "B.Q")
    unknowns = healthy.hypothesis((t,))
    runs = Runs()
    X = healthy.observe([Member((t,), unknowns, np.array([0.0, 0.0, 0.0, x])) for x in np.linspace(0.0, 9.0, 10)], runs)
    assert runs.meter.simulations == 1
    i = healthy.signals.index("B.Q")
    for x, each in zip(np.linspace(0.0, 9.0, 10), X, strict=True):
        ratio = np.ones(len(healthy.signals))
        ratio[i] = np.exp(0.03 * x)
        np.testing.assert_allclose(each, X[0] * ratio, rtol=1e-13)


def test_shorter_elements_that_break_down_are_not_taken(
    healthy: NetworkProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where half the elements cannot be simulated, the problem is the same, after one attempt."""
    real, tried = Simulator.coefficients, []

    def breaks(self: Simulator, *given: Any) -> np.ndarray:
        if self.settings.element_length < healthy.simulator.settings.element_length:
            tried.append(self.settings.element_length)
            raise NonPhysicalState("it did not converge", "A", 0.0, 0.0, "lower the inflow")
        return real(self, *given)

    monkeypatch.setattr(Simulator, "coefficients", breaks)
    assert healthy.sharpened(at(healthy, [0.0, 0.0, 0.0])) is healthy
    assert tried == [healthy.simulator.settings.element_length / 2.0]


def test_nothing_is_simulated_after_the_deadline(healthy: NetworkProblem) -> None:
    """The clock says 5 s when a batch begins, and 11 s within it; the limit is 4 s, 10 s, none."""
    member = at(healthy, [0.0, 0.0, 0.0]).member
    for deadline, times in ((4.0, [5.0]), (10.0, [5.0, 11.0])):
        ticks = iter(times)
        with pytest.raises(OutOfTime, match="allow more time"):
            healthy.observe([member], Runs(deadline=deadline, clock=ticks.__next__))
        assert not list(ticks)
    (X,) = healthy.observe([member], Runs())
    assert X is not None


def test_an_outlet_that_is_rewired_reflects_no_more() -> None:
    """Beside terminal_compliance at B no term may move B's reflection, at B or everywhere; that of C may."""
    compliance = term("terminal_compliance", "B")
    others = terms("terminal_reflection", "wall_stiffness")
    assert [t.place for t in others if not joins(t, (compliance,))] == ["all", "B"]
    assert all(joins(t, (term("wall_stiffness", "B"),)) for t in others)


def test_sense_is_the_catalogue() -> None:
    """Lag, gain, offset and resonance of one channel against effects.observe; other channels stay, bit by bit."""
    rng = np.random.default_rng(1)
    X = rng.normal(size=(6, len(NAMES))) + 1j * rng.normal(size=(6, len(NAMES)))
    omega = 2.0 * np.pi / T * np.arange(6)
    for t in sensor_effects(NETWORK, "C.R"):
        x = np.full(len(t.unknowns), 0.7)
        found = sense(Member((t,), t.unknowns, x), NAMES, X, T)
        fit = Fit((t,), t.unknowns, x, x, x, x, x)
        (channel,) = extended(NETWORK, fit).channels
        expected = catalogue.observe(channel.terms, X[:, -1], omega)
        np.testing.assert_allclose(found[:, -1], expected, rtol=1e-12, err_msg=t.effect)
        assert np.array_equal(found[:, :-1], X[:, :-1])
        assert not np.allclose(found[:, -1], X[:, -1])
    assert sense(Member((), (), np.zeros(0)), NAMES, X, T) is X


@pytest.mark.parametrize(("noise", "halvings"), [(1e-1, 0), (1e-4, 2)])
def test_sharpened_shortens_elements_where_they_matter(noise: float, halvings: int) -> None:
    """Elements of 40 cm: kept in 20 dB of noise, halved twice in 80 dB; the covariance then holds a smaller error."""
    problem = network_problem(beats(noise=noise), NETWORK)
    coarse = replace(problem.simulator.settings, element_length=0.4)
    problem = replace(problem, simulator=replace(problem.simulator, settings=coarse))
    none = at(problem, [0.0, 0.0, 0.0])
    sharp = problem.sharpened(none)
    assert sharp.simulator.settings.element_length == pytest.approx(0.4 / 2**halvings)
    assert problem.simulator.settings.element_length == 0.4
    assert np.all(sharp.error > 0.0)


def test_fits_are_restated_under_other_weights(stiff: Naming, healthy: NetworkProblem) -> None:
    """Whitened anew, z and J are those of the same simulation under the new covariance: to 1e-9."""
    before = network_problem(beats(1.25), NETWORK)
    after = replace(before, target=Target.of(before.signals, before.target.X, 1.7 * healthy.target.covariance))
    (old,) = before.refit([()])
    assert old is not None
    (new,) = after.restated([old], before)
    X = before.target.X[..., None] + before.target.unwhiten(old.z[:, None])
    np.testing.assert_allclose(new.z, after.target.residual(X[None, ..., 0])[0], atol=1e-9 * np.abs(new.z).max())
    (back,) = before.restated([new], after)
    np.testing.assert_allclose(back.z, old.z, atol=1e-9 * np.abs(old.z).max())
    np.testing.assert_allclose(back.J, old.J, atol=1e-9 * np.abs(old.J).max())


def test_held_out_beats_are_weighted_by_their_number(healthy: NetworkProblem) -> None:
    """5 beats have 3 times the variance of 15, their means no less; that of the solver's error stays. Whitened it is 1,
    and the mean is their own."""
    kept = beats(noise=0.02).select(range(5))
    other = healthy.held_out(kept, healthy.beats)
    C, W = other.target.covariance, other.target.whitener
    solver = np.array([np.diag(e) for e in healthy.error[1:] ** 2])
    np.testing.assert_allclose(C[1:] - solver, 3.0 * (healthy.target.covariance[1:] - solver), rtol=1e-12)
    first = np.diag(healthy.target.covariance[0]).real - healthy.error[0] ** 2
    assert np.all(np.diag(C[0]).real >= (3.0 * first + healthy.error[0] ** 2) * (1.0 - 1e-12))
    unit = W @ C @ W.conj().swapaxes(1, 2)
    np.testing.assert_allclose(unit, np.broadcast_to(np.eye(len(healthy.signals)), unit.shape), atol=1e-9)
    assert other.target.X[0, 0] == pytest.approx(kept.mean(healthy.signals[0]).mean())


def test_errors_of_the_model_stay_with_fewer_beats(healthy: NetworkProblem) -> None:
    """Five beats of fifteen have 3 times the variance of noise; errors of the model add what they add to fifteen. Where
    they were scaled with the noise, it was 3 times that."""
    kept = beats(noise=0.02).select(range(5))
    wide = healthy.granted(0.03)
    added = (wide.target.covariance - healthy.target.covariance)[1:]
    plain, other = (p.held_out(kept, healthy.beats).target.covariance[1:] for p in (healthy, wide))
    np.testing.assert_allclose(other - plain, added, atol=1e-12 * np.abs(added).max())


def test_extended_is_what_was_fitted(stiff: Naming) -> None:
    """The extended network simulated by itself gives the residual of the fit: |Δz| <= 0.05."""
    problem = stiff.problem
    assert isinstance(problem, NetworkProblem)
    network = extended(NETWORK, stiff.best.fit)
    X = problem.simulator.coefficients(network, {}, Runs())[0]
    np.testing.assert_allclose(problem.residual(X), stiff.best.fit.z, atol=0.05)
