"""The drives of a run's inlets: functions of time, sampled at the times of the schemes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .description import Network

Array = np.ndarray
Inflow = Callable[[Array], Array]
Inflows = Inflow | Mapping[str, Inflow]


def sampled_inflow(t: Array, Q: Array, period: float | None = None) -> Inflow:
    """The piecewise linear inflow through samples Q [m³/s] at times t [s] : (n,); repeated if a period [s] is given.

    Raises ValueError unless both are finite, of one length, with increasing t.
    """
    t, Q = np.asarray(t, float), np.asarray(Q, float)
    if t.ndim != 1 or t.shape != Q.shape or len(t) < 2:
        raise InputError(
            f"inflow samples: t and Q must be one-dimensional and of one length; got {t.shape}, {Q.shape}."
        )
    if period is not None and not (np.isfinite(period) and period >= t[-1] - t[0] > 0.0):
        raise InputError(f"inflow samples: period = {period!r} s must be finite and no shorter than the samples.")
    if not (np.isfinite(t).all() and np.isfinite(Q).all() and (np.diff(t) > 0).all()):
        raise InputError("inflow samples: t must increase and all values must be finite; remove gaps first.")
    return lambda at: np.interp(at, t, Q, period=period)


def drives_of(network: Network, inflow: Inflows | None, B: int) -> Drives:
    """The drives of the inlets for a batch of B: the given ones (for the first inlet also without its name), otherwise
    the network's own. Raises ValueError for an inlet without a drive, or for a name that drives nothing."""
    given = inflow if isinstance(inflow, Mapping) else {} if inflow is None else {network.inlet.drive: inflow}
    own = {inlet.drive: inlet.given for inlet in network.inlets}
    for name in given:
        if name not in own:
            raise InputError(f"inflow: {name} does not drive an inlet of network {network.name}; use {', '.join(own)}.")
        if not callable(given[name]):
            shown = f"{given[name]!r:.40}" if np.isscalar(given[name]) else f"a {type(given[name]).__name__}"
            raise InputError(
                f"inflow {name}: {shown} is no function of time; give one that takes an array of times [s], such as "
                "sampled_inflow(t, Q) of samples. A duration is given by name: duration=2.0."
            )
    found = {name: given.get(name, default) for name, default in own.items()}
    for name, drive in found.items():
        if drive is None:
            raise InputError(f"network {network.name}: nothing drives {name}; give it as inflow, P(t) in Pa.")
    return Drives({name: drive for name, drive in found.items() if drive is not None}, B)


@dataclass(frozen=True)
class Drives:
    """Q(t) [m³/s] or P(t) [Pa] of each inlet by the name of the driving variable, for a batch of B."""

    inflows: Mapping[str, Inflow]
    B: int

    def __call__(self, t: Array) -> Array:
        """The drives for the steps of the schemes at times t [s] : t.shape or t.shape + (B,), with an axis for the
        inlets after the first."""
        values = [self.values(name, t) for name in self.inflows]
        if any(each.ndim > t.ndim for each in values):
            values = [x if x.ndim > t.ndim else np.repeat(x[..., None], self.B, axis=-1) for x in values]
        return np.stack(values, axis=1)

    def members(self, part: Array) -> Drives:
        """The drives of some members of a batch."""

        return Drives({name: _Some(inflow, part) for name, inflow in self.inflows.items()}, len(part))

    def harmonics(self, T: float, K: int) -> Array | None:
        """(K+1, B or 1, n_inlets) complex harmonics [m³/s] or [Pa] of the period T [s], None if an inflow does not know
        its own. Those that do have a method ``harmonics(T, K)``, which returns (K+1,), (B, K+1) or None."""
        found = [known_harmonics(inflow, T, K) for inflow in self.inflows.values()]
        if any(X is None for X in found):
            return None
        each = np.broadcast_arrays(*(np.atleast_2d(X) for X in found if X is not None))
        return np.stack(each, axis=-1).swapaxes(0, 1)

    def values(self, name: str, t: Array) -> Array:
        """The flow [m³/s] or pressure [Pa] that drives an inlet at times t [s] : t.shape, or t.shape + (B,)."""
        Q, B = np.asarray(self.inflows[name](t.ravel()), float), self.B
        if Q.shape not in (t.ravel().shape, (t.size, B)):
            raise InputError(
                f"inflow {name}: for {t.size} times it gave shape {Q.shape}; it must give one value per time, or "
                f"one for each of the {B} parameter sets, {(t.size, B)}."
            )
        bad = np.argwhere(~np.isfinite(Q))
        if len(bad):
            first = tuple(bad[0])
            raise InputError(f"inflow {name}: {Q[first]} at t = {t.ravel()[first[0]]:g} s; all values must be finite.")
        return Q.reshape(t.shape + Q.shape[1:])


@dataclass(frozen=True)
class _Some:
    """An inflow of some members of a batch."""

    inflow: Inflow
    part: Array

    def __call__(self, t: Array) -> Array:
        Q = np.asarray(self.inflow(t), float)
        return Q if Q.ndim == t.ndim else Q[..., self.part]

    def harmonics(self, T: float, K: int) -> Array | None:
        X = known_harmonics(self.inflow, T, K)
        return X if X is None or X.ndim == 1 else X[self.part]


def known_harmonics(inflow: Inflow, T: float, K: int) -> Array | None:
    """(K+1,) or (B, K+1) complex harmonics [m³/s] or [Pa] of the period T [s], None if an inflow does not know them."""
    own = getattr(inflow, "harmonics", None)
    return None if own is None else own(T, K)
