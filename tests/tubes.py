"""Single tubes with simple loads, and what the textbook says of them."""

from __future__ import annotations

import numpy as np

from solver import transmission
from solver.laws.outlets import Outlet
from solver.linear import solve
from solver.network.coefficients import coefficients
from solver.network.description import Fluid, Inlet, Network, Segment, Site

RHO = 1060.0
INVISCID = Fluid(rho=RHO, nu=0.0)
VISCOUS = Fluid(rho=RHO)
OMEGA = 2.0 * np.pi * np.array([0.5, 2.0, 6.0, 20.0, 60.0])


def artery(name: str = "A", L: float = 0.2, phi0: float = 0.0, R0: float = 9e-3, h: float = 1e-3) -> Segment:
    return Segment(name, L=L, R0=R0, h=h, E=7e5, phi0=phi0)


def tube(
    segment: Segment, outlet: Outlet, fluid: Fluid = INVISCID, positions: tuple[float, ...] = (0.5,), **more: float
) -> Network:
    """One artery with sites x0, x1, … at the positions."""
    sites = tuple(Site(f"x{i}", segment.name, position) for i, position in enumerate(positions))
    return Network("tube", (segment,), Inlet(segment.name), outlets=(outlet,), sites=sites, fluid=fluid, **more)


def speed(s: Segment) -> float:
    return float(np.sqrt(2.0 * s.E * s.h / (3.0 * RHO * s.R0)))


def area(s: Segment) -> float:
    return np.pi * s.R0**2


def impedance(s: Segment) -> float:
    return RHO * speed(s) / area(s)


def inlet_impedance(network: Network, omega: np.ndarray = OMEGA) -> np.ndarray:
    return solve(network, np.ones_like(omega), omega).P_node[0]


def propagation(network: Network, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """γ = √(Z'Y') [1/m] and Z_c = √(Z'/Y') [Pa·s/m³] in the middle of every segment : (n_segments, n), as solved."""
    c = coefficients(network)
    n = c.L.shape[1]
    places, which = transmission.Places.of(network, c, np.arange(n), np.full(n, 0.5))
    own = np.arange(len(places.x))
    Z, Y, _ = transmission.line(places, places.c.wall_at(own, places.x), own, places.x, omega)
    return np.sqrt(Z * Y)[which[0]], np.sqrt(Z / Y)[which[0]]


def line(s: Segment, omega: np.ndarray = OMEGA) -> tuple[np.ndarray, np.ndarray]:
    """γ = (iω/c0) √((1 + C_f/(iωA0))/(1 + iωτ)) and Z_c = Z0 √((1 + C_f/(iωA0))(1 + iωτ)), by the paper's symbols."""
    friction = 1.0 + 22.0 * np.pi * VISCOUS.nu / (1j * omega * area(s))
    wall = 1.0 + 1j * omega * s.phi0 / s.E
    return 1j * omega / speed(s) * np.sqrt(friction / wall), impedance(s) * np.sqrt(friction * wall)
