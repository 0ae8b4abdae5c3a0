"""Periodic beats of one network under one inflow, for batches of parameters; the linearised response to it, and with it
the weights of a record: the noise of its channels, and that of the inflow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver import NonPhysicalState, Settings, beat_harmonics, repeating_beat
from solver.errors import InputError
from solver.laws.catalogue import filtered, zero_of
from solver.mesh.sources import Source
from solver.network.description import Network
from solver.quantities.units import INFLOW

from ...records.alignment.beats import Beats
from ...records.channels.inflow import Inflow, undoable
from ...records.channels.noise import Target, response, target
from ...records.channels.variability import BeatVariation, beat_variation
from ...records.limits import NEIGHBOURS
from ..fit import Array, Member
from ..hypothesis import rewired
from ..runs import Runs
from ..unknown import parameter_values, split_zeros
from .bench_observation import meter, sense

HARMONICS_BEYOND = 8  # above K in a harmonic balance: without them the error is 7e-5 of the pulse with elastic walls
_BEATS = 30  # without repeating, after which the simulation has failed
_SHORTER = 2  # times that the step is halved if the model as given breaks down


@dataclass(frozen=True)
class Forced:
    """Sources beside a network's own equations. amplitudes : (K+1, n_sources) harmonics of sources; signals : (K+1, m)
    added to the channels."""

    sources: tuple[Source, ...]
    amplitudes: Array
    signals: Array


@dataclass(frozen=True)
class Simulator:
    """Harmonics 0 … K of the channels ``names`` of a network under a periodic flow.

    beyond : harmonics above K in a harmonic balance (:func:`~solver.beat_harmonics`); 0 for a model without balance,
    whose beat is run in time with steps of settings.dt. start : time [s] in the beat at which such runs begin, where
    the flow is least: a run begins at rest, and a sudden flow would strain the walls more than any heart. tolerance,
    resolved : of the periodic beat. lengths : [m] by which balances cut the segments into elements (:meth:`cut`); None:
    the parameters'. forced : sources, which only a balance can include.
    """

    network: Network
    drive: Inflow
    T: float
    names: tuple[str, ...]
    K: int
    settings: Settings
    start: float = 0.0
    tolerance: float = 1e-5
    resolved: float = 0.0
    beyond: int = 0
    lengths: tuple[float, ...] | None = None
    forced: Forced | None = None

    def halved(self) -> Simulator:
        """The same with half the step."""
        return replace(self, settings=replace(self.settings, dt=self.settings.dt / 2.0))

    def finer(self) -> Simulator:
        """The same with half the step and half the element length, to measure the errors of both."""
        half = self.halved()
        return replace(half, settings=replace(half.settings, element_length=self.settings.element_length / 2.0))

    def cut(self, parameters: Mapping[str, float]) -> Simulator:
        """The same with elements for these parameters, whatever it simulates: harmonics are then smooth in lengths, of
        which the number of elements is a step function."""
        own = self.network.segments
        return replace(self, lengths=tuple(float(parameters.get(f"{s.name}.L", s.L)) for s in own))

    def delayed(self, network: Network, delay: float) -> Simulator:
        """The same with a network that knows a further delay [s] of the meter: the flow was earlier."""
        turned = self.drive.X * np.exp(1j * self.drive.omega * delay)
        return replace(self, network=network, drive=replace(self.drive, X=turned))

    def coefficients(
        self, network: Network, parameters: Mapping[str, Array], runs: Runs, inflow: Inflow | None = None,
        near: Array | None = None,
    ) -> Array:  # fmt: skip
        """X : (B, K+1, m) of the periodic beats under ``drive``, or under another inflow (possibly one per member),
        after the known filters and zeros of the channels. near : as in :func:`~solver.beat_harmonics`.

        Members without a periodic beat are NaN.
        Raises ValueError, NonPhysicalState and NotPeriodic as the solver, OutOfTime after the deadline.
        """
        runs.check()
        inflow, B = inflow or self.drive, max((np.size(value) for value in parameters.values()), default=1)
        if self.beyond:
            X = self._balanced(network, parameters, runs, inflow, near)
        elif self.forced is None:
            X = self._in_time(network, parameters, runs, inflow)
        else:
            X = np.full((B, self.K + 1, len(self.names)), np.nan, complex)
        runs.meter.add(B)
        X = as_shown(network, self.names, self.T, X)
        return X if self.forced is None else X + self.forced.signals

    def _balanced(
        self, network: Network, parameters: Mapping[str, Array], runs: Runs, inflow: Inflow, near: Array | None
    ) -> Array:
        """By harmonic balance; NaN if none is found. Raises ValueError if a member has no steady state."""
        forced = self.forced if self.forced and self.forced.sources else None
        sources, amplitudes = (forced.sources, forced.amplitudes) if forced else ((), None)
        return beat_harmonics(network, self.names, self.K, inflow, self.T, parameters=parameters,
                              settings=self.settings, tolerance=self.tolerance, more=self.beyond, sources=sources,
                              amplitudes=amplitudes, progress=runs.check, lengths=self.lengths,
                              near=None if near is None else near.tolist())  # fmt: skip

    def _in_time(self, network: Network, parameters: Mapping[str, Array], runs: Runs, inflow: Inflow) -> Array:
        """By time stepping until beats repeat."""

        def drive(t: Array) -> Array:
            return inflow(t + self.start)

        beat = repeating_beat(network, drive, self.T, parameters=parameters, settings=self.settings,
                              tolerance=self.tolerance, resolved=self.resolved, max_beats=_BEATS,
                              progress=lambda *_: runs.check())  # fmt: skip
        waves = np.stack([np.atleast_2d(beat[name])[:, :-1] for name in self.names], axis=-1)
        turn = np.exp(-2j * np.pi * np.arange(self.K + 1) * (self.start / self.T))
        return np.fft.rfft(waves, axis=1, norm="forward")[:, : self.K + 1] * turn[:, None]


def started(simulator: Simulator, runs: Runs) -> tuple[Simulator, Array]:
    """The model as given under this inflow; if it has no balance, by time stepping, with shorter steps if needed.

    Raises NonPhysicalState if all steps fail, ValueError if it has no steady state under the mean inflow.
    """
    X = simulator.coefficients(simulator.network, {}, runs)[0]
    if not np.isnan(X).any():
        return simulator, X
    simulator = replace(simulator, beyond=0)
    for _ in range(_SHORTER):
        try:
            return simulator, simulator.coefficients(simulator.network, {}, runs)[0]
        except NonPhysicalState:
            simulator = simulator.halved()
    return simulator, simulator.coefficients(simulator.network, {}, runs)[0]


def filters(network: Network, names: Sequence[str], T: float, K: int) -> Array:
    """H : (K+1, m) of the known filters of the channels."""
    return np.stack([filtered(network, name, 2.0 * np.pi / T * np.arange(K + 1)) for name in names], axis=1)


def as_shown(network: Network, names: Sequence[str], T: float, X: Array) -> Array:
    """Coefficients X : (…, K+1, m) through the known filters of their channels, with the known zeros."""
    found = X * filters(network, names, T, X.shape[-2] - 1)
    found[..., 0, :] += [zero_of(network, name) for name in names]
    return found


def linear_response(network: Network, names: Sequence[str], T: float, K: int, parameters: Mapping[str, float]) -> Array:
    """The linearised response (K + 1 + neighbours, m) to the inflow, with the filters of both. If the linear solver
    lacks a wall term, the response of walls without terms."""
    K += NEIGHBOURS
    filtered = filters(network, names, T, K) / undoable(network, INFLOW, 2.0 * np.pi / T * np.arange(K + 1))[:, None]
    try:
        return filtered * response(network, names, T, K, parameters)
    except InputError:
        plain = replace(network, segments=tuple(replace(s, terms={}) for s in network.segments))
        known = {n: v for n, v in parameters.items() if n in plain.parameters()}
        return filtered * response(plain, names, T, K, known)


def varying(
    beats: Beats,
    network: Network,
    names: Sequence[str],
    K: int,
    parameters: Mapping[str, float] | None = None,
) -> BeatVariation | None:
    """The linearised response to beat-to-beat variation of the inflow; None for beats cut at equal intervals."""

    def transfer(T: float, n: int) -> Array:
        return linear_response(network, names, T, n, parameters or {})[: n + 1]

    return beat_variation(beats, INFLOW, transfer, K + NEIGHBOURS)


def weighted(
    beats: Beats, simulator: Simulator, member: Member, error: Array, known: BeatVariation | None = None,
    known_at: Mapping[str, float] | None = None,
) -> tuple[Target, Array, BeatVariation | None, Mapping[str, float]]:  # fmt: skip
    """The weighted data of a record at a member, the response (K+1, m) to the inflow's noise, and that to beats that
    differ, with its parameters.

    error : (K+1, m) of the model. known : the last response to beats that differ, with the parameters known_at, kept
    for a member with effects. How much of the changes is noise of the meter does not depend on the effect that is
    tested: if one that the mean pressure refutes called them noise, no hypothesis would have to fit the mean.
    """
    names, T, K = simulator.names, simulator.T, simulator.K
    network = rewired(simulator.network, member.terms)
    values, _ = split_zeros(parameter_values(member.unknowns, network, member.x), network)
    at = {name: float(value) for name, value in values.items()}
    H = sense(member, names, linear_response(network, names, T, K, at), T, means=False)
    H = H / meter(member, len(H), T)[0][:, None]  # a slow meter hides more noise of the true inflow
    variation, variation_at = known, known_at or {}
    if known is None or not member.terms:
        variation, variation_at = varying(beats, network, names, K, at), at
    return target(beats, names, H, error, variation), H[: K + 1], variation, variation_at
