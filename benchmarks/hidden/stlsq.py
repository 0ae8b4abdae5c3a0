"""The comparator: the local wall law as sparse regression, by PySINDy's STLSQ, on the same bench records.

    P = c_1 + c_2 ε + c_3 ε² + c_4 ε̇/s + c_5 ε̇²/s + c_6 Ṗ,     s = R/R0, ε = s - 1

(P s for the law that has 1/s in it), every column and P standardised over 15 beats, R and P with their first eight
harmonics only, rates by Fourier series: better conditions than differences of noisy samples. (Of the variants tried on
tuning records, with 8, 10 or 15 harmonics, with or without ε ε̇, of beats or of their mean, this is among the best by
BIC.) What is selected beyond the terms of the base network is what STLSQ names. Its threshold is PySINDy's own, or of a
range the one that predicts the five held-out beats best, or that of the smallest BIC with n = samples. It knows no
sensors and cannot refuse, so that only nulls and wall effects are asked of it.

Brunton, Proctor and Kutz, PNAS 113, 2016, 3932; de Silva et al., JOSS 5, 2020, 2104 (PySINDy).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from fitting.records.alignment.align import align
from fitting.records.channels import spectral
from fitting.records.read.record import Record
from solver.network.description import Network
from tests.truth.records import FITTED, Case

Array = np.ndarray

METHODS = ("default", "held-out", "BIC")
COLUMNS = ("elasticity", "nonlinear_elasticity", "wall_viscosity", "nonlinear_wall_viscosity", "stress_relaxation")
WALL = ("wall_viscosity", "nonlinear_wall_viscosity", "nonlinear_elasticity", "stress_relaxation")

_BASE = {
    "elastic": {"elasticity"},
    "sheep": {"elasticity", "wall_viscosity"},
    "sheep_nonlinear": {"elasticity", "wall_viscosity", "nonlinear_elasticity", "nonlinear_wall_viscosity"},
}
_THRESHOLDS = np.logspace(-3.0, 0.0, 25)
_HARMONICS = 8


@dataclass(frozen=True)
class Regression:
    """Standardised columns (n, 5) and target (n,) of fitted and of held-out beats."""

    X: Array
    y: Array
    X_held: Array
    y_held: Array


def available() -> bool:
    """Whether PySINDy is installed (the extra ``test`` brings it)."""
    return find_spec("pysindy") is not None


def compared(record: Record, network: Network, case: Case) -> dict[str, list[str]] | None:
    """Per method the names that STLSQ adds to the base network; None where it is not asked, or not installed."""
    asked = all(e.name in WALL for e in case.effects) and len(case.effects) < 2
    if not asked or not available():
        return None
    regression = columns(record, network, case)
    found = {float(t): _coefficients(regression, float(t)) for t in _THRESHOLDS}
    chosen = {
        "default": _coefficients(regression, None),
        "held-out": min(found.values(), key=lambda c: _rms(regression.X_held @ c - regression.y_held)),
        "BIC": min(found.values(), key=lambda c: _bic(regression, c)),
    }
    base = _BASE[case.base]
    return {m: [n for n, c in zip(COLUMNS, chosen[m], strict=True) if c != 0.0 and n not in base] for m in METHODS}


def columns(record: Record, network: Network, case: Case) -> Regression:
    """The library of a bench record."""
    beats, site = align(record), case.channels
    P, R = (spectral.without_high(beats.values[f"{site}.{kind}"], _HARMONICS) for kind in "PR")
    R0 = network.segment(site).R0
    s, rate = R / R0, spectral.derivative(R, beats.T) / R0
    strain, inverse = s - 1.0, 1.0 if case.elastic_law == "regression" else 1.0 / s
    target = P * s if case.elastic_law == "regression" else P
    library = (strain, strain**2, rate * inverse, rate**2 * inverse, spectral.derivative(P, beats.T))
    stack = np.stack([*library, target], axis=-1)
    fitted = stack[:FITTED].reshape(-1, len(library) + 1)
    mean, spread = fitted.mean(axis=0), fitted.std(axis=0)
    fitted, held = (fitted - mean) / spread, (stack[FITTED:].reshape(-1, len(library) + 1) - mean) / spread
    return Regression(fitted[:, :-1], fitted[:, -1], held[:, :-1], held[:, -1])


def _coefficients(r: Regression, threshold: float | None) -> Array:
    """(5,) of STLSQ, refitted without its ridge; PySINDy's own threshold if there is none."""
    from pysindy.optimizers import STLSQ  # a second to import, and only here

    optimizer: Callable[..., Any] = STLSQ
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a large threshold selects nothing
        model = (optimizer() if threshold is None else optimizer(threshold=threshold)).fit(r.X, r.y[:, None])
    return np.asarray(model.coef_[0], float)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _bic(r: Regression, c: Array) -> float:
    n = len(r.y)
    return 2.0 * n * float(np.log(_rms(r.X @ c - r.y))) + np.count_nonzero(c) * float(np.log(n))
