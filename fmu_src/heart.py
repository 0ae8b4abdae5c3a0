"""A left heart: ventricle and atrium of time-varying elastance, two valves, filled from the veins; without FMI.

Chambers (Suga, Sagawa, Shoukas, Circ. Res. 32, 314 (1973)), with an activation e(t) between 0 and 1:

    P = P_0 + E(t) (V - V_0),     E(t) = E_min + (contractility E_max - E_min) e(t)

Valves (Mynard, Davidson, Penny, Smolich, Int. J. Numer. Meth. Biomed. Eng. 28, 626 (2012), doi:10.1002/cnm.1466), with
the open part s = r + (1 - r) ζ of the area A, r the part that never closes; a resistance R lies in series:

    ΔP = (ρ l / A s) dQ/dt + R Q + ρ |Q| Q / 2 (A s)²
    dζ/dt = K_open ΔP (1 - ζ)  where ΔP > 0,   K_close ΔP ζ  where ΔP < 0

Filling: venous.P - P_atrium = R_venous Q_venous. Load: the port of the arteries, :class:`Port`.

One implicit step per communication step, of second order. Volumes by the trapezoidal rule, so that what leaves the
ventricle is h (Q(t) + Q(t+h))/2, which is what arteries take up whose inflow is linear in time. Momentum by the second
backward difference (BDF2) and openings by the exponential of the mean rates, because the trapezoidal rule would ring
where a valve closes: there the resistance grows without bound.

The port is that of an inflow that is straight over a step, but the flow is curved. An artery that answers a jump of the
flow with a pressure that falls as t^-1/2, as a viscoelastic one does at first, answers a curved flow with the pressure
P + β Z (Q(t+h) - 2 Q(t) + Q(t-h)), β = 0.21; an elastic one, whose pressure does not fall, with β = 0. Without this
term the pair is of order 1.5.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from solver.quantity import quantity

from .component import Component
from .lumped import with_values
from .state import Kind, dataclasses

_CLOSED = 1e-12  # an opening below this counts as none
_LAMINAR = 1e-6  # m³/s, below which the loss of a valve is linear in the flow
_LARGEST_STEP = 0.05  # of a beat
_ITERATIONS = 60


@dataclass(frozen=True)
class Chamber:
    """An elastic chamber. Times are parts of a beat, which begins with the contraction of the ventricle."""

    E_max: float = quantity(None, "Pa/m^3", "largest elastance", 1e3, 1e11, nominal=1e8, display="mmHg/mL")
    E_min: float = quantity(None, "Pa/m^3", "smallest elastance", 1e3, 1e11, nominal=1e7, display="mmHg/mL")
    V_0: float = quantity(None, "m^3", "volume at the pressure P_0", 0.0, 1e-2, nominal=1e-5, display="mL")
    P_0: float = quantity(None, "Pa", "pressure at the volume V_0", -1e4, 1e4, nominal=100.0, display="mmHg")
    begin: float = quantity(None, "1", "begin of the contraction, part of a beat", 0.0, 1.0)
    rise: float = quantity(None, "1", "duration of the contraction, part of a beat", 0.01, 0.6)
    fall: float = quantity(None, "1", "duration of the relaxation, part of a beat", 0.01, 0.4)

    def elastance(self, phase: float, contractility: float = 1.0) -> float:
        """E [Pa/m³] at a phase of the beat, 0 to 1."""
        since = (phase - self.begin) % 1.0
        active = 0.0
        if since < self.rise:
            active = 0.5 - 0.5 * math.cos(math.pi * since / self.rise)
        elif since < self.rise + self.fall:
            active = 0.5 + 0.5 * math.cos(math.pi * (since - self.rise) / self.fall)
        return self.E_min + (contractility * self.E_max - self.E_min) * active


@dataclass(frozen=True)
class Valve:
    """A heart valve."""

    A: float = quantity(None, "m^2", "area of the open valve", 1e-6, 1e-1, nominal=1e-4, display="cm^2")
    l: float = quantity(None, "m", "length of the blood that the valve accelerates", 0.0, 0.5, nominal=1e-2)  # noqa: E741
    R: float = quantity(
        None, "Pa.s/m^3", "resistance in series with the valve", 0.0, 1e9, nominal=1e6, display="mmHg.s/mL"
    )
    K_open: float = quantity(None, "1/(Pa.s)", "rate of opening per pressure", 1e-5, 1e3, nominal=0.01)
    K_close: float = quantity(None, "1/(Pa.s)", "rate of closing per pressure", 1e-5, 1e3, nominal=0.01)
    regurgitation: float = quantity(None, "1", "part of the area that never closes", 0.0, 1.0)


@dataclass(frozen=True)
class Pace:
    """What a pacemaker and drugs change."""

    rate: float = quantity(None, "Hz", "heart rate, beats per second", 0.1, 10.0)
    contractility: float = quantity(1.0, "1", "factor of the largest elastance of the ventricle", 0.01, 10.0)
    rho: float = quantity(1060.0, "kg/m^3", "density of blood", 500.0, 2000.0, nominal=1e3, tunable=False)


@dataclass(frozen=True)
class Aorta:
    """The root of the aorta."""

    curvature: float = quantity(0.2, "1", "β: how much the port's pressure changes with the curvature of Q", 0.0, 0.5)


@dataclass(frozen=True)
class Filling:
    """Between the veins and the atrium."""

    R: float = quantity(None, "Pa.s/m^3", "resistance", 0.0, 1e9, nominal=1e6, display="mmHg.s/mL")


@dataclass(frozen=True)
class Heart:
    """A left heart. reference : where its numbers come from."""

    name: str
    reference: str
    heart: Pace
    left_ventricle: Chamber
    left_atrium: Chamber
    mitral_valve: Valve
    aortic_valve: Valve
    venous: Filling
    aorta: Aorta
    P_venous: float  # Pa, at the start
    P_aorta: float  # Pa, at the start

    @property
    def groups(self) -> dict[str, Any]:
        """Its quantities by the first word of their variables' names."""
        return {key: getattr(self, key) for key in _GROUPS}

    def with_values(self, values: Mapping[str, Any]) -> Heart:
        """The heart with the parameters in ``values``; raises ValueError if they do not fit together."""
        heart = replace(self, **{key: with_values(key, owner, values) for key, owner in self.groups.items()})
        for key in ("left_ventricle", "left_atrium"):
            chamber = getattr(heart, key)
            if chamber.rise + chamber.fall > 1.0:
                raise ValueError(
                    f"{key}.rise + {key}.fall = {chamber.rise + chamber.fall:g}: contraction and relaxation must end "
                    "within a beat, so at most 1; shorten them."
                )
        return heart


_GROUPS = ("heart", "left_ventricle", "left_atrium", "mitral_valve", "aortic_valve", "venous", "aorta")


@dataclass(frozen=True)
class Port:
    """What the arteries answer at the end of a step: P = P_0 + Z_0 Q(t) + Z Q(t+h) [Pa, Pa·s/m³]."""

    P_0: float
    Z: float
    Z_0: float


@dataclass(frozen=True)
class ValveState:
    """Flow [m³/s], the flow of the step before, opening ζ, and pressure difference [Pa]."""

    Q: float
    Q_before: float
    opening: float
    drop: float


@dataclass(frozen=True)
class HeartState:
    """Everything a step needs. taken [m³] : volume from the veins since the start; h_before [s] : 0 at the start."""

    t: float
    phase: float
    V_ventricle: float
    V_atrium: float
    mitral: ValveState
    aortic: ValveState
    Q_venous: float
    P_ventricle: float
    P_atrium: float
    P_aorta: float
    P_venous: float
    h_before: float
    taken: float
    ejected: float


def initial_state(heart: Heart, t0: float, P_venous: float, P_aorta: float) -> HeartState:
    """At the end of filling: both chambers at the venous pressure, valves closed, no flow."""

    def filled(chamber: Chamber) -> float:
        return chamber.V_0 + (P_venous - chamber.P_0) / chamber.elastance(0.0, heart.heart.contractility)

    ventricle, atrium = heart.left_ventricle, heart.left_atrium
    return HeartState(
        t0, 0.0, filled(ventricle), filled(atrium), ValveState(0.0, 0.0, 0.0, 0.0),
        ValveState(0.0, 0.0, 0.0, P_venous - P_aorta), 0.0, P_venous, P_venous, P_aorta, P_venous, 0.0, 0.0, 0.0,
    )  # fmt: skip


def step(heart: Heart, state: HeartState, h: float, port: Port, P_venous: float) -> HeartState:
    """Advance by h [s] against the port of the arteries.

    P_venous [Pa] : at the start of the step; its course is extrapolated over the step from the value before.
    Raises ValueError for a step that is too long, and when the equations of the step have no solution.
    """
    rate = heart.heart.rate
    if not (math.isfinite(h) and 0.0 < h <= _LARGEST_STEP / rate):
        raise ValueError(
            f"communication step of {h:g} s: a heart of {rate:g} beats per second needs steps above 0 and up to "
            f"{_LARGEST_STEP / rate:g} s; take shorter ones."
        )
    trial = _Trial(heart, state, h, port, P_venous)
    Q_m, Q_a = trial.solve()
    return trial.end(Q_m, Q_a)


class _Trial:
    """The equations of one step for the flows at its end."""

    def __init__(self, heart: Heart, state: HeartState, h: float, port: Port, P_venous: float) -> None:
        self.heart, self.state, self.h, self.port = heart, state, h, port
        self.phase = (state.phase + h * heart.heart.rate) % 1.0
        self.E_ventricle = heart.left_ventricle.elastance(self.phase, heart.heart.contractility)
        self.E_atrium = heart.left_atrium.elastance(self.phase)
        ahead = h / state.h_before if state.h_before else 0.0
        self.P_venous_now = P_venous
        self.P_venous = P_venous + ahead * (P_venous - state.P_venous)
        # the second backward difference of the flows; of first order at the start and after a step that was far shorter
        ratio = ahead if ahead <= 2.0 else 0.0
        self.c_end = (1.0 + 2.0 * ratio) / (1.0 + ratio) / h
        self.beta = heart.aorta.curvature if ratio else 0.0
        self.Q_straight = state.aortic.Q + ratio * (state.aortic.Q - state.aortic.Q_before)
        self.c_now, self.c_before = -(1.0 + ratio) / h, ratio * ratio / (1.0 + ratio) / h

    def atrium(self, Q_m: float) -> tuple[float, float]:
        """Venous inflow [m³/s] and volume [m³] at the end."""
        chamber, s, half = self.heart.left_atrium, self.state, 0.5 * self.h
        V = s.V_atrium + half * (s.Q_venous - s.mitral.Q - Q_m)
        P = chamber.P_0 + self.E_atrium * (V - chamber.V_0)
        Q_venous = (self.P_venous - P) / (self.heart.venous.R + half * self.E_atrium)
        return Q_venous, V + half * Q_venous

    def pressures(self, Q_m: float, Q_a: float) -> tuple[float, float, float]:
        """In the atrium, in the ventricle and in the aorta at the end [Pa]."""
        s, ventricle, atrium = self.state, self.heart.left_ventricle, self.heart.left_atrium
        V = s.V_ventricle + 0.5 * self.h * (s.mitral.Q + Q_m - s.aortic.Q - Q_a)
        return (
            atrium.P_0 + self.E_atrium * (self.atrium(Q_m)[1] - atrium.V_0),
            ventricle.P_0 + self.E_ventricle * (V - ventricle.V_0),
            self.port.P_0 + self.port.Z_0 * s.aortic.Q + self.port.Z * (Q_a + self.beta * (Q_a - self.Q_straight)),
        )

    def opening(self, valve: Valve, before: ValveState, drop: float) -> tuple[float, float]:
        """ζ at the end, and its derivative by the pressure difference at the end."""
        half = 0.5 * self.h
        opens = half * valve.K_open * (max(before.drop, 0.0) + max(drop, 0.0))
        closes = half * valve.K_close * (max(-before.drop, 0.0) + max(-drop, 0.0))
        rates = opens + closes
        kept = math.exp(-rates)
        reached = -math.expm1(-rates) / rates if rates > 0.0 else 1.0
        slope = (kept - reached) / rates if rates > 1e-8 else -0.5
        opening = before.opening * kept + opens * reached
        d_opens, d_closes = (half * valve.K_open, 0.0) if drop > 0.0 else (0.0, -half * valve.K_close)
        return opening, (opens * slope - before.opening * kept) * (d_opens + d_closes) + d_opens * reached

    def law(self, valve: Valve, before: ValveState, Q: float, drop: float) -> tuple[float, float, float]:
        """The equation of a valve times s² [Pa], which is to be 0, and its derivatives by Q and by the drop."""
        zeta, d_zeta = self.opening(valve, before, drop)
        s, d_s = valve.regurgitation + (1.0 - valve.regurgitation) * zeta, (1.0 - valve.regurgitation) * d_zeta
        L, B = self.heart.heart.rho * valve.l / valve.A, 0.5 * self.heart.heart.rho / valve.A**2
        rate = self.c_end * Q + self.c_now * before.Q + self.c_before * before.Q_before
        speed = math.hypot(Q, _LAMINAR)
        left = drop - valve.R * Q
        value = L * s * rate + B * speed * Q - s * s * left
        by_Q = L * s * self.c_end + B * (speed + Q * Q / speed) + s * s * valve.R
        return value, by_Q, d_s * (L * rate - 2.0 * s * left) - s * s

    def solve(self) -> tuple[float, float]:
        """Newton's iterations for the flows at the end, with steps cut where they lead away. Raises ValueError."""
        heart, s = self.heart, self.state
        half = 0.5 * self.h
        by_ventricle = half * self.E_ventricle
        R_in = heart.venous.R
        by_atrium = -half * self.E_atrium * R_in / (R_in + half * self.E_atrium) if R_in else 0.0
        scale = max(abs(s.P_ventricle), abs(self.port.P_0), 100.0)

        def equations(Q_m: float, Q_a: float) -> tuple[float, ...]:
            P_atrium, P_ventricle, P_aorta = self.pressures(Q_m, Q_a)
            return (
                *self.law(heart.mitral_valve, s.mitral, Q_m, P_atrium - P_ventricle),
                *self.law(heart.aortic_valve, s.aortic, Q_a, P_ventricle - P_aorta),
            )

        x = (s.mitral.Q, s.aortic.Q)
        now = equations(*x)
        for _ in range(_ITERATIONS):
            F, F_Q, F_drop, G, G_Q, G_drop = now
            a, b = F_Q + F_drop * (by_atrium - by_ventricle), F_drop * by_ventricle
            c, d = G_drop * by_ventricle, G_Q - G_drop * (by_ventricle + (1.0 + self.beta) * self.port.Z)
            det = a * d - b * c
            dx = ((b * G - d * F) / det, (c * F - a * G) / det) if det else (math.nan, math.nan)
            if not math.isfinite(dx[0] + dx[1]):
                break
            size, part = abs(F) + abs(G), 1.0
            while True:
                new = (x[0] + part * dx[0], x[1] + part * dx[1])
                now = equations(*new)
                if abs(now[0]) + abs(now[3]) <= (1.0 - 0.25 * part) * size + 1e-13 * scale or part < 1e-3:
                    break
                part *= 0.5
            x = new
            if max(abs(dx[0]), abs(dx[1])) <= 1e-12 * max(abs(x[0]), abs(x[1]), 1e-5):
                return x
        raise ValueError(
            f"t = {s.t + self.h:.6g} s: the flows through the valves have no solution over a step of {self.h:g} s "
            f"(aorta.P_0 = {self.port.P_0:g} Pa, aorta.Z = {self.port.Z:g} Pa.s/m^3); take shorter steps."
        )

    def end(self, Q_m: float, Q_a: float) -> HeartState:
        """The state with these flows at the end."""
        heart, s, half = self.heart, self.state, 0.5 * self.h
        P_atrium, P_ventricle, P_aorta = self.pressures(Q_m, Q_a)
        Q_venous, V_atrium = self.atrium(Q_m)

        def valve(law: Valve, before: ValveState, Q: float, drop: float) -> ValveState:
            zeta = self.opening(law, before, drop)[0]
            return ValveState(Q, before.Q, zeta if zeta > _CLOSED else 0.0, drop)

        return HeartState(
            t=s.t + self.h,
            phase=self.phase,
            V_ventricle=s.V_ventricle + half * (s.mitral.Q + Q_m - s.aortic.Q - Q_a),
            V_atrium=V_atrium,
            mitral=valve(heart.mitral_valve, s.mitral, Q_m, P_atrium - P_ventricle),
            aortic=valve(heart.aortic_valve, s.aortic, Q_a, P_ventricle - P_aorta),
            Q_venous=Q_venous,
            P_ventricle=P_ventricle,
            P_atrium=P_atrium,
            P_aorta=P_aorta,
            P_venous=self.P_venous_now,
            h_before=self.h,
            taken=s.taken + half * (s.Q_venous + Q_venous),
            ejected=s.ejected + half * (s.aortic.Q + Q_a),
        )


class HeartComponent(Component):
    """The heart as a component of an FMU."""

    remade = frozenset(("own",))

    def __init__(self, heart: Heart) -> None:
        self.own = self.heart = heart

    def kinds(self) -> dict[type, Kind]:
        """What a saved state holds."""
        return dataclasses(Heart, Pace, Chamber, Valve, Filling, Aorta, HeartState, ValveState)

    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        """Begin at the end of filling; raises ValueError if the parameters do not fit together."""
        self.heart = self.own.with_values(values)
        self.known = {name: values[name] for name in INPUTS}
        self.state = initial_state(self.heart, t0, values["venous.P"], values["aorta.P_0"])

    def retune(self, changed: Mapping[str, Any]) -> None:
        """Take over tunable parameters: the phase of the beat goes on from where it is."""
        self.heart = self.heart.with_values(changed)

    def step(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        """Advance from t to t + h. Where P_0, Z and Z_0 are 0 nothing has been received: the inputs before count."""
        known = {name: values[name] for name in INPUTS}
        if not (known["aorta.P_0"] or known["aorta.Z"] or known["aorta.Z_0"]):
            known = self.known
        port = Port(known["aorta.P_0"], known["aorta.Z"], known["aorta.Z_0"])
        self.state, self.known = step(self.heart, replace(self.state, t=t), h, port, known["venous.P"]), known

    def outputs(self) -> list[float]:
        """In the order of ``OUTPUTS``."""
        s = self.state
        return [
            s.aortic.Q, s.P_aorta, s.ejected, s.taken, s.Q_venous, s.P_ventricle, s.V_ventricle, s.P_atrium, s.V_atrium,
            s.mitral.Q, s.mitral.opening, s.aortic.opening, s.phase,
        ]  # fmt: skip


INPUTS = ("aorta.P_0", "aorta.Z", "aorta.Z_0", "venous.P")
OUTPUTS = (
    "aorta.Q", "aorta.P", "aorta.V", "venous.V", "venous.Q", "left_ventricle.P", "left_ventricle.V", "left_atrium.P",
    "left_atrium.V", "mitral_valve.Q", "mitral_valve.opening", "aortic_valve.opening", "heart.phase",
)  # fmt: skip
