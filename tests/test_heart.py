"""The heart: its laws, its step against an independent integration, and what its inputs and parameters do."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from functools import cache
from itertools import islice, repeat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus import Instance, Store
from scipy.integrate import solve_ivp

from fmu_src.contents.models import heart_model
from fmu_src.slaves import body_slave
from fmu_src.slaves.base import Subject
from fmu_src.slaves.heart_slave import HeartSlave, table
from solver.lumped.heart import OUTPUTS, HeartComponent, HeartState, Port, initial_state, step
from solver.lumped.heart_parts import Heart
from solver.lumped.heart_search import one_by_one
from solver.lumped.species import HUMAN_BODY, HUMAN_HEART, SHEEP_HEART
from solver.quantities.units import MMHG

Array = np.ndarray

MS, ML = 1e-3, 1e-6
P_VENOUS, P_AORTA = 11.0 * MMHG, 80.0 * MMHG
R1, C, R2 = 0.05 * MMHG / ML, 1.6 * ML / MMHG, 1.2 * MMHG / ML  # of a Windkessel
LEAKY = replace(
    HUMAN_HEART,
    mitral_valve=replace(HUMAN_HEART.mitral_valve, regurgitation=0.02),
    aortic_valve=replace(HUMAN_HEART.aortic_valve, regurgitation=0.02),
    aorta=replace(HUMAN_HEART.aorta, curvature=0.0),  # a Windkessel answers a curved flow as the port says
)


def windkessel(heart: Heart, steps: Iterable[float], P_venous: float = P_VENOUS) -> Iterator[HeartState]:
    """The states of a heart on a Windkessel R1, C, R2, integrated by the trapezoidal rule, after these steps [s]."""
    state, P_C = initial_state(heart, 0.0, P_venous, P_AORTA), P_AORTA
    for h in steps:
        a = 0.5 * h / (C * R2)
        kept, Z_0 = (1.0 - a) / (1.0 + a), 0.5 * h / C / (1.0 + a)
        Q = state.aortic.Q
        state = step(heart, state, h, Port(kept * P_C, Z_0 + R1, Z_0), P_venous)
        P_C = kept * P_C + Z_0 * (Q + state.aortic.Q)
        yield state


@cache
def _begun(heart: Heart, h: float) -> tuple[list[HeartState], Iterator[HeartState]]:
    return [], windkessel(heart, repeat(h))


def evenly(heart: Heart, h: float, n: int) -> list[HeartState]:
    """The first n states in equal steps of h, which all tests share."""
    states, further = _begun(heart, h)
    states += islice(further, max(n - len(states), 0))
    return states[:n]


def integrated(heart: Heart, time: Array) -> Array:
    """The same by an implicit Runge-Kutta method with 1e-9 : (n, 4) ventricle and atrium V, aortic Q, P_C."""
    venous, rho = heart.venous.R, heart.heart.rho

    def flow(valve: Any, Q: float, zeta: float, drop: float) -> tuple[float, float]:
        s = valve.regurgitation + (1.0 - valve.regurgitation) * zeta
        loss = 0.5 * rho * math.hypot(Q, 1e-6) / (s * valve.A) ** 2
        opening = valve.K_open * drop * (1.0 - zeta) if drop > 0.0 else valve.K_close * drop * zeta
        return (drop - (valve.R + loss) * Q) * valve.A * s / (rho * valve.l), opening

    def rates(t: float, y: Array) -> list[float]:
        V, V_a, Q_m, Q_a, z_m, z_a, P_C = y.tolist()
        phase = t * heart.heart.rate % 1.0
        ventricle, atrium = heart.left_ventricle, heart.left_atrium
        P = ventricle.P_0 + ventricle.elastance(phase) * (V - ventricle.V_0) - ventricle.R * Q_a
        P_a = atrium.P_0 + atrium.elastance(phase) * (V_a - atrium.V_0)
        dQ_m, dz_m = flow(heart.mitral_valve, Q_m, z_m, P_a - P)
        dQ_a, dz_a = flow(heart.aortic_valve, Q_a, z_a, P - P_C - R1 * Q_a)
        return [Q_m - Q_a, (P_VENOUS - P_a) / venous - Q_m, dQ_m, dQ_a, dz_m, dz_a, (Q_a - P_C / R2) / C]

    start = initial_state(heart, 0.0, P_VENOUS, P_AORTA)
    y0 = [start.V_ventricle, start.V_atrium, 0.0, 0.0, 0.0, 0.0, P_AORTA]
    scale = np.array([1e-4, 1e-4, 1e-4, 1e-4, 1.0, 1.0, 1e4])
    found = solve_ivp(
        lambda t, x: np.array(rates(t, x * scale)) / scale, (0.0, time[-1]), np.array(y0) / scale, "Radau", time,
        rtol=1e-8, atol=1e-9, max_step=2e-3,
    )  # fmt: skip
    return (found.y.T * scale)[:, [0, 1, 3, 6]]


# --- the laws -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heart", [HUMAN_HEART, SHEEP_HEART], ids=lambda heart: heart.name)
def test_elastance(heart: Heart) -> None:
    """E is E_min at rest and contractility E_max at the peak, is continuous, and so is its slope."""
    for chamber in (heart.left_ventricle, heart.left_atrium):
        peak = chamber.elastance((chamber.begin + chamber.rise) % 1.0, 1.3)
        assert peak == pytest.approx(1.3 * chamber.E_max, rel=1e-12)
        assert chamber.elastance((chamber.begin + chamber.rise + chamber.fall + 0.01) % 1.0) == chamber.E_min
        E = np.array([chamber.elastance(phase) for phase in np.linspace(0.0, 2.0, 20001) % 1.0])
        bend = np.abs(np.diff(E, 2)).max() / np.ptp(E)
        assert bend <= 1.1 * 0.5 * (np.pi * 1e-4 / min(chamber.rise, chamber.fall)) ** 2


def test_closed_valves_let_nothing_through() -> None:
    """Against a pressure that the ventricle never reaches the aortic flow is 0, exactly, for three beats."""
    state = initial_state(HUMAN_HEART, 0.0, P_VENOUS, 300.0 * MMHG)
    for _ in range(2700):
        state = step(HUMAN_HEART, state, MS, Port(300.0 * MMHG, 0.0, 0.0), P_VENOUS)
        assert state.aortic.Q == 0.0 == state.aortic.opening
    assert state.ejected == 0.0


@pytest.mark.parametrize("h", [0.5 * MS, 5 * MS])
def test_mitral_valve_does_not_leak(h: float) -> None:
    """While the ventricle ejects, from 0.1 to 0.3 s of a beat, nothing flows back: below 1e-9 of the largest flow."""
    states = evenly(HUMAN_HEART, h, round(2.7 / h))
    Q = np.array([s.mitral.Q for s in states])
    ejecting = np.array([0.1 < s.phase * 0.9 < 0.3 for s in states])
    assert np.abs(Q[ejecting]).max() < 1e-9 * Q.max()


# --- the step -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_against_an_independent_integration() -> None:
    """A heart with leaky valves on a Windkessel: two beats by Radau. Error of order 2 in the step: 9e-5 at 1 ms.

    (Valves that close fully make the equations singular, which only the step itself can handle.)
    """
    errors, steps = [], (4, 2, 1)  # of 0.25 ms
    exact = integrated(LEAKY, np.arange(1, round(1.8 / (0.25 * MS)) + 1) * 0.25 * MS)
    for n in steps:
        states, expected = evenly(LEAKY, n * 0.25 * MS, len(exact) // n), exact[n - 1 :: n]
        found = np.array([[s.V_ventricle, s.V_atrium, s.aortic.Q] for s in states])
        off = np.sqrt(np.mean((found - expected[:, :3]) ** 2, axis=0)) / np.ptp(expected[:, :3], axis=0)
        errors.append(off.max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[0] < 1.2e-4
    assert (orders > 1.9).all() and (orders < 2.1).all()


def test_volumes_are_counted_exactly() -> None:
    """V changes by what the valves let through: trapezoid by trapezoid, to round-off after 20 beats."""
    states = evenly(HUMAN_HEART, 2 * MS, 9000)
    Q = np.array([0.0, *(s.aortic.Q for s in states)])
    assert states[-1].ejected == pytest.approx(np.sum(Q[1:] + Q[:-1]) * MS, rel=1e-13)
    start = initial_state(HUMAN_HEART, 0.0, P_VENOUS, P_AORTA)
    for s in states[::500]:
        held = s.V_ventricle + s.V_atrium - start.V_ventricle - start.V_atrium
        assert held == pytest.approx(s.taken - s.ejected, abs=1e-16)  # of 1e-4 m³


def test_steps_of_any_length() -> None:
    """Steps of 0.2 to 3 ms in random order give the same beat as 1 ms: volume and pressure of the ventricle to 2.4e-3
    and 1.9e-3 of their range, that of the aorta to 7e-3."""
    random = np.random.default_rng(3)
    steps = random.uniform(0.2 * MS, 3 * MS, 1200)
    uneven, even = list(windkessel(HUMAN_HEART, steps.tolist())), evenly(HUMAN_HEART, MS, 2000)
    for key, most in {"V_ventricle": 3e-3, "P_ventricle": 2.5e-3, "P_aorta": 8e-3}.items():
        expected = [getattr(s, key) for s in even]
        t = np.array([s.t for s in uneven])
        inside = t < 1.9
        off = np.interp(t, [s.t for s in even], expected) - [getattr(s, key) for s in uneven]
        assert np.abs(off[inside]).max() < most * np.ptp(expected)


@pytest.mark.parametrize("heart", [HUMAN_HEART, SHEEP_HEART], ids=lambda heart: heart.name)
@pytest.mark.parametrize("h", [pytest.param(0.5 * MS, marks=pytest.mark.slow), MS, 2 * MS, 5 * MS, 20 * MS])
def test_stable(heart: Heart, h: float) -> None:
    """At every step the beats repeat, flows stay below 1.2 L/s and pressures below 200 mmHg."""
    states = evenly(heart, h, round(12 / h))
    assert max(abs(s.aortic.Q) for s in states) < 1.2e-3
    assert max(s.P_ventricle for s in states) < 200.0 * MMHG
    n = round(1.0 / heart.heart.rate / h)
    if abs(n * h * heart.heart.rate - 1.0) < 1e-9:
        assert states[-1].V_ventricle == pytest.approx(states[-1 - n].V_ventricle, rel=2e-3)


# --- parameters and inputs ----------------------------------------------------------------------------------------


def component(heart: Heart = HUMAN_HEART, **starts: float) -> tuple[HeartComponent, dict[str, Any]]:
    """A heart begun at rest, and the values of its variables."""
    values = {v.name: v.start for v in table(heart) if v.start is not None}
    values |= {name.replace("__", "."): value for name, value in starts.items()}
    found = HeartComponent(heart)
    found.initialize(0.0, values)
    return found, values


def test_heart_rate_changes_within_a_beat() -> None:
    """The phase goes on from where it is, and no pressure jumps: a step of 1 ms changes it no more than before."""
    heart, values = component(aorta__Z=0.2 * MMHG / ML, aorta__P_0=75 * MMHG)
    P = [heart.state.P_ventricle]
    for i in range(400):
        if i == 150:  # in the middle of ejection
            heart.retune({"heart.rate": 2.0})
            before = heart.state.phase
        heart.step(i * MS, MS, values)
        P.append(heart.state.P_ventricle)
        if i == 150:
            assert heart.state.phase == pytest.approx(before + 2.0 * MS, rel=1e-12)
    steps = np.abs(np.diff(P))
    assert steps[150] < 1.5 * steps[:150].max()


def test_contractility_raises_pressure_and_stroke() -> None:
    """With 1.5 times the largest elastance a beat against a Windkessel ejects more: by 10 to 25 %."""
    strokes = []
    for factor in (1.0, 1.5):
        heart = replace(HUMAN_HEART, heart=replace(HUMAN_HEART.heart, contractility=factor))
        V = [s.V_ventricle for s in evenly(heart, MS, 3600)[-900:]]
        strokes.append(np.ptp(V))
    assert 1.1 < strokes[1] / strokes[0] < 1.25


def test_regurgitation_leaks() -> None:
    """An aortic valve of which 5 % never closes lets 35 mL back in diastole, near A s sqrt(2 ΔP/ρ); none without."""
    for part, least in ((0.0, 0.0), (0.05, 30 * ML)):
        valve = replace(HUMAN_HEART.aortic_valve, regurgitation=part)
        states = evenly(replace(HUMAN_HEART, aortic_valve=valve), MS, 1800)
        back = -sum(s.aortic.Q for s in states[900:] if 0.5 < s.phase < 0.95) * MS
        assert back > least if part else back == 0.0


def test_nothing_received_yet() -> None:
    """A master that begins with zeros: the heart goes on with the inputs of its start, venous.P included."""
    heart, values = component()
    other, _ = component()
    heart.step(0.0, MS, values)
    other.step(0.0, MS, {**values, **dict.fromkeys(("aorta.P_0", "aorta.Z", "aorta.Z_0", "venous.P"), 0.0)})
    assert heart.outputs() == other.outputs()


def test_zero_pressure_is_a_pressure() -> None:
    """After the first step zeros at the port are what they say: an aorta without pressure."""
    heart, values = component()
    heart.step(0.0, MS, values)
    heart.step(MS, MS, {**values, **dict.fromkeys(("aorta.P_0", "aorta.Z", "aorta.Z_0"), 0.0)})
    assert heart.state.P_aorta == 0.0


def test_extrapolation_after_a_short_step() -> None:
    """venous.P rises by 10 Pa after a step of 1e-6 s: over the 1 ms that follows it is held, not led on to 10 kPa."""
    heart, values = component()
    heart.step(0.0, 1e-6, values)
    heart.step(1e-6, MS, {**values, "venous.P": values["venous.P"] + 10.0})
    held = heart.state.Q_venous
    assert 10 * ML < held < 50 * ML


def test_contractility_of_the_ventricle_alone() -> None:
    """In the first 0.1 ms nothing happens in the atrium, whatever the contractility: 2.6 mL/s from the veins."""
    flows = []
    for factor in (1.0, 2.0):
        heart, values = component(heart__contractility=factor)
        heart.step(0.0, 0.1 * MS, values)
        assert heart.state.P_atrium == pytest.approx(11.2 * MMHG, rel=1e-2)
        flows.append(heart.state.Q_venous)
    assert flows[0] == pytest.approx(2.6 * ML, rel=0.05)
    assert flows[1] == pytest.approx(flows[0], rel=1e-6)


def test_resistance_of_the_ejecting_ventricle() -> None:
    """P = P_0 + E (V - V_0) - R Q in the ventricle, so an open valve has little drop: at the largest flow 4 mmHg.

    Without R in the ventricle but in the valve the same flow leaves it.
    """
    ventricle, valve = HUMAN_HEART.left_ventricle, HUMAN_HEART.aortic_valve
    states = evenly(HUMAN_HEART, MS, 900)
    s = max(states, key=lambda s: s.aortic.Q)
    E = ventricle.elastance(s.phase)
    P = ventricle.P_0 + E * (s.V_ventricle - ventricle.V_0) - ventricle.R * s.aortic.Q
    assert s.P_ventricle == pytest.approx(P, rel=1e-12)
    assert ventricle.R * s.aortic.Q > 20 * MMHG
    assert s.P_ventricle - s.P_aorta < 6 * MMHG
    quick = replace(valve, K_open=1.0, K_close=1.0)
    inside = replace(HUMAN_HEART, aortic_valve=quick)
    outside = replace(HUMAN_HEART, left_ventricle=replace(ventricle, R=0.0), aortic_valve=replace(quick, R=ventricle.R))
    strokes = [evenly(heart, MS, 900)[-1].ejected for heart in (inside, outside)]
    assert strokes[0] == pytest.approx(strokes[1], rel=0.03)


@pytest.mark.parametrize("t", [0.0, 5.0, float("nan")])
def test_time_is_that_of_the_component(t: float) -> None:
    """A step from another time than that where the heart stands, 1 ms, is refused and changes nothing."""
    heart, values = component()
    heart.step(0.0, MS, values)
    before = heart.state
    with pytest.raises(ValueError, match=r"step from t = .* s, but the component stands at 0\.001 s; step on from"):
        heart.step(t, MS, values)
    assert heart.state is before


def test_steps_that_are_too_long() -> None:
    """More than a twentieth of a beat, none or a negative one is refused in a sentence, and nothing has changed."""
    heart, values = component()
    for h in (0.0, -MS, 0.046, 1e9, float("nan")):
        before = heart.state
        with pytest.raises(
            ValueError, match=r"communication step of .*(must be positive|a heart of 1\.11111 beats per second)"
        ):
            heart.step(0.0, h, values)
        assert heart.state is before


def test_contraction_must_fit_into_a_beat() -> None:
    """rise + fall above 1 is refused with the chamber's name."""
    values = {"left_ventricle.rise": 0.6, "left_ventricle.fall": 0.4, "left_atrium.rise": 0.6}
    assert HUMAN_HEART.with_values({**values}).left_ventricle.rise == 0.6
    with pytest.raises(ValueError, match=r"left_ventricle\.rise \+ left_ventricle\.fall = 1\.01: .* shorten them\."):
        HUMAN_HEART.with_values({**values, "left_ventricle.fall": 0.41})


def test_any_parameters() -> None:
    """Random values within their ranges and random steps: a step with finite outputs, or one sentence."""
    random = np.random.default_rng(11)
    numbers = [v for v in table(HUMAN_HEART) if v.start is not None and v.quantity is not None]

    def anything(low: float, high: float) -> float:
        if low < 0.0 or high > 1e12:
            return float(np.clip(random.choice([-1.0, 0.0, 1.0]) * 10 ** random.uniform(-3, 12), low, high))
        return float(np.exp(random.uniform(*np.log([low, high]))) if low > 0.0 else random.uniform(low, high))

    for _ in range(100):
        chosen = [v for v in numbers if random.random() < 0.3 and v.quantity is not None]
        values = {v.name: v.start for v in numbers}
        values |= {v.name: anything(v.quantity.low, v.quantity.high) for v in chosen if v.quantity is not None}
        heart = HeartComponent(HUMAN_HEART)
        try:
            heart.initialize(0.0, values)
            for i in range(20):
                heart.step(i * MS, MS, values)
        except ValueError as error:
            assert str(error).endswith(".")
        if hasattr(heart, "state"):
            assert np.isfinite(heart.outputs()).all()


def test_outputs_are_those_of_the_table() -> None:
    """One value for each output, in order; each parameter has a unit, a range and its start value in it."""
    heart, _ = component()
    assert len(heart.outputs()) == len(OUTPUTS)
    assert tuple(v.name for v in table(HUMAN_HEART) if v.causality == "output") == OUTPUTS
    for variable in (*table(HUMAN_HEART), *table(SHEEP_HEART)):
        if variable.start is not None:
            variable.check(variable.start)


def test_ranges_of_inputs() -> None:
    """Every input has a finite range: an impedance of the arteries is not negative, but its memory may be."""
    inputs = {v.name: v for v in (*table(HUMAN_HEART), *body_slave.table(HUMAN_BODY)) if v.causality == "input"}
    for variable in inputs.values():
        for value in (1e300, -1e300, float("inf")):
            with pytest.raises(ValueError, match="must lie in"):
                variable.check(value)
    with pytest.raises(ValueError, match=r"aorta\.Z = -1 Pa\.s/m\^3 is not allowed"):
        inputs["aorta.Z"].check(-1.0)
    inputs["aorta.Z_0"].check(-2.7e7)  # of network human with ``smooth``


@pytest.mark.parametrize("given", [(math.nan, math.nan), (math.nan, -1.0), (-1.0, math.nan), (math.inf, -math.inf)])
def test_residuals_that_are_not_finite(given: tuple[float, float]) -> None:
    """Are no solution, though the bisection does not move from where it begins."""
    assert not one_by_one(lambda Q_m, Q_a: given, 1e-4, 2e-4)[0]
    found, Q_m, Q_a = one_by_one(lambda Q_m, Q_a: (Q_m - 3e-4, Q_a + Q_m - 4e-4), 1e-4, 2e-4)
    assert found and (Q_m, Q_a) == pytest.approx((3e-4, 1e-4), rel=1e-12)


def test_a_state_without_solution() -> None:
    """A step from a volume that is not a number is refused as one without solution."""
    heart = HUMAN_HEART
    state = replace(initial_state(heart, 0.0, 11 * MMHG, 80 * MMHG), V_ventricle=math.nan)
    with pytest.raises(ValueError, match="the flows through the valves have no solution over a step of 0.001 s"):
        step(heart, state, MS, Port(80 * MMHG, 0.0, 0.0), 11 * MMHG)


# --- the FMU ------------------------------------------------------------------------------------------------------


class Overflowing(HeartComponent):
    """A heart of which an output is infinite after the second step."""

    def outputs(self) -> list[float]:
        found = super().outputs()
        return [*found[:4], float("inf"), *found[5:]] if self.state.t > 1.5 * MS else found


class OverflowingSlave(HeartSlave):
    """Its slave."""

    @classmethod
    def subject(cls, data: Any) -> Subject:
        return replace(super().subject(data), make=lambda: Overflowing(HUMAN_HEART))


def test_no_output_is_infinite(tmp_path: Path) -> None:
    """A step after which an output is not finite is refused with its name, and nothing has changed."""
    data = {"heart": asdict(HUMAN_HEART), "version": "1", "starts": {}}
    (tmp_path / "heart.json").write_text(json.dumps(data))
    slave = OverflowingSlave(instance_name="heart", resources=str(tmp_path))
    slave.setup_experiment(0.0)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    assert slave.do_step(0.0, MS)
    values, state = list(slave.values), slave.component.state
    assert not slave.do_step(MS, MS)
    assert slave.values == values and slave.component.state is state
    assert "venous.Q would be inf: must be finite; check the values" in slave.log_queue[-1].msg


def test_saved_state(stored: Store, tmp_path: Path) -> None:
    """In the middle of ejection and after a change of the heart rate, from the FMU to bytes and back: equal bits."""
    instance = Instance(stored.lumped(heart_model), tmp_path / "heart")
    instance.initialize()
    load = {"aorta.P_0": 78 * MMHG, "aorta.Z": 0.2 * MMHG / ML}

    def run(first: int, last: int) -> list[list[float]]:
        found = []
        for i in range(first, last):
            instance.set(load)
            instance.slave.doStep(i * MS, MS)
            found.append(instance.get())
        return found

    run(0, 150)
    instance.set({"heart.rate": 1.5})
    run(150, 160)
    state = instance.slave.getFMUState()
    expected = run(160, 400)
    blob = instance.slave.serializeFMUState(state)
    instance.set({"heart.rate": 1.0, "heart.contractility": 2.0})
    run(400, 420)
    instance.slave.setFMUState(instance.slave.deSerializeFMUstate(blob))
    assert run(160, 400) == expected
    instance.slave.terminate()
    instance.slave.freeInstance()
