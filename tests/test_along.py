"""What is looked for beside walls that differ, and by what an effect of a part shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_network import NETWORK, term, terms

from discrepancy.name.scoring import Compared, Named, apart, whitened_response
from fitting.inference.fit import Fit
from fitting.inference.hypothesis import PlacedEffect, placed_effect
from fitting.inference.unknown import Unknown, with_prior
from solver.laws import effects
from solver.laws.effect import Effect
from solver.network.description import Network
from solver.quantities.coordinate import SHIFT, Coordinate

Array = np.ndarray
OWN = Unknown("A.E of its own", SHIFT, (("A.E", 1.0),), -1.0, 1.0, group="E")


def fit_of(
    z: Array, effects: Sequence[PlacedEffect] = (), more: Sequence[Unknown] = (), x: Sequence[float] = ()
) -> Fit:
    """A hypothesis with this residual and these values of its unknowns, which change nothing more."""
    unknowns = (*more, *(u for t in effects for u in t.unknowns))
    values = np.array(x) if len(x) else np.zeros(len(unknowns))
    n = len(z)
    return Fit(tuple(effects), unknowns, values, z, np.zeros((n, len(unknowns))), np.zeros(n, int), np.zeros(n, int))


ASKED = terms("side_branch", "stenosis", "wall_stiffness")


def test_what_is_looked_for_beside_walls_that_differ() -> None:
    """Of effects that are merely the animal's where every artery differs none is sought, but all are counted in the
    price of a name, the same however the walls are asked for."""
    problem: Any = SimpleNamespace(network=NETWORK)
    common, own = (
        Compared(problem, Named(fit_of(np.ones(40), more=more), 1e6, 100.0), (), {}, ASKED) for more in ((), (OWN,))
    )
    assert common.sought == ASKED
    assert {t.effect for t in own.sought} == {"side_branch", "stenosis"} and own.terms == ASKED


# --- how an effect of a part shows ------------------------------------------------------------------------------------


def test_where_an_effect_lies_is_no_size() -> None:
    """An effect whose size changes the data by 3, and whose place would by 40 more, 4 steps off the middle: d' is 3."""
    size = with_prior(Coordinate("A.K", SHIFT, (("A.K", 1.0),), 0.0, math.inf), 10.0, of_size=True)
    place = with_prior(Coordinate("A.K_position", SHIFT, (("A.K_position", 0.15),), -3.0, 3.0), 4.0)
    across = [PlacedEffect("stenosis", "A", ("A",), (size, place)), term("channel_gain", "B.P")]
    fit = fit_of(np.zeros(3), across, x=(1.5, 4.0, 100.0))
    fit.J[:] = [[2.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 1.0]]
    assert min(np.linalg.norm(whitened_response(fit, [t])) for t in across) == pytest.approx(3.0)


@pytest.mark.parametrize("effect", effects.ALL, ids=lambda e: e.name)
def test_every_effect_has_a_size(sheep: Network, effect: Effect) -> None:
    """Without one it would never show."""
    channel = effect.owner == "channel"
    found = [placed_effect(sheep, effect, place) for place in (["CA.P", "CA.Q"] if channel else effect.where(sheep))]
    assert all(any(u.of_size for u in t.unknowns) for t in found if t is not None)


def test_distances_are_from_the_first() -> None:
    """Costs of 9, 25 and 5: the second is told from the first by d' = 4, the third, better by cost, by none."""
    costs, scores = (9.0, 25.0, 5.0), (1.0, 3.0, 2.0)
    order = apart([Named(fit_of(np.array([math.sqrt(c)])), s, 0.0) for c, s in zip(costs, scores, strict=True)])
    assert [n.separation for n in order] == pytest.approx([0.0, 4.0, 0.0])
    assert [n.above_best for n in order] == pytest.approx([0.0, 2.0, 1.0])
