"""Speed and accuracy of the solver on the paper's sheep network: a table, and JSON on request.

    python benchmarks/speed.py [--json FILE] [--small]

CPU time of one thread, the best of several beats in one run; errors against the reference waveforms in tests/data
(relative L2 of the last beat, pressures by their mean-removed norm). A set of a study: the best batch of some. Nothing
here is asserted: see the tests.
"""

from __future__ import annotations

import time

import numpy as np

from arterial_fmu.study.batch import Batch, run_batch
from arterial_fmu.study.models import read_model
from arterial_fmu.study.plan import plan_of
from arterial_fmu.study.varied import parse_varied
from benchmarks.schemes import FOUR, errors
from benchmarks.table import MACHINE, JsonFile, Row, Small, best, show, start
from solver import Settings, Waveforms, load
from solver.network.coefficients import Parameters
from solver.scheme.model import build
from solver.scheme.outputs import reporter
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.stage import operators
from solver.scheme.step import State, initial_state, step

BEATS = 6
SHEEP = load("sheep")
ELASTIC = {f"{segment.name}.phi0": 0.0 for segment in SHEEP.segments}
MANY = {"CA.phi0": np.linspace(7e4, 8e4, 32), "AA.E": np.linspace(1.4e6, 1.6e6, 32)}


def beats(
    parameters: Parameters | None, settings: Settings, count: int
) -> tuple[list[float], np.ndarray, tuple[str, ...]]:
    """CPU seconds of each beat, reporting included; outputs of the last one (n + 1, B, n_outputs); their names."""
    model = build(SHEEP, parameters, settings)
    report = reporter(model)
    state: State = initial_state(model)
    n = round(SHEEP.inlet.T / settings.dt)
    table = np.empty((n + 1, model.coefficients.B, len(report.names)))
    seconds = []
    for beat in range(count):
        inflow = SHEEP.inlet.Q((beat * n + np.arange(n)[:, None] + INFLOW_TIMES) * settings.dt)
        start = time.process_time()
        table[0] = report(state)
        for i in range(n):
            state = step(model, state, settings.dt, inflow[i])
            table[i + 1] = report(state)
        seconds.append(time.process_time() - start)
    return seconds, table, report.names


def solver_rows(count: int) -> list[Row]:
    """A beat to a stated error, viscoelastic and elastic; a batch against one run; the operators."""
    rows = []
    cases = (
        (
            "viscoelastic beat, P and Q at MD and CA within 1e-3",
            None,
            Settings(dt=5e-3, tolerance=1e-3),
            "sheep_kelvin_voigt",
            35.0,
        ),
        ("viscoelastic beat, the same within 1e-4", None, Settings(dt=2.5e-3), "sheep_kelvin_voigt", 250.0),
        ("viscoelastic beat at the default settings", None, Settings(), "sheep_kelvin_voigt", None),
        ("elastic beat, the same within 5e-3", ELASTIC, Settings(), "sheep_elastic", 400.0),
    )
    for what, parameters, settings, file, target in cases:
        seconds, table, names = beats(parameters, settings, count)
        beat = Waveforms(
            settings.dt * np.arange(len(table)), dict(zip(names, table[:, 0].T, strict=True)), {}, count, 0.0
        )
        found = errors(beat, file)
        reached = max(found[name] for name in FOUR)
        rows.append(Row(what, 1e3 * min(seconds), "ms", target, f"error {reached:.1e}, dt {1e3 * settings.dt:g} ms"))
    one = min(beats({name: value[0] for name, value in MANY.items()}, Settings(), count)[0])
    batch = min(beats(MANY, Settings(), count)[0])
    rows.append(Row("batch of 32 parameter sets, against one", batch / one, "x", 3.0, f"{1e3 * batch:.0f} ms a beat"))
    model = build(SHEEP)
    first = best(lambda: operators(build(SHEEP), 1e-3)) - best(lambda: build(SHEEP))
    rows.append(Row("building the operators", 1e3 * first, "ms", 5.0))
    operators(model, 1e-3)
    rows.append(Row("the same, cached", 1e3 * best(lambda: operators(model, 1e-3)), "ms"))
    return rows


def study_rows(batches: int) -> list[Row]:
    """A parameter set of a study, at steps of 2.5 ms (the default) and 5 ms: the best batch, without the recording."""
    rows = []
    for dt, target in (("2.5 ms", 2.9), ("5 ms", None)):
        model = read_model("sheep", None, dt, None, 1e-4)
        varied = parse_varied(["CA.phi0=10..120kPa*s", "all.E=0.8..1.2x"], model.known, model.nominal, model.name)
        plan, seconds = plan_of(model, varied, 512, 1, "MD,CA"), []
        for sets in plan.batches[: 1 + batches]:
            batch = Batch(plan.model, sets, plan.parameters(sets), tuple(plan.measures), plan.waves)
            start = time.process_time()
            run_batch(batch)
            seconds.append((time.process_time() - start) / len(sets))
        set_of = min(seconds[1:])
        note = f"batch of {len(sets)}, two ranges, two sites; 4096 sets: {4096 * set_of:.0f} s of CPU time"
        rows.append(Row(f"a set of a study, steps of {dt}", 1e3 * set_of, "ms", target, note))
    return rows


def main(
    json_file: JsonFile = None,
    small: Small = False,
) -> None:
    """Measure and print."""
    rows = solver_rows(1 if small else BEATS) + study_rows(1 if small else 7)
    show(rows, MACHINE, json_file)


if __name__ == "__main__":
    start(main)
