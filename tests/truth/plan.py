"""The lists of cases of the bank: which effects, where, how large, in how much noise; drawn from ranges fixed here.

Sizes are log-uniform from hardly visible to typical or above: d' about 1 to 1000 at 40 dB. A quarter of the cases are
nulls, a tenth is outside the catalogue, a tenth has two effects; the rest goes round all effects in turn, each at a
random place. The order is shuffled, so that any first part of a plan is a fair sample of it. Tuning uses its own seed,
and a reported seed whose records were looked at becomes one of tuning (20260401 and
20261121 have).
"""

from __future__ import annotations

import numpy as np

from .hide import ALL, CHANNEL, OUTSIDE, OUTSIDE_WALL, WALL, Effect
from .records import SITES, Case

TUNING_SEED = 11
REPORTED_SEED = 20270315
REPORTED = {"bench": 1200, "network": 400}  # of these a quarter are nulls

SHARE_NULL, SHARE_OUTSIDE, SHARE_PAIR = 0.25, 0.1, 0.1
NOISE = {40.0: 0.5, 30.0: 0.35, 20.0: 0.15}

SEGMENTS = (*SITES, "VA1", "VA2", "VA3")
OUTLETS = ("CA", "FA", "VA1", "VA2", "VA3")
JUNCTIONS = ("AA", "BT", "PD", "MD", "DD")

# smallest and largest size (see Effect), and the share of cases with the opposite sign
BENCH_SIZES: dict[str, tuple[float, float, float]] = {
    "wall_viscosity": (3e-5, 0.03, 0.0),
    "nonlinear_wall_viscosity": (0.02, 1.4, 0.6),
    "nonlinear_elasticity": (0.1, 5.0, 0.0),
    "stress_relaxation": (5e-4, 0.3, 0.0),
    "external_pressure": (300.0, 1.5e4, 0.5),
    "channel_lag": (1e-4, 1e-2, 0.0),
    "channel_gain": (1e-3, 0.2, 0.5),
    "channel_offset": (0.02, 2.0, 0.5),
    "catheter_resonance": (0.01, 0.1, 0.0),
    "springpot": (0.01, 1.0, 0.0),
    "cubic_rate": (0.02, 2.0, 0.0),
}
NETWORK_SIZES: dict[str, tuple[float, float, float]] = {
    "wall_viscosity": (1e-5, 0.02, 0.0),
    "nonlinear_wall_viscosity": (5e-3, 1.4, 0.6),
    "nonlinear_elasticity": (0.02, 5.0, 0.0),
    "stress_relaxation": (2e-4, 0.1, 0.0),
    "external_pressure": (1.0, 1500.0, 0.5),
    "wall_stiffness": (3e-4, 0.5, 0.5),
    "taper": (3e-3, 0.4, 0.7),
    "fluid_friction": (3e-3, 2.0, 0.0),
    "velocity_profile": (0.01, 0.33, 0.0),
    "unsteady_friction": (3e-3, 1.0, 0.0),
    "terminal_reflection": (3e-4, 0.4, 0.5),
    "terminal_compliance": (1e-4, 0.2, 0.0),
    "side_branch": (2e-3, 0.3, 0.0),
    "stenosis": (0.05, 100.0, 0.0),
    "junction_loss": (0.01, 1.0, 0.0),
    "channel_lag": (1e-5, 0.01, 0.0),
    "channel_gain": (3e-4, 0.1, 0.5),
    "channel_offset": (3e-4, 0.2, 0.5),
    "catheter_resonance": (7e-3, 0.07, 0.0),
    "springpot": (0.01, 1.0, 0.0),
    "cubic_rate": (5e-3, 0.5, 0.0),
    "swinging_outlet": (1e-3, 0.3, 0.0),
    "inflow_bent": (1e-3, 0.2, 0.5),
    "inflow_rectified": (5e-3, 1.0, 0.0),
}
_POSITIVE_RATIO = 0.5  # φ_NL/φ0 of the positive sign ends here, as in the paper: beyond, the upstroke stiffens at once

_RADIUS_GAIN = 0.01  # a radius pulsates by a few per cent of its mean, so that a gain shows a hundred times more


def plan(kind: str, n: int, seed: int) -> list[Case]:
    """n cases of a kind, "bench" or "network"; the same seed, the same plan."""
    rng = np.random.default_rng((seed, ("bench", "network").index(kind), n))
    draw = _Draw(kind, rng)
    nulls, outside, pairs = (round(n * share) for share in (SHARE_NULL, SHARE_OUTSIDE, SHARE_PAIR))
    names = [name for name in draw.sizes if name not in OUTSIDE]
    beyond = [name for name in draw.sizes if name in OUTSIDE]
    lists: list[tuple[str, ...]] = [()] * nulls + [(beyond[i % len(beyond)],) for i in range(outside)]
    lists += [draw.pair(names) for _ in range(pairs)]
    lists += [(names[i % len(names)],) for i in range(n - len(lists))]
    cases = [draw.case(each) for each in lists]
    return [cases[i] for i in rng.permutation(n)]


def seed_of(kind: str, seed: int, i: int) -> tuple[int, int, int]:
    """The seed of record i of a plan, for :func:`~.records.make`."""
    return (seed, ("bench", "network").index(kind), i)


class _Draw:
    """Random places, sizes and circumstances."""

    def __init__(self, kind: str, rng: np.random.Generator) -> None:
        self.kind, self.rng = kind, rng
        self.sizes = BENCH_SIZES if kind == "bench" else NETWORK_SIZES

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
        effects = tuple(self._effect(name, channels, len(names) == 2) for name in names)
        law = "regression" if self.kind == "bench" and rng.random() < 0.3 else "beta"
        base = self._base(effects)
        return Case(self.kind, channels, dB, effects, base, law, self._viscous_law(base, effects))

    def _viscous_law(self, base: str, effects: tuple[Effect, ...]) -> str:
        """The paper's quadratic law now and then, but not where its effective viscosity would change sign."""
        softens = any(e.name == "nonlinear_wall_viscosity" and e.size < 0.0 for e in effects)
        if base == "sheep_nonlinear" or softens or self.rng.random() > 0.3:
            return "monotone"
        return "quadratic"

    def _base(self, effects: tuple[Effect, ...]) -> str:
        """Viscosity is hidden in elastic walls, in one segment also in viscous ones; what needs φ0 has it."""
        names = {e.name for e in effects}
        everywhere = any(e.name == "wall_viscosity" and (e.where == ALL or self.kind == "bench") for e in effects)
        chance = self.rng.random()
        if everywhere:
            return "elastic"
        if names & {"nonlinear_wall_viscosity", "stress_relaxation", *OUTSIDE_WALL}:
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
            high = _POSITIVE_RATIO
        share = rng.uniform(0.5, 1.0) if pair else rng.random()
        size = sign * low * (high / low) ** share
        where = self._where(name, channels)
        if name == "channel_gain" and self.kind == "network" and where[0].endswith(".R"):
            size *= _RADIUS_GAIN
        return Effect(name, where, float(size), self._second(name))

    def _second(self, name: str) -> float:
        rng = self.rng
        if name == "catheter_resonance":  # a catheter that rings, or a slow sensor
            return float(rng.uniform(0.05, 0.3) if rng.random() < 0.6 else rng.uniform(0.8, 2.0))
        bounds = {"springpot": (0.2, 0.6), "terminal_compliance": (0.5, 0.9), "swinging_outlet": (0.0, 1.0)}
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
        if name in ("fluid_friction", "velocity_profile", "unsteady_friction", *OUTSIDE_WALL):
            return ALL
        if name in (*WALL, "junction_loss") and name != "wall_stiffness" and rng.random() < 0.4:
            return ALL
        places = {"junction_loss": JUNCTIONS}
        for end in ("terminal_reflection", "terminal_compliance", "swinging_outlet"):
            places[end] = OUTLETS
        return (str(rng.choice(places.get(name, SEGMENTS))),)
