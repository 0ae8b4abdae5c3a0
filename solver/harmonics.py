"""The periodic beat as harmonics of its outputs, for fits, which compare harmonics and need thousands of beats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .errors import InputError
from .mesh.sources import NO_FORCING, Forcing, Source, shown
from .network.coefficients import Parameters
from .network.description import Network
from .network.inflow import Drives, Inflows, drives_of
from .periodic.harmonic_balance import MOST, balanced, moments_of, spectrum, steady, storable
from .periodic.native_balance import BalanceEngine, Beat, Unsolved, engine_for
from .periodic.waves import Near, Waves, amplitudes, samples
from .scheme.guards import physical
from .scheme.model import Model, Settings, build
from .scheme.outputs import reporter
from .scheme.step import State
from .simulate import check_network
from .tracing.native import NoEngine, refuse_without

Array = np.ndarray

_CORRECTIONS = 60
_FEW = 3  # harmonics of the beat for the comparison
_OF_FIRST = 3e-3  # of its first correction, the last one of a beat near another; their difference is as accurate
_CONVERGED = 1e-10  # tolerance of the comparison: at a coarser one, the mixing of corrections carries round-off
_EQUAL = 1e-8  # maximum difference between engine and NumPy, relative to the largest harmonic of its kind


def beat_harmonics(
    network: Network, names: Sequence[str], K: int, inflow: Inflows | None = None, period: float | None = None, *,
    parameters: Parameters | None = None, settings: Settings | None = None, tolerance: float = 1e-5, more: int = 8,
    sources: Sequence[Source] = (), amplitudes: Array | None = None, progress: Callable[[], None] | None = None,
    backend: str = "auto", near: Sequence[int] | None = None, lengths: Sequence[float] | None = None,
) -> Array:  # fmt: skip
    """X : (B, K+1, m) complex harmonics of outputs of the periodic beat: x(t) = X_0 + 2 Re Σ X_k e^{2πikt/T}.

    By harmonic balance (:mod:`~solver.periodic.harmonic_balance`): the limit of :func:`~solver.simulate_periodic` for
    small steps, in the time of a few dozen of them. names : of the outputs. tolerance : of the last correction of the
    pulsatile flows, relative to them; the error is a fraction of it. more : harmonics beyond K in the balance, whose
    products with others contribute below K. settings.dt has no effect. sources : terms added to the equations
    (:mod:`~solver.mesh.sources`), with the harmonics ``amplitudes`` : (n, n_sources), the same for all members.
    progress : called after every correction; an exception from it ends the search. backend : "numpy"; "native", the
    compiled engine (:mod:`~solver.periodic.native_balance`), which agrees to 1e-9 of the largest harmonic of its kind;
    "auto", the engine if it is available and supports the network. near : (B,) the member at whose beat the corrections
    of each one start, its own index for the steady state; the difference between two such beats of similar parameters
    is accurate to a few thousandths of itself; it is NaN if the other is. With leaks every beat starts by itself, and
    so does one that is not found from the other.
    lengths : (n_segments,) [m] by which segments are cut into elements, so that the beats are smooth in parameters L;
    default: the longest of the B. An inflow with a method ``harmonics`` (:meth:`.Drives.harmonics`) is not sampled.
    Other arguments as there.

    Members of a batch without a converged balance, or too large for one, are NaN; a simulation in time may find their
    beat. Raises ValueError as simulate_periodic, for names that are no outputs, and if a member has no steady state
    under the mean of the drive.
    """
    _check(network, names, K, more, tolerance)
    T = network.inlet.T if period is None else period
    if not (isinstance(T, (int, float, np.number)) and 0.0 < T < np.inf):
        raise InputError(f"period = {T!r} s: must be a positive number.")
    model = build(network, parameters, settings, lengths)
    asked = _Asked(tuple(names), K, more, T, tolerance, progress, backend)
    beats = _Beats(model, drives_of(network, inflow, model.coefficients.B), tuple(sources), amplitudes, asked)
    if near is None:
        return beats.of(np.arange(model.coefficients.B))[0]
    return beats.near(_checked(near, model.coefficients.B))


def has_room(network: Network, harmonics: int, settings: Settings | None = None) -> bool:
    """True if a balance with this number of harmonics fits into memory for one member."""
    return storable(build(network, None, settings)) >= harmonics


def _check(network: Network, names: Sequence[str], K: int, more: int, tolerance: float) -> None:
    check_network(network)
    if isinstance(names, str):
        raise InputError(f"names = {names!r}: must be a sequence of outputs, such as ({names!r},).")
    known = network.output_units()
    for name in names:
        if name not in known:
            raise InputError(f"{name} is no output of network {network.name}; it has {', '.join(known)}.")
    if not (K >= 0 and more >= 1 and K + more <= MOST):
        raise InputError(f"K = {K} harmonics and more = {more} beyond them: 0 and 1 at least, together {MOST} at most.")
    if not tolerance > 0.0:
        raise InputError(f"tolerance = {tolerance!r} must be a positive number.")


class _Asked(NamedTuple):
    """The request: outputs, numbers of harmonics, period and tolerances; progress : called after every correction.
    keep : the beats, for others to start at."""

    names: tuple[str, ...]
    K: int
    more: int
    T: float
    tolerance: float
    progress: Callable[[], None] | None
    backend: str
    of_first: float = 0.0
    keep: bool = False


Found = tuple[Array, Near | None]  # harmonics (B, K+1, m) of the outputs; the beats, if they are kept


@dataclass(frozen=True)
class _Beats:
    """The beats of a batch under drives and sources with harmonics ``amplitudes``."""

    model: Model
    drives: Drives
    sources: tuple[Source, ...]
    amplitudes: Array | None
    asked: _Asked

    def near(self, near: Array) -> Array:
        """X : (B, K+1, m), the beats of most members from those of others; not with leaks, whose residual of mass is
        corrected in each beat by itself."""
        B = len(near)
        first, others = np.flatnonzero(near == np.arange(B)), np.flatnonzero(near != np.arange(B))
        X = np.empty((B, self.asked.K + 1, len(self.asked.names)), complex)
        if not (len(others) and self.model.storage.proportional):
            return self.of(np.arange(B))[0]
        X[first], kept = replace(self, asked=self.asked._replace(keep=True)).of(first)
        if kept is None:
            X[others], _ = self.of(others)
            return X
        begun = kept.members(np.searchsorted(first, near[others]))
        X[others], _ = replace(self, asked=self.asked._replace(of_first=_OF_FIRST)).of(others, begun)
        lost = others[np.isnan(X[others]).any(axis=(1, 2))]
        if len(lost):  # the first corrections of a small difference may grow, where those from rest fall
            X[lost], _ = self.of(lost)
        X[np.isnan(X[near]).any(axis=(1, 2))] = np.nan  # the residual of a beat that is lost is none to share
        return X

    def of(self, members: Array, near: Near | None = None) -> Found:
        """The beats of some members, as many at once as fit into memory."""
        fit = self.model.coefficients.B * storable(self.model) // (self.asked.K + self.asked.more)
        if not fit:
            return np.full((len(members), self.asked.K + 1, len(self.asked.names)), np.nan, complex), None
        found = []
        for at in range(0, len(members), fit):
            part = slice(at, at + fit)
            found.append(self._together(members[part], near and near.members(part)))
        kept = [each for _, each in found if each]
        return np.concatenate([X for X, _ in found]), Near.joined(kept) if len(kept) == len(found) else None

    def _together(self, members: Array, near: Near | None) -> Found:
        B, asked = self.model.coefficients.B, self.asked
        model, drives = self.model, self.drives
        if len(members) < B:
            model, drives = model.members(members), drives.members(members)
        g = np.zeros((1, 0)) if self.amplitudes is None else self.amplitudes
        every, each = model.tables.beside(self.sources, g, asked.T, asked.K + asked.more + 1)
        forcing = Forcing.of(model, every, each, asked.K + asked.more + 1) if every else NO_FORCING
        X, kept = _beats(model, spectrum(model, drives, asked.T, asked.K + asked.more), forcing, asked, near)
        own = each[: asked.K + 1] @ shown(model.network, asked.names, every)
        X[:, : len(own)] += own
        return X, kept


def _checked(near: Sequence[int], B: int) -> Array:
    found = np.asarray(near)
    whole = found.shape == (B,) and found.dtype.kind in "iu" and ((found >= 0) & (found < B)).all()
    if not (whole and (found[found] == found).all()):
        raise InputError(
            f"near = {near!r:.80}: it must give, for each of the {B} parameter sets, the index of the set at whose "
            "beat its corrections start; that set must have its own index."
        )
    return found


def _beats(model: Model, drive: Array, forcing: Forcing, asked: _Asked, near: Near | None) -> Found:
    """The beats under drives and sources with these harmonics; by the engine if it solves all members."""
    engine = engine_for(model, asked.backend)
    try:
        if engine is not None:
            return _by_engine(engine, drive, forcing, asked, near)
    except Unsolved:
        pass
    except NoEngine as reason:
        if asked.backend == "native":
            refuse_without(reason)
    return _by_numpy(model, drive, forcing, asked, near)


def _by_engine(engine: BalanceEngine, drive: Array, forcing: Forcing, asked: _Asked, near: Near | None) -> Found:
    """The engine's result. Raises NoEngine if it differs from NumPy's, Unsolved."""
    model = engine.model
    if not engine.recorded.checked:
        _compare(engine, drive, forcing, asked)
    X = np.full((model.coefficients.B, asked.K + 1, len(asked.names)), np.nan, complex)
    units = tuple(model.network.output_units())
    columns = [units.index(name) for name in asked.names]
    kept = list[Beat]()
    beats = engine.beats(drive, asked.T, asked.tolerance, _CORRECTIONS, asked.progress, forcing, near=near,
                         of_first=asked.of_first, keep=asked.keep)  # fmt: skip
    for b, (beat, found) in enumerate(beats):
        if found is not None and np.isfinite(beat.last):
            X[b] = found[: asked.K + 1, columns]
        kept += [beat] if asked.keep else []
    return X, engine.near(kept, asked.T) if kept else None


def _compare(engine: BalanceEngine, drive: Array, forcing: Forcing, asked: _Asked) -> None:
    """Compare a beat of few harmonics of the first member with NumPy's. Raises NoEngine if they differ."""
    few, one, model = slice(_FEW + 1), slice(1), engine.model
    alone = model.members(np.arange(1))
    part = asked._replace(K=min(asked.K, _FEW), progress=None, of_first=0.0, tolerance=_CONVERGED)
    drive, forcing = drive[few, one], forcing.part(few, one)
    expected = _by_numpy(alone, drive, forcing, part, None)[0][0]
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
    engine.recorded.checked = not asked.keep  # effects may be 0 in a beat at which others start


def _by_numpy(model: Model, drive: Array, forcing: Forcing, asked: _Asked, near: Near | None) -> Found:
    with np.errstate(all="ignore"):
        rest = steady(model, drive[0].real)
        try:
            waves, last, kept = balanced(model, rest, drive, asked.T, asked.tolerance, _CORRECTIONS, asked.progress,
                                         forcing, near, asked.of_first, asked.keep)  # fmt: skip
        except np.linalg.LinAlgError:  # undetermined waves at some frequency
            return np.full((model.coefficients.B, asked.K + 1, len(asked.names)), np.nan, complex), None
        X, good = _observed(model, waves, rest, asked.names)
    X[~(good & np.isfinite(last))] = np.nan
    return X[:, : asked.K + 1], kept


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
