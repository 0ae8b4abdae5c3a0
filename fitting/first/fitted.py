"""A first model fitted to the mean beats, as small waves about the mean pressure.

With the harmonics X of the channels and their model Y(p) under the inflow, p logarithms of factors of the estimates,
of the taper its change,

    min over p    Σ |X - Y(p) exp(iω lag)|²/σ² + Σ (p/s)²,     σ² = noise² + (error of the model)²,

without a lag of inlet.Q, and if much is left with one near the lag between the feet of inlet.Q and of the pressure at
the root: a late meter would otherwise pass as a shorter tube and a larger compliance. Pressure and flow of one place
rise together, whatever lies behind it; a lag fitted to the whole beat alone would also mend a network that is wrong.

A study that uses a first model takes its accuracy, and the prior of its numbers, from here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from solver.laws.effects import ExternalPressure
from solver.linear import amplitudes
from solver.network.description import Network
from solver.quantities.coordinate import SCALE, SHIFT, Coordinate
from solver.quantities.units import INFLOW

from ..inference.hypothesis import Calibrated, along
from ..records import limits
from ..records.alignment.beats import Array, Beats
from ..records.channels.spectral import coefficients, resample
from .estimates import FEET, heard, late
from .options import is_first
from .tubes import (
    FARTHEST,
    KEYS,
    SPREAD,
    TAPER,
    TAPER_ERROR,
    TAPERED,
    Section,
    forks,
    keyed,
    narrowed,
    on_the_way,
    ratios,
    rest_of,
)

_HARMONICS = 16  # at most: they hold the pulse
# Of the pulsation: the error of the model at each harmonic, in its fit and in a study. Judgement: above the 0.04 to
# 0.46 % (rms over harmonics) that first models leave of 15 virtual animals in which nothing is hidden
ACCURACY = 0.005


class Data:
    """root : the channel of the pressure at the root, the one whose mean counts. k : (K+1,) of the harmonics. Q :
    (K+1,) of the inflow [m³/s]. names : the pressures and flows. X, sigma : (K+1,) of each, with the standard deviation
    √(noise² + (error of the model)²). n : how many real numbers count."""

    def __init__(self, beats: Beats, root: str) -> None:
        self.beats, self.root = beats, root
        most = min(_HARMONICS, max(int(heard(beats, name).max(initial=1)) for name in beats.values))
        self.k = np.arange(most + 1)
        self.Q = coefficients(resample(beats.mean(INFLOW), 2 * most + 2))[: most + 1]
        self.names = [name for name in beats.values if name[-2:] in (".P", ".Q") and name != INFLOW]
        self.X = {name: coefficients(beats.mean(name))[: most + 1] for name in self.names}
        self.sigma = {name: self._sigma(name) for name in self.names}
        self.n = sum(2 * int(np.sum(np.isfinite(each))) for each in self.sigma.values())

    def _sigma(self, name: str) -> Array:
        noise = np.zeros(len(self.k))
        if self.beats.n_beats > 1:
            noise = np.sqrt(self.beats.covariance((name,))[: len(self.k), 0, 0].real)
        noise[0] = 0.0 if name == self.root else np.inf  # breathing moves single beats; zeros elsewhere may be off
        size = self.size(name)
        return np.asarray(np.hypot(noise, ACCURACY * size) + 1e-12 * size)

    def size(self, name: str) -> float:
        """rms of the pulsation of a channel."""
        return rms(self.X[name])


def rms(X: Array) -> float:
    """Of the pulsation with harmonics X."""
    return float(np.sqrt(2.0 * np.sum(np.abs(X[1:]) ** 2)))


# standard deviation of the logarithm, and the range of the factor: judgement. The length stands for a reflection time
# that is known by its order only
_PRIORS = keyed(
    L=(2.0, 0.03, 10.0),
    E=(0.7, 0.2, 5.0),
    phi0=(1.0, 0.1, 5.0),
    R1=(0.7, 0.2, 5.0),
    C=(0.7, 0.2, 5.0),
    R2=(0.2, 0.5, 2.0),
)
_TAPER = (TAPER_ERROR, -TAPER_ERROR, -TAPER)  # the same of the shift of a taper
_SHORTEST, _LONGEST = 5e-3, 0.6  # of a tube [m]
# where a search may start, as factors of the estimates: at the best of all combinations
_GRID = keyed(E=(0.6, 1.0, 1.7), phi0=(0.15, 1.0), C=(0.6, 1.0, 2.0))
_LENGTHS = (0.2, 0.5, 1.0, 2.0)  # the same of all lengths
_FORK, _ODDS = "fork", (0.1, 0.5, 2.0, 10.0)
_SEARCHES = 2  # that are begun at the best points of a grid
_STEP = 1e-4  # of the finite differences


@dataclass(frozen=True)
class Fitted:
    """factor : by parameter of the network; share : of that of the flow, by tube. rms : of the residual of the channel
    at the root [SI]. price : -2 ln of the probability of the record with such tubes. x : the unknowns, by name."""

    factor: Mapping[str, float]
    share: Mapping[str, float]
    rms: float
    price: float
    x: Mapping[str, float]

    @property
    def undivided(self) -> list[str]:
        """The tubes behind which the flow is divided as unevenly as is allowed."""
        u = {name.removesuffix(f".{_FORK}"): abs(x) for name, x in self.x.items() if _kind(name) == _FORK}
        return [tube for tube, size in u.items() if size > 0.99 * FARTHEST]


@dataclass(frozen=True)
class Delay:
    """late : of inlet.Q [s] by the fit; feet : the same from foot to foot. before, after : rms of the residual of the
    channel at the root [SI] without and with it."""

    late: float
    feet: float
    before: float
    after: float


def fitted(
    data: Data, network: Network, known: bool, tubes: Sequence[Section], simpler: Fitted | None = None
) -> Fitted | None:
    """Fit lengths, walls, shares and Windkessels. known : whether a distance gives the lengths, which then stay.
    simpler : of the same tubes with one branch less, where the search starts; None if even a perfect fit would have a
    higher price."""
    problem = _Problem(data, network, known, tubes, {} if simpler is None else simpler.x)
    if simpler is not None and problem.price(0.0) >= simpler.price:
        return None
    return problem.fitted(problem.search(0.0, 0.0))


def delayed(
    data: Data, network: Network, known: bool, tubes: Sequence[Section], plain: Fitted
) -> tuple[Fitted, Delay | None]:
    """The same with a delay of inlet.Q, if one is needed. plain : without it."""
    feet = late(data.beats, data.root)
    if plain.rms > limits.LATE_MATTERS * data.size(data.root) and feet:
        problem = _Problem(data, network, known, tubes, {})
        x = problem.search(feet, FEET * data.beats.T)
        if (moved := problem.fitted(x)).rms < limits.LATE_CLOSES * plain.rms:
            return moved, Delay(float(x[-1]), feet, plain.rms, moved.rms)
    return plain, None


def of_owner(factor: Mapping[str, float], owner: str) -> dict[str, float]:
    """The factors of one segment or outlet, by key."""
    return {_kind(name): x for name, x in factor.items() if name.rpartition(".")[0] == owner}


def _prior(kind: str, value: float) -> tuple[float, float, float]:
    """Standard deviation and range of the logarithm of a parameter, or of its shift."""
    if kind not in _PRIORS:
        return _TAPER
    spread, low, high = _PRIORS[kind]
    if kind == "L":
        low, high = max(low, min(_SHORTEST / value, 1.0)), min(high, max(_LONGEST / value, 1.0))
    return spread, float(np.log(low)), float(np.log(high))


class _Problem:
    """groups : the parameters that have a factor or a shift in common: E, φ0 and the narrowing of all tubes, R2 of ends
    with measured flows; lengths and Windkessels have their own. x : (p,) logarithms of the factors, the shift,
    u of each fork (:func:`ratios`), and the lag [s]; unknowns : their names but for the lag. found : some of them, by a
    fit before, where a second search starts. known : whether lengths stay."""

    def __init__(
        self, data: Data, network: Network, known: bool, tubes: Sequence[Section], found: Mapping[str, float]
    ) -> None:
        nominal = network.parameters()
        kinds = {name: _kind(name) for name in nominal}
        divided = {f"{tube.name}.outlet.{KEYS[2]}" for branches in forks(tubes) for tube in branches}
        own = [name for name, kind in kinds.items() if kind in ("L", *KEYS[:2]) or name in divided]
        common = [[n for n, k in kinds.items() if k == kind and n not in own] for kind in (*_PRIORS, TAPERED)]
        groups = [[name] for name in own if not (known and kinds[name] == "L")] + common
        self.groups = [group for group in groups if group]
        self.data, self.network, self.nominal = data, network, nominal
        self.begins = [{}, found] if found else [{}]
        self.known, self.tubes, self.shape = known, tubes, list(narrowed(tubes, TAPER).values())
        self.tapers = [name for name, kind in kinds.items() if kind == TAPERED]
        self.forks = len(forks(tubes))
        self.unknowns = [group[0] if group[0] in own else kinds[group[0]] for group in self.groups]
        self.unknowns += [f"{branches[0].parent}.{_FORK}" for branches in forks(tubes)]
        way = self.way({}, {tube.name: np.ones(()) for tube in tubes})
        ends = [tube.name for tube in tubes if tube.end]
        self.whole = {end: way[end] + sum(nominal[f"{end}.outlet.{key}"] for key in (KEYS[0], KEYS[2])) for end in ends}
        priors = [_prior(kinds[group[0]], nominal[group[0]]) for group in self.groups]
        priors += [(SPREAD, -FARTHEST, FARTHEST)] * self.forks
        self.spread, self.low, self.high = np.array(priors).T

    def values(self, X: Array) -> dict[str, Array]:
        """The parameters at points X : (…, p). With another taper the radius of the root and the wave speed at the
        middle of each tube remain, with another share the wave speed. The factor of R2 is that of the whole resistance
        of an end, so that the flow is shared as it should."""
        nominal, r, s = self.nominal, self.ratios(X), X[..., 0] * 0.0 + TAPER
        found = dict[str, Array]()
        for i, group in enumerate(self.groups):
            s = s + X[..., i] if group == self.tapers else s
            found |= {name: nominal[name] * np.exp(X[..., i]) for name in group if group != self.tapers}
        for (tube, (taper, R0)), (_, before) in zip(narrowed(self.tubes, s).items(), self.shape, strict=True):
            found[f"{tube}.{TAPERED}"] = taper
            wider = R0 / before * np.sqrt(r[tube])
            found |= {name: nominal[name] * wider for name in (f"{tube}.R0", f"{tube}.h")}
        way = self.way(found, r)
        for tube, whole in self.whole.items():
            R1, C, R2 = (f"{tube}.outlet.{key}" for key in KEYS)
            found[R1], found[C] = found[R1] / r[tube], found[C] * r[tube]
            found[R2] = rest_of(whole * found[R2] / nominal[R2] / r[tube], found[R1], way[tube])
        return found

    def way(self, values: Mapping[str, Array], r: Mapping[str, Array]) -> Mapping[str, Array]:
        """The resistance of the way to the end of each tube."""
        every = self.nominal | dict(values)
        of: dict[str, dict[str, Array]] = {
            t.name: {key: np.asarray(every[f"{t.name}.{key}"]) for key in ("L", "R0", TAPERED)} for t in self.tubes
        }
        return on_the_way(self.tubes, {t.name: of[t.name] | {"share": t.share * r[t.name]} for t in self.tubes})

    def ratios(self, X: Array) -> Mapping[str, Array]:
        """Of the shares of the flow to the estimates, by tube."""
        first = len(self.groups)
        return ratios(self.tubes, X[..., first : first + self.forks])

    def fitted(self, x: Array) -> Fitted:
        """The result at a point."""
        root, share = self.data.root, {tube: float(r) for tube, r in self.ratios(x).items()}
        price = self.price(float(np.sum(self.residual(x[None]) ** 2)))
        unknowns = dict(zip(self.unknowns, map(float, x[:-1]), strict=True))
        factors = {name: float(value / self.nominal[name]) for name, value in self.values(x).items()}
        return Fitted(factors, share, rms(self.model(x[None])[root][0] - self.data.X[root]), price, unknowns)

    def price(self, cost: float) -> float:
        """-2 ln of the probability of the record, but for a constant, for a minimum: n ln(max(χ²/n, 1)) + min(χ², n) +
        k ln n for n data and k unknowns (G. Schwarz, Ann. Stat. 6, 1978, 461). What χ² counts beyond the noise are
        errors of the model, whose size is not known."""
        n, k = self.data.n, len(self.spread)
        return float(n * np.log(max(cost, n) / n) + min(cost, n) + k * np.log(n))

    def model(self, X: Array) -> dict[str, Array]:
        """Harmonics (B, K+1) of every channel for a batch of points X : (B, p)."""
        data = self.data
        omega = data.beats.omega * data.k
        found, turn = amplitudes(self.network, data.Q, omega, self.values(X)), np.exp(1j * omega * X[:, -1:])
        return {name: found[name] * turn for name in data.names}

    def residual(self, X: Array) -> Array:
        """(B, n) weighted residuals, priors included."""
        Y, data = self.model(X), self.data
        z = [np.sqrt(2.0) * (Y[name] - data.X[name]) / data.sigma[name] for name in data.names]
        parts = [np.concatenate([each.real, each.imag], axis=1) for each in z]
        return np.concatenate([*parts, X[:, :-1] / self.spread], axis=1)

    def search(self, late: float, error: float) -> Array:
        """The best point : (p,), from points about the estimates, with a lag [s] of ``late`` to an error."""
        T = self.data.beats.T
        unit = np.append(np.ones(len(self.spread)), T)  # of x: the lag in periods
        low, high = np.append(self.low, (late - error) / T), np.append(self.high, (late + error) / T)

        @lru_cache(maxsize=1)  # the last point with its neighbours: one batch takes little longer than the point
        def near(point: bytes) -> Array:
            x = np.frombuffer(point)
            return self.residual(np.concatenate([x[None], x + _STEP * np.eye(len(x))]) * unit)

        def at(x: Array) -> Array:
            return np.asarray(near(x.tobytes())[0])

        def slopes(x: Array) -> Array:
            z = near(x.tobytes())
            return np.asarray((z[1:] - z[0]).T / _STEP)

        starts = list[Array]()
        for grid in map(self._starts, self.begins):
            points = np.clip(np.pad(grid, ((0, 0), (0, 1)), constant_values=late / T), low, high)
            order = np.argsort(np.sum(self.residual(points * unit) ** 2, axis=1))
            starts += list(points[order[:_SEARCHES]])
        accuracy = {"ftol": 1e-4, "xtol": 1e-4, "max_nfev": 40, "bounds": (low - 1e-9, high + 1e-9)}
        found = [least_squares(at, start, slopes, **accuracy) for start in starts]
        return np.asarray(min(found, key=lambda each: each.cost).x * unit)

    def _starts(self, begin: Mapping[str, float]) -> Array:
        """(n, p) points: all combinations of a few factors, of the unknowns that no fit before has found."""
        odds = _ODDS if self.forks else (1.0,)
        coarse = {} if begin else _GRID
        grid = product(odds, (1.0,) if self.known else _LENGTHS, *coarse.values())
        each = [dict(zip((_FORK, "L", *coarse), np.log(factors), strict=True)) for factors in grid]
        return np.array([[begin.get(x, at.get(_kind(x), 0.0)) for x in self.unknowns] for at in each])


def _kind(name: str) -> str:
    """ "L" of "Ao.L"."""
    return name.rpartition(".")[2]


# --- how far the numbers of a first model may be off: the prior of a study that uses one ------------------------------

# standard deviations of the logarithms, whatever fits the mean beat best: judgement. They are wider than those between
# the walls of one species, since lengths and viscosities are not measured at all
_SPREAD = keyed(L=0.5, R0=0.25, E=0.3, phi0=1.0, R1=0.3, C=0.3, R2=0.1)


def accuracy(network: Network) -> float:
    """The stated error of a network at each harmonic, as a fraction of a channel's pulsation; 0 unless it is a first
    model."""
    return ACCURACY if is_first(network) else 0.0


def spread(network: Network) -> Calibrated:
    """The unknowns of a first model: lengths, walls, tapers and Windkessels, independent of each other."""
    known = network.parameters()
    scales = {name: sd for name, x in known.items() if (sd := _SPREAD.get(_kind(name))) and x > 0.0}
    tapered = {s.name: s.L for s in network.segments if TAPERED in s.terms}
    shifts = {f"{name}.{TAPERED}": TAPER_ERROR * L / max(tapered.values()) for name, L in tapered.items()}
    coordinates = [
        Coordinate(name, kind, ((name, 1.0),), -np.inf, np.inf)
        for kind, names in ((SCALE, scales), (SHIFT, shifts))
        for name in names
    ]
    found = along(coordinates, np.diag(np.array([*scales.values(), *shifts.values()]) ** 2), network)
    # R0 and E are those of the mean pressure, and how the walls stiffen about it is not known: nor is another pressure
    outside = {f"{s.name}.{key}" for s in network.segments for key in ExternalPressure.terms}
    return replace(found, free=found.single | outside)
