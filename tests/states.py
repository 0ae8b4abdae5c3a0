"""Recordings of one animal in several states, by the independent generator: each has its rate, pressure and stroke."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from truth.anatomy import anatomy
from truth.animal import nuisance, walls_of_its_own
from truth.beat import Beat, at_phase
from truth.hide import Effect
from truth.records import BEATS, Case, truth_channels
from truth.sensors import clock, measured, pulsatile
from truth.shapes import MMHG, arteries, ejection

from fitting.records.read.record import Record

_HARMONICS = {"bench": (60, 192), "network": (80, 256)}


@dataclass(frozen=True)
class State:
    """period : of the heart [s]. level : change of the mean pressure [mmHg], of a bench. flow : of the inflow, or of
    the pulse of a bench's pressure. effects : that act in this state alone."""

    period: float = 0.5
    level: float = 0.0
    flow: float = 1.0
    effects: tuple[Effect, ...] = ()


REST, OTHER = State(), State(0.32, 25.0, 1.1)


def recorded(case: Case, seed: int, states: Sequence[State] = (REST, OTHER)) -> list[Record]:
    """A recording in each state: the same animal, hidden effects and sensors; heart and noise of each its own."""
    base = case.network()
    animal = nuisance(np.random.default_rng(seed), case.kind)
    if case.walls:
        animal = walls_of_its_own(np.random.default_rng((seed, 1)), animal, anatomy(base), case.walls)
    found = []
    for i, state in enumerate(states):
        rng = np.random.default_rng((seed, 2, i))
        beat = Beat(state.period, *_HARMONICS[case.kind])
        heart = ejection(rng, beat, base.inlet.Q_max if case.kind == "network" else 1.0)
        if case.kind == "bench":
            bed = arteries(rng, beat, heart)
            drive = replace(bed, mean=95.0 * MMHG, pulse=(40.0 * state.flow, bed.pulse[1])).pressure(heart, beat.omega)
            drive[0] += state.level * MMHG
        else:
            drive = state.flow * heart
        hidden = replace(case, effects=(*case.effects, *state.effects))
        clean, _ = truth_channels(hidden, anatomy(base), animal, drive, beat)
        at = clock(rng, beat.T, BEATS)
        channels = {
            name: measured(
                rng, at_phase(clean[name], at.phase), at, pulsatile(clean[name]) * 10 ** (-case.dB / 20), beat.T
            )
            for name in case.names
        }
        found.append(Record(f"{'ABCD'[i]}.csv", f"{i}" * 64, at.time, channels, {}))
    return found
