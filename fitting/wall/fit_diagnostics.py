"""Warnings about the fit of a wall, one sentence each, and their thresholds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import chdtrc, ndtri

from solver.network.doubts import THIN, more_than_thin
from solver.quantities.units import MMHG

from .elastic_law import MISFIT
from .errors_in_variables import MISSED
from .wall_fit import WallFit
from .wall_model import relative_viscosity

COLLINEAR = 300.0  # condition number of the columns above which the fit warns
USUAL_E = (5e4, 5e7)  # Pa, of arteries, generously
LOOSE, LOOSE_WITH_LAG = 0.1, 0.04  # of φ0: for a larger standard deviation the problem is nonlinear within the interval
NEAR_THE_TURN = 0.25  # of φ0: below this viscosity of the quadratic law, second order is insufficient
NOISE_BIAS = 1e-3  # of a value: a smaller bias by the noise of R gets no sentence


def doubts(fitted: WallFit) -> tuple[str, ...]:
    """The sentences that apply to a fit, each starting with its site."""
    checks = (_law, _unusual, _thick, _viscosity, _collinear, _noise_of_R, _misfit, _undetermined, _loose)
    return tuple(f"{fitted.site}: {text}" for check in checks for text in check(fitted))


def _law(fitted: WallFit) -> Iterator[str]:
    if fitted.evidence is not None and not fitted.evidence.decided:
        E = " and ".join(f"{1e-6 * f.values['E']:.4g} MPa by the {f.model.elastic} law" for _, f in fitted.laws)
        yield f"E is {E}: the data cannot distinguish the laws; E_inc hardly depends on the law."


def _unusual(fitted: WallFit) -> Iterator[str]:
    E, (low, high) = fitted.values["E"], USUAL_E
    if not low <= E <= high:
        yield f"E = {E:.3g} Pa is not that of an artery ({low:g} to {high:g} Pa); check the units of P, R and h."


def _thick(fitted: WallFit) -> Iterator[str]:
    """Of h/R0 beyond that of a thin wall, with (ΔP/ΔR) at the inner radius."""
    x = fitted.values["h"] / fitted.values["R0"]
    if x > THIN:
        yield (
            f"h is {x:.2g} of R0, no thin wall: E and E_inc, which are those of the thin-wall law, are "
            f"{1.0 - 1.0 / more_than_thin(x):.0%} below the modulus of the material."
        )


def _viscosity(fitted: WallFit) -> Iterator[str]:
    R_t = fitted.solution.R_t
    lowest = float(np.min(relative_viscosity(fitted.model, fitted.values, R_t)))
    if lowest <= NEAR_THE_TURN and fitted.model.viscous != "monotone":
        rate = float(np.max(np.abs(R_t)) / fitted.values["R0"])
        limit = abs(fitted.values["phi0"] / (2.0 * fitted.values["phiNL"]))
        yield (
            f"the loop {'leaves' if lowest <= 0.0 else 'nearly leaves'} the range of the quadratic phiNL: "
            f"strain rates reach {rate:.2g} /s and its viscosity turns negative at {limit:.2g} /s; fit the monotone "
            "model."
        )


def _collinear(fitted: WallFit) -> Iterator[str]:
    if fitted.condition > COLLINEAR:
        yield (
            f"the columns are nearly collinear (condition number {fitted.condition:.0f}, warned above "
            f"{COLLINEAR:g}): the parameters are determined together better than one by one; give R0 or leave one out."
        )


def _noise_of_R(fitted: WallFit) -> Iterator[str]:
    worst = max(
        fitted.model.free,
        key=lambda name: abs(fitted.ignored_noise[name] - fitted.values[name]) / (fitted.sd(name) or np.inf),
    )
    shift = fitted.ignored_noise[worst] - fitted.values[worst]
    least = max(float(ndtri(0.975)) * fitted.sd(worst), NOISE_BIAS * abs(fitted.values[worst]))
    if abs(shift) > least and not any(_misfit(fitted)):  # else ordinary least squares differs for another reason
        yield (
            f"the noise of R biases ordinary least squares by more than the interval ({worst} by "
            f"{shift / fitted.values[worst]:+.1%}); the values given are corrected for it."
        )


def _misfit(fitted: WallFit) -> Iterator[str]:
    loop = fitted.loop
    if all(loop.noise[1:, i, i].mean() < 1e3 * loop.floor[i] for i in (0, 1)):
        # the beats are identical to rounding, which does not measure a misfit
        missed = float(np.sqrt(max(0.0, 1.0 - fitted.r2)))
        if missed > MISSED:
            yield (
                f"the {fitted.model.name} model misses the noise-free loop by {missed:.2g} of the pulse; "
                f"{_allowed(fitted) or 'the intervals do not cover that'}."
            )
    elif chdtrc(fitted.dof, fitted.chi2) < MISFIT:
        yield (
            f"the {fitted.model.name} model does not describe the loop within its noise (chi²/dof = "
            f"{fitted.chi2 / fitted.dof:.1f}); {_allowed(fitted) or 'intervals are widened to match'}, but may miss a "
            "systematic error"
            + ("" if "R0" in fitted.model.free else "; check R0, which was given")
            + ("; a channel that is late changes phi0: see --lag." if np.isnan(fitted.lag[1]) else ".")
        )


def _allowed(fitted: WallFit) -> str:
    if not fitted.model_error:
        return ""
    return f"fit and intervals allow the law a random error of {fitted.model_error / MMHG:.2g} mmHg (rms over the beat)"


def _undetermined(fitted: WallFit) -> Iterator[str]:
    if wide := [n for n in fitted.model.free if fitted.ci95(n)[0] < 0.0 < fitted.ci95(n)[1]]:
        yield f"the interval of {' and '.join(wide)} contains 0: the loop does not determine it."


def _loose(fitted: WallFit) -> Iterator[str]:
    share, alone = fitted.sd("phi0") / fitted.values["phi0"], bool(np.isnan(fitted.lag[1]))
    if "phiNL" in fitted.model.free and share > (LOOSE if alone else LOOSE_WITH_LAG):
        yield (
            f"phi0 is known to {share:.0%} only, and the intervals of phi0 and phiNL are then too narrow; "
            f"record more beats, or fit {'the linear model' if alone else 'no lag'}."
        )
