"""Indices of a calibrated network: the fork of tests/forked.py, 40 dB on every channel, 15 beats."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from forked import CHANNELS, NETWORK, SETTINGS, T, exact, record
from rich.console import Console

from arterial_fmu.cli.tables.fits import network_indices_table
from fitting.calibrate.network_calibration import Calibration, calibrate
from fitting.calibrate.network_indices import indices_at, network_indices
from fitting.records.alignment.beats import Beats
from fitting.records.channels.inflow import inflow
from fitting.records.channels.spectral import derivative
from fitting.results.estimate import Estimate
from fitting.wall.indices import OF_LAW, plain
from solver import simulate_periodic

START = NETWORK.with_parameters({f"{s.name}.E": 1.2 * s.E for s in NETWORK.segments})


@cache
def calibrated() -> tuple[Calibration, Beats, dict[str, dict[str, Estimate]]]:
    channels = [name for name in CHANNELS if name != "C.R"]
    beats = record({name: exact()[name] for name in ("inlet.Q", *channels)}, 15, 0.01, 1)
    found = calibrate(beats, START, ["all.E", "A.E", "all.phi0", "B.R0", "C.outlet.R_t"], settings=SETTINGS)
    return found, beats, network_indices(found, START, beats, SETTINGS)


@pytest.mark.parametrize("site", ["A", "B", "C"])
def test_direct_formulas(site: str) -> None:
    """β-law K ε with K = E h/((1-η²) R0), of the calibrated network simulated by itself: all by hand.

    E_inc = E (R/R0)², dP/dR = K/R0, D = 2/(R dP/dR), dA/dP = A D, c = 1/√(ρ D) at the mean radius: to
    1e-8 (7e-9 measured: time stepping here, harmonic balance there).
    The energy lost is the viscous one, ∫ φ0 K_h/2 (∂A/∂t)²/A dt with the spectral ∂A/∂t: to 3e-4 (2.4e-4
    measured).
    """
    calibration, beats, found = calibrated()
    network = calibration.parameter_set().apply(START)
    beat = simulate_periodic(network, inflow(beats, SETTINGS.dt), T, settings=SETTINGS, tolerance=1e-6)
    wall, radius = network.segment(site), beat[f"{site}.R"][:-1]
    R, A = radius.mean(), np.pi * radius**2
    K_h = wall.h / (0.75 * wall.R0)
    slope = wall.E * K_h / wall.R0
    D = 2.0 / (R * slope)
    by_hand = {
        "E_inc": wall.E * (R / wall.R0) ** 2,
        "distensibility": D,
        "compliance": np.pi * R**2 * D,
        "wave_velocity": 1.0 / np.sqrt(network.fluid.rho * D),
        "relaxation_time": wall.phi0 / wall.E,
    }
    for name, value in by_hand.items():
        assert found[site][name].value == pytest.approx(value, rel=1e-8), name
    loss = T * np.mean(wall.phi0 * K_h / 2.0 * derivative(A, T) ** 2 / A)
    assert found[site]["loss"].value == pytest.approx(loss, rel=3e-4)


def test_delta_method_against_sampling() -> None:
    """Half-widths equal those of 100 sets of unknowns, each simulated, to 1e-4 (4e-5 measured).

    The sets are normal and then moved and turned so that their mean and covariance are the calibration's own: what
    is left is the curvature of the indices and the step of the derivatives.
    """
    calibration, beats, found = calibrated()
    z = np.random.default_rng(0).normal(size=(100, len(calibration.x)))
    z -= z.mean(axis=0)
    z = np.linalg.solve(np.linalg.cholesky(np.cov(z.T)), z.T).T
    x = calibration.x + z @ np.linalg.cholesky(calibration.covariance).T
    sd = indices_at(x, calibration, START, beats, SETTINGS).std(axis=0, ddof=1)
    for i, site in enumerate("ABC"):
        for j, (name, _) in enumerate(OF_LAW):
            low, high = found[site][name].ci95
            assert (high - low) / 2.0 == pytest.approx(calibration.quantile * sd[i, j], rel=1e-4), (site, name)


def test_truth_and_measured_loss() -> None:
    """The indices of the network that made the record lie within the intervals (this seed), and so do measured losses.

    loss_measured is there where the record has P and R: not at C.
    """
    calibration, beats, found = calibrated()
    own = calibrate(record(exact()), NETWORK, ["all.E"], settings=SETTINGS)
    truth = network_indices(own, NETWORK, record(exact()), SETTINGS)
    for site, values in found.items():
        for name, estimate in values.items():
            assert estimate.ci95[0] <= truth[site][name].value <= estimate.ci95[1], (site, name)
    assert [site for site, values in found.items() if "loss_measured" in values] == ["A", "B"]


def test_written_and_shown() -> None:
    """JSON holds value, unit and interval of every index; the table has a line a site, a dash where there is none."""
    _, _, found = calibrated()
    data = json.loads(json.dumps({site: plain(values) for site, values in found.items()}))
    assert data["A"]["E_inc"] == {
        "value": found["A"]["E_inc"].value,
        "unit": "Pa",
        "ci95": list(found["A"]["E_inc"].ci95),
    }
    table = network_indices_table("fork", found)
    lines = io.StringIO()
    Console(file=lines, width=80).print(table)
    assert not re.search(r"±\s*│", lines.getvalue())  # no number is wrapped
    assert "velocity" in lines.getvalue() and "relax-" in lines.getvalue()
    assert [list(column.cells)[2] for column in table.columns][-1] == "–"
    assert list(table.columns[0].cells) == ["A", "B", "C"]
    E = found["B"]["E_inc"]
    half = (E.ci95[1] - E.ci95[0]) / 2.0
    assert list(table.columns[1].cells)[1] == f"{1e-6 * E.value:.4f}\n±{1e-6 * half:.2g}"
    fixed = network_indices_table("fork", {"A": {"E_inc": replace(E, ci95=(E.value, E.value))}})
    assert list(fixed.columns[1].cells) == [f"{1e-6 * E.value:.4f}\n(given)"]


def test_refused_in_one_sentence() -> None:
    """The network with the calibrated values, from which x would be counted twice; other laws; no inflow."""
    calibration, beats, _ = calibrated()
    with pytest.raises(ValueError, match=r"network fork: with it, A\.E of the calibration of fork is .* instead of "):
        network_indices(calibration, calibration.parameter_set().apply(START), beats, SETTINGS)
    with pytest.raises(ValueError, match=r"network fork: its laws \(regression, quadratic\) are not those of the cal"):
        network_indices(calibration, replace(START, elastic_law="regression"), beats, SETTINGS)
    dry = record({name: exact()[name] for name in CHANNELS})
    with pytest.raises(ValueError, match=r"inlet\.Q"):
        network_indices(calibration, START, dry, SETTINGS)
