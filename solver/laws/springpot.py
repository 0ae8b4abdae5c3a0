"""The fractional viscosity of a wall: a springpot, approximated by Maxwell elements with fixed rates."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ..quantities.quantity import Quantity
from .effect import Array, Effect, SearchSpec, Values
from .wall import Wall

REFERENCE = 10.0  # rad/s, where springpot and damper have equal magnitude: a typical heart rate
# Relaxation rates [Hz] that, with a damper, approximate (iω)^(a-1) for any order a from 0.05 to 0.95 within 0.5 % from
# 0.5 to 60 Hz. They minimise that error; the slowest acts as a spring at heart rates. Weights are positive for orders
# from 0.07; below, the weight of the slowest is negative, and it alone would release energy at 0.02 Hz.
RATES = 2.0 * np.pi * np.array([0.02, 0.26, 1.0, 4.2, 17.5, 90.0])
_TIMES = np.concatenate([1.0 / RATES, [0.0]])
_BAND = 2.0 * np.pi * np.geomspace(0.4, 75.0, 60)  # rad/s, over which the weights are fitted
_ELEMENTS = 1.0 / (1.0 + 1j * _BAND[:, None] * _TIMES)


def shares(a: Array) -> Array:
    """Weights g : (7, …) of Maxwell elements with Σ g_j/(1 + iωτ_j) = (iω/ω_r)^(a-1), 1/τ the RATES, and a damper last.

    a : (…) orders. By least squares of the relative error, which makes them smooth functions of a.
    """
    orders, place = np.unique(a, return_inverse=True)
    found = np.empty((len(_TIMES), len(orders)))
    for i, order in enumerate(orders):
        relative = _ELEMENTS / (1j * _BAND[:, None] / REFERENCE) ** (order - 1.0)
        rows = np.concatenate([relative.real, relative.imag])
        found[:, i] = np.linalg.lstsq(rows, np.repeat([1.0, 0.0], len(_BAND)), rcond=None)[0]
    return found[:, place.reshape(np.shape(a))]


class FractionalViscosity(Effect):
    """A springpot beside the damper. Source: R. L. Bagley, P. J. Torvik, A theoretical basis for the application of
    fractional calculus to viscoelasticity, J. Rheol. 27 (1983) 201."""

    name = "fractional_viscosity"
    equation = "φ0 iω ε becomes φ0 iω ε ((1 - w) + w (iω/ω_r)^(a-1)), ω_r = 10 rad/s"
    owner = "segment"
    places = ("all", "segment")
    terms = {
        "springpot": Quantity("1", "fraction w of the viscous stress from the springpot", 0.0, 1.0, nominal=0.3),
        "springpot_order": Quantity("1", "order a of the springpot (0 spring, 1 damper)", 0.0, 1.0, nominal=0.3),
    }
    neutral = {"springpot": 0.0, "springpot_order": 0.3}
    how = ("springpot_order",)
    needs = "phi0"
    remembers = True
    search = SearchSpec(
        typical={"springpot": 0.3, "springpot_order": 0.2},
        starts=tuple(product((0.3, 1.0, 2.0), (-1.0, 0.0, 1.0, 2.0))),
        local=True,
    )
    signature = "loss nearly independent of frequency; dynamic stiffness grows slowly with frequency"
    confusable = ("stress_relaxation", "wall_viscosity")
    separator = "a second heart rate"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        w = values["springpot"]
        tau, share = wall.elements
        more = shares(values["springpot_order"])
        times = np.broadcast_to(_TIMES[:, None, None], more.shape)
        return replace(wall, tau=np.concatenate([tau, times]), share=np.concatenate([share * (1.0 - w), w * more]))
