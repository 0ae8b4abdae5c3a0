"""The catalogue of effects: physical terms that a network may hold or lack, one small class per row, all in ``ALL``.

An effect says what it is (name, equation, units, ranges), where it may act, and how it enters the equations: by the
hooks of :class:`solver.effect.Effect` ``wall``, ``friction``, ``drag`` and ``observe``, which leave things as they are
unless a class says otherwise. Everything else follows from ``ALL``: the keys of the network file, the FMU's variables,
batch parameters, regression columns and docs/effects.md. A number of an effect is either a field that every network has
(phi0, R_t, k …) or a *term*, which only the segments, fluids and channels that were given it have.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .effect import Array, Drag, Effect, Points, Values, check_known
from .quantity import Quantity, quantities
from .wall import Wall

if TYPE_CHECKING:
    from .network import Network


# --- the wall -----------------------------------------------------------------------------------------------------


class WallViscosity(Effect):
    name = "wall_viscosity"
    equation = "σ = … + φ0 ε̇"
    owner = "segment"
    places = ("all", "segment")
    field_of = ("Segment", ("phi0",))
    neutral = {"phi0": 0.0}
    signature = "the P-R loop opens, its loss proportional to ω; high harmonics are damped"
    confusable = ("stress_relaxation", "channel_lag")
    separator = "radius; two heart rates"


class _NeedsViscosity(Effect):
    """What changes the viscous stress acts only where there is one."""

    def acts_on(self, owner: Any) -> bool:
        return owner.phi0 > 0.0


class NonlinearWallViscosity(_NeedsViscosity):
    name = "nonlinear_wall_viscosity"
    equation = "φ0 ε̇ becomes φ0 (e^(2rε̇) - 1)/(2r), r = φNL/φ0 (viscous_law = monotone) or φ0 ε̇ + φNL ε̇² (quadratic)"
    owner = "segment"
    places = ("all", "segment")
    field_of = ("Segment", ("phiNL",))
    neutral = {"phiNL": 0.0}
    signature = "even in ε̇: upstroke, second harmonic"
    confusable = ("nonlinear_elasticity",)
    separator = "phase; amplitude"


class NonlinearElasticity(Effect):
    name = "nonlinear_elasticity"
    equation = "σ = … + E_NL ε²"
    owner = "segment"
    places = ("all", "segment")
    field_of = ("Segment", ("ENL",))
    neutral = {"ENL": 0.0}
    at_rest = True
    signature = "bends the loop's spine without area"
    confusable = ("external_pressure",)
    separator = "pressure level"


class StressRelaxation(_NeedsViscosity):
    name = "stress_relaxation"
    equation = "τ dσ_v/dt + σ_v = φ0 ε̇: the viscous stress has memory"
    owner = "segment"
    places = ("all", "segment")
    terms = {"tau": Quantity("s", "relaxation time tau of the viscous stress", 0.0, 10.0, nominal=1e-2, display="ms")}
    neutral = {"tau": 0.0}
    signature = "stiffness reaches a plateau at high frequency"
    confusable = ("wall_viscosity", "channel_lag")
    separator = "heart rate"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, tau=values["tau"])


class ExternalPressure(Effect):
    name = "external_pressure"
    equation = "P = P_ext + P_ref + …"
    owner = "segment"
    places = ("all", "segment")
    terms = {"P_ext": Quantity("Pa", "external pressure P_ext", -1e5, 1e5, nominal=1e3, display="mmHg")}
    neutral = {"P_ext": 0.0}
    at_rest = True
    signature = "offset without hysteresis; exact alias of a free R0"
    confusable = ("channel_offset",)
    separator = "measured R0"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, P_ref=wall.P_ref + values["P_ext"])


class WallStiffness(Effect):
    name = "wall_stiffness"
    equation = "E becomes s E in one segment"
    owner = "segment"
    places = ("segment",)
    terms = {"E_scale": Quantity("1", "stiffness scale s of the wall, E becomes s E", 1e-2, 1e2)}
    neutral = {"E_scale": 1.0}
    at_rest = True
    signature = "reflections timed by place; wave speed"
    confusable = ("taper",)
    separator = "radius with pressure"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, K=wall.K * values["E_scale"], e=wall.e / values["E_scale"])


class Taper(Effect):
    name = "taper"
    equation = "R0(x) = R0 (1 + s (x/L - 1/2)), h constant"
    owner = "segment"
    places = ("segment",)
    terms = {"taper": Quantity("1", "taper s, R0(x) = R0 (1 + s (x/L - 1/2))", -1.5, 1.5, tunable=False)}
    neutral = {"taper": 0.0}
    at_rest = True
    signature = "amplification toward the periphery"
    confusable = ("wall_stiffness",)
    separator = "several sites"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        f = 1.0 + values["taper"] * (x - 0.5)
        return replace(wall, A0=wall.A0 * f * f, K=wall.K / f, K_h=wall.K_h / f)


class SideBranch(Effect):
    name = "side_branch"
    equation = "∂A/∂t + ∂Q/∂x = -g (P - P_venous), P_venous of the outlet where the segment ends, else 0"
    owner = "segment"
    places = ("segment",)
    terms = {"leak": Quantity("m^2/(Pa.s)", "leak conductance g per length", 0.0, 1e-3, nominal=1e-9)}
    neutral = {"leak": 0.0}
    signature = "flow is lost across the segment"
    confusable = ("terminal_reflection",)
    separator = "Q at both sides"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, leak=values["leak"])


# --- the fluid ----------------------------------------------------------------------------------------------------


class FluidFriction(Effect):
    name = "fluid_friction"
    equation = "C_f becomes s C_f"
    owner = "fluid"
    places = ("all",)
    terms = {"friction_scale": Quantity("1", "friction scale s, C_f becomes s C_f", 0.0, 1e3)}
    neutral = {"friction_scale": 1.0}
    signature = "mean pressure gradient along the path"
    confusable = ("terminal_reflection", "stenosis")
    separator = "P at both ends with Q"

    def friction(self, C_f: Array, values: Values) -> Array:
        return C_f * values["friction_scale"]


class VelocityProfile(Effect):
    name = "velocity_profile"
    equation = "∂(α Q²/A)/∂x"
    owner = "fluid"
    places = ("all",)
    field_of = ("Fluid", ("alpha",))
    neutral = {"alpha": 1.0}
    signature = "proportional to the amplitude squared; systole, inlet"
    confusable = ("junction_loss",)
    separator = "amplitude"


# Σ_n 1/(s + j²_{2,n}) over the zeros of J_2: the first three as they are (weight 1), the rest by five exponentials
# fitted to the exact sum I_3(√s)/(2√s I_2(√s)) on s = iω and s = ω, within 0.6 % for 1 <= |s| <= 3e4
WOMERSLEY_RATES = np.array(
    [26.374616427163, 70.849998919096, 135.020708865970, 277.641, 969.124, 3915.91, 16931.0, 159409.0]
)
WOMERSLEY_WEIGHTS = np.array([1.0, 1.0, 1.0, 2.72220, 6.76031, 14.0965, 32.5254, 250.128])


class UnsteadyFriction(Effect):
    """W. Zielke, Frequency-dependent friction in transient pipe flow, J. Basic Eng. 90 (1968) 109, with U = Q/A and
    the sum over the zeros of J_2 in eight exponentials."""

    name = "unsteady_friction"
    equation = "∂Q/∂t = … - A s (4ν/R²) Σ y_n, dy_n/dt = -j²_{2,n} (ν/R²) y_n + dU/dt (Zielke 1968)"
    owner = "fluid"
    places = ("all",)
    terms = {"unsteady_scale": Quantity("1", "part s of the frequency-dependent wall shear", 0.0, 1e2)}
    neutral = {"unsteady_scale": 0.0}
    signature = "attenuation grows as √ω"
    confusable = ("terminal_reflection",)
    separator = "friction against harmonic"

    def drag(self, values: Values, points: Points) -> Drag | None:
        per_time = points.nu / points.R0**2
        shape = (-1,) + (1,) * per_time.ndim
        rate = WOMERSLEY_RATES.reshape(shape) * per_time
        weight = 4.0 * WOMERSLEY_WEIGHTS.reshape(shape) * per_time * values["unsteady_scale"]
        return Drag(np.zeros(np.broadcast_shapes(rate.shape[1:])), weight, rate)


class Stenosis(Effect):
    name = "stenosis"
    equation = "Δp = K (ρ/2) Q|Q|/A² over the middle tenth of the segment"
    owner = "segment"
    places = ("segment",)
    terms = {"K": Quantity("1", "loss coefficient K of a stenosis in the middle tenth", 0.0, 1e5, tunable=False)}
    neutral = {"K": 0.0}
    cuts = (0.45, 0.55)
    signature = "systolic quadratic drop, timed reflection"
    confusable = ("fluid_friction",)
    separator = "paired P"

    def drag(self, values: Values, points: Points) -> Drag | None:
        inside = (points.centre > self.cuts[0]) & (points.centre < self.cuts[1])
        quadratic = np.where(inside, 0.5 * values["K"] / ((self.cuts[1] - self.cuts[0]) * points.L), 0.0)
        quadratic = np.broadcast_to(quadratic, points.R0.shape)
        none = np.zeros((0, *quadratic.shape))
        return Drag(quadratic, none, none)


# --- outlets and junctions ----------------------------------------------------------------------------------------


class TerminalReflection(Effect):
    name = "terminal_reflection"
    equation = "Q = A w(A) (1 - R_t)/(1 + R_t)"
    owner = "outlet"
    places = ("all", "outlet")
    field_of = ("Reflection", ("R_t",))
    neutral = {"R_t": 0.0}
    signature = "size of the reflected wave, mean P"
    confusable = ("side_branch",)
    separator = "distal Q"

    def acts_on(self, owner: Any) -> bool:
        return hasattr(owner, "R_t")


class TerminalCompliance(Effect):
    """Another condition at the outlet rather than a number of the one it has, so there is nothing neutral."""

    name = "terminal_compliance"
    equation = "the outlet becomes P = P_C + R1 Q, C dP_C/dt = Q - (P_C - P_venous)/R2"
    owner = "outlet"
    places = ("outlet",)
    field_of = ("Windkessel", ("R1", "C", "R2"))
    neutral: ClassVar[Mapping[str, float]] = {}
    signature = "diastolic decay"
    confusable = ("wall_stiffness",)
    separator = "distal Q"

    def add(self, network: Network, place: str, values: Mapping[str, float]) -> Network:
        from .network import Windkessel  # which imports this module

        check_known(self.name, values, self.variables(network, place))

        def changed(outlet: Any) -> Any:
            if outlet.segment != place:
                return outlet
            kept = {f.name: getattr(outlet, f.name) for f in fields(outlet)} if isinstance(outlet, Windkessel) else {}
            given = {key: float(value) for key, value in values.items()}
            missing = [key for key in self.quantities if key not in kept | given]
            if missing:
                raise ValueError(f"{self.name} at {place}: give {', '.join(missing)} too; it needs R1, C and R2.")
            return Windkessel(**{"segment": place, "P_venous": outlet.P_venous, **kept, **given})

        return replace(network, outlets=tuple(changed(outlet) for outlet in network.outlets))


class JunctionLoss(Effect):
    name = "junction_loss"
    equation = "P + k (ρ/2) (Q/A)² is common at the junction: k = 0 static … 1 total pressure"
    owner = "junction"
    places = ("all", "junction")
    field_of = ("Junction", ("k",))
    neutral = {"k": 0.0}
    signature = "systolic step at one junction"
    confusable = ("stenosis",)
    separator = "P either side"


# --- the measurement chain ----------------------------------------------------------------------------------------


class ChannelLag(Effect):
    name = "channel_lag"
    equation = "y(t) = x(t - lag)"
    owner = "channel"
    places = ("channel",)
    terms = {"lag": Quantity("s", "delay of the channel", -1.0, 1.0, nominal=1e-3, display="ms")}
    neutral = {"lag": 0.0}
    signature = "one channel only: phase linear in frequency"
    confusable = ("wall_viscosity", "stress_relaxation")
    separator = "calibration of the sensor"

    def observe(self, values: Values, X: Array, omega: Array) -> Array:
        return X * np.exp(-1j * omega * values["lag"])


class ChannelGain(Effect):
    name = "channel_gain"
    equation = "y(t) = g x(t)"
    owner = "channel"
    places = ("channel",)
    terms = {"gain": Quantity("1", "gain g of the channel", 1e-3, 1e3)}
    neutral = {"gain": 1.0}
    signature = "one channel only: scale"
    confusable = ("wall_stiffness",)
    separator = "calibration of the sensor"

    def observe(self, values: Values, X: Array, omega: Array) -> Array:
        return X * values["gain"]


class ChannelOffset(Effect):
    name = "channel_offset"
    equation = "y(t) = x(t) + o"
    owner = "channel"
    places = ("channel",)
    terms = {"offset": Quantity("signal", "offset o of the channel, in the unit of its signal", -1e6, 1e6)}
    neutral = {"offset": 0.0}
    signature = "one channel only: mean"
    confusable = ("external_pressure",)
    separator = "calibration of the sensor"

    def observe(self, values: Values, X: Array, omega: Array) -> Array:
        return X + np.where(omega == 0.0, values["offset"], 0.0)


class CatheterResonance(Effect):
    name = "catheter_resonance"
    equation = "Y/X = 1/(1 + 2iζ f/f_n - (f/f_n)²); f_n = 0 means none"
    owner = "channel"
    places = ("channel",)
    terms = {
        "f_n": Quantity("Hz", "natural frequency f_n of the catheter (0: no resonance)", 0.0, 1e5, nominal=10.0),
        "zeta": Quantity("1", "damping ratio zeta of the catheter", 0.0, 100.0),
    }
    neutral = {"f_n": 0.0, "zeta": 1.0}
    signature = "one channel only: peak near f_n"
    confusable = ("wall_viscosity",)
    separator = "calibration of the sensor"

    def observe(self, values: Values, X: Array, omega: Array) -> Array:
        natural = 2.0 * np.pi * np.asarray(values["f_n"])
        ratio = np.divide(
            omega, natural, out=np.zeros(np.broadcast_shapes(omega.shape, natural.shape)), where=natural > 0
        )
        return X / (1.0 + 2j * np.asarray(values["zeta"]) * ratio - ratio * ratio)


ALL: tuple[Effect, ...] = (
    WallViscosity(),
    NonlinearWallViscosity(),
    NonlinearElasticity(),
    StressRelaxation(),
    ExternalPressure(),
    WallStiffness(),
    Taper(),
    FluidFriction(),
    VelocityProfile(),
    UnsteadyFriction(),
    TerminalReflection(),
    TerminalCompliance(),
    SideBranch(),
    Stenosis(),
    JunctionLoss(),
    ChannelLag(),
    ChannelGain(),
    ChannelOffset(),
    CatheterResonance(),
)
BY_NAME: dict[str, Effect] = {effect.name: effect for effect in ALL}


# --- terms of an owner --------------------------------------------------------------------------------------------


def terms_of(owner: str) -> dict[str, Quantity]:
    """The terms that a segment, fluid or channel may hold, by key, in the order of the catalogue."""
    return {key: q for effect in ALL if effect.owner == owner for key, q in effect.terms.items()}


def quantities_of(thing: Any) -> dict[str, Quantity]:
    """The quantities of an object of the network: its fields and the terms that it holds."""
    held = getattr(thing, "terms", {})
    known = terms_of(thing.OWNER) if held else {}
    return quantities(thing) | {key: q for key, q in known.items() if key in held}


def value_of(thing: Any, key: str) -> float:
    """The number behind a key of :func:`quantities_of`."""
    held = getattr(thing, "terms", {})
    return held[key] if key in held else getattr(thing, key)


def neutral_value(key: str, variable: str = "") -> float:
    """The value of a term that switches it off. Raises ValueError if no effect has such a term."""
    for effect in ALL:
        if key in effect.terms:
            return effect.neutral[key]
    raise ValueError(f"{variable or key}: no parameter of the network and no term of the catalogue.")


# --- the measurement chain as a whole -----------------------------------------------------------------------------


def observe(terms: Mapping[str, Any], X: Array, omega: Array) -> Array:
    """What a channel with these terms (lag, gain, offset, f_n, zeta) shows of a periodic signal.

    y(t) = g x(t - lag) + o, then the catheter's second order. X : (..., n) complex Fourier coefficients of e^{iωt} at
    omega : (n,) [rad/s], the mean where ω = 0. The terms are numbers, or arrays that broadcast against X. Returns X's
    shape. Raises ValueError for an unknown term.
    """
    check_known("channel", terms, terms_of("channel"))
    X, omega = np.asarray(X), np.asarray(omega, float)
    for effect in ALL:
        if effect.owner == "channel" and any(key in terms for key in effect.terms):
            X = effect.observe(dict(effect.neutral) | dict(terms), X, omega)
    return X


# --- documentation ------------------------------------------------------------------------------------------------


def table() -> str:
    """The catalogue as a Markdown table, for docs/effects.md."""
    rows = ["| Effect | Equation | Key [unit], range, off | Where | Signature | Confused with | Told apart by |"]
    rows += ["|---|---|---|---|---|---|---|"]
    for e in ALL:
        keys = "; ".join(_documented(key, q, e.neutral.get(key)) for key, q in e.quantities.items())
        rivals = ", ".join(f"`{name}`" for name in e.confusable)
        cells = (f"`{e.name}`", e.equation, keys, ", ".join(e.places), e.signature, rivals, e.separator)
        rows.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(rows)


def _documented(key: str, q: Quantity, neutral: float | None) -> str:
    unit = {"1": "–", "signal": "its signal's"}.get(q.unit, q.unit)
    off = "" if neutral is None else f", {neutral:g}"
    return f"`{key}` [{unit}] {q.low:g} to {q.high:g}{off}"
