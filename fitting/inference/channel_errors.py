"""Errors of a network's model, channel by channel: what of them the whitened residual shows.

The parts of :mod:`fitting.inference.misfit`: one for the harmonics of each channel, one for the means of each quantity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..records.noise import Target
from .misfit import Block, sizes

Array = np.ndarray


def parts(names: Sequence[str]) -> tuple[str, ...]:
    """What the parts of channels with these names belong to."""
    return (*names, *dict.fromkeys(_mean_of(name) for name in names))


def blocks(target: Target) -> list[Block]:
    """One block for the means, and one for each harmonic: real and imaginary parts of all m channels."""
    m, K = len(target.names), len(target.X) - 1
    white = target.whitener * sizes(target.X)[:, None, :]
    found = [Block(np.arange(m), white[0].real, _parts_of_means(target))]
    for k in range(1, K + 1):
        a, b = white[k].real, white[k].imag
        rows = np.concatenate([m * k + np.arange(m), m * (K + k) + np.arange(m)])
        found.append(Block(rows, np.block([[a, -b], [b, a]]), np.tile(np.arange(m), 2)))
    return found


def widened(target: Target, parts: Array) -> Target:
    """With errors of these parts in its covariance."""
    at, covariance = np.arange(len(target.names)), target.covariance.copy()
    covariance[:, at, at] += of_parts(target, parts) ** 2
    return Target.of(target.names, target.X, covariance)


def of_parts(target: Target, parts: Array) -> Array:
    """(K+1, m) standard deviation of errors of these parts."""
    size = sizes(target.X)
    return np.concatenate([parts[_parts_of_means(target)] * size[:1], parts[: len(target.names)] * size[1:]])


def _mean_of(name: str) -> str:
    return f"means of {name.rpartition('.')[2]}"


def _parts_of_means(target: Target) -> Array:
    known = parts(target.names)
    return np.array([known.index(_mean_of(name)) for name in target.names])
