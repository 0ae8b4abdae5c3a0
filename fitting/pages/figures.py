"""Figures of one site's fit, as in the paper: the measured P–R loop against linear and nonlinear model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes

from solver.quantities.legible import number
from solver.quantities.units import MMHG

from ..records.alignment.beats import Array, Beats
from ..wall.site_fit import without_lag
from ..wall.wall_fit import WallFit
from .style import BLACK, BLUE, GREEN, PURPLE, SKY, STYLE, VERMILION, Picture

_TITLES = {
    "linear": "Linear Kelvin–Voigt",
    "nonlinear": "Nonlinear Kelvin–Voigt, quadratic",
    "monotone": "Nonlinear Kelvin–Voigt, monotone",
    "extended": "Nonlinear Kelvin–Voigt, quadratic, $E_{NL}$",
    "extended monotone": "Nonlinear Kelvin–Voigt, monotone, $E_{NL}$",
}


def loop_figure(fits: Sequence[WallFit], beats: Beats | None = None) -> Picture:
    """Recorded loop and model for each fit side by side, and the residuals' spectrum of each against its noise.

    beats : the fitted beats, shown individually with their mean. The title begins with the name of the record's file,
    which labels virtual data.
    """
    first = fits[0]
    with rc_context(STYLE):
        figure = Picture(figsize=(3.6 * (len(fits) + 1), 3.6), layout="constrained")
        axes = figure.subplots(1, len(fits) + 1)
        for ax, fitted in zip(axes, fits, strict=False):
            _loop(ax, fitted, beats)
        for ax in axes[1 : len(fits)]:
            ax.sharey(axes[0])
        _spectrum(axes[-1], fits)
        title = f"{Path(first.source).name}, site {first.site}: {first.n_beats} beats of {number(first.loop.T, 4)} s"
        figure.suptitle(title, fontsize=10)
    return figure


def _loop(ax: Axes, fitted: WallFit, beats: Beats | None) -> None:
    """Every recorded beat, their mean, and the model."""
    if beats is not None:
        P, R = without_lag(beats, fitted).site(fitted.site)
        ax.plot(1e3 * R.T, P.T / MMHG, ".", color=SKY, markersize=2, alpha=0.35, zorder=1)
        ax.plot([], [], ".", color=SKY, label="all beats")
    ax.plot(*_closed(1e3 * fitted.loop.R, fitted.loop.P / MMHG), color=BLACK, linewidth=1.0, label="mean beat")
    # above the harmonics of the pressure, the curve would show the noise of R, whose rate the model multiplies by φ0
    harmonics = _harmonics_shown(fitted)
    R_model, P_model = _closed(1e3 * _up_to(harmonics, fitted.solution.R), _up_to(harmonics, fitted.P_fitted / MMHG))
    ax.plot(R_model, P_model, color=VERMILION, linewidth=1.8, linestyle=(0, (4, 2)), label="model")
    ax.set_title(f"{_TITLES.get(fitted.model.name, fitted.model.name)}\n{fitted.model.elastic} law")
    ax.set_xlabel("radius R, mm")
    ax.set_ylabel("pressure P, mmHg")
    ax.text(
        0.97,
        0.03,
        f"residual {number(100 * np.sqrt(max(1.0 - fitted.r2, 0.0)), 2)} % of the pulse\n"
        f"χ²/dof {number(fitted.chi2 / fitted.dof)}",
        transform=ax.transAxes,
        ha="right",
        va="bottom",
    )
    ax.legend(loc="upper left", fontsize=8)


def _spectrum(ax: Axes, fits: Sequence[WallFit]) -> None:
    """|residual_k| per model and its expected noise, up to the last harmonic of P above the noise."""
    harmonics = _harmonics_shown(fits[0])
    for fitted, colour, marker in zip(fits, (BLUE, VERMILION, GREEN, PURPLE), "osD^", strict=False):
        k, size, _ = fitted.residual_spectrum()
        ax.semilogy(
            k[1:harmonics], size[1:harmonics] / MMHG, marker, color=colour, markersize=4, label=fitted.model.name
        )
    k, _, expected = fits[-1].residual_spectrum()
    P = np.abs(np.fft.rfft(fits[0].loop.P)) / fits[0].loop.N
    ax.semilogy(k[1:harmonics], P[1:harmonics] / MMHG, color=BLACK, linewidth=1.0, label="pressure")
    noise = "noise and model error (1 sd)" if fits[-1].model_error else "noise (1 sd)"
    ax.semilogy(k[1:harmonics], expected[1:harmonics] / MMHG, color=SKY, linewidth=2.0, label=noise)
    ax.set_title("Residual of the pressure")
    ax.set_xlabel("harmonic k")
    ax.set_ylabel("Fourier coefficient, mmHg")
    ax.legend(fontsize=8)


def _harmonics_shown(fitted: WallFit) -> int:
    k, _, expected = fitted.residual_spectrum()
    P = np.abs(np.fft.rfft(fitted.loop.P)) / fitted.loop.N
    above = k[P > 3.0 * expected]
    return int(min(len(k), max(12, 1.5 * above.max() if above.size else 12)))


def _up_to(K: int, x: Array) -> Array:
    """The harmonics 0 to K of samples of one period."""
    X = np.fft.rfft(x)
    X[K + 1 :] = 0.0
    return np.fft.irfft(X, len(x))


def _closed(x: Array, y: Array) -> tuple[Array, Array]:
    return np.append(x, x[0]), np.append(y, y[0])
