"""A left heart: ventricle and atrium of time-varying elastance, two valves, filled from the veins; without FMI.

Chambers (Suga, Sagawa, Shoukas, Circ. Res. 32, 314 (1973)), with an activation e(t) between 0 and 1:

    P = P_0 + E(t) (V - V_0),     E(t) = E_min + (contractility E_max - E_min) e(t)

In the ventricle minus R Q, with Q its flow into the aorta: an ejecting ventricle develops less pressure than an
isovolumic one at the same volume.

Valves (Mynard, Davidson, Penny, Smolich, Int. J. Numer. Meth. Biomed. Eng. 28, 626 (2012), doi:10.1002/cnm.1466), with
the open fraction s = r + (1 - r) ζ of the area A, r the fraction that never closes, and a resistance R in series:

    ΔP = (ρ l / A s) dQ/dt + R Q + ρ |Q| Q / 2 (A s)²
    dζ/dt = K_open ΔP (1 - ζ)  where ΔP > 0,   K_close ΔP ζ  where ΔP < 0

Filling: venous.P - P_atrium = R_venous Q_venous. Load: the port of the arteries, :class:`Port`.

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
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..io.saved import Kind, dataclasses
from .arithmetic import Number, divided, exp, expm1, positive, require, select, solution, sqrt
from .component import Arithmetic
from .heart_parts import Aorta, Chamber, Filling, Heart, Pace, Valve, Ventricle, within_a_beat
from .heart_search import newton, one_by_one

INPUTS = ("aorta.P_0", "aorta.Z", "aorta.Z_0", "venous.P")
OUTPUTS = (
    "aorta.Q", "aorta.P", "aorta.V", "venous.V", "venous.Q", "left_ventricle.P", "left_ventricle.V", "left_atrium.P",
    "left_atrium.V", "mitral_valve.Q", "mitral_valve.opening", "aortic_valve.opening", "heart.phase",
)  # fmt: skip

_CLOSED = 1e-12  # an opening below this counts as none
_LAMINAR = 1e-6  # m³/s, below which the loss of a valve is linear in the flow
_LARGEST_STEP = 0.05  # of a beat


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


def initial_state(heart: Heart, t0: float, P_venous: Number, P_aorta: float) -> HeartState:
    """At the end of filling: both chambers at the venous pressure, valves closed, no flow."""

    def filled(chamber: Chamber, contractility: float = 1.0) -> float:
        return chamber.V_0 + (P_venous - chamber.P_0) / chamber.elastance(0.0, contractility)

    ventricle, atrium = heart.left_ventricle, heart.left_atrium
    return HeartState(
        t0, 0.0, filled(ventricle, heart.heart.contractility), filled(atrium), ValveState(0.0, 0.0, 0.0, 0.0),
        ValveState(0.0, 0.0, 0.0, P_venous - P_aorta), 0.0, P_venous, P_venous, P_aorta, P_venous, 0.0, 0.0, 0.0,
    )  # fmt: skip


def step(heart: Heart, state: HeartState, h: Number, port: Port, P_venous: Number) -> HeartState:
    """Advance by h [s] against the port of the arteries.

    P_venous [Pa] : at the start of the step; it is extrapolated over the step from the previous value.
    Raises ValueError for a step that is too long, or if the equations of the step have no solution.
    """
    rate = heart.heart.rate
    require(
        (h > 0.0) & (h <= _LARGEST_STEP / rate),
        "communication step of %g s: a heart of %g beats per second needs steps above 0 and up to %g s; take shorter "
        "ones.",
        h, rate, _LARGEST_STEP / rate,
    )  # fmt: skip
    trial = _Trial(heart, state, h, port, P_venous)
    Q_m, Q_a = trial.solve()
    return trial.end(Q_m, Q_a)


class _Trial:
    """The equations of one step h [s] for the flows [m³/s] at its end.

    E [Pa/m³] : elastances at the end. c [1/s] : coefficient of the flow difference. P_venous [Pa] : at the end.
    by_filled, by_ejected, by_ventricle, by_pumped [Pa·s/m³] : how the pressure differences across the valves change
    with the flows, the mitral one's by Q_m and Q_a, the aortic one's by Q_m and, negative, by Q_a.
    """

    def __init__(self, heart: Heart, state: HeartState, h: Number, port: Port, P_venous: Number) -> None:
        self.heart, self.state, self.h, self.port = heart, state, h, port
        self.phase = within_a_beat(state.phase + h * heart.heart.rate)
        self.E_ventricle = heart.left_ventricle.elastance(self.phase, heart.heart.contractility)
        self.E_atrium = heart.left_atrium.elastance(self.phase)
        ahead = divided(h, state.h_before, 0.0)
        # second order, but first order at the start and after a much shorter step
        ratio = select(ahead <= 2.0, ahead, 0.0)
        self.P_venous_now = P_venous
        self.P_venous = P_venous + ratio * (P_venous - state.P_venous)
        self.c_end = (1.0 + 2.0 * ratio) / (1.0 + ratio) / h
        self.beta = select(ratio > 0.0, heart.aorta.curvature, 0.0)
        self.Q_straight = state.aortic.Q + ratio * (state.aortic.Q - state.aortic.Q_before)
        self.c_now, self.c_before = -(1.0 + ratio) / h, ratio * ratio / (1.0 + ratio) / h
        half, R_in = 0.5 * h, heart.venous.R
        self.by_ventricle = half * self.E_ventricle
        self.by_ejected = self.by_ventricle + heart.left_ventricle.R
        self.by_filled = -half * self.E_atrium * R_in / (R_in + half * self.E_atrium) - self.by_ventricle
        self.by_pumped = self.by_ejected + (1.0 + self.beta) * port.Z

    def atrium(self, Q_m: Number) -> tuple[Number, Number]:
        """Venous inflow [m³/s] and volume [m³] of the atrium at the end, for Q_m [m³/s] through the mitral valve."""
        chamber, s, half = self.heart.left_atrium, self.state, 0.5 * self.h
        V = s.V_atrium + half * (s.Q_venous - s.mitral.Q - Q_m)
        P = chamber.P_0 + self.E_atrium * (V - chamber.V_0)
        Q_venous = (self.P_venous - P) / (self.heart.venous.R + half * self.E_atrium)
        return Q_venous, V + half * Q_venous

    def pressures(self, Q_m: Number, Q_a: Number) -> tuple[Number, Number, Number]:
        """Pressures [Pa] in atrium, ventricle and aorta at the end, for Q_m, Q_a [m³/s] through the valves."""
        s, ventricle, atrium = self.state, self.heart.left_ventricle, self.heart.left_atrium
        V = s.V_ventricle + 0.5 * self.h * (s.mitral.Q + Q_m - s.aortic.Q - Q_a)
        return (
            atrium.P_0 + self.E_atrium * (self.atrium(Q_m)[1] - atrium.V_0),
            ventricle.P_0 + self.E_ventricle * (V - ventricle.V_0) - ventricle.R * Q_a,
            self.port.P_0 + self.port.Z_0 * s.aortic.Q + self.port.Z * (Q_a + self.beta * (Q_a - self.Q_straight)),
        )

    def opening(self, valve: Valve, before: ValveState, drop: Number) -> tuple[Number, Number]:
        """ζ [-] at the end, and its derivative [1/Pa] by the pressure difference at the end, ``drop`` [Pa]."""
        half = 0.5 * self.h
        opens = half * valve.K_open * (positive(before.drop) + positive(drop))
        closes = half * valve.K_close * (positive(-before.drop) + positive(-drop))
        rates = opens + closes
        kept = exp(-rates)
        reached = divided(-expm1(-rates), rates, 1.0)
        slope = select(rates > 1e-8, divided(kept - reached, rates, 0.0), -0.5)
        opening = before.opening * kept + opens * reached
        d_rates = half * select(drop > 0.0, valve.K_open, -valve.K_close)
        d_opens = half * select(drop > 0.0, valve.K_open, 0.0)
        return opening, (opens * slope - before.opening * kept) * d_rates + d_opens * reached

    def law(self, valve: Valve, before: ValveState, Q: Number, drop: Number) -> tuple[Number, Number, Number]:
        """The residual of a valve's equation times s² [Pa], and its derivatives by Q [Pa·s/m³] and drop [-]."""
        zeta, d_zeta = self.opening(valve, before, drop)
        s, d_s = valve.regurgitation + (1.0 - valve.regurgitation) * zeta, (1.0 - valve.regurgitation) * d_zeta
        L, B = self.heart.heart.rho * valve.l / valve.A, 0.5 * self.heart.heart.rho / valve.A**2
        rate = self.c_end * Q + self.c_now * before.Q + self.c_before * before.Q_before
        speed = sqrt(Q * Q + _LAMINAR * _LAMINAR)
        driving = drop - valve.R * Q
        value = L * s * rate + B * speed * Q - s * s * driving
        by_Q = L * s * self.c_end + B * (speed + Q * Q / speed) + s * s * valve.R
        return value, by_Q, d_s * (L * rate - 2.0 * s * driving) - s * s

    def equations(self, Q_m: Number, Q_a: Number) -> tuple[Number, ...]:
        """The laws of the mitral and of the aortic valve, of Q_m, Q_a [m³/s]: see :meth:`law`."""
        heart, s = self.heart, self.state
        P_atrium, P_ventricle, P_aorta = self.pressures(Q_m, Q_a)
        return (
            *self.law(heart.mitral_valve, s.mitral, Q_m, P_atrium - P_ventricle),
            *self.law(heart.aortic_valve, s.aortic, Q_a, P_ventricle - P_aorta),
        )

    def solve(self) -> tuple[Number, Number]:
        """The flows [m³/s] through the mitral and the aortic valve at the end. Raises ValueError."""
        start = self.state.mitral.Q, self.state.aortic.Q
        converged, *flows = newton(self._correction, *start)
        start = select(converged, flows[0], start[0]), select(converged, flows[1], start[1])
        found, Q_m, Q_a = one_by_one(self._residuals, *start, converged)
        require(
            found,
            "t = %.6g s: the flows through the valves have no solution over a step of %g s (aorta.P_0 = %g Pa, "
            "aorta.Z = %g Pa.s/m^3); take shorter steps.",
            self.state.t + self.h, self.h, self.port.P_0, self.port.Z,
        )  # fmt: skip
        return solution((Q_m, Q_a), lambda *flows: self._correction(*flows)[:2])

    def _correction(self, Q_m: Number, Q_a: Number) -> tuple[Number, Number, Number]:
        """The correction of the flows that Newton's method makes [m³/s], and the sum of the residuals [Pa]."""
        F, F_Q, F_drop, G, G_Q, G_drop = self.equations(Q_m, Q_a)
        a, b = F_Q + F_drop * self.by_filled, F_drop * self.by_ejected
        c, d = G_drop * self.by_ventricle, G_Q - G_drop * self.by_pumped
        det = a * d - b * c
        return divided(b * G - d * F, det, math.nan), divided(c * F - a * G, det, math.nan), abs(F) + abs(G)

    def _residuals(self, Q_m: Number, Q_a: Number) -> tuple[Number, Number]:
        laws = self.equations(Q_m, Q_a)
        return laws[0], laws[3]

    def end(self, Q_m: Number, Q_a: Number) -> HeartState:
        """The state with these flows [m³/s] at the end."""
        heart, s, half = self.heart, self.state, 0.5 * self.h
        P_atrium, P_ventricle, P_aorta = self.pressures(Q_m, Q_a)
        Q_venous, V_atrium = self.atrium(Q_m)

        def valve(law: Valve, before: ValveState, Q: Number, drop: Number) -> ValveState:
            zeta = self.opening(law, before, drop)[0]
            return ValveState(Q, before.Q, select(zeta > _CLOSED, zeta, 0.0), drop)

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


# --- the component ------------------------------------------------------------------------------------------------


class HeartComponent(Arithmetic):
    """The heart as a component of an FMU."""

    remade = frozenset(("own",))
    kept = ("known", "state")

    def __init__(self, heart: Heart) -> None:
        self.own = self.heart = heart

    def kinds(self) -> dict[type, Kind]:
        """The types of objects in a saved state."""
        return dataclasses(Heart, Pace, Chamber, Ventricle, Valve, Filling, Aorta, HeartState, ValveState)

    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        """Start at the end of filling; raises ValueError if the parameters are inconsistent."""
        self.heart = self.own.with_values(values)
        self.known = {name: values[name] for name in INPUTS}
        self.state = initial_state(self.heart, t0, values["venous.P"], values["aorta.P_0"])

    def retune(self, changed: Mapping[str, Any]) -> None:
        """Apply tunable parameters; the phase of the beat is continuous."""
        self.heart = self.heart.with_values(changed)

    def advance(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        """One step. If P_0, Z and Z_0 are all 0 in the first step, the start values apply."""
        sent = (values["aorta.P_0"] != 0.0) | (values["aorta.Z"] != 0.0) | (values["aorta.Z_0"] != 0.0)
        received = sent | (self.state.h_before > 0.0)
        known = {name: select(received, values[name], self.known[name]) for name in INPUTS}
        port = Port(known["aorta.P_0"], known["aorta.Z"], known["aorta.Z_0"])
        self.state = step(self.heart, replace(self.state, t=t), h, port, known["venous.P"])

    def outputs(self) -> list[float]:
        """In the order of ``OUTPUTS``."""
        s = self.state
        return [
            s.aortic.Q, s.P_aorta, s.ejected, s.taken, s.Q_venous, s.P_ventricle, s.V_ventricle, s.P_atrium, s.V_atrium,
            s.mitral.Q, s.mitral.opening, s.aortic.opening, s.phase,
        ]  # fmt: skip
