"""Where searches begin besides the network's own values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from .unknown import SCALE, Unknown, bounds

Array = np.ndarray

WIDER = 2.0  # starts than priors: they are to be farther apart than what animals are
ANYWHERE = 5.0  # the same without a prior, in default ones: a factor of 3 is then usual
WIDEST = 1.0  # of a logarithm, whatever its prior: at ten times its length or more a network is slow, and no animal's


def starting_points(unknowns: Sequence[Unknown], starts: int, seed: int) -> Array:
    """(starts, p) x : 0, then points of a scrambled Sobol' sequence.

    x_i = 2 s_i Φ⁻¹(u_i), within its allowed range; s : standard deviation of the prior, where there is none 2.5 times
    that of the default one; 2 s is 1 at most where x is a logarithm; u : the point in the unit cube.
    """
    from scipy.stats.qmc import Sobol  # takes half a second

    p = len(unknowns)
    u = Sobol(p, seed=seed).random_base2(int(starts - 1).bit_length())[: starts - 1]
    spread = np.array([(ANYWHERE if each.prior_sd is None else WIDER) * each.typical_sd for each in unknowns])
    logarithms = [each.kind == SCALE for each in unknowns]
    spread = np.where(logarithms, np.minimum(spread, WIDEST), spread)
    x = spread * ndtri(np.clip(u, 1e-6, 1.0 - 1e-6))
    return np.clip(np.concatenate([np.zeros((1, p)), x]), *bounds(unknowns))
