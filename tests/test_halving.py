"""Steps that do not converge are cut into halves: the grid stays, and the result says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fmu_src.cosimulation.arteries import CoSimulation
from fmu_src.variables.arteries_variables import variable_table
from solver import Network, NonPhysicalState, Settings, simulate
from solver.errors import NotConverged
from solver.scheme.model import build
from solver.scheme.sdirk import HALVES, INFLOW_TIMES
from solver.scheme.step import initial_state, parts, step

Array = np.ndarray

LONG = Settings(dt=5e-3)


@pytest.fixture
def elastic(sheep: Network) -> Network:
    return sheep.with_parameters({f"{s.name}.phi0": 0.0 for s in sheep.segments})


def jumping(t: Array) -> Array:
    """1 L/s, twenty times the sheep's peak, switched on and off ten times a second."""
    return 1e-3 * (np.mod(t, 0.2) > 0.1)


def test_cubic_in_halves() -> None:
    """The inflow of the halves is the cubic of the whole step: to 1e-15."""
    cubic = np.polynomial.Polynomial([1.0, -2.0, 3.0, 5.0])
    for half, drive in enumerate(HALVES @ cubic(INFLOW_TIMES)):
        np.testing.assert_allclose(drive, cubic(0.5 * (half + INFLOW_TIMES)), rtol=1e-14)


def test_result_says_so(elastic: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """Elastic walls under a jumping inflow in steps of 5 ms: halved, the same times; broken down where none may be."""
    run = simulate(elastic, jumping, 0.225, settings=LONG)
    assert run.halved > 0 and f"({run.halved} times)" in run.notes[0]
    np.testing.assert_allclose(run.time, LONG.dt * np.arange(46), rtol=1e-14)
    assert np.isfinite(run["AA.P"]).all()
    assert simulate(elastic, duration=0.02, settings=LONG).notes == ()
    monkeypatch.setattr("solver.scheme.step._HALVINGS", 0)
    with pytest.raises(NotConverged, match=r"^segment \w+ at x = "):
        simulate(elastic, jumping, 0.225, settings=LONG)


def test_parts_of_a_step(elastic: Network) -> None:
    """The parts end where the step ends, with the inflow that is given there: to 1e-12."""
    model, dt, cut = build(elastic, settings=LONG), LONG.dt, 0
    state = initial_state(model)
    for i in range(45):
        drive = jumping((i + INFLOW_TIMES) * dt)
        found = parts(model, state, dt, drive)
        cut += len(found) > 1
        assert found[-1].Q[0, model.mesh.inlet_element, 0] == pytest.approx(drive[-1], rel=1e-12, abs=1e-17)
        assert found[-1].t == state.t + dt
        state = found[-1]
    assert cut > 0


def test_given_up(elastic: Network) -> None:
    """What no part of a step can do is refused with the sentence of the whole step, at its end."""
    model = build(elastic, settings=LONG)
    with pytest.raises(NonPhysicalState, match=r"t = 0\.005 s: the area fell to zero"):
        step(model, initial_state(model), LONG.dt, np.full(4, -2e-2))


def test_component(elastic: Network) -> None:
    """The FMU's component goes on as well, and has a remark for the log after just the steps that were halved."""
    component = CoSimulation(elastic, LONG)
    values = {v.name: v.start for v in variable_table(elastic, LONG)} | {"inlet.interpolation": "hold"}
    component.initialize(0.0, values)
    remarks = []
    for i in range(45):
        component.step(i * LONG.dt, LONG.dt, {**values, "inlet.Q": float(jumping(np.array((i + 0.5) * LONG.dt)))})
        remarks.append(component.remark)
    assert "" in remarks and any("did not converge and was cut into halves" in text for text in remarks)


def test_count_is_of_the_run(elastic: Network) -> None:
    """A state that is taken over keeps its count, a new run begins at none."""
    model = build(elastic, settings=LONG)
    state = replace(initial_state(model), halved=3)
    assert step(model, state, LONG.dt, np.zeros(4)).halved == 3
