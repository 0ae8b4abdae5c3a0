"""The periodic beat as harmonics of its outputs, for fits, which compare harmonics and need thousands of beats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from .errors import InputError
from .mesh.sources import NO_FORCING, Forcing, Source, shown
from .network.coefficients import Parameters
from .network.description import Network
from .network.inflow import Drives, Inflows, drives_of
from .periodic.harmonic_balance import (
    MOST,
    Waves,
    amplitudes,
    balanced,
    moments_of,
    samples,
    spectrum,
    steady,
    storable,
)
from .periodic.native_balance import BalanceEngine, Unsolved, engine_for
from .scheme.guards import physical
from .scheme.model import Model, Settings, build
from .scheme.outputs import reporter
from .scheme.step import State
from .simulate import check_network
from .tracing.native import NoEngine, refuse_without

Array = np.ndarray

_CORRECTIONS = 40
_FEW = 3  # harmonics of the beat for the comparison
_EQUAL = 1e-8  # maximum difference between engine and NumPy, relative to the largest harmonic of its kind


def beat_harmonics(
    network: Network, names: Sequence[str], K: int, inflow: Inflows | None = None, period: float | None = None, *,
    parameters: Parameters | None = None, settings: Settings | None = None, tolerance: float = 1e-5, more: int = 8,
    sources: Sequence[Source] = (), amplitudes: Array | None = None, progress: Callable[[], None] | None = None,
    backend: str = "auto", lengths: Sequence[float] | None = None,
) -> Array:  # fmt: skip
    """X : (B, K+1, m) complex harmonics of outputs of the periodic beat: x(t) = X_0 + 2 Re Σ X_k e^{2πikt/T}.

    By harmonic balance (:mod:`~solver.periodic.harmonic_balance`): the limit of :func:`~solver.simulate_periodic` for
    small steps, in the time of a few dozen of them. names : of the outputs. tolerance : of the last correction of the
    pulsatile flows, relative to them; the error is a fraction of it. more : harmonics beyond K in the balance, whose
    products with others contribute below K. settings.dt has no effect. sources : terms added to the equations
    (:mod:`~solver.mesh.sources`), with the harmonics ``amplitudes`` : (n, n_sources), the same for all members.
    progress : called after every correction; an exception from it ends the search. backend : "numpy"; "native", the
    compiled engine (:mod:`~solver.periodic.native_balance`), which agrees to 1e-9 of the largest harmonic of its kind;
    "auto", the engine if it is available and supports the network. lengths : (n_segments,) [m] by which segments are
    cut into elements, so that the beats are smooth in parameters L; default: the longest of the B. Other arguments as
    there.

    Members of a batch without a converged balance, or too large for one, are NaN; a simulation in time may find their
    beat. Raises ValueError as simulate_periodic, for names that are no outputs, and if a member has no steady state
    under the mean of the drive.
    """
    _check(network, names, K, more, tolerance)
    T = network.inlet.T if period is None else period
    if not (isinstance(T, (int, float, np.number)) and 0.0 < T < np.inf):
        raise InputError(f"period = {T!r} s: must be a positive number.")
    model = build(network, parameters, settings, lengths)
    B = model.coefficients.B
    drives, fit = drives_of(network, inflow, B), B * storable(model) // (K + more)
    g = np.zeros((1, 0)) if amplitudes is None else amplitudes

    def found_of(model: Model, drives: Drives) -> Array:
        every, each = model.tables.beside(sources, g, T, K + more + 1)
        forcing = Forcing.of(model, every, each, K + more + 1) if every else NO_FORCING
        asked = _Asked(tuple(names), K, T, tolerance, progress)
        X = _beats(model, spectrum(model, drives, T, K + more), forcing, asked, backend)
        own = each[: K + 1] @ shown(network, names, every)
        X[:, : len(own)] += own
        return X

    if fit >= B:
        return found_of(model, drives)
    if not fit:
        return np.full((B, K + 1, len(names)), np.nan, complex)
    found = []
    for part in (slice(at, at + fit) for at in range(0, B, fit)):
        own = {name: np.broadcast_to(value, B)[part] for name, value in (parameters or {}).items()}
        found.append(found_of(build(network, own, settings, lengths), drives.members(part)))
    return np.concatenate(found)


def has_room(network: Network, harmonics: int, settings: Settings | None = None) -> bool:
    """True if a balance with this number of harmonics fits into memory for one member."""
    return storable(build(network, None, settings)) >= harmonics


def _check(network: Network, names: Sequence[str], K: int, more: int, tolerance: float) -> None:
    check_network(network)
    known = network.output_units()
    for name in names:
        if name not in known:
            raise InputError(f"{name} is no output of network {network.name}; it has {', '.join(known)}.")
    if not (K >= 0 and more >= 1 and K + more <= MOST):
        raise InputError(f"K = {K} harmonics and more = {more} beyond them: 0 and 1 at least, together {MOST} at most.")
    if not tolerance > 0.0:
        raise InputError(f"tolerance = {tolerance!r} must be a positive number.")


class _Asked(NamedTuple):
    """The request: outputs, number of harmonics, period and tolerance; progress : called after every correction."""

    names: tuple[str, ...]
    K: int
    T: float
    tolerance: float
    progress: Callable[[], None] | None


def _beats(model: Model, drive: Array, forcing: Forcing, asked: _Asked, backend: str) -> Array:
    """X : (B, K+1, m) under drives and sources with these harmonics; by the engine if it solves all members."""
    engine = engine_for(model, backend)
    try:
        return _by_numpy(model, drive, forcing, asked) if engine is None else _by_engine(engine, drive, forcing, asked)
    except Unsolved:
        return _by_numpy(model, drive, forcing, asked)
    except NoEngine as reason:
        if backend == "native":
            refuse_without(reason)
        return _by_numpy(model, drive, forcing, asked)


def _by_engine(engine: BalanceEngine, drive: Array, forcing: Forcing, asked: _Asked) -> Array:
    """The engine's result. Raises NoEngine if it differs from NumPy's, Unsolved."""
    model = engine.model
    if not engine.recorded.checked:
        _compare(engine, drive, forcing, asked)
    X = np.full((model.coefficients.B, asked.K + 1, len(asked.names)), np.nan, complex)
    units = tuple(model.network.output_units())
    columns = [units.index(name) for name in asked.names]
    beats = engine.beats(drive, asked.T, asked.tolerance, _CORRECTIONS, asked.progress, forcing)
    for b, (beat, found) in enumerate(beats):
        if found is not None and beat.last < asked.tolerance:
            X[b] = found[: asked.K + 1, columns]
    return X


def _compare(engine: BalanceEngine, drive: Array, forcing: Forcing, asked: _Asked) -> None:
    """Compare a beat of few harmonics of the first member with NumPy's. Raises NoEngine if they differ."""
    few, one, model = slice(_FEW + 1), slice(1), engine.model
    own = {name: np.broadcast_to(value, model.coefficients.B)[one] for name, value in model.parameters.items()}
    alone, part = model.with_parameters(own), asked._replace(K=min(asked.K, _FEW), progress=None)
    drive, forcing = drive[few, one], forcing.part(few, one)
    expected = _by_numpy(alone, drive, forcing, part)[0]
    ((beat, found),) = BalanceEngine(alone).beats(drive, part.T, part.tolerance, _CORRECTIONS, None, forcing)
    if found is None or np.isnan(expected).any():
        return
    units = tuple(model.network.output_units())
    off = np.abs(found[: part.K + 1, [units.index(name) for name in part.names]] - expected)
    kinds = np.array([name[-1] for name in part.names])
    for kind in set(kinds.tolist()):
        of = kinds == kind
        apart = off[:, of].max() / max(np.abs(expected[:, of]).max(), np.finfo(float).tiny)
        if not apart <= _EQUAL:
            raise NoEngine(f"a balance of it is not that of NumPy: {kind} is {apart:.1e} off")
    engine.recorded.checked = True


def _by_numpy(model: Model, drive: Array, forcing: Forcing, asked: _Asked) -> Array:
    with np.errstate(all="ignore"):
        rest = steady(model, drive[0].real)
        try:
            waves, last = balanced(model, rest, drive, asked.T, asked.tolerance, _CORRECTIONS, asked.progress, forcing)
        except np.linalg.LinAlgError:  # undetermined waves at some frequency
            return np.full((model.coefficients.B, asked.K + 1, len(asked.names)), np.nan, complex)
        X, good = _observed(model, waves, rest, asked.names)
    X[~(good & (last < asked.tolerance))] = np.nan
    return X[:, : asked.K + 1]


def _observed(model: Model, waves: Waves, rest: State, names: Sequence[str]) -> tuple[Array, Array]:
    """Harmonics (B, K+1, m) of outputs, and whether a member is physical at all times : (B,)."""
    moments, values, good = moments_of(model, len(waves.y)), list[Array](), list[Array]()
    report = reporter(moments.model, tables=False)
    for y, H, rate in moments.of_each(*map(samples, (waves.y, waves.H, waves.rates))):
        A, A_t, Q = (model.layout.part(x, name) for x, name in ((y, "A"), (rate, "A"), (y, "Q")))
        values.append(report(rest.of_moments(y, A_t, H)))
        good.append(physical(moments.model, A, A_t, Q))
    columns = [report.names.index(name) for name in names]
    X = amplitudes(np.concatenate(values)[:, columns], waves.y).swapaxes(0, 1)
    return X, np.logical_and.reduce(np.concatenate(good).reshape(-1, model.coefficients.B))
