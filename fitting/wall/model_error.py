"""The error of a wall law: a random error of P of equal size at every harmonic, estimated from the residual of the fit.

A law that misses the loop by many times the noise cannot be weighted by the noise: the harmonics that the sensors
happen to measure best would decide. So the error of the law joins the noise, estimated by restricted maximum likelihood
(:mod:`fitting.inference.model_discrepancy`), alternating with the fit, as in a network
(:mod:`fitting.inference.joint.model_error`). It is 0 if the law leaves only noise, and unless it explains the residual
decidedly better than noise that is a common factor larger than the scatter between the beats tells, as with gaps; then
the covariance is multiplied by χ²/dof.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..inference.fit import Fit
from ..inference.joint.model_error import CHANCE
from ..inference.model_discrepancy import Block, estimated, settled, widened, worst_octave
from ..inference.models.loop import Loop
from ..records.channels import spectral
from .elastic_law import DECIDED
from .errors_in_variables import Solution, solve, whitened
from .wall_model import WallModel

MISSED = 1e-5  # of the pulse: a smaller residual of a noise-free loop is that of its integration
# Largest factor of the variance of the noise: of 40 recordings of 15 beats with gaps, where a twentieth of the beat was
# measured once, the law being right, χ²/dof is 2.0 (median) and 3.1 (largest), and none has a model error
_MISJUDGED = 4.0
_ALTERNATIONS = 12  # of fit and error estimate, at most
_SAME = 1e-2  # relative change of the error that is negligible


def with_model_error(loop: Loop, model: WallModel, found: Solution, lag_free: bool) -> Loop:
    """The loop with the model error that a solution ``found`` by the noise alone calls for; as given if it is 0.

    Raises NoFit as :func:`fitting.wall.errors_in_variables.solve`.
    """
    dof, pulse, wide = loop.N - len(found.covariance), float(np.std(loop.P)), loop
    if found.chi2 < dof + CHANCE * math.sqrt(2.0 * dof):
        return loop
    for _ in range(_ALTERNATIONS):
        fit, white = whitened(loop, model, found)
        each = [Block(np.arange(loop.N), pulse * white, np.zeros(loop.N, int))]
        share = estimated(fit, each, 1)
        # the first error must be decidedly more probable than misjudged noise
        if not wide.model_error and (
            share[0] < MISSED or not _scaled(fit) - _cost(widened(fit, each, share)) > 2.0 * DECIDED
        ):
            return loop
        error = float(share[0]) * pulse / math.sqrt(loop.N)
        if abs(error - wide.model_error) <= _SAME * error:
            break
        wide = replace(loop, model_error=error)
        found = solve(wide, model, found.values, lag=found.lag if lag_free else None)
    return wide


def _cost(fit: Fit) -> float:
    """-2 ln of the restricted likelihood of a linear problem at its minimum, up to a constant."""
    return fit.chi2 + fit.log_volume + float(np.linalg.slogdet(fit.J.T @ fit.J)[1])


def _scaled(fit: Fit) -> float:
    """The same with all noise multiplied by its most probable factor."""
    best, dof = settled(fit), len(fit.z) - len(fit.x)
    factor = min(best.chi2 / dof, _MISJUDGED)
    return _cost(best) + best.chi2 * (1.0 / factor - 1.0) + dof * math.log(factor)


def widening(loop: Loop, found: Solution) -> float:
    """Factor by which the covariance of a solution is too small: χ²/dof by the noise alone; with a model error that of
    the worst octave."""
    dof = loop.N - len(found.covariance)
    if not loop.model_error:
        return max(1.0, found.chi2 / dof)
    k = np.abs(np.fft.fftfreq(loop.N, 1.0 / loop.N)).round().astype(int)
    ratio = (np.abs(spectral.coefficients(found.residual)) / found.expected)[k] ** 2
    return max(1.0, worst_octave(ratio * loop.N / dof, k))
