"""The plans of the bank: what each group draws, the same each time, and records that can be made."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from truth.hide import CHANNEL, FLOW, OUTSIDE, OUTSIDE_SENSOR, WALL
from truth.plan import GROUPS, REPORTED, REPORTED_SEED, TUNING_SEED, plan, seed_of, whole
from truth.records import Case, make

REAL = [(name, kind) for name, group in GROUPS.items() if name != "standard" for kind in group.records]


@pytest.mark.parametrize("kind", ["bench", "network"])
def test_plan(kind: str) -> None:
    """The reported plan: enough nulls, every effect of the catalogue, seeds apart, the same each time."""
    cases = plan(kind, REPORTED[kind], REPORTED_SEED)
    assert cases == plan(kind, REPORTED[kind], REPORTED_SEED)
    assert len(cases) >= {"bench": 1000, "network": 250}[kind]
    assert sum(not c.effects for c in cases) >= {"bench": 300, "network": 100}[kind]
    names = {e.name for c in cases for e in c.effects}
    needed = {*WALL, *FLOW, *CHANNEL} if kind == "network" else {*WALL, *CHANNEL} - {"wall_stiffness"}
    assert needed <= names
    outside = {e.name for c in cases for e in c.effects} & set(OUTSIDE)
    assert outside == {"cubic_rate"} | ({"swinging_outlet", *OUTSIDE_SENSOR} if kind == "network" else set())
    assert seed_of(kind, TUNING_SEED, 0) != seed_of(kind, REPORTED_SEED, 0)


@pytest.mark.parametrize("kind", ["bench", "network"])
def test_records_of_the_plan_can_be_made(kind: str) -> None:
    """The first four of the tuning plan."""
    for i, case in enumerate(plan(kind, 40, TUNING_SEED)[:4]):
        assert_finite(case, seed_of(kind, TUNING_SEED, i))


def test_the_standard_plan_stays() -> None:
    """Cases of the tuning seed as they have been since the first bank, so that verdicts of then and now compare."""
    cases = [c for kind in ("bench", "network") for c in plan(kind, REPORTED[kind], TUNING_SEED)]
    told = [(c.channels, c.dB, c.base, [(e.where, f"{e.size:.12g}", f"{e.second:.12g}") for e in c.effects])
            for c in cases]  # fmt: skip
    assert hashlib.sha256(repr(told).encode()).hexdigest()[:16] == "04fa1c52dbdd7d98"


def test_seeds_are_apart() -> None:
    """No seed serves two groups, nor tuning and report."""
    seeds = [seed for group in GROUPS.values() for seed in (group.tuning, group.reported)]
    assert len({*seeds, 20260401, 20261121, 20270315}) == len(seeds) + 3


@pytest.mark.parametrize(("name", "kind"), REAL)
def test_groups(name: str, kind: str) -> None:
    """Every group has its nulls and draws what it is there for, the same each time."""
    group = GROUPS[name]
    cases = whole(kind, name, group.tuning)
    assert cases == whole(kind, name, group.tuning) != whole(kind, name, group.reported)
    assert sum(not c.effects for c in cases) == round(group.nulls * len(cases))
    assert {c.walls for c in cases} == set(group.walls) and {c.sensors for c in cases} == set(group.sensors)
    assert {c.varying for c in cases} == {group.varying}
    hidden = [(c, e) for c in cases for e in c.effects]
    names = {e.name for _, e in hidden}
    far = [c for c in cases if any(e.name in OUTSIDE for e in c.effects)]
    assert len(far) == round(group.outside * len(cases))
    if group.sizes:
        assert names == set(group.sizes)
        least = {key: low for key, (low, _, _) in group.sizes.items()}
        assert all(least[e.name] <= abs(e.size) <= group.sizes[e.name][1] and e.size > -1.0 for _, e in hidden)
    elif any(group.walls):
        assert "wall_stiffness" not in names
        assert all(c.base == "elastic" for c, e in hidden if e.name == "wall_viscosity")
    if group.position:
        assert all(0.15 <= e.position <= 0.85 for _, e in hidden)


# one of a network whose beats differ is made, and judged by its noise: test_hidden_varying.py
LONG = pytest.param("varying", "network", marks=pytest.mark.endurance)


@pytest.mark.deep
@pytest.mark.parametrize(("name", "kind"), [LONG if each == ("varying", "network") else each for each in REAL])
def test_records_of_groups_can_be_made(name: str, kind: str) -> None:
    """The first two of the tuning plan."""
    seed = GROUPS[name].tuning
    for i, case in enumerate(whole(kind, name, seed)[:2]):
        assert_finite(case, seed_of(kind, seed, i))


def assert_finite(case: Case, seed: tuple[int, ...]) -> None:
    made = make(case, seed)
    assert set(made.channels) == set(case.names)
    assert all(np.isfinite(x).all() for x in made.channels.values())
