"""Time of a repeating beat by harmonic balance, by NumPy and the engine, and of runs in time: a table, and JSON.

    python benchmarks/balance.py [--json FILE] [--small]

Sheep network, viscoelastic and elastic, a smooth inflow, batches of 1, 4, 16, 32 and 64 moduli; others, each under its
own inflow. CPU time of one thread, the best of several calls in one run; the first of the engine, which records, is not
among them. The error is that of a run in steps of 2.5 ms by NumPy, relative to the balance, of the worst harmonic of
P, Q and R at the sites. Nothing here is asserted: see tests/test_harmonics.py and tests/test_native_balance.py.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.table import JsonFile, Row, Small, best, show, start
from solver import Network, Settings, beat_harmonics, load, repeating_beat
from solver.network.inflow import Inflow

SHEEP = load("sheep")
ELASTIC = SHEEP.with_parameters({f"{s.name}.phi0": 0.0 for s in SHEEP.segments})
K, BATCHES = 20, (1, 4, 16, 32, 64)
STEPS = Settings(dt=2.5e-3)


def smooth(t: np.ndarray) -> np.ndarray:
    """The sheep's mean and its first ten harmonics, smoothed [m³/s]."""
    T = SHEEP.inlet.T
    X = np.fft.rfft(SHEEP.inlet.Q(T * np.arange(1024) / 1024.0), norm="forward")[:11]
    X *= np.exp(-((np.arange(11) / 6.0) ** 2)) * np.where(np.arange(11) > 0, 2.0, 1.0)
    return np.asarray((np.exp(2j * np.pi * np.outer(t / T, np.arange(11))) @ X).real)


def rows_of(name: str, network: Network, batches: tuple[int, ...], inflow: Inflow | None = None) -> list[Row]:
    """Both ways, of every batch. inflow : None, that of the network."""
    found, names = [], [f"{site.name}.{kind}" for site in network.sites for kind in "PQR"]
    first = network.segments[0]
    for B in batches:
        moduli = {f"{first.name}.E": first.E * np.linspace(0.9, 1.1, B)}
        X, native = (beat_harmonics(network, names, K, inflow, parameters=moduli, backend=b) for b in ("numpy", "auto"))
        beat = repeating_beat(network, inflow, parameters=moduli, settings=STEPS, backend="numpy")
        run = np.stack([np.fft.rfft(beat[n][:, :-1], norm="forward")[:, : K + 1] for n in names], axis=-1)
        error = float((np.abs(run - X) / np.abs(X[:, 1:]).max(axis=1, keepdims=True)).max())
        apart = float((np.abs(native - X) / np.abs(X).max(axis=1, keepdims=True)).max())
        balance, engine = (
            best(partial(beat_harmonics, network, names, K, inflow, parameters=moduli, backend=b), 5)
            for b in ("numpy", "auto")
        )
        in_time = best(partial(repeating_beat, network, inflow, parameters=moduli, settings=STEPS, backend="numpy"), 3)
        note = f"{in_time / balance:.1f} times as fast"
        found.append(Row(f"{name}, batch of {B}, balance", 1e3 * balance, "ms", None, note))
        note = f"{balance / engine:.1f} times as fast as NumPy; apart {apart:.0e}"
        found.append(Row(f"{name}, batch of {B}, balance, engine", 1e3 * engine, "ms", None, note))
        found.append(Row(f"{name}, batch of {B}, in time", 1e3 * in_time, "ms", None, f"off by {error:.1e}"))
    return found


def main(
    json_file: JsonFile = None,
    small: Small = False,
) -> None:
    """Measure and print."""
    batches = BATCHES[:1] if small else BATCHES
    rows = rows_of("sheep", SHEEP, batches, smooth) + rows_of("elastic", ELASTIC, batches, smooth)
    for name in () if small else ("human", "circle_of_willis", "adan56"):
        rows += rows_of(name, load(name), BATCHES[:1])
    show(rows, f"a beat that repeats, {K} harmonics, one thread", json_file)


if __name__ == "__main__":
    start(main)
