"""One step of a left heart: its equations, and their solution.

One implicit second-order step per communication step. The trapezoidal rule integrates volumes, so the volume that
leaves the ventricle is h (Q(t) + Q(t+h))/2, consistent with arteries whose inflow is linear in time. BDF2 integrates
momentum, and the exponential of the mean rates integrates openings, because the trapezoidal rule would oscillate where
a valve closes and the resistance grows without bound.

The port assumes an inflow that is linear over a step, but the flow is curved. An artery whose pressure response to a
jump of the flow decays as t^-1/2, as that of a viscoelastic one initially does, responds to a curved flow with the
pressure P + β Z (Q(t+h) - 2 Q(t) + Q(t-h)), β = 0.21; for an elastic artery, whose response does not decay, β = 0.
Without this term the pair is of order 1.5.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ..errors import InputError
from .heart_parts import Chamber, Heart, Valve

_CLOSED = 1e-12  # an opening below this counts as none
_LAMINAR = 1e-6  # m³/s, below which the loss of a valve is linear in the flow
_LARGEST_STEP = 0.05  # of a beat
_ITERATIONS = 40


@dataclass(frozen=True)
class Port:
    """The response of the arteries at the end of a step: P = P_0 + Z_0 Q(t) + Z Q(t+h) [Pa, Pa·s/m³]."""

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

    def filled(chamber: Chamber, contractility: float = 1.0) -> float:
        return chamber.V_0 + (P_venous - chamber.P_0) / chamber.elastance(0.0, contractility)

    ventricle, atrium = heart.left_ventricle, heart.left_atrium
    return HeartState(
        t0, 0.0, filled(ventricle, heart.heart.contractility), filled(atrium), ValveState(0.0, 0.0, 0.0, 0.0),
        ValveState(0.0, 0.0, 0.0, P_venous - P_aorta), 0.0, P_venous, P_venous, P_aorta, P_venous, 0.0, 0.0, 0.0,
    )  # fmt: skip


def step(heart: Heart, state: HeartState, h: float, port: Port, P_venous: float) -> HeartState:
    """Advance by h [s] against the port of the arteries.

    P_venous [Pa] : at the start of the step; it is extrapolated over the step from the previous value.
    Raises ValueError for a step that is too long, or if the equations of the step have no solution.
    """
    rate = heart.heart.rate
    if not (math.isfinite(h) and 0.0 < h <= _LARGEST_STEP / rate):
        raise InputError(
            f"communication step of {h:g} s: a heart of {rate:g} beats per second needs steps above 0 and up to "
            f"{_LARGEST_STEP / rate:g} s; take shorter ones."
        )
    trial = _Trial(heart, state, h, port, P_venous)
    Q_m, Q_a = trial.solve()
    return trial.end(Q_m, Q_a)


class _Trial:
    """The equations of one step h [s] for the flows [m³/s] at its end.

    E [Pa/m³] : elastances at the end. c [1/s] : coefficient of the flow difference. P_venous [Pa] : at the end.
    """

    def __init__(self, heart: Heart, state: HeartState, h: float, port: Port, P_venous: float) -> None:
        self.heart, self.state, self.h, self.port = heart, state, h, port
        self.phase = (state.phase + h * heart.heart.rate) % 1.0
        self.E_ventricle = heart.left_ventricle.elastance(self.phase, heart.heart.contractility)
        self.E_atrium = heart.left_atrium.elastance(self.phase)
        ahead = h / state.h_before if state.h_before else 0.0
        # second order, but first order at the start and after a much shorter step
        ratio = ahead if ahead <= 2.0 else 0.0
        self.P_venous_now = P_venous
        self.P_venous = P_venous + ratio * (P_venous - state.P_venous)
        self.c_end = (1.0 + 2.0 * ratio) / (1.0 + ratio) / h
        self.beta = heart.aorta.curvature if ratio else 0.0
        self.Q_straight = state.aortic.Q + ratio * (state.aortic.Q - state.aortic.Q_before)
        self.c_now, self.c_before = -(1.0 + ratio) / h, ratio * ratio / (1.0 + ratio) / h

    def atrium(self, Q_m: float) -> tuple[float, float]:
        """Venous inflow [m³/s] and volume [m³] of the atrium at the end, for Q_m [m³/s] through the mitral valve."""
        chamber, s, half = self.heart.left_atrium, self.state, 0.5 * self.h
        V = s.V_atrium + half * (s.Q_venous - s.mitral.Q - Q_m)
        P = chamber.P_0 + self.E_atrium * (V - chamber.V_0)
        Q_venous = (self.P_venous - P) / (self.heart.venous.R + half * self.E_atrium)
        return Q_venous, V + half * Q_venous

    def pressures(self, Q_m: float, Q_a: float) -> tuple[float, float, float]:
        """Pressures [Pa] in atrium, ventricle and aorta at the end, for Q_m, Q_a [m³/s] through the valves."""
        s, ventricle, atrium = self.state, self.heart.left_ventricle, self.heart.left_atrium
        V = s.V_ventricle + 0.5 * self.h * (s.mitral.Q + Q_m - s.aortic.Q - Q_a)
        return (
            atrium.P_0 + self.E_atrium * (self.atrium(Q_m)[1] - atrium.V_0),
            ventricle.P_0 + self.E_ventricle * (V - ventricle.V_0) - ventricle.R * Q_a,
            self.port.P_0 + self.port.Z_0 * s.aortic.Q + self.port.Z * (Q_a + self.beta * (Q_a - self.Q_straight)),
        )

    def opening(self, valve: Valve, before: ValveState, drop: float) -> tuple[float, float]:
        """ζ [-] at the end, and its derivative [1/Pa] by the pressure difference at the end, ``drop`` [Pa]."""
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
        """The residual of a valve's equation times s² [Pa], and its derivatives by Q [Pa·s/m³] and drop [-]."""
        zeta, d_zeta = self.opening(valve, before, drop)
        s, d_s = valve.regurgitation + (1.0 - valve.regurgitation) * zeta, (1.0 - valve.regurgitation) * d_zeta
        L, B = self.heart.heart.rho * valve.l / valve.A, 0.5 * self.heart.heart.rho / valve.A**2
        rate = self.c_end * Q + self.c_now * before.Q + self.c_before * before.Q_before
        speed = math.hypot(Q, _LAMINAR)
        left = drop - valve.R * Q
        value = L * s * rate + B * speed * Q - s * s * left
        by_Q = L * s * self.c_end + B * (speed + Q * Q / speed) + s * s * valve.R
        return value, by_Q, d_s * (L * rate - 2.0 * s * left) - s * s

    def equations(self, Q_m: float, Q_a: float) -> tuple[float, ...]:
        """The laws of the mitral and of the aortic valve, of Q_m, Q_a [m³/s]: see :meth:`law`."""
        heart, s = self.heart, self.state
        P_atrium, P_ventricle, P_aorta = self.pressures(Q_m, Q_a)
        return (
            *self.law(heart.mitral_valve, s.mitral, Q_m, P_atrium - P_ventricle),
            *self.law(heart.aortic_valve, s.aortic, Q_a, P_ventricle - P_aorta),
        )

    def solve(self) -> tuple[float, float]:
        """The flows [m³/s] through the mitral and the aortic valve at the end. Raises ValueError."""
        found = self._newton() or self._one_by_one()
        if found is None:
            raise InputError(
                f"t = {self.state.t + self.h:.6g} s: the flows through the valves have no solution over a step of "
                f"{self.h:g} s (aorta.P_0 = {self.port.P_0:g} Pa, aorta.Z = {self.port.Z:g} Pa.s/m^3); "
                "take shorter steps."
            )
        return found

    def _newton(self) -> tuple[float, float] | None:
        """Newton iterations with damped steps; None if they do not converge."""
        half, R_in = 0.5 * self.h, self.heart.venous.R
        by_ventricle = half * self.E_ventricle
        by_ejected = by_ventricle + self.heart.left_ventricle.R
        by_atrium = -half * self.E_atrium * R_in / (R_in + half * self.E_atrium)
        x = (self.state.mitral.Q, self.state.aortic.Q)
        now = self.equations(*x)
        for _ in range(_ITERATIONS):
            F, F_Q, F_drop, G, G_Q, G_drop = now
            a, b = F_Q + F_drop * (by_atrium - by_ventricle), F_drop * by_ejected
            c, d = G_drop * by_ventricle, G_Q - G_drop * (by_ejected + (1.0 + self.beta) * self.port.Z)
            det = a * d - b * c
            dx = ((b * G - d * F) / det, (c * F - a * G) / det) if det else (math.nan, math.nan)
            if not math.isfinite(dx[0] + dx[1]):
                break
            size, part = abs(F) + abs(G), 1.0
            while True:
                new = (x[0] + part * dx[0], x[1] + part * dx[1])
                now = self.equations(*new)
                if abs(now[0]) + abs(now[3]) <= (1.0 - 0.25 * part) * size + 1e-10 or part < 1e-3:
                    break
                part *= 0.5
            x = new
            if max(abs(dx[0]), abs(dx[1])) <= 1e-12 * max(abs(x[0]), abs(x[1]), 1e-5):
                return x
        return None

    def _one_by_one(self) -> tuple[float, float] | None:
        """One valve after the other, each by bisection: slow, but robust if a valve closes instantaneously."""
        Q_m, Q_a = self.state.mitral.Q, self.state.aortic.Q
        for _ in range(_ITERATIONS):
            before = Q_m, Q_a
            Q_m = _root(partial(self._mitral, Q_a), Q_m)
            Q_a = _root(partial(self._aortic, Q_m), Q_a)
            if abs(Q_m - before[0]) + abs(Q_a - before[1]) <= 1e-12 * max(abs(Q_m), abs(Q_a), 1e-5):
                return Q_m, Q_a
        return None

    def _mitral(self, Q_a: float, Q_m: float) -> float:
        return self.equations(Q_m, Q_a)[0]

    def _aortic(self, Q_m: float, Q_a: float) -> float:
        return self.equations(Q_m, Q_a)[3]

    def end(self, Q_m: float, Q_a: float) -> HeartState:
        """The state with these flows [m³/s] at the end."""
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


def _root(function: Callable[[float], float], guess: float) -> float:
    """The root, near a guess, of a function that is negative for low and positive for high flows."""
    width, low, high = 1e-7, guess, guess
    while function(low) > 0.0 and width < 1.0:
        low, width = low - width, 2.0 * width
    while function(high) < 0.0 and width < 1.0:
        high, width = high + width, 2.0 * width
    for _ in range(80):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if function(middle) > 0.0:
            high = middle
        else:
            low = middle
    return low if abs(function(low)) < abs(function(high)) else high
