"""More than the catalogue holds: partial answers of a network."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from forked import NETWORK, N, T, inflow, record
from small_network import NAMES, term, terms

from discrepancy import thresholds as at
from discrepancy.name.intervals import stated
from discrepancy.name.model_selection import name
from discrepancy.name.verdict import Naming
from fitting.inference.extended_network import estimates
from fitting.inference.fit import Fit
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.network_record import network_problem
from solver import Settings, simulate_periodic
from solver.laws.effects import BY_NAME

KNOWN = ("wall_stiffness", "channel_gain", "terminal_reflection")  # all that is searched for

# --- a stenosis that nobody looks for ---------------------------------------------------------------------------------


@cache
def problem(K: float) -> NetworkProblem:
    """B 25 % stiffer and a stenosis in C, by the same solver on half the elements; 40 dB."""
    hidden = BY_NAME["stenosis"].add(NETWORK.with_parameters({"B.E": 1.25 * 9e5}), "C", {"K": K})
    settings = Settings(dt=T / 200, element_length=Settings().element_length / 2.0, tolerance=1e-7)
    beat = simulate_periodic(hidden, inflow, T, settings=settings, tolerance=1e-6)
    X = {n: np.fft.rfft(beat[n][:-1], norm="forward")[: N // 2 + 1] for n in ("inlet.Q", *NAMES)}
    return network_problem(record({n: np.fft.irfft(x, N, norm="forward") for n, x in X.items()}, 15, 0.01), NETWORK)


def named(K: float) -> Naming:
    return name(problem(K), terms(*KNOWN), walls="common")


@pytest.mark.deep
def test_a_stiff_wall_beside_what_is_in_no_catalogue() -> None:
    """K = 3: the stiff wall is named, and that more remains, most of it at the stenosis, which the free terms beside it
    find. The interval is thirteen times as wide as by noise alone, and holds the truth: 1.250 ± 0.020 for 1.25. With
    errors of every channel by itself it was 1.217 ± 0.023."""
    naming = named(3.0)
    assert (naming.verdict, naming.best.label) == ("partial", "wall_stiffness at B")
    assert [n.label for n in naming.members] == ["wall_stiffness at B"]
    assert naming.reason is not None and naming.reason.startswith("whitened RMS 3.") and "most in C.P" in naming.reason
    assert "a drop of pressure in C at x/L = 0.5" in naming.reason
    assert at.PART_CLOSED < naming.confidence < 0.67
    (plain,) = problem(3.0).refit([(term("wall_stiffness", "B"),)])
    assert plain is not None
    low, high = stated(NETWORK, naming, naming.best, naming.best.fit.terms[0])["B.E_scale"].ci95
    assert low < 1.25 < high and 0.5 * (low + high) == pytest.approx(1.2495, abs=0.0005)
    assert high - low == pytest.approx(13.2 * np.ptp(scale_of(plain)), rel=0.1)


def scale_of(fit: Fit) -> tuple[float, float]:
    """The 95 % interval of the stiffness of B."""
    return estimates(NETWORK, fit, fit.terms[0], 1.96)["B.E_scale"].ci95


@pytest.mark.deep
def test_where_more_than_half_remains_nothing_is_named() -> None:
    """K = 30, ten times as much: what comes nearest closes less than half of the gap."""
    naming = named(30.0)
    assert (naming.verdict, naming.members) == ("unknown", ())
    assert naming.reason is not None and "comes nearest, but more remains" in naming.reason
