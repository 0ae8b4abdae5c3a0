"""How visible a hidden effect is, from truth and noise alone: d' and the separation from its nearest rival.

    d'² = min over the nuisance of Σ_k N w_k Δ_kᴴ Σ_k⁻¹ Δ_k + Σ (nuisance/prior)²,     w_0 = 1, w_k = 2

Δ_k: harmonic k of the record without noise less the base model's, which is driven by the record's own inflow or
pressure. N: samples in the fitted beats, fewer for the
mean, which drifts. Σ_k: white noise of every channel, and what that of the driving
channel does to all of them (h σ² hᴴ). The nuisance moves about its true value under the prior; d' of a null is zero.
What makes beats differ is measured by how far they do.
With two effects, d' of one is what is left when the size of the other is free. The separation is the same with a
rival's parameters free, too.

On the bench everything is refitted. On the network the nuisance is (with individual walls by the derivatives at the
truth); separations are d' times the sine of the angle
between an effect and its rivals, all taken on one standard beat (linear in the rivals, truths at their own sizes).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .anatomy import anatomy
from .animal import priors
from .beat import at_phase
from .bench import bench_wall, radius
from .hide import CHANNEL, WALL, Effect, hide
from .network import Balance, Flow, Linearised
from .records import BEATS, FITTED, Made, points_for
from .refit import refit, weights, whitened
from .rivals import rival_sines
from .sensors import pulsatile, sensed
from .varying import SPARE

Array = np.ndarray


@dataclass(frozen=True)
class Detection:
    """d' of each effect of a case, in its order; for a single one the separation and its nearest rival.

    separation: from any other name of the catalogue (infinite if no rival exists); of two clear effects on a bench from
    any single one, theirs with all their numbers free. place_separation: from the same name elsewhere (network only).
    """

    d_prime: tuple[float, ...]
    separation: float = float("inf")
    rival: str = ""
    place_separation: float = float("inf")
    place_rival: str = ""


def detect(made: Made, least: float = 0.0) -> Detection:
    """d' and separation of what is hidden in a record; of less d' than ``least`` no separation."""
    if any(effect.over_beats for effect in made.case.effects):
        return Detection((wander(made),))
    problem = BenchProblem(made) if made.case.kind == "bench" else NetworkProblem(made)
    effects = made.case.effects
    seen = tuple(
        min(d_prime(problem, [e for j, e in enumerate(effects) if j != i]), distance(effect, problem.free))
        for i, effect in enumerate(effects)
    )
    if min(seen, default=0.0) < least:
        return Detection(seen)
    if len(effects) == 2 and isinstance(problem, BenchProblem) and min(seen) >= _BOTH:
        one = {e.name: problem.left_with_one(e) for e in effects}
        one |= {name: problem.left_with(name) for name in bench_rivals(made)}
        return Detection(seen, min(*one.values(), *seen), min(one, key=one.__getitem__))
    if len(effects) != 1:
        return Detection(seen)
    if isinstance(problem, NetworkProblem):
        return _on_network(made, seen[0])
    found = {name: problem.left_with(name) for name in bench_rivals(made)}
    name = min(found, key=found.__getitem__)
    return Detection(seen, min(found[name], seen[0]), name)


def distance(effect: Effect, free: Mapping[str, float]) -> float:
    """How far the animal's own number must be off to be this effect, in its standard deviations: its d' is no more. ∞
    if none can be. A refit may end short of it.

    free : standard deviations of what the animal has of its own.
    """
    key = {"wall_stiffness": "E", "wall_radius": "R0", "terminal_reflection": "R_t"}.get(effect.name)
    sd = free.get(f"{effect.where[0]}.{key}", 0.0)
    if sd == 0.0 or effect.length:
        return float("inf")
    return float(abs(effect.size if key == "R_t" else np.log1p(effect.size)) / sd)


def wander(made: Made) -> float:
    """How far the fitted beats are from steady ones, in units of the noise; nothing is refitted."""
    fitted = slice(0, len(made.time) * FITTED // BEATS)
    phase = made.at.phase[fitted] * (BEATS + SPARE)
    off = [(made.samples[name][fitted] - at_phase(made.clean[name], phase)) / made.noise[name] for name in made.clean]
    return float(np.sqrt(np.sum(np.square(off))))


def _on_network(made: Made, seen: float) -> Detection:
    sines = rival_sines(made)
    name = made.case.effects[0].name
    other = {rival: sine for rival, sine in sines.items() if rival.partition("@")[0] != name}
    same = {rival: sine for rival, sine in sines.items() if rival.partition("@")[0] == name}
    nearest = min(other, key=other.__getitem__)
    place = min(same, key=same.__getitem__, default="")
    return Detection((seen,), seen * other[nearest], nearest, seen * same.get(place, np.inf), place)


_BOTH = 30.0  # d' of two effects, from which their separation is asked for: it takes seconds
_FEW = 10  # unknowns: with more, one set of derivatives serves all steps of a refit


def d_prime(problem: BenchProblem | NetworkProblem, others: list[Effect]) -> float:
    """d' when ``others`` stay in the model with free sizes."""
    sizes = np.array([e.size for e in others])

    def predict(x: Array) -> Array:
        known = [replace(e, size=s) for e, s in zip(others, x[problem.nuisances :], strict=True)]
        return problem.residual(x[: problem.nuisances], known)

    x0 = np.concatenate([np.zeros(problem.nuisances), sizes])
    step = np.concatenate([np.full(problem.nuisances, 1e-3), 1e-2 * sizes])
    prior = np.concatenate([problem.prior, np.full(len(others), np.inf)])
    return refit(predict, x0, step, prior, keep=problem.nuisances > _FEW)


# --- bench ---------------------------------------------------------------------------------------------------------


class BenchProblem:
    """Residual of R, of a wall under the record's pressure as its sensor shows it."""

    def __init__(self, made: Made) -> None:
        self.made, self.beat = made, made.beat
        self.base = anatomy(made.base)
        self.free = priors("bench", self.base, made.case.walls)
        self.nuisances, self.prior = len(self.free), np.array(list(self.free.values()))
        self.P_name, self.R_name = made.case.names
        self.P, self.R = made.clean[self.P_name], made.clean[self.R_name]
        self.start: Array | None = None
        self.weight = weights(made, len(self.R))
        self.response = self._response()

    def _response(self) -> Array:
        """δR/δP per harmonic of the base at the mean radius."""
        wall = bench_wall(self.made.nuisance.applied(self.base), self.made.case.channels, self.beat)
        A = np.pi * self.R[0].real ** 2
        return (1.0 / (wall.impedance(np.array([A])) * 2.0 * np.pi * self.R[0].real))[None]

    def residual(self, x: Array, effects: list[Effect], a: float = 0.0, b: float = 0.0, on: str = "") -> Array:
        """Whitened residual with nuisance x (logarithms) and effects; ``on`` a channel a sensor 1/(1 + iωa - ω²b)."""
        model = self.made.nuisance.moved(dict(zip(self.free, x, strict=True))).applied(self.base)
        P = self.P
        for effect in effects:
            model = hide(model, effect)
            if self.P_name in effect.where:
                P = _undone(P, effect, self)
        sensor = 1.0 + 1j * self.beat.omega * a - self.beat.omega**2 * b
        if on == self.P_name:
            P = P * sensor
        wall = bench_wall(model, self.made.case.channels, self.beat)
        samples = radius(wall, self.beat.values(P), self.start)
        self.start = samples
        R = self.beat.coefficients(samples)
        for effect in effects:
            if self.R_name in effect.where:
                R = sensed(R, effect, self.beat)
        if on == self.R_name:
            R = R / sensor
        noise = self.made.noise
        return whitened(
            (self.R - R)[None], np.array([noise[self.R_name]]), self.response, noise[self.P_name], self.weight
        )

    def left_with_one(self, effect: Effect) -> float:
        """What one of two effects leaves when its numbers and the nuisance are refitted."""
        return refit(
            lambda x: self.residual(x[:3], [replace(effect, size=float(x[3]), second=float(x[4]))]),
            np.array([0.0, 0.0, 0.0, effect.size, effect.second]),
            np.array([1e-3, 1e-3, 1e-3, 1e-2 * effect.size, 1e-2 * effect.second + 1e-9]),
            np.array([*self.prior, np.inf, np.inf]),
        )

    def left_with(self, rival: str) -> float:
        """What is left when ``rival`` (name@where) is refitted with the nuisance."""
        name, _, where = rival.partition("@")
        if name == "fractional_viscosity":
            return self._left_with_springpot(where)
        if name == "catheter_resonance":
            return refit(
                lambda x: self.residual(x[:3], [], x[3], x[4] ** 2, where),  # the square: no negative inertia
                np.array([0.0, 0.0, 0.0, 0.0, 2e-3]),
                np.array([1e-3, 1e-3, 1e-3, 1e-4, 1e-5]),
                np.array([*self.prior, np.inf, np.inf]),
            )
        return refit(
            lambda x: self.residual(x[:3], [Effect(name, (where,), float(x[3]))]),
            np.zeros(4),
            np.array([1e-3, 1e-3, 1e-3, _STEP[name]]),
            np.array([*self.prior, np.inf]),
        )

    def _left_with_springpot(self, where: str) -> float:
        """The same of a springpot of any order: what small ones of a low and of a high order change, in any size."""
        x0 = np.zeros(3)
        small = [Effect("fractional_viscosity", (where,), _SMALL, order) for order in (0.2, 0.6)]
        columns = np.stack([self.residual(x0, [e]) - self.residual(x0, []) for e in small], axis=1) / _SMALL
        return refit(
            lambda x: self.residual(x[:3], []) + columns @ x[3:],
            np.zeros(5),
            np.full(5, 1e-3),
            np.array([*self.prior, np.inf, np.inf]),
        )


_SMALL = 0.02  # share of a springpot whose change is that of a small one


def _undone(P: Array, effect: Effect, problem: BenchProblem) -> Array:
    """The pressure that a faulty sensor showed as P."""
    omega = problem.beat.omega
    match effect.name:
        case "channel_lag":
            return P * np.exp(1j * omega * effect.size)
        case "channel_gain":
            return P / (1.0 + effect.size)
        case "channel_offset":
            result = P.copy()
            result[0] -= effect.size * pulsatile(P)
            return result
    ratio = omega * effect.size / (2.0 * np.pi)
    return P * (1.0 + 2j * effect.second * ratio - ratio**2)


# finite-difference steps of sizes, about a hundredth of a typical effect
_STEP = {
    "wall_viscosity": 1e-4,
    "nonlinear_wall_viscosity": 1e-2,
    "nonlinear_elasticity": 1e-2,
    "stress_relaxation": 1e-4,
    "external_pressure": 10.0,
    "channel_lag": 1e-4,
    "channel_gain": 1e-3,
    "channel_offset": 1e-2,
}


def bench_rivals(made: Made) -> list[str]:
    """Every other effect of the catalogue that a bench record can show, as name@where.

    wall_stiffness is the nuisance itself. Without wall viscosity there is nothing to be nonlinear or to relax; with it
    a change of phi0 is the nuisance.
    """
    own = {f"{e.name}@{where}" for e in made.case.effects for where in e.where}
    viscous = made.case.base != "elastic"
    needs = {"nonlinear_wall_viscosity", "stress_relaxation", "fractional_viscosity"}
    absent = {"wall_stiffness"} | ({"wall_viscosity"} if viscous else needs)
    names = [f"{name}@{made.case.channels}" for name in WALL if name not in absent]
    names += [f"{name}@{channel}" for name in CHANNEL for channel in made.case.names]
    return [name for name in names if name not in own]


# --- network -------------------------------------------------------------------------------------------------------


_BESIDE = 0.02  # difference of numbers, up to which the linearised equations of a flow serve its neighbours


class _Near(NamedTuple):
    """A flow that was solved: its numbers, and what its neighbours begin with."""

    at: Array
    unknown: Array
    linear: Linearised


class NetworkProblem:
    """Residual of the recorded channels, of a network under the record's inflow as its sensor shows it."""

    def __init__(self, made: Made) -> None:
        assert made.flow is not None
        self.made, self.base, self.names = made, anatomy(made.base), made.case.names[1:]
        self.free = priors("network", self.base, made.case.walls)
        self.nuisances, self.prior = len(self.free), np.array(list(self.free.values()))
        self.n = points_for(self.base)
        self.weight = weights(made, made.beat.K + 1)
        self.noise = np.array([made.noise[name] for name in self.names])
        balance = Balance(made.nuisance.applied(self.base), made.beat, self.n)
        self.start = balance.solve(made.clean["inlet.Q"]).unknown
        linear = Linearised(balance, self.start)
        self.near = _Near(np.zeros(self.nuisances), self.start, linear)
        response = linear.inlet_response()
        self.response = np.stack([response[name] for name in self.names])

    def residual(self, x: Array, effects: list[Effect]) -> Array:
        """Whitened residual with nuisance x (scales in logarithms, shifts of R_t) and effects of known sizes."""
        model = self.made.nuisance.moved(dict(zip(self.free, x, strict=True))).applied(self.base)
        inflow = self.made.clean["inlet.Q"]
        for effect in effects:
            model = hide(model, effect)
            if "inlet.Q" in effect.where:
                inflow = self.made.drive  # known, not refitted: its sensor cannot always be undone
        balance = Balance(model, self.made.beat, self.n)
        channels = self._flow(balance, inflow, np.concatenate([x, [effect.size for effect in effects]])).channels
        for effect in effects:
            for name in effect.where if effect.name in CHANNEL else ():
                channels[name] = sensed(channels[name], effect, self.made.beat)
        delta = np.stack([self.made.clean[name] - channels[name] for name in self.names])
        return whitened(delta, self.noise, self.response, self.made.noise["inlet.Q"], self.weight)

    def _flow(self, balance: Balance, inflow: Array, at: Array) -> Flow:
        """The periodic flow at the numbers ``at``; beside the last ones its linearised equations serve again."""
        near = self.near
        if len(balance.pieces) != self.start.shape[1]:
            return balance.solve(inflow)
        if len(at) == len(near.at) and np.abs(at - near.at).max(initial=0.0) <= _BESIDE:
            return balance.solve(inflow, near.unknown, linear=near.linear)
        found = balance.solve(inflow, near.unknown)
        self.near = _Near(at, found.unknown, found.linear)
        return found
