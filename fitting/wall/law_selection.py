"""Selection of the elastic law by the evidence of a record.

Every law is fitted to the same loop. By Laplace's approximation its evidence is

    -2 ln p(loop | law) = Σ z²/c - ln det S,

with the whitened residual z of the harmonics above their noise, and the covariance S of ln E, ln R0, ln φ0, φ_NL/φ0 and
E_NL/E, whose priors are flat and the same for all laws. The true radius has Jeffreys' prior, uniform along the loop in
units of the noise of both channels, so ln det V does not enter. With a flat prior of the radius it would enter, and
with one of the pressure its negative; either would favour a law for its effect on harmonics that contain only noise.

c is 1 if a law describes the loop, otherwise the mean of z² of the best one (quasi-likelihood; R. W. M. Wedderburn,
Biometrika 61 (1974) 439). The misfit of the best law beyond noise is added to c: it is a single error, however many
harmonics it affects, and a law may have absorbed only a part of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from solver.network.description import Segment
from solver.quantities.quantity import quantities

from ..records.channels import spectral
from .elastic_law import MISFIT, LawEvidence
from .wall_fit import WallFit

_ABOVE_NOISE = 4.0  # standard deviations: threshold for harmonics of P and R


def weighing_model(name: str) -> str:
    """The model for the comparison of laws, with φ_NL free, because missing nonlinear viscosity resembles a nonlinear
    elastic law."""
    return "extended monotone" if name.startswith("extended") else "monotone"


def evidence(fits: Sequence[WallFit], refused: Sequence[str] = ()) -> LawEvidence:
    """The evidence from fits of one loop, one per law. refused : laws without a fit."""
    missed, dof = min(map(_missed, fits)), 2 * _harmonics(fits[0]) + 1 - len(fits[0].model.free)
    c = max(1.0, missed / dof) + max(0.0, missed - float(chdtri(dof, MISFIT)))
    ln = {f.model.elastic: -0.5 * (_missed(f) / c - _log_volume(f)) for f in fits}
    best = max(ln.values())
    return LawEvidence({law: x - best for law, x in ln.items()}, tuple(refused))


def _harmonics(fitted: WallFit) -> int:
    """K, the last harmonic with both P and R above their noise; at least enough to fit the wall."""
    loop = fitted.loop
    sizes = (np.abs(spectral.coefficients(x)) for x in (loop.P, loop.R))
    noise = (np.sqrt(loop.noise[:, i, i].real) for i in (0, 1))
    above = (np.flatnonzero(x > _ABOVE_NOISE * sd) for x, sd in zip(sizes, noise, strict=True))
    return max(len(fitted.model.free), min(int(k.max(initial=0)) for k in above))


def _missed(fitted: WallFit) -> float:
    """Σ z² up to harmonic K."""
    k, size, expected = fitted.residual_spectrum()
    z2 = np.where(k, 2.0, 1.0) * (size / expected) ** 2
    return float(z2[: _harmonics(fitted) + 1].sum())


def _log_volume(fitted: WallFit) -> float:
    """ln det S."""
    free, values = fitted.model.free, fitted.values
    scale = np.ones(len(fitted.solution.covariance))  # a lag, which is last, has one unit for all laws
    scale[: len(free)] = [values[quantities(Segment)[name].ratio_to or name] for name in free]
    return float(np.linalg.slogdet(fitted.solution.covariance / np.outer(scale, scale))[1])
