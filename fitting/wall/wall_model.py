"""The wall law as a function of its parameters: P(R, dR/dt; E, R0, φ0, φ_NL, E_NL) and its derivatives.

The terms are those of :mod:`solver.laws.wall`, so the fit uses the same law as the solver and the FMU.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from solver import loop
from solver.errors import InputError
from solver.laws.wall import Wall
from solver.laws.wall_laws import ELASTIC_LAWS, VISCOUS_LAWS, ElasticLaw, ViscousLaw
from solver.network.description import Segment
from solver.quantities.quantity import quantities

Array = np.ndarray
Values = Mapping[str, float]

PARAMETERS = ("E", "R0", "phi0", "phiNL", "ENL")
"""The parameters of a fit. A wall's values are these and ``h`` [m] and ``eta``, which are given."""

UNITS = {name: quantities(Segment)[name].unit for name in PARAMETERS}


@dataclass(frozen=True)
class WallModel:
    """The fitted law and its free parameters: names of :mod:`solver.laws.wall`, and a subset of ``PARAMETERS``.

    P = K (ε + e ε²)[/s] + K_h/s σ_v(ε̇) with s = R/R0, ε = s - 1, ε̇ = R'/R0 (`eq:general`, `sheep_pressure_radius`).
    """

    name: str
    elastic: str
    viscous: str
    free: tuple[str, ...]

    @property
    def elastic_law(self) -> ElasticLaw:
        return ELASTIC_LAWS[self.elastic]

    @property
    def viscous_law(self) -> ViscousLaw:
        return VISCOUS_LAWS[self.viscous]

    def without(self, name: str) -> WallModel:
        """The model with one parameter given instead of free."""
        return WallModel(self.name, self.elastic, self.viscous, tuple(p for p in self.free if p != name))


_LINEAR = ("E", "R0", "phi0")
_NONLINEAR = (*_LINEAR, "phiNL")


def model(name: str, elastic: str) -> WallModel:
    """One of the models below with an elastic law, ``beta`` or ``regression``. Raises ValueError for an unknown name.

    ``linear``: E, R0, φ0. ``nonlinear``: also φ_NL as in the paper (quadratic). ``extended``: also E_NL.
    ``monotone``: φ_NL in the monotone form φ0 (e^{2rε̇} - 1)/(2r), which has no negative viscosity.
    ``extended monotone``: also E_NL; on loops of a monotone wall, ``extended`` attributes the nonlinear viscosity to
    E_NL.
    """
    laws = {
        "linear": ("monotone", _LINEAR),  # without phiNL the two laws are one
        "nonlinear": ("quadratic", _NONLINEAR),
        "extended": ("quadratic", (*_NONLINEAR, "ENL")),
        "monotone": ("monotone", _NONLINEAR),
        "extended monotone": ("monotone", (*_NONLINEAR, "ENL")),
    }
    if name not in laws:
        raise InputError(f"model {name!r} is not known; use one of {', '.join(laws)}.")
    if elastic not in fitted_laws():
        raise InputError(
            f"elastic law {elastic!r}: no wall can be fitted with it; use one of {', '.join(fitted_laws())}."
        )
    viscous, free = laws[name]
    return WallModel(name, elastic, viscous, free)


def fitted_laws() -> tuple[str, ...]:
    """The elastic laws that a wall can be fitted with: those with the methods columns, solve and energy."""
    needed = ("columns", "solve", "energy")
    return tuple(name for name, law in ELASTIC_LAWS.items() if all(hasattr(law, each) for each in needed))


def columns(model: WallModel, R: Array, R_t: Array) -> Array:
    """The paper's matrix M : (…, N, p): [1, 1/R, R'/R, R'²/R] for the regression law and ``nonlinear``.

    The β-law has R in place of 1/R, ``extended`` one more column of the elastic law, ``linear`` no R'²/R.
    """
    elastic, law, rest = model.elastic_law.columns(R), model.viscous_law, np.zeros(1)
    viscous = (R_t / R * (2.0 * law.factor(rest) - law.slope(rest)), R_t * R_t / R * law.bend(rest))
    chosen = [*elastic[:2], *(elastic[2:] if "ENL" in model.free else ()), *viscous[: 1 + ("phiNL" in model.free)]]
    return np.stack(np.broadcast_arrays(*chosen), axis=-1)


def parameters_of(model: WallModel, C: Array, h: float, eta: float) -> dict[str, float]:
    """E, R0, φ0, φ_NL, E_NL, and h and eta as given, of the coefficients C of :func:`columns`.

    For the regression law C = [E h'/R0, -E h', φ0 h'/R0, φ_NL h'/R0²] with h' = h/(1-η²): the paper's vector C, with
    the 1/R0² that its last entry lacks.
    """
    bent = "ENL" in model.free
    c = np.array([C[0], C[1], C[2] if bent else 0.0])
    viscous = C[2 + bent :]
    K, R0, e = model.elastic_law.solve(c)
    E = K * R0 * (1.0 - eta**2) / h
    phi0 = viscous[0] * R0 * (1.0 - eta**2) / h
    phiNL = viscous[1] * R0 * R0 * (1.0 - eta**2) / h if len(viscous) > 1 else 0.0
    found = {"E": E, "R0": R0, "phi0": phi0, "phiNL": phiNL, "ENL": e * E, "h": h, "eta": eta}
    return {name: float(value) for name, value in found.items()}


@dataclass(frozen=True)
class Evaluated:
    """P : (N,) [Pa] on a loop; its derivatives by R, by R', and by each free parameter, (N, p)."""

    P: Array
    by_R: Array
    by_R_t: Array
    by_parameter: Array


def evaluate(model: WallModel, values: Values, R: Array, R_t: Array) -> Evaluated:
    """The pressure on a loop R, R' : (N,) and all its first derivatives."""
    w = wall(model, values)
    P, by_R, by_R_t = loop.tangent(w, R, R_t)
    s, rate = R / values["R0"], R_t / values["R0"]
    one = w.elastic.pressure(s, np.ones(()), np.zeros(()))
    two = w.elastic.pressure(s, np.ones(()), np.ones(())) - one
    x = w.r * rate
    by = {
        "E": w.K_h * one,
        "R0": -(P + R * by_R + R_t * by_R_t) / values["R0"],  # P is homogeneous of degree -1 in R, R' and R0
        "phi0": w.K_h / s * rate * (2.0 * w.viscous.factor(x) - w.viscous.slope(x)),
        "phiNL": w.K_h / s * rate * rate * w.viscous.bend(x),
        "ENL": w.K_h * two,
    }
    return Evaluated(P, by_R, by_R_t, np.stack([by[name] for name in model.free], axis=-1))


def relative_viscosity(model: WallModel, values: Values, R_t: Array) -> Array:
    """dσ_v/dε̇ / φ0 along a loop: if it is not positive, the equation is ill-posed and no wall can follow the law."""
    return model.viscous_law.slope(values["phiNL"] / values["phi0"] * R_t / values["R0"])


def wall(model: WallModel, values: Values, rho: float = 1060.0) -> Wall:
    """The fitted wall as the solver's :class:`solver.laws.wall.Wall` of one point."""
    E, R0, phi0, phiNL, ENL = (np.array(values[name]) for name in PARAMETERS)
    K_h = values["h"] / ((1.0 - values["eta"] ** 2) * R0)
    return Wall(
        elastic=model.elastic_law,
        viscous=model.viscous_law,
        A0=np.pi * R0**2,
        K=E * K_h,
        e=ENL / E,
        K_h=np.array(K_h),
        phi0=phi0,
        r=phiNL / phi0,
        P_ref=np.array(0.0),
        rho=np.array(rho),
        nonlinear=bool(phiNL != 0.0),
        bent=bool(ENL != 0.0),
    )
