"""The body: a reservoir that counts volumes, whatever the order in which a master runs the components."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fmu_src.slaves.body_slave import table
from solver.lumped.body import BodyComponent
from solver.lumped.species import HUMAN_BODY, SHEEP_BODY
from solver.quantities.units import MMHG

MS, ML = 1e-3, 1e-6


def component(**starts: Any) -> tuple[BodyComponent, dict[str, Any]]:
    """A body begun at P_start, and the values of its variables."""
    values = {v.name: v.start for v in table(HUMAN_BODY) if v.start is not None}
    values |= {name.replace("__", "."): value for name, value in starts.items()}
    body = BodyComponent(HUMAN_BODY)
    body.initialize(0.0, values)
    return body, values


def arrived(t: float) -> float:
    """A volume that grows with a wave: 80 mL/s ± 40 mL/s."""
    return 80 * ML * t + 40 * ML / 5.0 * np.sin(5.0 * t)


def test_initial_dependencies_are_complete() -> None:
    """An initial output changes with a variable only if the FMU's description lists it, whatever volumes are set."""
    variables = table(HUMAN_BODY)
    outputs = [variable for variable in variables if variable.causality == "output"]
    for volumes in ({}, {"arteries__V": 60 * ML, "heart__V": 19 * ML}):
        body, values = component(**volumes)
        for known in (variable for variable in variables if variable.quantity and variable.start is not None):
            other, _ = component(**{**volumes, known.name.replace(".", "__"): 1.01 * values[known.name] + 1e-9})
            for output, before, after in zip(outputs, body.outputs(), other.outputs(), strict=True):
                assert abs(after - before) <= 1e-9 * abs(before) or known.name in output.sources, (
                    output.name,
                    known.name,
                )


def test_pressure_of_the_volume() -> None:
    """P = (V - V_unstressed)/C; the volume is that of the start, what came and what went, to round-off."""
    body, values = component()
    assert body.outputs()[0] == pytest.approx(11.2 * MMHG, rel=1e-12)
    V = body.outputs()[1]
    body.step(0.0, MS, {**values, "arteries.V": 60 * ML, "heart.V": 19 * ML})
    P, after = body.outputs()
    assert after - V == pytest.approx(41 * ML, rel=1e-12)
    assert P == pytest.approx(12.2 * MMHG, rel=1e-12)  # C = 41 mL/mmHg


def test_extrapolates_what_is_not_known_yet() -> None:
    """Inputs for the start of a step: the volume at its end is extrapolated, with an error of h² V'' (order 2)."""
    errors = []
    for h in (4 * MS, 2 * MS):
        body, values = component(body__exchange="start")
        V = body.outputs()[1]
        off = []
        for i in range(500):
            body.step(i * h, h, {**values, "arteries.V": arrived(i * h)})
            off.append(body.outputs()[1] - V - arrived((i + 1) * h))
        errors.append(np.abs(off[1:]).max())
    assert errors[1] == pytest.approx((2 * MS) ** 2 * 200 * ML, rel=0.05)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_extrapolation_after_a_short_step() -> None:
    """1 mL came in 1e-6 s: over the 1 ms that follows the volume is held, not led on by a litre."""
    body, values = component(body__exchange="start")
    V = body.outputs()[1]
    body.step(0.0, 1e-6, values)
    body.step(1e-6, 1e-6, {**values, "arteries.V": ML})
    body.step(2e-6, MS, {**values, "arteries.V": 2 * ML})
    assert body.outputs()[1] - V == pytest.approx(2 * ML, rel=1e-9)


@pytest.mark.parametrize("t", [0.0, 5.0])
def test_time_is_that_of_the_component(t: float) -> None:
    """A step from another time than that where the body stands is refused and changes nothing."""
    body, values = component()
    body.step(0.0, MS, values)
    before = body.state
    with pytest.raises(ValueError, match=r"step from t = .* s, but the component stands at 0\.001 s; step on from"):
        body.step(t, MS, values)
    assert body.state is before


def test_nothing_is_lost_over_many_steps() -> None:
    """80 mL in and out in each of a thousand steps: the volume stays to 1e-15 m³, as no flows are added up."""
    body, values = component()
    V = body.outputs()[1]
    for i in range(1, 1001):
        moved = 80 * ML * i
        body.step(i - 1.0, 1.0, {**values, "arteries.V": moved, "heart.V": moved})
    assert body.outputs()[1] == pytest.approx(V, abs=1e-15)


def test_compliance_is_tunable() -> None:
    """A lower compliance raises the pressure of the same volume."""
    body, values = component()
    before = body.outputs()[0]
    body.retune({"body.C": 0.5 * HUMAN_BODY.body.C})
    assert body.outputs()[0] == pytest.approx(2.0 * before, rel=1e-12)
    assert body.body.body.P_start == HUMAN_BODY.body.P_start


@pytest.mark.parametrize("h", [0.0, -MS, float("inf"), float("nan")])
def test_bad_steps(h: float) -> None:
    """A step that is not positive is refused in a sentence."""
    body, values = component()
    with pytest.raises(ValueError, match=r"communication step of .* s: must be positive\."):
        body.step(0.0, h, values)


def test_start_values_are_allowed() -> None:
    """Each parameter of both species lies in its range."""
    for variable in (*table(HUMAN_BODY), *table(SHEEP_BODY)):
        if variable.start is not None:
            variable.check(variable.start)
