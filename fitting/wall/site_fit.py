"""Fit of the wall's E, R0, φ0, φ_NL and E_NL to the beats of one site, with reliable intervals.

1. The paper's loop over γ gives a filtered radius and, by its regression, the start
   (:mod:`fitting.records.channels.spectral`).
2. Errors in variables: the mean beats of P *and* R are noisy; the scatter between beats gives the variance of each
   harmonic (:mod:`fitting.wall.errors_in_variables`). This gives the estimate and its covariance.
3. Diagnostics: residual spectrum, condition, the effect of a time lag between the two channels, the estimate that
   ignores the noise of R, and warnings in words.

A wall whose elastic law is not given is fitted with each, and the evidence of the record selects the law.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import chdtri

from solver.errors import InputError
from solver.network.description import Network, Segment
from solver.quantities.quantity import quantities

from ..inference.models.loop import Loop, NoFit, mean_loop, paired
from ..parallel.threads import single_threaded
from ..records.alignment.beats import Beats
from ..records.alignment.variable_beats import mean
from ..records.channels import spectral
from .elastic_law import MISFIT, LawEvidence
from .errors_in_variables import Solution, plain, solve, widening, with_model_error
from .fit_diagnostics import doubts
from .wall_fit import WallFit
from .wall_model import WallModel, columns, evaluate, fitted_laws, model, parameters_of

_LAG_HARMONICS = 12  # of the radius, to find a lag: enough for its shape, few enough to limit its noise
_ABOVE_NOISE = 4.0  # standard deviations: threshold for harmonics of P and R, in the selection of the law
_THIN = (2.0, 300.0)  # wide range of R0/h of arteries: outside, a unit or a channel is wrong


@single_threaded
def fit(
    beats: Beats,
    site: str,
    h: float,
    wall: WallModel | str = "monotone",
    *,
    R0: float | None = None,
    eta: float = 0.5,
    lag_free: bool = False,
) -> WallFit:
    """The wall at ``site`` from its channels P and R.

    wall : a model, or the name of one (:func:`~fitting.wall.wall_model.model`), which is fitted with every elastic law:
    the result is the fit by the most probable law, with the others and the evidence (:func:`evidence`).
    h : measured wall thickness [m]. R0 : measured unstressed radius [m]; fitted if not given. eta : Poisson's ratio.
    lag_free : also fit a delay of P against R, which the loop hardly distinguishes from φ0.
    Raises ValueError if the channels are missing or do not pulsate, or no wall describes the loop (NoFit).
    """
    quantities(Segment)["h"].check(f"{site}.h", h)
    quantities(Network)["eta"].check("eta", eta)
    if R0 is not None:
        quantities(Segment)["R0"].check(f"{site}.R0", R0)
    loop = mean_loop(beats, site)
    _check_thickness(site, float(loop.R.mean()), h)
    by = partial(_fitted, beats, site, loop, h=h, eta=eta, R0=R0, lag_free=lag_free)
    kept = _by_evidence(by, wall) if isinstance(wall, str) else by(wall)
    kept = _with_model_error(beats, loop, kept)
    return replace(kept, warnings=(*(f"{site}: {text}" for text in beats.warnings), *doubts(kept)))


# --- the selection of the elastic law --------------------------------------------------------------------------------


def _by_evidence(by: Callable[[WallModel], WallFit], name: str) -> WallFit:
    """The wall by the most probable elastic law, with the others."""
    fits, refused = _by_laws(by, name)
    if not fits:
        raise list(refused.values())[-1]
    weights, without = (fits, refused) if weighing_model(name) == name else _by_laws(by, weighing_model(name))
    if not any(f.model.elastic in (w.model.elastic for w in weights) for f in fits):
        weights, without = fits, refused
    found = evidence([w for w in weights if w.model.elastic not in refused], tuple(without | refused))
    judged = [replace(f, evidence=found) for f in fits if f.model.elastic in found.of]
    kept = next(f for f in judged if f.model.elastic == found.kept)
    return replace(kept, others=tuple(f for f in judged if f is not kept))


def _by_laws(by: Callable[[WallModel], WallFit], name: str) -> tuple[list[WallFit], dict[str, NoFit]]:
    """The fits of a model, one per law, and the reasons for missing ones."""
    fits: list[WallFit] = []
    refused: dict[str, NoFit] = {}
    for law in fitted_laws():
        try:
            fits.append(by(model(name, law)))
        except NoFit as error:
            refused[law] = error
    return fits, refused


def weighing_model(name: str) -> str:
    """The model for the comparison of laws, with φ_NL free, because missing nonlinear viscosity resembles a nonlinear
    elastic law."""
    return "extended monotone" if name.startswith("extended") else "monotone"


def evidence(fits: Sequence[WallFit], refused: Sequence[str] = ()) -> LawEvidence:
    """The evidence from fits of one loop, one per law. refused : laws without a fit.

    By Laplace's approximation the evidence of a law is

        -2 ln p(loop | law) = Σ z²/c - ln det S,

    with the whitened residual z of the harmonics above their noise, and the covariance S of ln E, ln R0, ln φ0, φ_NL/φ0
    and E_NL/E, whose priors are flat and the same for all laws. The true radius has Jeffreys' prior, uniform along the
    loop in units of the noise of both channels, so ln det V does not enter. With a flat prior of the radius it would
    enter, and with one of the pressure its negative; either would favour a law for its effect on harmonics that contain
    only noise.

    c is 1 if a law describes the loop, otherwise the mean of z² of the best one (quasi-likelihood; R. W. M. Wedderburn,
    Biometrika 61 (1974) 439). The misfit of the best law beyond noise is added to c: it is a single error, however many
    harmonics it affects, and a law may have absorbed only a part of it.
    """
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


# --- the fit by one law -----------------------------------------------------------------------------------------------


def _fitted(
    beats: Beats, site: str, loop: Loop, chosen: WallModel, *, h: float, eta: float, R0: float | None, lag_free: bool
) -> WallFit:
    """The wall by one model. Raises NoFit if no wall describes the loop."""
    if R0 is not None:
        chosen = chosen.without("R0")
    start_lag = _start_lag(chosen, loop) if lag_free else None
    timed = loop.earlier(start_lag or 0.0)
    filtered = spectral.gamma_loop(timed.P, timed.R, timed.T, partial(columns, chosen))
    try:
        solution = solve(loop, chosen, _start(chosen, timed, filtered, h, eta, R0), lag=start_lag)
        timed = loop.earlier(solution.lag)
        ignored = plain(timed, chosen, solution.values, filtered.R)
    except NoFit as error:
        hint = "".join(f" Note that {text}" for text in beats.warnings[:1])
        raise NoFit(f"{beats.source}: site {site}: {error}{hint}") from None
    return _result(beats, site, chosen, timed, filtered, solution, ignored)


def _with_model_error(beats: Beats, loop: Loop, kept: WallFit) -> WallFit:
    """The fits of all laws with the error of the most probable one, which was selected by the noise alone. As given if
    it leaves only noise, or if there is no wall with an error."""

    def again(fitted: WallFit) -> WallFit:
        lag = fitted.lag[0] if np.isfinite(fitted.lag[1]) else None
        solution = solve(wide, fitted.model, fitted.values, lag=lag)
        timed, filtered = wide.earlier(solution.lag), fitted.filtered
        found = _result(beats, fitted.site, fitted.model, timed, filtered, solution, fitted.ignored_noise)
        return replace(found, chi2=fitted.chi2, evidence=fitted.evidence)

    def or_as_it_is(fitted: WallFit) -> WallFit:
        try:
            return again(fitted)
        except NoFit:  # of a rejected law, which is only shown
            return fitted

    with suppress(NoFit):
        wide = with_model_error(loop, kept.model, kept.solution, bool(np.isfinite(kept.lag[1])))
        if wide.model_error:
            return replace(again(kept), others=tuple(map(or_as_it_is, kept.others)))
    return kept


def without_lag(beats: Beats, fitted: WallFit) -> Beats:
    """The beats without the fitted lag between P and R of the site: P is shifted, including its gaps."""
    lag = fitted.lag[0]
    if not lag:
        return beats
    name = f"{fitted.site}.P"
    P, fraction = beats.values[name], -lag / beats.T
    gaps = np.isnan(P)
    moved = spectral.shift(np.where(gaps, beats.mean(name), P), fraction)
    moved[np.roll(gaps, round(fraction * beats.N), axis=1)] = np.nan
    return replace(beats, values={**beats.values, name: moved})


def linear_fit(kept: WallFit, beats: Beats, options: dict[str, Any]) -> list[WallFit]:
    """The linear model's fit, for comparison with that of another model; empty if there is none.

    options : of :func:`fit`, as for ``kept``.
    """
    with suppress(NoFit):
        if kept.model.name != "linear":
            return [fit(beats, kept.site, kept.h, model("linear", kept.model.elastic), **options)]
    return []


def favoured_law(kept: WallFit, beats: Beats, options: dict[str, Any]) -> list[str]:
    """A sentence if the record favours a law other than the given one. options : as for :func:`linear_fit`."""
    with suppress(NoFit):
        if kept.evidence is None:
            best = fit(beats, kept.site, kept.h, kept.model.name, **options)
            if best.evidence is not None and best.evidence.decided and best.model.elastic != kept.model.elastic:
                return [f"{kept.site}: --law {kept.model.elastic} was given, but the record favours {best.law}."]
    return []


@single_threaded
def bootstrap(
    fitted: WallFit, beats: Beats, replicates: int = 200, seed: int = 0, progress: Callable[[float], None] | None = None
) -> dict[str, tuple[float, float]]:
    """95 % bootstrap intervals from beats drawn with replacement, to check the intervals of :func:`fit`.

    Each replicate refits the mean of n drawn beats; the noise of the harmonics stays that of the record. Percentile
    intervals, for ``model.free``; none without replicates. They are widened by √(n/(n - 1)), because n drawn beats
    scatter less than n measured ones.
    """
    if replicates == 0:
        return {}
    rng = np.random.default_rng(seed)
    beats, lag = paired(without_lag(beats, fitted), fitted.site), 0.0 if np.isfinite(fitted.lag[1]) else None
    names = (f"{fitted.site}.P", f"{fitted.site}.R")
    means = np.empty((replicates, len(fitted.model.free)))
    n = beats.n_beats
    for i in range(replicates):
        which = rng.integers(0, n, n)
        drawn = ((mean(beats.values[name][which].T), beats.mean(name)) for name in names)
        P, R = (spectral.resample(np.where(np.isnan(x), usual, x), fitted.loop.N) for x, usual in drawn)
        loop = replace(fitted.loop, P=P, R=R)
        values = solve(loop, fitted.model, fitted.values, lag=lag, rounds=3).values
        means[i] = [values[name] for name in fitted.model.free]
        if progress:
            progress((i + 1) / replicates)
    centre = np.array([fitted.values[name] for name in fitted.model.free])
    wide = centre + (means - centre) * np.sqrt(n / (n - 1))
    low, high = np.quantile(wide, [0.025, 0.975], axis=0)
    return {name: (float(low[i]), float(high[i])) for i, name in enumerate(fitted.model.free)}


# --- start and result ---------------------------------------------------------------------------------------------


def _start_lag(chosen: WallModel, loop: Loop) -> float:
    """The lag of P, up to a tenth of a beat in either direction, with which the paper's regression explains P best."""
    lags = np.linspace(-0.1, 0.1, 41) * loop.T
    R_t = spectral.derivative(spectral.without_high(loop.R, _LAG_HARMONICS), loop.T)
    M = columns(chosen, loop.R, R_t)
    q = np.linalg.qr(M / np.linalg.norm(M, axis=0))[0]
    P = np.stack([spectral.shift(loop.P, -lag / loop.T) for lag in lags])
    missed = np.linalg.norm(P - (P @ q) @ q.T, axis=1)
    return float(lags[int(np.argmin(missed))])


def _start(
    chosen: WallModel, loop: Loop, filtered: spectral.Filtered, h: float, eta: float, R0: float | None
) -> dict[str, float]:
    """The paper's regression on the filtered radius.

    With noise, the regression with E_NL may not correspond to any wall; then the start is the regression without it.
    """
    R, R_t = filtered.R, filtered.R_t
    if R0 is None:
        M = columns(chosen, R, R_t)
        scale = np.linalg.norm(M, axis=0)
        C = np.linalg.lstsq(M / scale, loop.P, rcond=None)[0] / scale
        values = parameters_of(chosen, C, h, eta)
        if "ENL" in chosen.free and not (np.isfinite(values["R0"]) and values["E"] > 0.0 and values["phi0"] > 0.0):
            return _start(chosen.without("ENL"), loop, filtered, h, eta, None)
    else:  # with phiNL = ENL = 0 it is linear in all other parameters, whatever the point of linearisation
        values = {"E": 1.0, "R0": R0, "phi0": 1.0, "phiNL": 0.0, "ENL": 0.0, "h": h, "eta": eta}
        M = evaluate(chosen, values, R, R_t).by_parameter
        scale = np.linalg.norm(M, axis=0)
        values |= dict(zip(chosen.free, np.linalg.lstsq(M / scale, loop.P, rcond=None)[0] / scale, strict=True))
    _check_start(values, float(loop.R.mean()))
    return {name: float(value) for name, value in values.items()}


def _check_start(values: Mapping[str, float], R: float) -> None:
    E, R0, phi0 = values["E"], values["R0"], values["phi0"]
    if not (np.isfinite(E) and np.isfinite(R0) and 0.0 < R0 < 3.0 * R):
        raise NoFit(
            "no unstressed radius fits the loop: the pressure does not rise with the radius as in a wall; "
            "check the sign and the order of the two channels, that they belong together, and R0 if it was given."
        )
    if E <= 0.0:
        raise NoFit(
            f"E = {E:.3g} Pa is negative: the radius falls when the pressure rises; "
            "check the sign and the order of the two channels, and R0 if it was given."
        )
    if phi0 <= 0.0:
        raise NoFit(
            f"phi0 = {1e-3 * phi0:.3g} kPa·s is negative: the pressure comes after the radius, so the loop would give "
            "energy; check that P and R are not swapped, fit a time lag between them with --lag, and check R0 if it "
            "was given."
        )


def _check_thickness(site: str, R: float, h: float) -> None:
    low, high = _THIN
    if not low <= R / h <= high:
        raise InputError(
            f"{site}.h = {h:g} m is not allowed: with a mean radius of {R:.3g} m, R/h = {R / h:.3g} must lie in "
            f"[{low:g}, {high:g}]; check the units of h and R, and that P and R are not swapped."
        )


def _result(
    beats: Beats,
    site: str,
    chosen: WallModel,
    loop: Loop,
    filtered: spectral.Filtered,
    solution: Solution,
    ignored_noise: Mapping[str, float],
) -> WallFit:
    p, values = len(chosen.free), solution.values
    lag_free = len(solution.covariance) > p
    dof = loop.N - len(solution.covariance)
    covariance = solution.covariance * widening(loop, solution)
    pulsatile = loop.P - loop.P.mean()
    missed = loop.P - evaluate(chosen, values, filtered.R, filtered.R_t).P
    changes = dict(zip(chosen.free, solution.by_lag, strict=True))
    return WallFit(
        site=site,
        model=chosen,
        values=values,
        covariance=covariance[:p, :p],
        lag=(solution.lag, float(np.sqrt(covariance[-1, -1])) if lag_free else np.nan),
        r2=1.0 - float(np.sum(missed**2) / np.sum(pulsatile**2)),
        dof=dof,
        chi2=solution.chi2,
        by_lag={n: float(1e-3 * change / values[n]) for n, change in changes.items() if values[n] and not lag_free},
        ignored_noise=ignored_noise,
        filtered=filtered,
        loop=loop,
        solution=solution,
        n_beats=beats.n_beats,
        source=beats.source,
        sha256=beats.sha256,
        told=beats.told,
    )
