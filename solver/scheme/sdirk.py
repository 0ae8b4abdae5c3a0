"""The time scheme as data: coefficients, order and reference.

R. Alexander, Diagonally implicit Runge–Kutta methods for stiff O.D.E.'s, SIAM J. Numer. Anal. 14 (1977) 1006: three
stages, order 3, L-stable, stiffly accurate (the last stage is the step).
"""

from __future__ import annotations

import numpy as np

# γ is the root of γ³ - 3γ² + 3γ/2 - 1/6 in (1/6, 1/2)
GAMMA = 0.43586652150845967
SDIRK3 = np.array(
    [
        [GAMMA, 0.0, 0.0],
        [(1.0 - GAMMA) / 2.0, GAMMA, 0.0],
        [-1.5 * GAMMA**2 + 4.0 * GAMMA - 0.25, 1.5 * GAMMA**2 - 5.0 * GAMMA + 1.25, GAMMA],
    ]
)
STAGES = len(SDIRK3)

# The inflow of a step is given at these fractions of it. They define a cubic, whose derivative the method integrates to
# the values at the stages. Imposing values at the stages instead would cost the inlet pressure an order and a half
# (stage order).
INFLOW_TIMES = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
_POWERS = np.arange(4)
_STAGE_POWERS = np.column_stack(
    [np.ones(STAGES), *(k * SDIRK3 @ SDIRK3.sum(axis=1) ** (k - 1) for k in _POWERS[1:])]
)  # ∫ k s^(k-1) ds = s^k, by the method: exact at the end of the step
_CUBIC = np.linalg.inv(INFLOW_TIMES[:, None] ** _POWERS)
INFLOW_AT_STAGES = _STAGE_POWERS @ _CUBIC
# A pressure is a force, for which the method needs the values at the stages.
VALUES_AT_STAGES = SDIRK3.sum(axis=1)[:, None] ** _POWERS @ _CUBIC

# The same cubic at these fractions of the first and of the second half of a step, (2, 4, 4).
HALVES = np.stack([(0.5 * (half + INFLOW_TIMES))[:, None] ** _POWERS @ _CUBIC for half in (0, 1)])
