"""Before any experiment: what a set of sensors could tell apart, and which sensor to add.

A virtual record of the network as it is, at a given noise, stands for the experiment: all its outputs are simulated
once, with every effect, and each set of sensors is judged by its part of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.beats import Beats
from fitting.units import INFLOW
from fitting.virtual import measured
from solver import simulate_periodic
from solver.network import Network
from solver.report import output_variables

from . import thresholds
from .fits import Fit
from .isolability import isolability
from .network import NetworkProblem, Tell, network_problem
from .outcome import Isolability
from .terms import Term, candidates

Array = np.ndarray

_SAMPLES = 100  # of a beat
_SEED = 5


@dataclass(frozen=True)
class Gain:
    """What one more sensor would bring: effects that become visible, and pairs of effects that become separable."""

    channel: str
    visible: tuple[str, ...]
    separable: int


@dataclass(frozen=True)
class SensorPlan:
    """table : of the chosen channels. gains : of further channels, largest first."""

    channels: tuple[str, ...]
    table: Isolability
    gains: tuple[Gain, ...]


def plan_sensors(
    network: Network, channels: Sequence[str], dB: float = 40.0, beats: int = 15, tell: Tell = lambda _: None
) -> SensorPlan:
    """Isolability of some outputs of a network beside its inflow, at a noise of ``dB`` and over ``beats`` beats.

    Raises ValueError for a channel that the network has not.
    """
    known = tuple(n for n in output_variables(network)[0] if n.partition(".")[2] in ("P", "Q", "R") and n != "inlet.P")
    for name in channels:
        if name not in known:
            raise ValueError(
                f"channel {name}: network {network.name} has no such output; use some of {', '.join(known)}."
            )
    if not channels:
        raise ValueError(f"channels: none given; name some outputs of network {network.name}, such as {known[0]}.")
    problem = network_problem(_virtual(network, known, dB, beats), network, known, tell)
    terms = candidates(network, known)
    (base,) = problem.refit([()])
    assert base is not None
    columns = problem.columns(base, [t for t in terms if not t.rewires])
    tables = {name: _table(problem, base, columns, terms, (*channels, name)) for name in known if name not in channels}
    own = _table(problem, base, columns, terms, tuple(channels))
    gains = [_gain(own, name, table) for name, table in tables.items()]
    order = sorted(gains, key=lambda g: (-g.separable - 3 * len(g.visible), g.channel))
    return SensorPlan(tuple(channels), own, tuple(order))


def _virtual(network: Network, names: Sequence[str], dB: float, n_beats: int) -> Beats:
    """A virtual record: the network's own beat with white noise."""
    T = network.inlet.T
    beat = simulate_periodic(network, tolerance=1e-5)
    rng = np.random.default_rng(_SEED)
    values = {}
    for name in (INFLOW, *names):
        wave = beat[name][:-1]
        spectrum = np.fft.rfft(wave, norm="forward")[: _SAMPLES // 2 + 1]
        clean = np.fft.irfft(spectrum, _SAMPLES, norm="forward")
        values[name] = measured(np.tile(clean, n_beats), rng, dB).reshape(n_beats, _SAMPLES)
    return Beats("virtual record", "", T, values, np.zeros(n_beats))


def _table(
    problem: NetworkProblem, base: Fit, columns: Mapping[str, Array], terms: Sequence[Term], chosen: Sequence[str]
) -> Isolability:
    """Isolability by some of the problem's channels."""
    keep = np.array([problem.names.index(name) for name in dict.fromkeys(chosen)])
    part = _Part(problem, keep)
    seen = [t for t in terms if not t.is_sensor or t.place in chosen]
    fit = replace(base, z=part(base.z[:, None])[:, 0], J=part(base.J))
    return isolability(fit, {t.label: part(columns[t.label]) for t in seen if t.label in columns}, seen)


class _Part:
    """Turns whitened columns of all channels into those of some: back to coefficients, chosen, whitened anew."""

    def __init__(self, problem: NetworkProblem, keep: Array) -> None:
        self.m, self.K, self.keep = len(problem.names), problem.K, keep
        self.back = np.linalg.inv(problem.target.whitener)
        C = problem.target.covariance[:, keep[:, None], keep]
        scale = np.sqrt(np.einsum("kii->ki", C).real)
        factor = np.linalg.cholesky(C / (scale[:, :, None] * scale[:, None, :]))
        self.white = np.linalg.inv(factor) / scale[:, None, :]

    def __call__(self, z: Array) -> Array:
        mean, rest = z[: self.m], z[self.m :].reshape(2, self.K, self.m, -1) / np.sqrt(2.0)
        whole = np.concatenate([mean[None] + 0j, rest[0] + 1j * rest[1]])
        part = self.white @ (self.back @ whole)[:, self.keep]
        parts = [part[:1].real, np.sqrt(2.0) * part[1:].real, np.sqrt(2.0) * part[1:].imag]
        return np.concatenate([p.reshape(-1, z.shape[1]) for p in parts])


def _gain(own: Isolability, channel: str, table: Isolability) -> Gain:
    visible = tuple(e for e in own.invisible if e in table.labels and e not in table.invisible)
    return Gain(channel, visible, _separable(table, own.labels) - _separable(own, own.labels))


def _separable(table: Isolability, effects: Sequence[str]) -> int:
    """Pairs of visible effects that can be told apart."""
    at = [table.labels.index(e) for e in effects if e in table.labels and e not in table.invisible]
    block = table.separation[np.ix_(at, at)]
    return int((block >= thresholds.INSEPARABLE).sum() // 2)
