"""Responses of a network's outputs to small sources: linear waves about its steady state, for many sources at once.

The Jacobians are those of the harmonic balance (:mod:`~solver.periodic.harmonic_balance`), about the steady state of
the mean drive. Waves of a physiological beat are large, and their response differs from this one by a few per cent:
accurate enough for the direction of a search, not for its result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..mesh.sources import Source, shown
from ..network.description import Network
from ..network.inflow import Inflows, drives_of
from ..scheme.model import Model, Settings, build
from ..scheme.outputs import reporter
from ..scheme.step import State
from .harmonic_balance import Response, spectrum, steady
from .native_balance import BalanceEngine, Unsolved, engine_for
from .waves import constant, taus_of

Array = np.ndarray

_SMALL = 1e-4  # of a source, so that outputs are linear in it


def source_responses(
    network: Network, names: Sequence[str], K: int, sources: Sequence[Source], units: Sequence[float],
    inflow: Inflows | None = None, period: float | None = None, *,
    parameters: Mapping[str, float] | None = None, settings: Settings | None = None, backend: str = "auto",
) -> Array:  # fmt: skip
    """G : (n_sources, K+1, m), the response of harmonic k of outputs to harmonic k of a source's amplitude, per unit.

    units : (n_sources,) unit amplitudes, small against the drive. Other arguments as in :func:`~solver.beat_harmonics`,
    for one parameter set.
    Raises ValueError and LinAlgError as that function, if there is no steady state or no response to it.
    """
    T = network.inlet.T if period is None else period
    model = build(network, parameters, settings)
    mean, omega = spectrum(model, drives_of(network, inflow, 1), T, 1)[0].real, 2.0 * np.pi / T * np.arange(K + 1)
    size = _SMALL * np.asarray(units, float)
    momentum, nodes = (size.reshape(-1, *[1] * (x.ndim - 1)) * x for x in _unit(model, sources))
    engine = engine_for(model, backend)
    with np.errstate(all="ignore"):
        try:
            rest, y, H = _waves(model, mean, taus_of(omega), momentum, nodes, engine)
        except Unsolved:
            rest, y, H = _waves(model, mean, taus_of(omega), momentum, nodes, None)
        X = _observed(model, rest, omega, y, H, names) / _SMALL
    return X + (np.asarray(units)[:, None] * shown(network, names, sources))[:, None]


def _waves(
    model: Model, mean: Array, taus: Sequence[Any], momentum: Array, nodes: Array, engine: BalanceEngine | None
) -> tuple[State, Array, Array]:
    """The steady state, and the waves about it caused by sources."""
    if engine is None or not engine.recorded.checked:  # a balance of such a model was not yet compared with NumPy's
        rest = steady(model, mean)
        return rest, *Response.about(model, taus, rest).to_sources(momentum, nodes)
    return engine.to_sources(np.array(taus, complex), mean[0], momentum, nodes)


def _unit(model: Model, sources: Sequence[Source]) -> tuple[Array, Array]:
    """Contributions of sources of unit amplitude to momentum, (S, n_e, N+1), and to ΣQ at the nodes with those of the
    inlets, (S, n_nodes)."""
    momentum = np.zeros((len(sources), *model.mass.shape[1:]))
    nodes = np.zeros((len(sources), model.mesh.n_nodes))
    for source, own, at_nodes in zip(sources, momentum, nodes, strict=True):
        for to, added in ((own, source.momentum(model)), (at_nodes, source.nodes(model)),
                          (at_nodes[model.mesh.topology.inlets], source.inlets(model))):  # fmt: skip
            if added is not None:
                to += added
    return momentum, nodes


def _observed(model: Model, rest: State, omega: Array, y: Array, H: Array, names: Sequence[str]) -> Array:
    """(S, K+1, m) changes of outputs by small waves y : (K+1, S, n), H : (K+1, S, n_nodes) about the steady state."""
    report = reporter(model)
    columns = [report.names.index(name) for name in names]
    rates = 1j * omega[:, None, None] * y
    still = constant(rest.y, 1).real

    def at(y: Array, rates: Array, H: Array) -> Array:
        n = y.shape[0] * y.shape[1]
        A_t = model.layout.part(rates.reshape(n, -1), "A")
        state = rest.of_moments(still[0] + y.reshape(n, -1), A_t, rest.H + H.reshape(n, -1))
        return report(state)[:, columns].reshape(*y.shape[:2], -1)

    nothing = at(0.0 * y[:1, :1].real, 0.0 * y[:1, :1].real, 0.0 * H[:1, :1].real)
    found = at(y.real, rates.real, H.real) - nothing + 1j * (at(y.imag, rates.imag, H.imag) - nothing)
    return np.asarray(found.swapaxes(0, 1))
