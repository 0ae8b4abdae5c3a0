"""Observed order of convergence on the sheep network with a smooth inflow, by self-convergence at fixed settings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from compare import relative_error

from solver import Network, Settings, Waveforms, simulate

SITES = tuple(f"{site}.{kind}" for site in ("MD", "CA") for kind in "PQR")


def inflow(t: np.ndarray) -> np.ndarray:
    """55 mL/s sin⁴: four continuous derivatives at the start."""
    return 55e-6 * np.sin(2.0 * np.pi * t / 0.5) ** 4


def _run(sheep: Network, dt: float, length: float, degree: int) -> Waveforms:
    return simulate(sheep, inflow, 0.24, settings=Settings(dt, length, degree, 1e-10), backend="auto")


def _error(names: tuple[str, ...], result: Waveforms, fine: Waveforms) -> float:
    every = round((len(fine.time) - 1) / (len(result.time) - 1))
    return max(relative_error(name, result[name], fine[name][::every]) for name in names)


def _orders(errors: list[float]) -> np.ndarray:
    return np.log2(np.array(errors[:-1]) / errors[1:])


def test_order_in_time(sheep: Network) -> None:
    """dt 2, 1, 0.5 ms against 0.125 ms: order 3 within 0.3 at MD and CA; 2 to 2.5 for the inlet pressure."""
    fine = _run(sheep, 1.25e-4, 0.05, 3)
    runs = [_run(sheep, dt, 0.05, 3) for dt in (2e-3, 1e-3, 5e-4)]
    orders = _orders([_error(SITES, run, fine) for run in runs])
    assert np.all(np.abs(orders - 3.0) <= 0.3), orders
    orders = _orders([_error(("inlet.P",), run, fine) for run in runs])
    assert np.all((orders >= 1.9) & (orders <= 2.5)), orders


@pytest.mark.parametrize(("degree", "expected"), [(1, 2.0), (2, 3.0), (3, 4.0)])
def test_order_in_space(sheep: Network, degree: int, expected: float) -> None:
    """Elements of 5, 2.5, 1.25 cm at one dt against degree 5: order N + 1 within 0.5 at MD and CA."""
    fine = _run(sheep, 1e-3, 0.0125, 5)
    errors = [_error(SITES, _run(sheep, 1e-3, length, degree), fine) for length in (0.05, 0.025, 0.0125)]
    assert np.all(np.abs(_orders(errors) - expected) <= 0.5), (errors, _orders(errors))


def test_orders_in_elastic_walls(sheep: Network) -> None:
    """Damping leaves what elements resolve: order 4 in space (4.02) and 3 in time, within 0.3."""
    walls = replace(sheep, segments=tuple(replace(s, phi0=0.0) for s in sheep.segments))
    fine = _run(walls, 1e-3, 0.0125, 5)
    orders = _orders([_error(SITES, _run(walls, 1e-3, length, 3), fine) for length in (0.05, 0.025)])
    assert np.all(np.abs(orders - 4.0) <= 0.3), orders
    fine = _run(walls, 1.25e-4, 0.05, 3)
    orders = _orders([_error(SITES, _run(walls, dt, 0.05, 3), fine) for dt in (2e-3, 1e-3, 5e-4)])
    assert np.all(np.abs(orders - 3.0) <= 0.3), orders
