"""The beat that repeats, as the harmonics of its outputs: for fits, which compare these and need thousands of beats."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .balance import Waves, amplitudes, balanced, moments, samples, spectrum, steady, storable
from .coefficients import Parameters
from .inflow import Inflows, drives_of
from .network import Network
from .outputs import reporter
from .scheme.guards import physical
from .scheme.model import Model, Settings, build
from .scheme.step import State

Array = np.ndarray

_CORRECTIONS = 40


def beat_harmonics(
    network: Network, names: Sequence[str], K: int, inflow: Inflows | None = None, period: float | None = None, *,
    parameters: Parameters | None = None, settings: Settings | None = None, tolerance: float = 1e-5, more: int = 8,
    progress: Callable[[], None] | None = None,
) -> Array:  # fmt: skip
    """X : (B, K+1, m) complex harmonics of outputs of the beat that repeats: x(t) = X_0 + 2 Re Σ X_k e^{2πikt/T}.

    By harmonic balance (:mod:`~solver.balance`): as the beat of :func:`~solver.simulate_periodic` with steps that
    vanish, in the time of a few dozen of them. names : of the outputs. tolerance : of the last correction, relative to
    the flows of the wave; what is left is a part of it. more : harmonics that are kept beyond K, whose products with
    others count below it. settings.dt plays no role. Other arguments as there.

    Members of a batch whose balance is not found, or has no room, are NaN; a simulation in time may find their beat.
    Raises ValueError as simulate_periodic, and where there is no steady state with the mean of the drive.
    """
    model = build(network, parameters, settings)
    B, T = model.coefficients.B, network.inlet.T if period is None else period
    if storable(model) < K + more:
        return np.full((B, K + 1, len(names)), np.nan, complex)
    harmonics = spectrum(model, drives_of(network, inflow, B), T, K + more)
    with np.errstate(all="ignore"):
        rest = steady(model, harmonics[0].real)
        waves, last = balanced(model, rest, harmonics, T, tolerance, _CORRECTIONS, progress)
        X, good = _observed(model, waves, rest, names)
    X[~(good & (last < tolerance))] = np.nan
    return X[:, : K + 1]


def _observed(model: Model, waves: Waves, rest: State, names: Sequence[str]) -> tuple[Array, Array]:
    """Harmonics (B, K+1, m) of outputs, and whether every moment of a member is physical : (B,)."""
    report, values, good = reporter(model), list[Array](), list[Array]()
    for y, H, rate in moments(model, *map(samples, (waves.y, waves.H, waves.rates))):
        A_t = model.layout.part(rate, "A")
        values.append(report(rest.of_moments(y, A_t, H)))
        good.append(physical(model, model.layout.part(y, "A"), A_t, model.layout.part(y, "Q")))
    columns = [report.names.index(name) for name in names]
    X = amplitudes(np.concatenate(values)[:, columns], waves.y).swapaxes(0, 1)
    return X, np.logical_and.reduce(np.concatenate(good).reshape(-1, model.coefficients.B))
