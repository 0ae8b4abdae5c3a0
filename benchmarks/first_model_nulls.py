"""How often something is named in animals in which nothing is hidden, judged by a first model.

    python benchmarks/first_model_nulls.py [--first N] [--animals N]

Each animal is an independent draw, by its number: the human arteries of ``tests/truth``, scaled to a pig, sheep or dog,
each with its own lengths, walls and loads. Beats vary by themselves and with breathing, which also moves all pressures;
sensors have noise, hum and a resolution. ``first`` makes a model of far fewer vessels from the flow and one to three
pressures, and the search of ``discover`` judges the recording by it. Every name is false.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Annotated

import numpy as np
import typer

from benchmarks.hidden.row import borne_out, held_out
from benchmarks.table import start
from discrepancy.find.study import prepare
from discrepancy.name.model_selection import name as named_by
from discrepancy.options import TIME_LIMIT
from fitting.first.fitted import spread
from fitting.first.model import first_model
from fitting.inference.runs import Runs
from fitting.records.alignment.align import align
from fitting.records.read.record import Record
from solver import load
from solver.network.files import loads
from solver.quantities.units import MMHG
from tests.truth.anatomy import Anatomy, Place, anatomy
from tests.truth.animal import Nuisance, walls_of_its_own
from tests.truth.beat import Beat, at_phase
from tests.truth.network import Balance
from tests.truth.shapes import ejection
from tests.truth.varying import Run

PLACES = {"Ao": ("AsA", 0.3), "Fem": ("RI", 0.9), "Car": ("LC", 0.7)}
SITES = (("Ao",), ("Ao", "Fem"), ("Ao", "Car"), ("Ao", "Fem", "Car"))
SPECIES = {"pig": (25.0, 50.0, 0.6), "sheep": (40.0, 75.0, 0.65), "dog": (18.0, 30.0, 0.5)}  # masses [kg], beat [s]
BREATH, HARMONICS = 3.0, 24  # s; of a beat


def animal(rng: np.random.Generator, mass: float, resistance: float, storage: float, bend: float) -> Anatomy:
    """Human arteries scaled to a mass [kg]. resistance : of all loads together [mmHg s/mL]. storage : factor of their
    compliances. bend : E_NL/E."""
    m, s, longer = anatomy(load("human")), (mass / 75.0) ** 0.375, (mass / 75.0) ** 0.3
    vessels, ends = list(m.vessels), list(m.ends)
    for i, v in enumerate(vessels):
        v = replace(v, L=v.L * longer * rng.uniform(0.85, 1.2), E=v.E * rng.uniform(0.8, 1.3))
        vessels[i] = replace(v, R0=v.R0 * s, h=v.h * s, e=bend)
    m = replace(m, vessels=tuple(vessels), P_ref=75.0 * MMHG, P_0=75.0 * MMHG)
    m = walls_of_its_own(rng, Nuisance(), m, 1.0).applied(m)
    factor = resistance * 1e6 * MMHG * sum(1.0 / (end.R1 + end.R2) for end in ends)
    for i, end in enumerate(ends):
        R, C = np.array([(end.R1 + end.R2) * factor, end.C * storage]) * np.exp(0.2 * rng.standard_normal(2))
        ends[i] = replace(end, R1=end.R1 / s**2, R2=R - end.R1 / s**2, C=C)
    return replace(m, ends=tuple(ends))


def unlike(rng: np.random.Generator, n: int, T: float, rate: float, swing: float) -> tuple[Run, int]:
    """n beats, and the number of breaths. rate : standard deviation of intervals. swing : of strokes, by breathing."""
    breaths, onset, stroke, t = max(1, round(n * T / BREATH)), [], [], 0.0
    for phase in 2.0 * np.pi * breaths * np.arange(n) / n:
        onset.append(t)
        stroke.append(1.0 + 0.02 * rng.standard_normal() + swing * np.sin(phase))
        t += T * (1.0 + rate * rng.standard_normal() + 0.02 * np.sin(phase + 0.5))
    return Run(Beat(t, n * HARMONICS, n * 80, T), np.array(onset), np.array(stroke)), breaths


def sensed(rng: np.random.Generator, name: str, t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A wave with noise, in steps of its sensor; a pressure with hum of the mains."""
    noise, hum, step = rng.standard_normal(len(x)), np.sin(100.0 * np.pi * t), 0.05 * MMHG
    if name == "inlet.Q":
        return np.round((x + 0.012 * np.ptp(x) * noise) / 1e-7) * 1e-7
    return np.round((x + 0.15 * MMHG * noise + step * hum) / step) * step


def recorded(seed: int) -> tuple[Record, str, float]:
    """The recording of an animal, its species and its mass [kg]."""
    rng, own = np.random.default_rng(9000 + seed), np.random.default_rng(9100 + seed)
    sites, species = SITES[seed % len(SITES)], tuple(SPECIES)[seed % len(SPECIES)]
    mass = {name: rng.uniform(least, most) for name, (least, most, _) in SPECIES.items()}[species]
    T, flow = SPECIES[species][2] * rng.uniform(0.85, 1.2), 1.5 * rng.uniform(0.8, 1.15)  # s, mL/s/kg
    resistance, n = (90.0 + 10.0 * rng.standard_normal()) / (flow * mass), int(rng.integers(45, 80))
    storage, bend, hz = rng.uniform(0.8, 1.4), rng.uniform(0.5, 1.0), int(rng.choice([250, 500, 1000]))
    thorax, swing, rate = rng.uniform(1.0, 4.0), rng.uniform(0.03, 0.1), rng.uniform(0.01, 0.04)
    truth = replace(animal(own, mass, resistance, storage, bend), places=tuple(Place(s, *PLACES[s]) for s in sites))
    run, breaths = unlike(own, n + 2, T, rate, swing)
    once = ejection(own, Beat(T, HARMONICS, 160), 1.0)
    X = {"inlet.Q": run.flow(once * (flow * mass * 1e-6 / once[0].real))}
    found, breathing = Balance(truth, run.beat, 8).solve(X["inlet.Q"], tolerance=1e-6), np.zeros_like(X["inlet.Q"])
    breathing[breaths] = -0.5j * thorax * MMHG
    for name in (f"{site}.P" for site in sites):
        X[name] = (found.channels[name] + breathing) / (1.0 + 1j * run.beat.omega / (2e3 * np.pi))
    t = np.arange(int(n * T * hz)) / hz + 0.37
    waves = {name: sensed(own, name, t, at_phase(c, np.mod(t / run.beat.T, 1.0))) for name, c in X.items()}
    return Record(f"animal {seed}", "", t - t[0], waves, {}), species, mass


def main(first: Annotated[int, typer.Option(min=0)] = 0, animals: Annotated[int, typer.Option(min=1)] = 12) -> None:
    """A line for each animal: the gap to held-out beats without effect, the verdict and what it cost."""
    named = 0
    for seed in range(first, first + animals):
        record, species, mass = recorded(seed)
        paths = ("Ao,Fem", "Ao,Car") if len(record.channels) > len(SITES[1]) + 1 else ()
        network = loads(first_model(align(record), species, mass=round(mass), paths=paths).text, record.path)
        start, runs = (
            time.process_time(),
            Runs(deadline=time.process_time() + TIME_LIMIT, clock=time.process_time),
        )
        study = prepare(record, network, runs=runs, prior=spread(network))
        naming = borne_out(record, study, named_by(study.problem, study.terms, runs))
        gap, cost = held_out(study, {"none": naming.base.fit}).get("none", math.nan), time.process_time() - start
        names, n = [m.label for m in naming.members if naming.adds], runs.meter.simulations
        named += naming.adds
        print(f"{seed} {species}: gap {gap:.2f}, {naming.verdict} {names}, {n} simulations, {cost:.0f} s", flush=True)
    print(f"something is named in {named} of {animals}")


if __name__ == "__main__":
    start(main)
