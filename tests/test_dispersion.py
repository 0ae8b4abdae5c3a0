"""Phase velocity and attenuation in a single tube against the dispersion relation."""

from __future__ import annotations

import numpy as np
import pytest

from solver import Fluid, Inlet, Network, Reflection, Segment, Settings, Site, simulate_periodic

L, R0, H, E, PHI0, RHO, NU = 0.4, 8e-3, 1e-3, 8e5, 1.2e4, 1060.0, 3.5e-6
T = 0.25
OMEGA = 2.0 * np.pi / T


def _tube(phi0: float) -> Network:
    sites = tuple(Site(f"x{i}", "tube", 0.25 * (i + 1)) for i in range(3))
    segment = Segment("tube", L, R0, H, E, phi0)
    return Network("tube", (segment,), Inlet("tube"), (), (Reflection("tube", 0.5),), sites, Fluid(RHO, NU))


def _exact(phi0: float) -> complex:
    """γ = √(Z'Y'), Z' = (ρ/A)(iω + 22πν/A), Y' = iω/(dP/dA + iω ν_s), written out anew here."""
    A = np.pi * R0**2
    stiffness = E * H / (0.75 * R0) / (2.0 * A)
    nu_s = phi0 * H / (0.75 * R0) / (2.0 * A)
    Z = RHO / A * (1j * OMEGA + 22.0 * np.pi * NU / A)
    return complex(np.sqrt(Z * 1j * OMEGA / (stiffness + 1j * OMEGA * nu_s)))


def _measured(phi0: float, settings: Settings) -> complex:
    """γ from three equidistant pressures: cosh γd = (P1 + P3)/(2 P2), whatever the reflections."""
    beat = simulate_periodic(
        _tube(phi0), lambda t: 1e-9 * np.sin(OMEGA * t), T, settings=settings, tolerance=1e-8, max_beats=200
    )
    P = [np.fft.rfft(beat[f"x{i}.P"][:-1])[1] for i in range(3)]
    return complex(np.arccosh((P[0] + P[2]) / (2.0 * P[1])) / (0.25 * L))


@pytest.mark.parametrize("phi0", [PHI0, 0.0])
def test_velocity_and_attenuation(phi0: float) -> None:
    """Default settings, 4 Hz: phase velocity ω/Im γ and attenuation Re γ to 1e-6 (4.5e-7 measured)."""
    measured, exact = _measured(phi0, Settings(tolerance=1e-8)), _exact(phi0)
    assert OMEGA / measured.imag == pytest.approx(OMEGA / exact.imag, rel=1e-6)
    assert abs(measured.real - exact.real) <= 1e-6 * abs(exact)


def test_order_in_space() -> None:
    """Staggered finite volumes (degree 1), cells halved twice: the error of γ falls at order 2 within 0.1."""
    exact = _exact(PHI0)
    errors = [abs(_measured(PHI0, Settings(1e-3, length, 1, 1e-9)) - exact) for length in (0.05, 0.025, 0.0125)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 2.0) <= 0.1), (errors, orders)


def test_order_in_time() -> None:
    """Steps halved twice: the error of γ falls at order 3 within 0.3."""
    exact = _exact(PHI0)
    errors = [abs(_measured(PHI0, Settings(dt, 0.05, 5, 1e-10)) - exact) for dt in (T / 32, T / 64, T / 128)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 3.0) <= 0.3), (errors, orders)
