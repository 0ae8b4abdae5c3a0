"""The lists of cases of the bank: which effects, where, how large, in how much noise; drawn from ranges fixed here.

A plan belongs to a group, which says what its records are like; each group has a seed of its own for tuning and one
for the reported run. The order of a plan is shuffled, so that any first part of it is a fair sample. A reported seed
whose records were looked at becomes one of tuning (20260401, 20261121, 20270315, 20290611, 20310105, 20310113, 20310115
and 20310120 of the standard group have, 20290612, 20310106, 20310107, 20310117, 20310119, 20310123 and 20310124 of the
walls, 20290615, 20310108 and 20310118 of those off centre, 20290614 of those that vary, 20290616 of those outside the
catalogue; of all groups those of 20321100 to 20331209).

    standard       identical beats, common nuisances; a tenth outside the catalogue, a tenth with two effects
    walls          every wall off by itself, by half, once or one and a half times what is usual
    sensors        noise in mmHg, per cent of the peak flow and micrometres
    varying        intervals that vary by 3 % and strokes by 5 % from beat to beat
    offcentre      stenoses and leaks away from the middle of their segment, half of them in individual walls
    outside_walls  effects outside the catalogue in individual walls
    own            one wall or end far off by itself, in individual walls: E x 0.4 to 3, R_t +- 0.3, R0 +- 12 %
    elastic        individual walls without viscosity, seven sites; one effect or two
    pairs          two effects in individual walls, seven sites
    three          one effect in individual walls, seen by the inflow and three pressures

In groups other than the standard one sizes are from the upper half of their ranges, of `pairs` from the upper quarter,
of `elastic` and `three` from the upper third. Where walls are off by themselves
nothing is hidden that is merely this animal's wall: another stiffness, or another phi0 where there is one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .hide import ALL, CHANNEL, OUTSIDE, OUTSIDE_WALL, WALL, Effect
from .records import SENSORS, SITES, Case
from .sizes import BENCH_SIZES, NETWORK_SIZES, POSITIVE_RATIO, RADIUS_GAIN, SOFTEST

NOISE = {40.0: 0.5, 30.0: 0.35, 20.0: 0.15}

SEGMENTS = (*SITES, "VA1", "VA2", "VA3")
OUTLETS = ("CA", "FA", "VA1", "VA2", "VA3")
JUNCTIONS = ("AA", "BT", "PD", "MD", "DD")

# what the standard group calls outside the catalogue when it shares its records out: fixed, as its plan is
_BEYOND = ("fractional_viscosity", "cubic_rate", "swinging_outlet", "inflow_bent", "inflow_rectified")


_OF_VISCOUS_WALLS = ("nonlinear_wall_viscosity", "stress_relaxation", "fractional_viscosity")


@dataclass(frozen=True)
class Group:
    """A group of records.

    records : how many of each kind the reported plan has; nulls, outside, pairs : shares of them, the rest has one
    effect. least : where in the ranges sizes begin. walls, sensors : drawn from evenly (see Case). only : effects, if
    not all. position : where along its segment a local effect may be. sizes : of these effects, in place of the usual
    ranges.
    """

    tuning: int
    reported: int
    records: Mapping[str, int]
    nulls: float
    outside: float = 0.0
    pairs: float = 0.0
    least: float = 0.5
    walls: tuple[float, ...] = (0.0,)
    sensors: tuple[str, ...] = ("",)
    varying: tuple[float, float] = (0.0, 0.0)
    only: tuple[str, ...] = ()
    position: tuple[float, float] | None = None
    sizes: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    channels: str = ""
    base: str = ""


_SPREADS = (0.5, 1.0, 1.5)
_OWN = {"wall_stiffness": (0.35, 2.0, 0.4), "terminal_reflection": (0.1, 0.3, 0.5), "wall_radius": (0.07, 0.12, 0.5)}
GROUPS = {
    "standard": Group(11, 20341100, {"bench": 1200, "network": 400}, 0.25, 0.1, 0.1, least=0.0),
    "walls": Group(21, 20341101, {"network": 560}, 0.4, walls=_SPREADS),
    "sensors": Group(22, 20341102, {"bench": 240, "network": 120}, 0.4, sensors=tuple(SENSORS)),
    "varying": Group(23, 20341103, {"bench": 240, "network": 140}, 0.6, varying=(0.03, 0.05)),
    "offcentre": Group(24, 20341104, {"network": 100}, 0.0, walls=(0.0, 1.0), only=("stenosis", "side_branch"),
                       position=(0.15, 0.85)),
    "outside_walls": Group(25, 20341105, {"bench": 120, "network": 120}, 0.0, 1.0, walls=_SPREADS),
    "own": Group(26, 20341106, {"network": 90}, 0.0, 1 / 3, least=0.0, walls=_SPREADS, only=tuple(_OWN), sizes=_OWN),
    "elastic": Group(27, 20341107, {"network": 60}, 0.0, pairs=0.5, least=2 / 3, walls=_SPREADS, channels="all",
                     base="elastic"),
    "pairs": Group(28, 20341108, {"network": 60}, 0.0, pairs=1.0, least=0.75, walls=_SPREADS, channels="all"),
    "three": Group(29, 20341109, {"network": 60}, 0.0, least=2 / 3, walls=_SPREADS, channels="three pressures"),
}  # fmt: skip
TUNING_SEED, REPORTED_SEED = GROUPS["standard"].tuning, GROUPS["standard"].reported
REPORTED = GROUPS["standard"].records


def plan(kind: str, n: int, seed: int, group: str = "standard") -> list[Case]:
    """n cases of a kind, "bench" or "network"; the same group and seed, the same plan."""
    rng = np.random.default_rng((seed, ("bench", "network").index(kind), n))
    what = GROUPS[group]
    draw = _Draw(kind, rng, what)
    beyond = _BEYOND if group == "standard" else OUTSIDE
    nulls, outside, pairs = (round(n * share) for share in (what.nulls, what.outside, what.pairs))
    names = [name for name in draw.sizes if name not in beyond and name not in OUTSIDE and draw.takes(name)]
    far = [name for name in draw.sizes if name in beyond]
    lists: list[tuple[str, ...]] = [()] * nulls + [(far[i % len(far)],) for i in range(outside)]
    lists += [draw.pair(names) for _ in range(pairs)]
    lists += [(names[i % len(names)],) for i in range(n - len(lists))]
    cases = [draw.case(each) for each in lists]
    return [cases[i] for i in rng.permutation(n)]


def whole(kind: str, group: str, seed: int) -> list[Case]:
    """The whole plan of a group, empty if it has no records of that kind."""
    n = GROUPS[group].records.get(kind, 0)
    return plan(kind, n, seed, group) if n else []


def seed_of(kind: str, seed: int, i: int) -> tuple[int, int, int]:
    """The seed of record i of a plan, for :func:`~.records.make`."""
    return (seed, ("bench", "network").index(kind), i)


class _Draw:
    """Random places, sizes and circumstances."""

    def __init__(self, kind: str, rng: np.random.Generator, group: Group) -> None:
        self.kind, self.rng, self.group = kind, rng, group
        self.sizes = group.sizes or (BENCH_SIZES if kind == "bench" else NETWORK_SIZES)
        self.own_walls = any(group.walls)

    def takes(self, name: str) -> bool:
        """Whether an effect of the catalogue belongs to the group."""
        if self.group.base == "elastic" and name in _OF_VISCOUS_WALLS:
            return False
        return name in self.group.only if self.group.only else not (self.own_walls and name == "wall_stiffness")

    def pair(self, names: list[str]) -> tuple[str, str]:
        """Two names that can act together."""
        while True:
            first, second = (str(name) for name in self.rng.choice(names, 2, replace=False))
            if {first, second} != {"terminal_reflection", "terminal_compliance"}:
                return first, second

    def case(self, names: tuple[str, ...]) -> Case:
        rng = self.rng
        dB = float(rng.choice(list(NOISE), p=list(NOISE.values())))
        channels = str(rng.choice(SITES))
        if self.kind == "network":
            channels = "all" if rng.random() < 0.7 else "three pressures"
            channels = self.group.channels or channels
        effects = tuple(self._effect(name, channels, len(names) == 2) for name in names)
        law = "regression" if self.kind == "bench" and rng.random() < 0.3 else "beta"
        base = self._base(effects)
        case = Case(self.kind, channels, dB, effects, base, law, self._viscous_law(base, effects))
        sensors, g = self._one(self.group.sensors), self.group
        return replace(case, dB=0.0 if sensors else dB, walls=self._one(g.walls), sensors=sensors, varying=g.varying)

    def _one(self, options: tuple[Any, ...]) -> Any:
        return options[int(self.rng.integers(len(options)))] if len(options) > 1 else options[0]

    def _viscous_law(self, base: str, effects: tuple[Effect, ...]) -> str:
        """The paper's quadratic law now and then, but not where its effective viscosity would change sign."""
        softens = any(e.name == "nonlinear_wall_viscosity" and e.size < 0.0 for e in effects)
        if base == "sheep_nonlinear" or softens or self.rng.random() > 0.3:
            return "monotone"
        return "quadratic"

    def _base(self, effects: tuple[Effect, ...]) -> str:
        """Viscosity is hidden in elastic walls, in one segment also in viscous ones; what needs φ0 has it."""
        names = {e.name for e in effects}
        unseen = self.kind == "bench" or self.own_walls  # in a viscous wall it is a scale of its phi0
        everywhere = any(e.name == "wall_viscosity" and (e.where == ALL or unseen) for e in effects)
        chance = self.rng.random()
        if self.group.base:
            return self.group.base
        if everywhere:
            return "elastic"
        if names & {*_OF_VISCOUS_WALLS, *OUTSIDE_WALL}:
            return "sheep"
        if "wall_viscosity" in names:
            return "elastic" if chance < 0.5 else "sheep"
        if chance < (0.3 if self.kind == "bench" else 0.15):
            return "elastic"
        return "sheep_nonlinear" if chance > 0.85 else "sheep"

    def _effect(self, name: str, channels: str, pair: bool) -> Effect:
        """One effect; of a pair the upper half of the sizes, so that both can be seen."""
        rng = self.rng
        low, high, opposite = self.sizes[name]
        sign = -1.0 if rng.random() < opposite else 1.0
        if name == "nonlinear_wall_viscosity" and sign > 0.0:
            high = POSITIVE_RATIO
        if name == "wall_stiffness" and sign < 0.0:
            high = min(high, SOFTEST)
        share = rng.uniform(max(0.5, self.group.least) if pair else self.group.least, 1.0)
        size = sign * low * (high / low) ** share
        where = self._where(name, channels)
        if name == "channel_gain" and self.kind == "network" and where[0].endswith(".R"):
            size *= RADIUS_GAIN
        effect = Effect(name, where, float(size), self._second(name))
        if self.group.position is None:
            return effect
        return replace(effect, position=float(rng.uniform(*self.group.position)), length=0.1)

    def _second(self, name: str) -> float:
        rng = self.rng
        if name == "catheter_resonance":  # a catheter that rings, or a slow sensor
            return float(rng.uniform(0.05, 0.3) if rng.random() < 0.6 else rng.uniform(0.8, 2.0))
        bounds = {"fractional_viscosity": (0.2, 0.6), "terminal_compliance": (0.5, 0.9), "swinging_outlet": (0.0, 1.0)}
        bounds["varying_tone"] = (0.0, 1.0)
        return float(rng.uniform(*bounds[name])) if name in bounds else 0.0

    def _where(self, name: str, channels: str) -> tuple[str, ...]:
        rng = self.rng
        if name.startswith("inflow"):
            return ("inlet.Q",)
        if name in CHANNEL:
            names = Case(self.kind, channels, 0.0).names
            return (str(rng.choice(names)),)
        if self.kind == "bench":
            return (channels,)
        if name in ("fluid_friction", "velocity_profile", "unsteady_friction", "fractional_viscosity", *OUTSIDE_WALL):
            return ALL
        if name in (*WALL, "junction_loss") and name != "wall_stiffness" and rng.random() < 0.4:
            return ALL
        places = {"junction_loss": JUNCTIONS}
        for end in ("terminal_reflection", "terminal_compliance", "swinging_outlet"):
            places[end] = OUTLETS
        return (str(rng.choice(places.get(name, SEGMENTS))),)
