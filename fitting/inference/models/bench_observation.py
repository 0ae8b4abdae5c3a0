"""Observation model: the measurement chains of a hypothesis on the true channels, and the inverse for the inflow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from solver.laws import effects
from solver.laws.sensors import Sensor
from solver.quantities.units import INFLOW

from ...records.channels.inflow import Inflow
from ..fit import Array, Member
from ..unknown import is_zero, values, zero_name


def chain(moved: Mapping[str, Array], channel: str, omega: Array) -> tuple[Array, Array]:
    """Transfer function (…, n) of a measurement chain at omega : (n,) [rad/s], and its offset (…, 1).

    moved : values (…,) of the unknowns by name; effects without a value are not in the chain.
    """
    H, offset = np.ones(len(omega)), np.zeros(1)
    for effect in effects.ALL:
        if isinstance(effect, Sensor) and any(f"{channel}.{key}" in moved for key in effect.searched(channel)):
            own = {key: np.asarray(moved[f"{channel}.{key}"])[..., None] for key in effect.searched(channel)}
            H, offset = H * effect.transfer(own, omega), offset + effect.offset(own)
    return H, offset


def sense(member: Member, names: Sequence[str], X: Array, T: float, means: bool = True) -> Array:
    """The coefficients X : (n, m) after the measurement chains of a hypothesis.

    means : include offsets.
    """
    if not any(term.is_sensor for term in member.terms):
        return X
    moved = values(member.unknowns, member.x, {})
    omega, X = 2.0 * np.pi / T * np.arange(len(X)), X.copy()
    for i, name in enumerate(names):
        H, offset = chain(moved, name, omega)
        X[:, i] *= H
        X[0, i] += float(offset[0]) * means
    return X


def zeros_apart(member: Member, names: Sequence[str]) -> tuple[Member, Array | None]:
    """The member without the zeros of sensors, on which no simulation depends, and the changes (m,) of these of some
    channels; None if no zero is an unknown."""
    zeros = np.array([is_zero(u.name) for u in member.unknowns], bool)
    if not zeros.any():
        return member, None
    moved = values([u for u in member.unknowns if is_zero(u.name)], member.x[zeros], {})
    others = tuple(u for u in member.unknowns if not is_zero(u.name))
    changes = np.array([moved.get(zero_name(name), 0.0) for name in names])
    return replace(member, unknowns=others, x=member.x[~zeros]), changes


def inlet_sensor(member: Member) -> dict[str, float]:
    """The parameters of the inlet flow meter in a hypothesis."""
    found = values(member.unknowns, member.x, {}) if any(term.place == INFLOW for term in member.terms) else {}
    return {name: float(value) for name, value in found.items() if name.startswith(f"{INFLOW}.")}


def meter(member: Member, n: int, T: float) -> tuple[Array, float]:
    """Transfer function (n,) of the flow meter at the inlet at harmonics 0 … n - 1 of T [s], and its offset."""
    moved = {name: np.asarray(value) for name, value in inlet_sensor(member).items()}
    H, offset = chain(moved, INFLOW, 2.0 * np.pi / T * np.arange(n))
    return H, float(offset[0])


def driven(drive: Inflow, members: Sequence[Member]) -> Inflow:
    """The true inflow of each hypothesis if the flow meter showed ``drive``; that itself without meter faults."""
    if not any(map(inlet_sensor, members)):
        return drive
    H, offset = zip(*(meter(m, drive.X.shape[-1], drive.T) for m in members), strict=True)
    return drive.true(np.array(H), np.array(offset)[:, None])


def shown(member: Member, wave: Array, T: float) -> Inflow:
    """The reading of a hypothesis' flow meter for the flow (N,): the inverse of :func:`driven`."""
    X = np.fft.rfft(wave, norm="forward")
    X[-1] *= 1.0 if len(wave) % 2 else 0.5  # the Nyquist coefficient is its own conjugate
    H, offset = meter(member, len(X), T)
    X *= H
    X[0] += offset
    return Inflow(T, X, np.ones(len(X), bool))
