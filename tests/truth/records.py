"""Cases with hidden effects, and the records and truths made of them.

A case and a seed give one record: the base network that the workflow is given, the samples of every channel, and the
truth. Every record, nulls too, has its own heart period, waveform and animal (``animal.py``): one scale of all E and
one of all phi0 (20 %), and on the network one shift of all R_t (0.1), on the bench one scale of R0 (1 %); where the
case says so, every wall is off by itself, too.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fitting.records.read.record import write_record
from solver import Network, load

from . import varying
from .anatomy import Anatomy, anatomy
from .animal import Nuisance, nuisance, walls_of_its_own
from .beat import Beat, at_phase
from .bench import bench_wall, radius
from .hide import Effect, hide, parameters, springpot_of
from .network import Balance, Flow
from .sensors import Clock, clock, measured, pulsatile, sensed
from .shapes import MMHG, Arteries, arteries, ejection

Array = np.ndarray

BEATS, FITTED = 20, 15
SITES = ("AA", "PD", "MD", "DD", "BT", "CA", "FA")
CHANNELS = {
    "all": tuple(f"{site}.{kind}" for site in SITES for kind in "PQR"),
    "three pressures": ("AA.P", "CA.P", "FA.P"),
}

SENSORS = {  # standard deviations of pressure [Pa], flow (of its peak) and radius [m]
    "radius 2 µm": (0.3 * MMHG, 0.02, 2e-6),
    "radius 10 µm": (0.3 * MMHG, 0.02, 10e-6),
}
_WALLS = 1  # makes another seed of a record's one, of its walls

# a beat's harmonics: bench walls are solved by dense matrices
_NETWORK_BEAT = (80, 256)
_BENCH_BEAT = (60, 192)


@dataclass(frozen=True)
class Case:
    """What one record hides.

    kind "bench" (P and R of one site, ``channels`` is its name) or "network" (``channels`` a key of CHANNELS; inlet.Q
    is always there). base: "sheep", "elastic" (sheep without wall viscosity) or "sheep_nonlinear". dB: noise. walls:
    how far each wall is off by itself, in the standard deviations of ``animal.INDIVIDUAL``. sensors: a key of SENSORS,
    whose noise is there in place of dB. varying: standard deviations of interval and stroke from beat to beat, of the
    mean; ``Made.clean`` is the steady beat.
    """

    kind: str
    channels: str
    dB: float
    effects: tuple[Effect, ...] = ()
    base: str = "sheep"
    elastic_law: str = "beta"
    viscous_law: str = "monotone"
    walls: float = 0.0
    sensors: str = ""
    varying: tuple[float, float] = (0.0, 0.0)

    @property
    def unlike(self) -> bool:
        """Whether beats differ."""
        return any(self.varying) or any(e.over_beats for e in self.effects)

    @property
    def names(self) -> tuple[str, ...]:
        """The recorded channels."""
        if self.kind == "bench":
            return (f"{self.channels}.P", f"{self.channels}.R")
        return ("inlet.Q", *CHANNELS[self.channels])

    def network(self) -> Network:
        """The base network that the workflow is given."""
        network = load("sheep" if self.base == "elastic" else self.base)
        if self.base == "elastic":
            network = network.with_parameters({f"{s.name}.phi0": 0.0 for s in network.segments})
        return replace(network, elastic_law=self.elastic_law, viscous_law=self.viscous_law)


@dataclass(frozen=True)
class Made:
    """A record and its truth.

    time (n,) [s]; channels (n,) each, SI; base: the network given to the workflow. truth: plain data with the effects,
    their parameters and the nuisance. clean: coefficients of every channel as its sensor shows it, without noise, in
    the steady beat; noise: its standard deviation; drive: coefficients of the true inflow or bench pressure; at and
    samples: phases of the samples, and the channels there without noise; dt, beat and nuisance of the record, for
    ``detect.py``.
    """

    case: Case
    time: Array
    channels: Mapping[str, Array]
    base: Network
    truth: Mapping[str, Any]
    clean: Mapping[str, Array]
    noise: Mapping[str, float]
    drive: Array
    beat: Beat
    nuisance: Nuisance
    at: Clock
    samples: Mapping[str, Array]
    flow: Flow | None = field(default=None, repr=False)

    @property
    def dt(self) -> float:
        return float(self.time[1] - self.time[0])


def make(case: Case, seed: int | tuple[int, ...]) -> Made:
    """The record of a case. The same seed gives the same record.

    Raises NoPeriodicFlow or NoPeriodicRadius if the effects are too large for a periodic state.
    """
    rng = np.random.default_rng(seed)
    harmonics, per_beat = _NETWORK_BEAT if case.kind == "network" else _BENCH_BEAT
    beat = Beat(float(rng.uniform(0.4, 0.6)), harmonics, per_beat)
    animal = nuisance(rng, case.kind)
    base = case.network()
    if case.walls:  # by numbers of their own, so that all else is as without
        animal = walls_of_its_own(_own_rng(seed), animal, anatomy(base), case.walls)
    heart = ejection(rng, beat, base.inlet.Q_max if case.kind == "network" else 1.0)
    bed = None if case.kind == "network" else arteries(rng, beat, heart)
    drive = heart if bed is None else bed.pressure(heart, beat.omega)
    clean, flow = truth_channels(case, anatomy(base), animal, drive, beat)
    noise = _noise(case, clean, beat)
    if case.unlike:
        at, samples = _varying(rng, case, hidden_model(case, anatomy(base), animal), beat, heart, bed, clean)
    else:
        at = clock(rng, beat.T, BEATS)
        samples = {name: at_phase(clean[name], at.phase) for name in case.names}
    channels = {name: measured(rng, samples[name], at, noise[name], beat.T) for name in case.names}
    truth = _truth(case, seed, anatomy(base), animal, beat, clean)
    return Made(case, at.time, channels, base, truth, clean, noise, drive, beat, animal, at, samples, flow)


def _noise(case: Case, clean: Mapping[str, Array], beat: Beat) -> dict[str, float]:
    """Standard deviation of every channel's noise [SI]."""
    if not case.sensors:
        return {name: pulsatile(clean[name]) * 10.0 ** (-case.dB / 20.0) for name in case.names}
    P, Q, R = SENSORS[case.sensors]

    def of(name: str) -> float:
        kind = name.rpartition(".")[2]
        return Q * float(np.abs(beat.values(clean[name])).max()) if kind == "Q" else {"P": P, "R": R}[kind]

    return {name: of(name) for name in case.names}


def _varying(
    rng: np.random.Generator,
    case: Case,
    model: Anatomy,
    beat: Beat,
    heart: Array,
    bed: Arteries | None,
    clean: dict[str, Array],
) -> tuple[Clock, dict[str, Array]]:
    """When a record of unlike beats is sampled, and every channel there without noise."""
    whole = varying.run(rng, beat, BEATS, *case.varying)
    if bed is None:
        long = varying.network_channels(model, whole, heart, points_for(model))
    else:
        long = varying.bench_channels(model, whole, heart, bed, case.channels)
    varying.faulty(long, case.effects, whole, clean)
    at = varying.clock(rng, whole, BEATS)
    samples = at_phase(np.stack([long[name] for name in case.names], axis=1), at.phase)
    return at, dict(zip(case.names, samples.T, strict=True))


def _own_rng(seed: int | tuple[int, ...]) -> np.random.Generator:
    return np.random.default_rng((*(seed if isinstance(seed, tuple) else (seed,)), _WALLS))


def write(made: Made, path: str | os.PathLike[str]) -> None:
    """The record as CSV at ``path``; beside it, with the endings .truth.json, what is hidden."""
    write_record(path, made.time, made.channels, {n: _UNITS[n.rpartition(".")[2]] for n in made.channels})
    Path(path).with_suffix(".truth.json").write_text(json.dumps(made.truth, indent=1))


_UNITS = {"P": "mmHg", "Q": "mL/s", "R": "mm"}


def truth_channels(
    case: Case, base: Anatomy, animal: Nuisance, drive: Array, beat: Beat
) -> tuple[dict[str, Array], Flow | None]:
    """Every recorded channel without noise, coefficients (K + 1,), for the true inflow or pressure ``drive``."""
    model = hidden_model(case, base, animal)
    flow = None
    if case.kind == "network":
        flow = Balance(model, beat, points_for(model)).solve(drive)
        clean = {name: flow.channels[name] for name in case.names}
    else:
        R = radius(bench_wall(model, case.channels, beat), beat.values(drive))
        clean = dict(zip(case.names, (drive, beat.coefficients(R)), strict=True))
    for effect in case.effects:
        if effect.on_channel:
            for name in effect.where:
                clean[name] = sensed(clean[name], effect, beat)
    return clean, flow


def hidden_model(case: Case, base: Anatomy, animal: Nuisance) -> Anatomy:
    """The truth: the animal with all effects of the case."""
    model = animal.applied(base)
    for effect in case.effects:
        model = hide(model, effect)
    return model


def points_for(model: Anatomy) -> int:
    """Points a piece: more where a wall without viscosity, or whose viscous stress relaxes, keeps the waves sharp."""
    return 10 if all(v.phi0 > 0.0 and v.tau == 0.0 for v in model.vessels) else 16


def _truth(
    case: Case,
    seed: int | tuple[int, ...],
    base: Anatomy,
    animal: Nuisance,
    beat: Beat,
    clean: Mapping[str, Array],
) -> dict[str, Any]:
    model = hidden_model(case, base, animal)

    def values(effect: Effect) -> dict[str, float]:
        if effect.name == "channel_offset":  # in the channel's unit; a constant leaves the pulse as it was
            return {f"{name}.offset": effect.size * pulsatile(clean[name]) for name in effect.where}
        if effect.name == "fractional_viscosity":
            share = springpot_of(effect.size, effect.second, beat.T)[0]
            known = {"springpot": share, "springpot_order": effect.second}
            return {f"{name}.{key}": value for name in effect.where for key, value in known.items()}
        return parameters(model, effect)

    return {
        "case": asdict(case),
        "seed": seed,
        "period": beat.T,
        "effects": [asdict(e) | {"parameters": values(e)} for e in case.effects],
        "nuisance": asdict(animal),
    }
