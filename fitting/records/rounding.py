"""The steps of a converter, and what rounding leaves in a mean beat."""

from __future__ import annotations

import numpy as np

Array = np.ndarray

_SHARE = 1e-3  # of the steps between neighbours that are not zero: the smallest may be an accident of rounding twice
_WHOLE = 0.02  # of a step, by which a difference may miss a whole number of steps
_FEWEST = 200  # samples
_FINEST = 1e-5  # of the range: finer steps are of no converter
_WAVES = np.arange(1, 6)


def converter_step(values: Array) -> float:
    """The step between neighbouring values of a digitised channel, 0 of one that is not.

    Differences of neighbouring samples are whole multiples of the smallest of them.
    """
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0.0]
    if len(steps) < _FEWEST:
        return 0.0
    span = float(np.nanmax(values) - np.nanmin(values))
    step = float(np.quantile(steps, _SHARE))
    if not step > _FINEST * span:
        return 0.0
    small = steps[(steps > 0.6 * step) & (steps < 8.4 * step)]
    step = float(np.median(small / np.rint(small / step)))
    off = np.abs(steps / step - np.rint(steps / step))
    return step if np.quantile(off[steps <= 30.0 * step], 0.9) < _WHOLE else 0.0


def rounding(beats: Array, step: float) -> float:
    """Standard deviation that rounding to ``step`` leaves in a sample of the mean of beats : (n, N), NaN in gaps.

    Where the noise σ of a sample is small beside the step q, all beats are rounded alike, and the mean of many keeps

        b² = q²/(2π²) Σ_m e^{-4π² m² σ²/q²} / m²      (q²/12 for σ = 0)

    of the variance; the rest, σ² + q²/12 - b², is scatter between beats, from which σ is found. A mean over beats whose
    values lie apart by a step or more, of noise or because the beats differ, is free of it.
    Source: B. Widrow and I. Kollár, Quantization Noise, Cambridge 2008, chapter on the characteristic function.
    """
    if not step > 0.0 or len(beats) < 2:
        return 0.0
    there = ~np.isnan(beats)
    counts = np.maximum(there.sum(axis=0), 2)
    middle = np.where(there, beats, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    scatter = np.where(there, (beats - middle) ** 2, 0.0).sum(axis=0) / (counts - 1) / step**2
    # one phase has few beats to tell by: its neighbours help
    width = min(5, len(scatter))
    pooled = np.convolve(np.pad(scatter, width // 2, mode="wrap"), np.ones(width) / width, mode="valid")
    sigma = np.linspace(0.0, 1.0, 201)
    left = (np.exp(-4.0 * np.pi**2 * np.outer(sigma**2, _WAVES**2)) / _WAVES**2).sum(axis=1) / (2.0 * np.pi**2)
    shown = sigma**2 + 1.0 / 12.0 - left
    return step * float(np.sqrt(np.mean(np.interp(pooled, shown, left))))
