"""Shares of the flow that no measurement gives, as unknowns of a fit.

Where a tube forks, the branches whose flow is not measured divide the remaining flow: the first takes the part

    f' = f e^u/(1 - f + f e^u)

of it for an estimate f, and the others share the remainder in the same ratio as before. A tube with r times the flow
has √r times the radius and thickness, so that its impedance is divided by r, and its Windkessel has R1/r, r C and 1/r
of the resistance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .sections import Array, Section, carried

SPREAD, FARTHEST = 1.0, 3.0  # standard deviation and range of u: judgement; a half becomes 0.05 to 0.95


def forks(tubes: Sequence[Section]) -> list[tuple[Section, ...]]:
    """The branches of each tube whose flow is not measured, if there are several."""
    found = [tuple(each for each in tubes if each.parent == tube.name and not each.measured) for tube in tubes]
    return [branches for branches in found if len(branches) > 1]


def ratios(tubes: Sequence[Section], u: Array) -> Mapping[str, Array]:
    """r of each tube, for u : (…, n_forks)."""
    odds = {first.name: np.exp(u[..., i]) for i, (first, *_) in enumerate(forks(tubes))}
    flows = carried(tubes, odds)
    return {each.name: flows[each.name] / each.share * np.ones(u.shape[:-1]) for each in tubes}
