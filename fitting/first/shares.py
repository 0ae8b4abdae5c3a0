"""Shares of the flow that no measurement gives, as unknowns of a fit.

Where a tube forks, the first branch takes the part

    f' = f e^u/(1 - f + f e^u)

of the flow for an estimate f, and the others share the rest in the same ratio as before. A tube with r times the flow
has √r times the radius and thickness, so that its impedance is 1/r of what it was, and its Windkessel has R1/r, r C and
1/r of the resistance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .stretches import Stretch

Array = np.ndarray

SPREAD, FARTHEST = 1.0, 3.0  # standard deviation and range of u: judgement; a half becomes 0.05 to 0.95


def forks(tubes: Sequence[Stretch]) -> list[tuple[Stretch, ...]]:
    """The branches of each tube whose shares are all guesses."""
    found = [tuple(each for each in tubes if each.parent == tube.name) for tube in tubes]
    return [branches for branches in found if len(branches) > 1 and all(each.guessed for each in branches)]


def ratios(tubes: Sequence[Stretch], u: Array) -> Mapping[str, Array]:
    """r of each tube, for u : (…, n_forks)."""
    one = np.ones(u.shape[:-1])
    at: dict[str, Array] = {}
    for i, (first, *others) in enumerate(forks(tubes)):
        f = first.share / (first.share + sum(each.share for each in others))
        odds = np.exp(u[..., i])
        at[first.name] = odds / (1.0 - f + f * odds)
        at |= {each.name: 1.0 / (1.0 - f + f * odds) for each in others}
    found: dict[str, Array] = {"": one}
    for tube in tubes:
        found[tube.name] = found[tube.parent] * at.get(tube.name, one)
    return found
