"""The share of the gap that acts at a place, against records with known sources; phases of a beat in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forked import CHANNELS, NETWORK, N, T, inflow, record

from discrepancy.findings.shown_map import gap_shares, main_phase, phases_of
from fitting.inference.models.network_record import network_problem
from fitting.inference.places import Place, places
from fitting.inference.source_maps.source_map import Signal, SourceMap
from solver import beat_harmonics

ML, K = 1e-6, 6


def acting(kind: str, name: str, size: float, turn: float) -> Signal:
    """A wave of one harmonic at a place of one source [SI]."""
    place: Place = next(p for p in places(NETWORK, CHANNELS, ()) if p.key == (kind, name, None))
    g = np.zeros((K + 1, 1), complex)
    g[1] = 0.5 * size * np.exp(1j * turn)
    return Signal(place, g, np.zeros((K + 1, 1)))


LEAK, OUTLET = acting("outflow", "B", 2.0 * ML, 0.3), acting("outlet", "C", 1.0 * ML, 2.0)


def shares_of(*signals: Signal) -> tuple[float, ...]:
    """Of a record in which LEAK and OUTLET act, by a map with these, the walls as they are."""
    sources = [source for s in (LEAK, OUTLET) for source in s.place.sources]
    g = np.concatenate([LEAK.g, OUTLET.g], axis=1)
    X = beat_harmonics(NETWORK, CHANNELS, N // 2 - 1, inflow, T, tolerance=1e-10, more=N, sources=sources, amplitudes=g)
    waves = dict(zip(CHANNELS, np.fft.irfft(X[0], N, axis=0, norm="forward").T, strict=True))
    problem = network_problem(
        record({"inlet.Q": inflow(np.arange(N) * (T / N)), **waves}, noise=1e-3), NETWORK, CHANNELS
    )
    unknowns = problem.hypothesis(())
    x, J = np.zeros(len(unknowns)), np.zeros((K + 1, 1, len(unknowns)))
    return gap_shares(problem, SourceMap(signals, unknowns, x, 0.0, 0.0, 1, (), J))


def test_shares_add_up() -> None:
    """Both places take all of it, to 2e-3; half of each wave is half of its share: the response is linear to 2 %."""
    both = shares_of(LEAK, OUTLET)
    assert min(both) > 0.02 and sum(both) == pytest.approx(1.0, abs=2e-3)
    halves = shares_of(*(replace(s, g=0.5 * s.g) for s in (LEAK, OUTLET)))
    assert halves == pytest.approx([0.5 * share for share in both], rel=0.02)
    assert shares_of(LEAK) == pytest.approx(both[:1], rel=1e-9)
    assert shares_of() == ()


def test_phases_of_a_half_sine() -> None:
    """Flow sin(πt/0.3) for 0.3 of a beat, turned anywhere: 0.1 of the peak at 0.0096 and 0.2904, half of it at 0.25."""
    t = np.arange(1000) / 1000.0
    flow = np.where(t < 0.3, np.sin(np.pi * t / 0.3), 0.0)
    ends = {"early systole": (0.0096, 0.15), "mid systole": (0.15, 0.25), "late systole": (0.25, 0.2904)}
    for turn in (0, 700, 850):
        found = {name: np.roll(there, -turn) for name, there in phases_of(np.roll(flow, turn)).items()}
        assert np.all(sum(there.astype(int) for there in found.values()) == 1)
        for name, (begin, end) in ends.items():
            assert (t[found[name]].min(), t[found[name]].max()) == pytest.approx((begin, end), abs=1.5e-3)
    late = np.where((t > 0.26) & (t < 0.31), 1.0, 0.0)
    name, part = main_phase(late, flow)
    assert name == "late systole" and part == pytest.approx(0.0304 / 0.05, abs=0.03)
    back = phases_of(flow - np.where((t > 0.3) & (t < 0.34), 0.3, 0.0))  # flow that returns is no systole
    assert t[back["late systole"]].max() == pytest.approx(0.2904, abs=1.5e-3)
