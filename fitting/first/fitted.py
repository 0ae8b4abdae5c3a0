"""A first model fitted to the mean beats, as small waves about the mean pressure.

With the harmonics X of the channels and their model Y(p) under the inflow, p logarithms of factors of the estimates,
of the taper its change,

    min over p    Σ |X - Y(p) exp(iω lag)|²/σ² + Σ (p/s)²,     σ² = noise² + (error of the model)²,

without a lag of inlet.Q, and if much is left with one near the lag between the feet of inlet.Q and of the pressure at
the root: a late meter would otherwise pass as a shorter tube and a larger compliance. Pressure and flow of one place
rise together, whatever lies behind it; a lag fitted to the whole beat alone would also mend a network that is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from solver.linear import waveforms
from solver.network.description import Network
from solver.quantities.units import INFLOW

from ..records import thresholds as limit
from ..records.alignment.beats import Beats
from ..records.channels.spectral import coefficients, resample
from . import shares
from .shares import forks
from .stretches import Stretch
from .tubes import KEYS, TAPER, TAPER_ERROR, TAPERED, keyed, narrowed, on_the_way, rest_of
from .waves import FEET, heard, late

Array = np.ndarray

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
# where searches may start, as factors of the estimates: the best of all combinations do
_GRID = keyed(E=(0.6, 1.0, 1.7), phi0=(0.15, 1.0), C=(0.6, 1.0, 2.0))
_LENGTHS = (0.2, 0.5, 1.0, 2.0)  # the same of all lengths
_FORK, _ODDS = "fork", (0.3, 3.0)  # the same of e^u
_SEARCHES = 3  # that are begun
_HARMONICS = 16  # at most: they hold the pulse
_ERROR = 0.005  # of the pulsation: an error of the model in each harmonic
_STEP = 1e-4  # of the finite differences


@dataclass(frozen=True)
class Fitted:
    """factor : by parameter of the network; share : of that of the flow, by tube. late : of inlet.Q [s], 0 where no lag
    helps; feet : the same from foot to foot. rms : of the residual of the channel at the root [SI] without and with
    that lag. cost : the minimum."""

    factor: Mapping[str, float]
    share: Mapping[str, float]
    late: float
    feet: float
    rms: tuple[float, float]
    cost: float


def fitted(network: Network, beats: Beats, root: str, known: bool, tubes: Sequence[Stretch]) -> Fitted:
    """Fit lengths, walls, shares and Windkessels. root : the channel of the pressure at the root. known : whether a
    distance gives the lengths, which then stay."""
    problem = _Problem(network, beats, root, known, tubes)
    plain = problem.search(0.0, 0.0)
    before, feet = problem.rms(plain, root), late(beats, root)
    if before > limit.LATE_MATTERS * problem.size(root) and feet:
        moved = problem.search(feet, FEET * beats.T)
        if (after := problem.rms(moved, root)) < limit.LATE_CLOSES * before:
            return problem.fitted(moved, float(moved[-1]), feet, (before, after))
    return problem.fitted(plain, 0.0, feet, (before, before))


def of_owner(factor: Mapping[str, float], owner: str) -> dict[str, float]:
    """The factors of one segment or outlet, by key."""
    return {name.rpartition(".")[2]: x for name, x in factor.items() if name.rpartition(".")[0] == owner}


def _prior(kind: str, value: float) -> tuple[float, float, float]:
    """Standard deviation and range of the logarithm of a parameter, or of its shift."""
    if kind not in _PRIORS:
        return _TAPER
    spread, low, high = _PRIORS[kind]
    if kind == "L":
        low, high = max(low, min(_SHORTEST / value, 1.0)), min(high, max(_LONGEST / value, 1.0))
    return spread, float(np.log(low)), float(np.log(high))


class _Problem:
    """groups : the parameters that have a factor or a shift in common. x : (p,) logarithms of the factors, the shift,
    u of each fork (:mod:`~fitting.first.shares`), and the lag [s]. root : the channel whose mean counts. known :
    whether lengths stay."""

    def __init__(self, network: Network, beats: Beats, root: str, known: bool, tubes: Sequence[Stretch]) -> None:
        nominal = network.parameters()
        kinds = {name: name.rpartition(".")[2] for name in nominal}
        own = [[name] for name, kind in kinds.items() if kind == "L" and not known]
        common = [[n for n, k in kinds.items() if k == kind] for kind in (*_PRIORS, TAPERED) if kind != "L"]
        self.groups = [group for group in own + common if group]
        self.network, self.nominal, self.beats = network, nominal, beats
        self.known, self.tubes, self.shape = known, tubes, list(narrowed(tubes, TAPER).values())
        self.tapers = [name for name, kind in kinds.items() if kind == TAPERED]
        self.forks = len(forks(tubes))
        way = self.way({}, {tube.name: np.ones(()) for tube in tubes})
        ends = [tube.name for tube in tubes if tube.end]
        self.whole = {end: way[end] + sum(nominal[f"{end}.outlet.{key}"] for key in (KEYS[0], KEYS[2])) for end in ends}
        priors = [_prior(kinds[group[0]], nominal[group[0]]) for group in self.groups]
        priors += [(shares.SPREAD, -shares.FARTHEST, shares.FARTHEST)] * self.forks
        self.spread, self.low, self.high = np.array(priors).T
        most = min(_HARMONICS, max(int(heard(beats, name).max(initial=1)) for name in beats.values))
        self.Q = resample(beats.mean(INFLOW), 2 * most + 2)
        self.k = np.arange(most + 1)
        there = waveforms(network, self.Q, beats.T)
        self.names = [name for name in beats.values if name in there and name[-2:] in (".P", ".Q")]
        self.X = {name: coefficients(beats.mean(name))[: most + 1] for name in self.names}
        self.sigma = {name: self._sigma(name) for name in self.names}
        for name in self.names:
            if name != root:  # the zero of a sensor elsewhere may be off
                self.sigma[name][0] = np.inf

    def _sigma(self, name: str) -> Array:
        noise = np.zeros(len(self.k))
        if self.beats.n_beats > 1:
            noise = np.sqrt(self.beats.covariance((name,))[: len(self.k), 0, 0].real)
        noise[0] = 0.0  # breathing moves the mean of single beats
        size = self.size(name)
        return np.asarray(np.hypot(noise, _ERROR * size) + 1e-12 * size)

    def size(self, name: str) -> float:
        """rms of the pulsation of a channel."""
        return float(np.sqrt(2.0 * np.sum(np.abs(self.X[name][1:]) ** 2)))

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
        return shares.ratios(self.tubes, X[..., first : first + self.forks])

    def fitted(self, x: Array, late: float, feet: float, rms: tuple[float, float]) -> Fitted:
        """The result at a point."""
        share = {tube: float(r) for tube, r in self.ratios(x).items()}
        return Fitted(self.factors(x), share, late, feet, rms, float(np.sum(self.residual(x[None]) ** 2)))

    def factors(self, x: Array) -> dict[str, float]:
        return {name: float(value / self.nominal[name]) for name, value in self.values(x).items()}

    def model(self, X: Array) -> dict[str, Array]:
        """Harmonics (B, K+1) of every channel for a batch of points X : (B, p)."""
        wave = waveforms(self.network, self.Q, self.beats.T, self.values(X))
        turn = np.exp(1j * self.beats.omega * self.k * X[:, -1:])
        return {name: np.fft.rfft(wave[name], norm="forward")[:, : len(self.k)] * turn for name in self.names}

    def residual(self, X: Array) -> Array:
        """(B, n) weighted residuals, priors included."""
        Y = self.model(X)
        z = [np.sqrt(2.0) * (Y[name] - self.X[name]) / self.sigma[name] for name in self.names]
        parts = [np.concatenate([each.real, each.imag], axis=1) for each in z]
        return np.concatenate([*parts, X[:, :-1] / self.spread], axis=1)

    def rms(self, x: Array, name: str) -> float:
        """Of the pulsation of a channel."""
        difference = (self.model(x[None])[name][0] - self.X[name])[1:]
        return float(np.sqrt(2.0 * np.sum(np.abs(difference) ** 2)))

    def search(self, late: float, error: float) -> Array:
        """The best point : (p,), from points about the estimates, with a lag [s] of ``late`` to an error."""
        T = self.beats.T
        unit = np.append(np.ones(len(self.spread)), T)  # of x: the lag in periods
        low, high = np.append(self.low, (late - error) / T), np.append(self.high, (late + error) / T)

        # the last point with its neighbours: one batch takes little longer than the point
        about = dict[bytes, Array]()

        def near(x: Array) -> Array:
            if x.tobytes() not in about:
                about.clear()
                about[x.tobytes()] = self.residual(np.concatenate([x[None], x + _STEP * np.eye(len(x))]) * unit)
            return about[x.tobytes()]

        def at(x: Array) -> Array:
            return np.asarray(near(x)[0])

        def slopes(x: Array) -> Array:
            z = near(x)
            return np.asarray((z[1:] - z[0]).T / _STEP)

        starts = np.clip(np.pad(self._starts(), ((0, 0), (0, 1)), constant_values=late / T), low, high)
        order = np.argsort(np.sum(self.residual(starts * unit) ** 2, axis=1))[:_SEARCHES]
        accuracy = {"ftol": 1e-4, "xtol": 1e-4, "max_nfev": 40, "bounds": (low - 1e-9, high + 1e-9)}
        found = [least_squares(at, start, slopes, **accuracy) for start in starts[order]]
        return np.asarray(min(found, key=lambda each: each.cost).x * unit)

    def _starts(self) -> Array:
        """(n, p) points: all combinations of a few factors."""
        odds = _ODDS if self.forks else (1.0,)
        grid = product(odds, (1.0,) if self.known else _LENGTHS, *_GRID.values())
        kinds = (_FORK, "L", *_GRID)
        of = [group[0].rpartition(".")[2] for group in self.groups] + [_FORK] * self.forks
        return np.array([[np.log(dict(zip(kinds, each, strict=True)).get(kind, 1.0)) for kind in of] for each in grid])
