"""The network: inlet flow in, P, Q and R at some sites compared, hypotheses refitted by batches of the solver.

The residual is that of :mod:`fitting.network_data`: whitened Fourier coefficients of the mean beats, with the noise of
the inflow, which all channels share, and the solver's own error in their covariance. Hypotheses are re-simulated, not
linearised: each has its own unknowns, all are members of one batch, and their Jacobians are kept up to date from the
simulations themselves (Broyden 1965).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fitting.beats import Beats
from fitting.network_data import (
    MAX_HARMONICS,
    NEIGHBOURS,
    Target,
    harmonics_above_noise,
    inflow,
    mean_beat,
    pulses,
    response,
    solver_error,
    target,
)
from fitting.units import INFLOW
from solver import NonPhysicalState, NotPeriodic, Settings, simulate_periodic
from solver.network import Network
from solver.report import output_variables
from solver.simulate import Waveforms

from .add import extended
from .fits import Fit, bounded_step, bounds, penalty
from .observation import mean_wander, transfer
from .terms import EVERY, Term, Unknown, followers, nuisances, refined, rewired, values
from .thresholds import COARSE_DT, PRIOR_WIDTH, SCREEN_DT

Array = np.ndarray
Tell = Callable[[str], None]

_STEP = 0.02  # of x: finite differences
_LARGEST = 2.0  # of a step in x
_ROUNDS = 14  # simulations of a hypothesis at most
_FRESH = (4, 8)  # of them before which derivatives are simulated anew: by then the updated ones have led astray
_BATCH = 64  # members at once
_PERIODIC = 1e-5
_SMALL = 0.02  # decrease of the cost that ends a search, for each unit of cost per datum
_SHORTER = 2  # times that the step is halved where the model as given breaks down
_SHARPER = 2  # times that the step is halved at most
_NEGLIGIBLE = 0.05  # of the noise's variance, on average: a smaller error of the solver needs no shorter step
_HOPELESS = 150.0  # by which a search may promise to stay above the best one and still go on


@dataclass
class Simulator:
    """Simulates hypotheses of one network under one inflow, and remembers the periodic states it started from.

    start : time [s] in the beat at which runs begin: where the flow is least, because a run begins at rest, and a
    flow that sets in at once would strain the walls as no heart does.
    """

    network: Network
    drive: Callable[[Array], Array]
    T: float
    names: tuple[str, ...]
    K: int
    settings: Settings
    start: float
    tell: Tell = field(default=lambda _: None)
    simulations: int = 0
    starts: dict[str, Waveforms] = field(default_factory=dict)

    def _beat(self, network: Network, parameters: Mapping[str, Array], start: Waveforms | None) -> Waveforms:
        """The periodic beats; from rest where the earlier state has another mesh (a stenosis elsewhere)."""
        try:
            return simulate_periodic(
                network,
                lambda t: self.drive(t + self.start),
                self.T,
                parameters=parameters,
                settings=self.settings,
                tolerance=_PERIODIC,
                start=start,
            )
        except ValueError:
            if start is None:
                raise
        return self._beat(network, parameters, None)

    def halved(self) -> Simulator:
        """The same with half the step."""
        return replace(self, settings=replace(self.settings, dt=self.settings.dt / 2.0), starts={})

    def finer(self) -> Simulator:
        """The same with half the step and half the elements, to see what both do."""
        half = self.halved()
        return replace(half, settings=replace(half.settings, element_length=self.settings.element_length / 2.0))

    def coefficients(self, network: Network, parameters: Mapping[str, Array], key: str) -> Array:
        """X : (B, K+1, m) of the periodic beats; ``key`` names networks that can start from one another's state."""
        size = next(iter(parameters.values())).size if parameters else 1
        beat = self._beat(network, parameters, self.starts.get(key))
        self.starts[key] = beat.member(0)
        self.simulations += size
        self.tell(f"{self.simulations} simulations")
        waves = np.stack([np.atleast_2d(beat[name])[:, :-1] for name in self.names], axis=-1)
        turn = np.exp(-2j * np.pi * np.arange(self.K + 1) * (self.start / self.T))
        return np.fft.rfft(waves, axis=1, norm="forward")[:, : self.K + 1] * turn[:, None]


@dataclass(frozen=True)
class Member:
    """One point of one hypothesis."""

    terms: tuple[Term, ...]
    unknowns: tuple[Unknown, ...]
    x: Array


@dataclass(frozen=True)
class NetworkProblem:
    """A network record and the network that it is compared with.

    error : (K+1, m) standard deviation of the solver's own error. response : (K+1, m) of the channels to the inflow.
    """

    network: Network
    beats: Beats
    names: tuple[str, ...]
    K: int
    simulator: Simulator
    target: Target
    error: Array
    response: Array

    @property
    def n_effective(self) -> int:
        """Independent numbers of the record: 2K + 1 per signal."""
        return len(self.names) * (2 * self.K + 1)

    @property
    def dof_of_noise(self) -> float:
        return 7.0 * (self.beats.n_beats - 1.0)

    @property
    def signals(self) -> tuple[str, ...]:
        return self.names

    def followers(self, fit: Fit, terms: Sequence[Term]) -> tuple[Term, ...]:
        """Terms that can act only beside those of a fit."""
        return followers(extended(self.network, fit), None, terms)

    def refined(self, fit: Fit, term: Term) -> Term | None:
        """A term that acts everywhere with a size of its own for every segment; None if it is no such term."""
        x = [x for u, x in zip(fit.unknowns, fit.x, strict=True) if u in term.unknowns]
        return refined(self.network, term, float(x[0]))

    def held_out(self, beats: Beats, fitted: Beats) -> NetworkProblem:
        """Other beats of the same record, with the noise that the fitted ones showed."""
        covariance = self.target.covariance * (fitted.n_beats / beats.n_beats)
        wander = mean_wander(beats, fitted, self.names)
        covariance[0] += np.diag(np.maximum(wander - np.diag(covariance[0]).real, 0.0))
        scale = np.sqrt(np.einsum("kii->ki", covariance).real)
        factor = np.linalg.cholesky(covariance / (scale[:, :, None] * scale[:, None, :]))
        whitener = np.linalg.inv(factor) / scale[:, None, :]
        X = mean_beat(beats, self.names, self.K)
        drive = inflow(beats, self.simulator.settings.dt)
        return replace(
            self,
            beats=beats,
            simulator=replace(self.simulator, drive=drive, starts={}),
            target=Target(self.names, X, covariance, whitener),
        )

    def predict(self, fits: Sequence[Fit]) -> list[tuple[float, float]]:
        """χ² of this record under the parameters of fits to another, and how many data; NaN if one breaks down."""
        X = self.observe([Member(f.terms, f.unknowns, f.x) for f in fits])
        z = [None if x is None else self.residual(x) for x in X]
        return [(np.nan, 1.0) if r is None else (float(r @ r), float(len(r))) for r in z]

    # --- hypotheses ---------------------------------------------------------------------------------------------------

    def hypothesis(self, terms: Sequence[Term]) -> tuple[tuple[Unknown, ...], Array]:
        """Unknowns and prior precisions of a hypothesis."""
        network = self._rewired(terms)
        nuisance = nuisances(network)
        mine = {variable for term in terms if term.rewires for u in term.unknowns for variable, _ in u.moves}
        # what a rewired outlet has is free in its own term, not by a nuisance of all outlets
        nuisance = tuple(u for u in nuisance if not {variable for variable, _ in u.moves} <= mine)
        own = tuple(u for term in terms for u in term.unknowns)
        return (*nuisance, *own), np.concatenate([np.ones(len(nuisance)), np.full(len(own), PRIOR_WIDTH**-2.0)])

    def _rewired(self, terms: Sequence[Term]) -> Network:
        network = self.network
        for term in terms:
            network = rewired(network, term)
        return network

    def observe(self, members: Sequence[Member]) -> list[Array | None]:
        """X : (K+1, m) as the sensors show it, of every member; None where the simulation broke down."""
        groups: dict[str, list[int]] = {}
        for i, member in enumerate(members):
            groups.setdefault(_group(member.terms), []).append(i)
        X: list[Array | None] = [None] * len(members)
        for key, group in groups.items():
            for at in range(0, len(group), _BATCH):
                part = group[at : at + _BATCH]
                for i, result in zip(part, self._batch(key, [members[i] for i in part]), strict=True):
                    X[i] = result
        return [
            None if x is None else sense(member, self.names, x, self.simulator.T)
            for member, x in zip(members, X, strict=True)
        ]

    def _batch(self, key: str, members: Sequence[Member]) -> list[Array | None]:
        network = self.network
        for term in {t.label: t for member in members for t in member.terms}.values():
            network = rewired(network, term)
        nominal = network.parameters()
        known = network.parameter_quantities()
        moved = [values(m.unknowns, m.x, nominal) for m in members]
        names = dict.fromkeys(name for each in moved for name in each if name in nominal)
        parameters = {
            n: np.clip([float(each.get(n, nominal[n])) for each in moved], known[n].low, known[n].high) for n in names
        }
        # a sensor alone needs no simulation of its own
        table = np.array([parameters[n] for n in parameters]).T if parameters else np.zeros((len(members), 0))
        unique, inverse = np.unique(table, axis=0, return_inverse=True)
        inverse = inverse.ravel()
        try:
            X = self.simulator.coefficients(network, {n: unique[:, i] for i, n in enumerate(parameters)}, key)
            return [X[i] for i in inverse]
        except (NonPhysicalState, NotPeriodic, ValueError):
            if len(members) == 1:
                return [None]
        half = len(members) // 2
        return self._batch(key, members[:half]) + self._batch(key, members[half:])

    def residual(self, X: Array) -> Array:
        """(n,) whitened."""
        return self.target.residual(X[None])[0]

    # --- derivatives --------------------------------------------------------------------------------------------------

    def derivatives(self, points: Sequence[tuple[Member, Sequence[Unknown]]]) -> list[tuple[Array, Array] | None]:
        """z : (n,) and its columns (n, q) by some unknowns, at every point."""
        members, shapes = [], []
        for member, by in points:
            members.append(member)
            for unknown in by:
                i = [u.name for u in member.unknowns].index(unknown.name)
                x = member.x.copy()
                x[i] += -_STEP if x[i] + _STEP > unknown.high else _STEP
                members.append(replace(member, x=x))
            shapes.append(1 + len(by))
        X = self.observe(members)
        result: list[tuple[Array, Array] | None] = []
        at = 0
        for (member, by), size in zip(points, shapes, strict=True):
            own, at = X[at : at + size], at + size
            if any(x is None for x in own):
                result.append(None)
                continue
            z = self.target.residual(np.stack([x for x in own if x is not None]))
            index = [u.name for u in member.unknowns]
            steps = [members[at - size + 1 + j].x[index.index(u.name)] - member.x[index.index(u.name)]
                     for j, u in enumerate(by)]  # fmt: skip
            columns = (z[1:] - z[0]).T / np.array(steps) if len(by) else np.zeros((len(z[0]), 0))
            result.append((z[0], columns))
        return result

    def columns(self, at: Fit, terms: Sequence[Term]) -> dict[str, Array]:
        """Whitened columns (n, q) of every term that may be added to a fit, by label; without those that break down."""
        settings = replace(self.simulator.settings, dt=max(SCREEN_DT, self.simulator.settings.dt))
        return replace(self, simulator=replace(self.simulator, settings=settings, starts={}))._columns(at, terms)

    def _columns(self, at: Fit, terms: Sequence[Term]) -> dict[str, Array]:
        plain = [t for t in terms if not t.rewires]
        groups: dict[str, list[Term]] = {}
        for term in plain:
            groups.setdefault(_group((*at.terms, term)), []).append(term)
        found: dict[str, Array] = {}
        for group in groups.values():
            members = [Member(at.terms, at.unknowns, at.x)]
            for term in group:
                for i in range(len(term.unknowns)):
                    x = np.concatenate([at.x, [_STEP if i == j else 0.0 for j in range(len(term.unknowns))]])
                    members.append(Member((*at.terms, term), (*at.unknowns, *term.unknowns), x))
            if _group((*at.terms, group[0])) != _group(at.terms):  # the same mesh for the point that they leave from
                members[0] = replace(members[1], x=np.concatenate([at.x, np.zeros(len(group[0].unknowns))]))
            X = self.observe(members)
            if X[0] is None:
                continue
            z0, position = self.residual(X[0]), 1
            for term in group:
                mine = X[position : position + len(term.unknowns)]
                position += len(term.unknowns)
                if all(x is not None for x in mine):
                    found[term.label] = np.stack([(self.residual(x) - z0) / _STEP for x in mine if x is not None], 1)
        return found

    # --- search -------------------------------------------------------------------------------------------------------

    def refit(self, hypotheses: Sequence[tuple[Term, ...]], start: Fit | None = None,
              columns: Mapping[str, Array] | None = None) -> list[Fit | None]:  # fmt: skip
        """The most probable unknowns of every hypothesis, all searched together in batches.

        start : of a simpler hypothesis that all contain; with ``columns`` of the terms there (:meth:`columns`) no
        derivative is simulated anew.
        """
        return self._search([self._begin(terms, start, columns or {}) for terms in hypotheses])

    def _search(self, searches: list[_Search]) -> list[Fit | None]:
        """Steps of all searches, one batch after the other, until none has any worth its simulation."""
        self._derive([s for s in searches if s.J is None])
        for turn in range(_ROUNDS):
            active = [s for s in searches if s.proposes()]
            best = min((s.cost for s in searches if not s.failed), default=np.inf)
            active = [s for s in active if s.promise < best + _HOPELESS]
            if not active:
                break
            if turn in _FRESH:
                self._derive(active)
                active = [s for s in active if s.proposes()]
            X = self.observe([s.trial() for s in active])
            for search, x in zip(active, X, strict=True):
                search.answer(None if x is None else self.residual(x))
        return [self._fit(s) for s in searches]

    def _derive(self, searches: Sequence[_Search]) -> None:
        """Residuals and Jacobians of searches, simulated where they are."""
        points = [(s.member(), s.unknowns) for s in searches]
        for search, found in zip(searches, self.derivatives(points), strict=True):
            if found is None:
                search.failed = True
            else:
                search.J = found[1]
                search.settle(found[0])

    def _begin(self, terms: tuple[Term, ...], start: Fit | None, columns: Mapping[str, Array]) -> _Search:
        unknowns, prior = self.hypothesis(terms)
        before = {} if start is None else dict(zip((u.name for u in start.unknowns), start.x, strict=True))
        low, high = bounds(unknowns)
        x = np.clip([before.get(u.name, 0.0) for u in unknowns], low, high)
        x = self._started(terms, unknowns, prior, x, start)
        search = _Search(terms, unknowns, prior, x)
        if not np.array_equal(x, np.clip([before.get(u.name, 0.0) for u in unknowns], low, high)):
            return search
        new = [t for t in terms if start is None or t.label not in {s.label for s in start.terms}]
        if start is not None and all(t.label in columns for t in new) and not any(t.rewires for t in new):
            own = {u.name: start.J[:, i] for i, u in enumerate(start.unknowns)}
            for t in new:
                own |= {u.name: columns[t.label][:, i] for i, u in enumerate(t.unknowns)}
            search.J, search.z = np.stack([own[u.name] for u in unknowns], axis=1), start.z
            search.settle(start.z)
        return search

    def refine(self, fits: Sequence[Fit]) -> list[Fit | None]:
        """Every fit searched on from where it is, with derivatives simulated anew."""
        searches = []
        for f in fits:
            unknowns, prior = self.hypothesis(f.terms)
            searches.append(_Search(f.terms, unknowns, prior, f.x))
        return self._search(searches)

    def sharpened(self, fit: Fit) -> NetworkProblem:
        """The same problem weighted for what a fit found: the solver's error there, and the response to the inflow.

        Where the error would matter beside the noise, the steps become shorter.
        Raises ArithmeticError if it breaks down.
        """
        member, problem = Member(fit.terms, fit.unknowns, fit.x), self
        for _ in range(_SHARPER):
            finer = replace(problem, simulator=problem.simulator.finer())
            X, X_finer = problem.observe([member])[0], finer.observe([member])[0]
            if X is None or X_finer is None:
                raise ArithmeticError(f"{fit.terms[-1].label if fit.terms else 'the model'}: shorter steps break down")
            error = solver_error(X, X_finer, pulses(self.beats, self.names))
            own = np.einsum("kii->ki", self.target.covariance).real - self.error**2
            weight = np.where(np.arange(len(own)) == 0, 0.5, 1.0)[:, None]
            if np.sum(weight * error**2 / own) < _NEGLIGIBLE * weight.sum() * own.shape[1]:
                break
            problem = replace(problem, simulator=problem.simulator.halved())
        return problem.weighted(fit, error)

    def restored(self, fit: Fit, dt: float, error: Array) -> NetworkProblem:
        """The problem as :meth:`sharpened` left it, from the step [s] and the error that it found."""
        simulator = replace(self.simulator, settings=replace(self.simulator.settings, dt=dt), starts={})
        return replace(self, simulator=simulator).weighted(fit, error)

    def weighted(self, fit: Fit, error: Array) -> NetworkProblem:
        """The same problem with the solver's error (K+1, m), and the response to the inflow's noise, at a fit."""
        network = self._rewired(fit.terms)
        nominal = network.parameters()
        at = {n: float(v) for n, v in values(fit.unknowns, fit.x, nominal).items() if n in nominal}
        H = _response(network, self.names, self.simulator.T, self.K, at)
        flat = np.where(["offset" in u.name for u in fit.unknowns], 0.0, fit.x)
        H = sense(Member(fit.terms, fit.unknowns, flat), self.names, H, self.simulator.T)
        return replace(self, target=target(self.beats, self.names, H, error), error=error, response=H[: self.K + 1])

    def _started(
        self, terms: Sequence[Term], unknowns: Sequence[Unknown], prior: Array, x: Array, start: Fit | None
    ) -> Array:
        """x with new sensors at the best of their starting points: that costs one simulation for all of them."""
        before = set() if start is None else {t.label for t in start.terms}
        for term in terms:
            known = term.is_sensor or term.place == EVERY  # others would need a simulation for every starting point
            if not term.starts or not known or term.label in before:
                continue
            at = [i for i, u in enumerate(unknowns) if u in term.unknowns]
            trials = [x]
            for values_ in term.starts:
                trial = x.copy()
                trial[at] = values_
                trials.append(trial)
            X = self.observe([Member(tuple(terms), tuple(unknowns), trial) for trial in trials])
            costs = [np.inf if each is None else float(np.sum(self.residual(each) ** 2)) for each in X]
            x = trials[int(np.argmin(costs))]
        return x

    def _fit(self, s: _Search) -> Fit | None:
        if s.failed or s.J is None:
            return None
        m, K = len(self.names), self.K
        order = np.concatenate([np.zeros(m, int), np.tile(np.repeat(np.arange(1, K + 1), m), 2)])
        signal = np.tile(np.arange(m), 2 * K + 1)
        return Fit(s.terms, s.unknowns, s.x, s.z, s.J, s.prior, order, signal, s.converged)


class _Search:
    """A damped Gauss–Newton search that asks for one simulation at a time."""

    def __init__(self, terms: tuple[Term, ...], unknowns: tuple[Unknown, ...], prior: Array, x: Array) -> None:
        self.terms, self.unknowns, self.prior, self.x = terms, unknowns, prior, x
        self.z: Array = np.zeros(0)
        self.J: Array | None = None
        self.damping, self.failed, self.converged = 0.0, False, False
        self.low, self.high = bounds(unknowns)
        self.cost = self.promise = np.inf
        self._step: Array = np.zeros_like(x)

    def member(self) -> Member:
        return Member(self.terms, self.unknowns, self.x)

    def settle(self, z: Array) -> None:
        self.z, self.cost = z, float(z @ z) + penalty(self.prior, self.x)

    def proposes(self) -> bool:
        """Whether another step is worth a simulation."""
        if self.failed or self.converged or self.J is None:
            return False
        step = bounded_step(self.J, self.z, self.prior, self.x, self.low, self.high, self.damping)
        size = np.abs(step).max(initial=0.0)
        step *= min(1.0, _LARGEST / size) if size > 0.0 else 1.0
        left = self.z + self.J @ step
        gain = self.cost - (float(left @ left) + penalty(self.prior, self.x + step))
        self.promise = self.cost - 3.0 * gain
        if gain < _SMALL * max(1.0, self.cost / len(self.z)):
            self.converged = True
            return False
        self._step = step
        return True

    def trial(self) -> Member:
        return Member(self.terms, self.unknowns, self.x + self._step)

    def answer(self, z: Array | None) -> None:
        assert self.J is not None
        step = self._step
        if z is None:
            self.damping = max(10.0 * self.damping, 1.0)
            self.failed = self.damping > 1e7
            return
        x = self.x + step
        cost = float(z @ z) + penalty(self.prior, x)
        # Broyden: the Jacobian that would have foretold what was found
        self.J = self.J + np.outer(z - self.z - self.J @ step, step) / float(step @ step)
        if cost < self.cost:
            self.x, self.damping = x, self.damping / 5.0 if self.damping > 1e-3 else 0.0
            self.settle(z)
        else:
            self.damping = max(5.0 * self.damping, 0.05)
            if self.damping > 1e6:
                self.converged = True


def _group(terms: Sequence[Term]) -> str:
    """Hypotheses that share a mesh and outlets run in one batch."""
    own = [t.label if t.rewires else "stenosis" for t in terms if t.rewires or t.effect == "stenosis"]
    return " ".join(sorted(set(own)))


def sense(member: Member, names: Sequence[str], X: Array, T: float) -> Array:
    """Observation: what the measurement chains of a hypothesis make of the coefficients X : (n, m)."""
    if not any(term.is_sensor for term in member.terms):
        return X
    moved = values(member.unknowns, member.x, {f"{name}.gain": 1.0 for name in names})
    omega, X = 2.0 * np.pi / T * np.arange(len(X)), X.copy()
    for i, name in enumerate(names):
        own = {key: float(moved.get(f"{name}.{key}", 0.0)) for key in ("lag", "slow", "resonance")}
        gain = float(moved.get(f"{name}.gain", 1.0))
        X[:, i] *= transfer(omega, own["lag"], gain, own["slow"], own["resonance"])
        X[0, i] += float(moved.get(f"{name}.offset", 0.0))
    return X


def network_problem(
    beats: Beats, network: Network, names: Sequence[str] | None = None, tell: Tell = lambda _: None
) -> NetworkProblem:
    """The problem of a record with inlet.Q and some outputs of the network.

    Raises ValueError if they do not belong together, or if the network breaks down with this inflow.
    """
    known = output_variables(network)[0]
    chosen = tuple(names or (n for n in beats.values if n != INFLOW and n in known))
    settings = Settings(dt=min(COARSE_DT, beats.T / 80.0), tolerance=3e-5)
    K = harmonics_above_noise(beats, chosen, min(MAX_HARMONICS, (beats.N - 1) // 2, int(beats.T / settings.dt / 2) - 1))
    drive = inflow(beats, settings.dt)
    time = beats.T * np.arange(200) / 200.0
    start = float(time[np.argmin(np.abs(drive(time)))])
    simulator, X = _first(Simulator(network, drive, beats.T, chosen, K, settings, start, tell))
    error = solver_error(X, simulator.finer().coefficients(network, {}, "")[0], pulses(beats, chosen))
    H = _response(network, chosen, beats.T, K, {})
    return NetworkProblem(network, beats, chosen, K, simulator, target(beats, chosen, H, error), error, H[: K + 1])


def _first(simulator: Simulator) -> tuple[Simulator, Array]:
    """The model as given under this inflow, with shorter steps if it needs them.

    Raises NonPhysicalState if none will do.
    """
    for _ in range(_SHORTER):
        try:
            return simulator, simulator.coefficients(simulator.network, {}, "")[0]
        except NonPhysicalState:
            simulator = simulator.halved()
    return simulator, simulator.coefficients(simulator.network, {}, "")[0]


def _response(network: Network, names: Sequence[str], T: float, K: int, parameters: Mapping[str, float]) -> Array:
    """The linearised response (K + 1 + neighbours, m) to the inflow; without the terms that the linear solver lacks."""
    try:
        return response(network, names, T, K + NEIGHBOURS, parameters)
    except ValueError:
        segments = tuple(
            replace(s, terms={k: v for k, v in s.terms.items() if k not in ("taper", "leak")}) for s in network.segments
        )
        plain = replace(network, segments=segments)
        return response(
            plain, names, T, K + NEIGHBOURS, {n: v for n, v in parameters.items() if n in plain.parameters()}
        )
