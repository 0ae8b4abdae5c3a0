"""Hypotheses simulated together: every member as it is alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from forked import NETWORK, clean, record
from small_network import term

from fitting.inference.fit import Member
from fitting.inference.hypothesis import PlacedEffect, placed
from fitting.inference.models.batches import kind_of
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.network_record import network_problem

Array = np.ndarray

ALONG = {"stenosis": 2.0, "side_branch": 3.0, "wall_stiffness": 1.0}


@pytest.fixture(scope="module")
def problem() -> NetworkProblem:
    return network_problem(record(clean()), NETWORK)


def anywhere(effect: str, place: str) -> PlacedEffect:
    found = placed(NETWORK, term(effect, place), [ALONG[effect]])
    assert found is not None
    return found


def member(problem: NetworkProblem, *terms: tuple[PlacedEffect, Sequence[float]]) -> Member:
    """Terms with these values, and no nuisance."""
    unknowns = problem.hypothesis([t for t, _ in terms])
    own = np.concatenate([x for _, x in terms])
    return Member(tuple(t for t, _ in terms), unknowns, np.concatenate([np.zeros(len(unknowns) - len(own)), own]))


def alone_and_together(problem: NetworkProblem, members: Sequence[Member]) -> float:
    """The largest difference of a member's harmonics in a batch and alone, of its channel's largest."""
    worst = 0.0
    for each, X in zip(members, problem.observe(members), strict=True):
        (alone,) = problem.observe([each])
        assert X is not None and alone is not None
        worst = max(worst, float((np.abs(X - alone).max(axis=0) / np.abs(alone).max(axis=0)).max()))
    return worst


@pytest.mark.parametrize("effect", ALONG)
def test_usual_and_placed_parts(problem: NetworkProblem, effect: str) -> None:
    """The same effect at one place in its usual part, and with a position that is searched, which the usual one behind
    it does not undo (a stenosis was off by 0.01): 4e-11 measured."""
    usual, free = term(effect, "A"), anywhere(effect, "A")
    size, rest = ALONG[effect], [0.0] * (len(free.unknowns) - 2)
    plain = member(problem, (usual, [size]))
    moved = member(problem, (free, [size, 0.4, *rest]))
    pair = member(problem, (free, [size, -1.5, *rest]), (term("terminal_reflection", "B"), [1.0]))
    assert alone_and_together(problem, [pair, moved, plain]) < 1e-9


def test_a_length_that_is_searched(problem: NetworkProblem) -> None:
    """Where a stenosis lies is searched first, then, from there and from one and three times its usual length, how long
    it is, and no more: in a batch with one at a place and one in its usual part, each as alone (2e-11 measured)."""
    at_place = anywhere("stenosis", "A")
    long = placed(NETWORK, at_place, [2.0, 0.4])
    assert [u.name for u in at_place.unknowns] == ["A.K", "A.K_position"]
    assert long is not None and [u.name for u in long.unknowns] == ["A.K", "A.K_position", "A.K_length"]
    assert long.starts == (pytest.approx((2.0, 0.4, 0.0)), pytest.approx((2.0, 0.4, 1.0)))
    assert placed(NETWORK, long, [2.0, 0.4, 0.5]) is None
    usual = member(problem, (term("stenosis", "A"), [2.0]))
    moved = member(problem, (at_place, [2.0, 0.4]))
    longer = member(problem, (long, [2.0, 0.4, 0.5]))
    assert alone_and_together(problem, [longer, moved, usual]) < 1e-10


@pytest.mark.slow
def test_more_members_than_a_batch_holds(problem: NetworkProblem) -> None:
    """Seventy positions of a stenosis at three places, and of a leak beside one: each where it is alone. The mesh
    of a batch is cut wherever one of its members is: 4e-7 measured."""
    rng = np.random.default_rng(3)
    members = []
    for i, x in enumerate(rng.uniform(-3.0, 3.0, 70)):
        stenosis = (anywhere("stenosis", "ABC"[i % 3]), [2.0, x])
        leak = (anywhere("side_branch", "A"), [3.0, -0.5 * x, -1.0])
        members.append(member(problem, *((stenosis, leak) if i % 7 == 0 else (stenosis,))))
    X = dict(zip(map(id, members), problem.observe(members), strict=True))
    worst = 0.0
    for each in (*members[::14], *members[-3:]):
        (alone,), there = problem.observe([each]), X[id(each)]
        assert alone is not None and there is not None
        worst = max(worst, float((np.abs(there - alone).max(axis=0) / np.abs(alone).max(axis=0)).max()))
    assert worst < 2e-6


def test_leaks_have_batches_of_their_own() -> None:
    """With a leak in it, no beat of a batch starts at another one."""
    assert kind_of((term("side_branch", "A"),)) != kind_of(()) == kind_of((term("wall_stiffness", "A"),))
