"""Which parts of segments are tried where more than noise remains, and by what an effect of a part shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from small_network import NETWORK, term, terms

from discrepancy import thresholds as at
from discrepancy.along import moved_along, promising
from discrepancy.compare import Compared
from discrepancy.weigh import Named, apart
from fitting.inference.fit import Fit
from fitting.inference.parts import placed
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term, term_at
from fitting.inference.unknown import Unknown, with_prior
from solver import effects
from solver.coordinate import SHIFT, Coordinate
from solver.effect import Effect
from solver.network import Network

Array = np.ndarray
SITES = 40  # data
OWN = Unknown("A.E of its own", SHIFT, (("A.E", 1.0),), -1.0, 1.0, group="E")


def fit_of(z: Array, effects: Sequence[Term] = (), more: Sequence[Unknown] = (), x: Sequence[float] = ()) -> Fit:
    """A hypothesis with this residual and these values of its unknowns, which change nothing more."""
    unknowns = (*more, *(u for t in effects for u in t.unknowns))
    values = np.array(x) if len(x) else np.zeros(len(unknowns))
    n = len(z)
    return Fit(tuple(effects), unknowns, values, z, np.zeros((n, len(unknowns))), np.zeros(n, int), np.zeros(n, int))


@dataclass
class Begun:
    """A problem in which an effect at x/L of its segment takes away one datum after another: what lies about ``best``
    most, the leak more than the stenosis, that more than the stiff wall, A more than B and B more than C."""

    best: float
    z: Array
    network: Network = NETWORK
    asked: list[Term] = field(default_factory=list)

    def columns(self, base: Fit, held: Sequence[Term], runs: Runs) -> dict[str, Array]:
        return {t.label: self._column(t) for t in held}

    def _column(self, held: Term) -> Array:
        (position,) = (u for u in held.unknowns if u.name.endswith("_position"))
        x = 0.5 + 0.15 * position.low
        order = ("side_branch", "stenosis", "wall_stiffness").index(held.effect) + 3 * "ABC".index(held.place)
        taken = SITES - 2 * order - 20 * (abs(x - self.best) > 0.01)
        return (-1e4 * np.where(np.arange(SITES) < taken, self.z, 0.0))[:, None]

    def refit(self, hypotheses: Sequence[tuple[Term, ...]], *_: Any) -> list[Fit]:
        self.asked += [t for (t,) in hypotheses]
        return [fit_of(self.z, h) for h in hypotheses]

    @staticmethod
    def placed(fit: Fit, effect: Term) -> Term | None:
        return placed(NETWORK, effect, [0.0] * len(effect.unknowns))


def compared(problem: Any, *ranked: Named, own: bool = False, asked: Sequence[Term] = ()) -> Compared:
    """Nothing known but a residual without effect; own : of walls that differ."""
    none = Named(fit_of(problem.z, more=(OWN,) if own else ()), 1e6, 100.0)
    return Compared(problem, (none,), ranked, {}, tuple(asked))


ASKED = terms("side_branch", "stenosis", "wall_stiffness")


@pytest.mark.parametrize("best", [0.15, 0.7])
@pytest.mark.parametrize("own", [False, True], ids=["walls in common", "walls that differ"])
def test_parts_are_begun_where_they_promise_most(best: float, own: bool) -> None:
    """The best place of every effect of a part, then the best of all: four, each begun at x/L where its column takes
    most and nowhere else, with growing sizes; a stiff part even where every artery differs."""
    problem = Begun(best, np.ones(SITES))
    assert len(promising(compared(problem, own=own, asked=ASKED), Runs())) == at.ALONG == 4
    assert {t.label for t in problem.asked} == {
        *("side_branch at A", "stenosis at A", "wall_stiffness at A", "side_branch at B"),
    }
    for tried in problem.asked:
        assert {round(0.5 + 0.15 * start[1], 3) for start in tried.starts} == {best}
        sizes = {start[0] for start in tried.starts}
        assert sizes >= {1.0, 3.0} and (min(sizes) < 0.0) == (tried.effect == "wall_stiffness")


def test_only_parts_of_effects_that_are_asked() -> None:
    """Of a catalogue without stenosis none is tried, of one without effects of a part nothing."""
    problem = Begun(0.5, np.ones(SITES))
    promising(compared(problem, asked=terms("side_branch", "wall_stiffness")), Runs())
    assert {t.effect for t in problem.asked} == {"side_branch", "wall_stiffness"}
    assert promising(compared(Begun(0.5, np.ones(SITES)), asked=terms("terminal_reflection")), Runs()) == []


def test_along_the_segment_and_then_how_long() -> None:
    """A stenosis in the middle: its place is searched, explains it the record or not. At a place: its length, where
    it does not explain the record. A leak, whose length is searched with its place: nothing more."""
    z = np.ones(SITES)
    usual = term("stenosis", "A")
    moved = placed(NETWORK, usual, [1.0])
    leak = placed(NETWORK, term("side_branch", "A"), [1.0])
    assert moved is not None and leak is not None

    def asked(effect: Term, misfit: float) -> list[str]:
        problem = Begun(0.5, z)
        moved_along(compared(problem, Named(fit_of(z, (effect,)), 0.0, misfit)), Runs())
        return [u.name.partition("_")[2] for t in problem.asked for u in t.unknowns[len(effect.unknowns) :]]

    bad, good = 2.0 * at.MISFIT, 0.0
    assert (asked(usual, bad), asked(usual, good)) == (["position"], ["position"])
    assert (asked(moved, bad), asked(moved, good)) == (["length"], [])
    assert asked(leak, bad) == asked(leak, good) == []


def test_what_is_looked_for_beside_walls_that_differ() -> None:
    """Of effects that are merely the animal's where every artery differs none is sought, but all are counted in the
    price of a name, the same however the walls are asked for."""
    problem = Begun(0.5, np.ones(SITES))
    assert compared(problem, asked=ASKED).sought == ASKED
    own = compared(problem, own=True, asked=ASKED)
    assert {t.effect for t in own.sought} == {"side_branch", "stenosis"} and own.terms == ASKED


# --- how an effect of a part shows ------------------------------------------------------------------------------------


def test_where_an_effect_lies_is_no_size() -> None:
    """An effect whose size changes the data by 3, and whose place would by 40 more, 4 steps off the middle: d' is 3."""
    size = with_prior(Coordinate("A.K", SHIFT, (("A.K", 1.0),), 0.0, math.inf), 10.0, of_size=True)
    place = with_prior(Coordinate("A.K_position", SHIFT, (("A.K_position", 0.15),), -3.0, 3.0), 4.0)
    across = [Term("stenosis", "A", ("A",), (size, place)), term("channel_gain", "B.P")]
    fit = fit_of(np.zeros(3), across, x=(1.5, 4.0, 100.0))
    fit.J[:] = [[2.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 1.0]]
    assert Named(fit, 0.0, 0.0).visibility == pytest.approx(3.0)


@pytest.mark.parametrize("effect", effects.ALL, ids=lambda e: e.name)
def test_every_effect_has_a_size(sheep: Network, effect: Effect) -> None:
    """Without one it would never show."""
    channel = effect.owner == "channel"
    found = [term_at(sheep, effect, place) for place in (["CA.P", "CA.Q"] if channel else effect.where(sheep))]
    assert all(any(u.of_size for u in t.unknowns) for t in found if t is not None)


def test_distances_are_from_the_first() -> None:
    """Costs of 9, 25 and 5: the second is told from the first by d' = 4, the third, better by cost, by none."""
    costs, scores = (9.0, 25.0, 5.0), (1.0, 3.0, 2.0)
    order = apart([Named(fit_of(np.array([math.sqrt(c)])), s, 0.0) for c, s in zip(costs, scores, strict=True)])
    assert [n.separation for n in order] == pytest.approx([0.0, 4.0, 0.0])
    assert [n.above_best for n in order] == pytest.approx([0.0, 2.0, 1.0])
