"""The catalogue of effects: physical terms that a network has or lacks, one small class per row, all in ``ALL``.

An effect defines its name, equation, units and ranges, the places where it may act, its terms in the equations, by the
hooks of :class:`solver.laws.effect.Effect`, and its search coordinates. ``ALL`` determines everything else: the keys of
the network file, the FMU's variables, batch parameters, candidates and docs/effects.md (:mod:`solver.laws.catalogue`).
Some effects use fields that every network has (phi0, R_t, k …); the numbers of the others are *terms*, which an owner
has only if they were given.

Effects on a part of a segment (stenosis, side branch, wall stiffness) are in :mod:`solver.laws.localised`, those of
sensors in :mod:`solver.laws.sensors`, learned ones in :mod:`solver.laws.learned`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from ..errors import InputError
from ..quantities.coordinate import SCALE, Coordinate
from ..quantities.quantity import Quantity, quantities
from ..quantities.text import check_keys
from .effect import (
    ALL_PLACES,
    Anatomy,
    Array,
    Described,
    Drag,
    Effect,
    Points,
    SearchSpec,
    Values,
    small_wave_impedance,
)
from .learned import LearnedOutlet, LearnedWall
from .localised import SideBranch, Stenosis, WallStiffness
from .outlets import Reflection, Windkessel
from .sensors import CatheterResonance, ChannelGain, ChannelLag, ChannelOffset, KnownDelay, KnownZero, LowPass
from .springpot import FractionalViscosity
from .wall import Wall

# --- the wall -----------------------------------------------------------------------------------------------------


class WallViscosity(Effect):
    name = "wall_viscosity"
    equation = "σ = … + φ0 ε̇"
    owner = "segment"
    places = ("all", "segment")
    terms = {
        "phi0": Quantity(
            "Pa.s",
            "wall viscosity phi0",
            0.0,
            1e8,
            nominal=1e4,
            display="kPa.s",
            spread=0.2,
            refit=("network", "wall"),
            individual=0.2,
        )
    }
    always = True
    neutral = {"phi0": 0.0}
    search = SearchSpec(
        typical={"phi0": 0.017}, relative={"phi0": ("E", "s")}, starts=((0.1,), (0.3,), (1.0,)), local=True
    )
    signature = "the P-R loop opens, its loss proportional to ω; high harmonics are damped"
    confusable = ("stress_relaxation", "channel_lag")
    separator = "radius; a second heart rate"

    def scaled(self, key: str, values: Sequence[float]) -> float | None:
        """0.3 (a change of 30 %) where all walls are viscous; None, a shift, where an elastic wall becomes viscous."""
        return 0.3 if all(value > 0.0 for value in values) else None

    def coordinates(self, network: Described, place: str, bench: bool = False) -> tuple[Coordinate, ...]:
        viscous = [s.phi0 > 0.0 for s in network.segments]
        mixed = place == "all" and any(viscous) and not all(viscous)  # no single number describes this
        return () if mixed else super().coordinates(network, place, bench)

    def of_animal(self, network: Described, place: str) -> bool:
        """True if the model already has viscosity there: another value belongs to the animal and is no discovery."""
        return any(s.phi0 > 0.0 for s in network.segments if place in (ALL_PLACES, s.name))

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, phi0=values["phi0"])


class NonlinearWallViscosity(Effect):
    name = "nonlinear_wall_viscosity"
    equation = "φ0 ε̇ becomes φ0 (e^(2rε̇) - 1)/(2r), r = φNL/φ0 (viscous_law = monotone) or φ0 ε̇ + φNL ε̇² (quadratic)"
    owner = "segment"
    places = ("all", "segment")
    terms = {
        "phiNL": Quantity(
            "Pa.s^2", "nonlinear wall viscosity phiNL", -1e8, 1e8, nominal=1e4, display="kPa.s^2", ratio_to="phi0"
        )
    }
    always = True
    neutral = {"phiNL": 0.0}
    needs = "phi0"  # an effect on the viscous stress needs a viscous wall
    search = SearchSpec(
        typical={"phiNL": 0.5}, relative={"phiNL": ("phi0", "s")}, starts=((0.5,), (-0.5,), (-2.0,)), local=True
    )
    signature = "even in ε̇: acts in the upstroke and at the second harmonic"
    confusable = ("nonlinear_elasticity",)
    separator = "phase of the second harmonic; a second pulse amplitude"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        phiNL, phi0 = np.broadcast_arrays(values["phiNL"], wall.phi0)
        r = np.divide(phiNL, phi0, out=np.zeros_like(phi0), where=phi0 > 0.0)
        return replace(wall, r=r, nonlinear=bool(np.any(phiNL != 0.0)))


class NonlinearElasticity(Effect):
    name = "nonlinear_elasticity"
    equation = "σ = … + E_NL ε²"
    owner = "segment"
    places = ("all", "segment")
    terms = {
        "ENL": Quantity("Pa", "nonlinear elastic modulus ENL", -1e10, 1e10, nominal=1e4, display="MPa", ratio_to="E")
    }
    always = True
    neutral = {"ENL": 0.0}
    search = SearchSpec(typical={"ENL": 1.0}, relative={"ENL": ("E", "1")}, starts=((1.0,), (4.0,)), local=True)
    signature = "curves the centre line of the P-R loop without changing its area"
    confusable = ("external_pressure",)
    separator = "a second mean pressure"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, e=values["ENL"] * wall.K_h / wall.K, bent=bool(np.any(values["ENL"] != 0.0)))


class StressRelaxation(Effect):
    name = "stress_relaxation"
    equation = "τ dσ_v/dt + σ_v = φ0 ε̇: the viscous stress relaxes"
    owner = "segment"
    places = ("all", "segment")
    terms = {"tau": Quantity("s", "relaxation time tau of the viscous stress", 0.0, 10.0, nominal=1e-2, display="ms")}
    neutral = {"tau": 0.0}
    needs = "phi0"
    remembers = True
    search = SearchSpec(typical={"tau": 0.01}, starts=((0.3,), (1.0,), (3.0,), (10.0,), (30.0,)), local=True)
    signature = "dynamic stiffness reaches a plateau at high frequency"
    confusable = ("wall_viscosity", "channel_lag")
    separator = "a second heart rate"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, tau=values["tau"][None], share=np.ones((1, *values["tau"].shape)))


class ExternalPressure(Effect):
    name = "external_pressure"
    equation = "P = P_ext + P_ref + …"
    owner = "segment"
    places = ("all", "segment")
    terms = {"P_ext": Quantity("Pa", "external pressure P_ext", -2e4, 4e4, nominal=1e3, display="mmHg")}
    neutral = {"P_ext": 0.0}
    search = SearchSpec(typical={"P_ext": 1333.0}, local=True)
    signature = "shifts the P-R loop without changing its area; indistinguishable from another R0"
    confusable = ("channel_offset",)
    separator = "a measured R0"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, P_ref=wall.P_ref + values["P_ext"])


class Taper(Effect):
    name = "taper"
    equation = "R0(x) = R0 (1 + s (x/L - 1/2)); likewise h and E, each with its own s"
    owner = "segment"
    places = ("segment",)
    terms = {
        key: Quantity("1", f"taper s of {of}, {of}(x) = {of} (1 + s (x/L - 1/2))", -1.5, 1.5, tunable=False)
        for key, of in (("taper", "R0"), ("taper_h", "h"), ("taper_E", "E"))
    }
    neutral = {"taper": 0.0, "taper_h": 0.0, "taper_E": 0.0}
    at_ends = {"R0": "taper", "h": "taper_h", "E": "taper_E"}
    search = SearchSpec(typical={"taper": 0.2})
    signature = "pulse amplification toward the periphery"
    confusable = ("wall_stiffness",)
    separator = "several sites along the segment"

    def coordinates(self, network: Described, place: str, bench: bool = False) -> tuple[Coordinate, ...]:
        """The taper of the radius alone, because records cannot distinguish the three tapers."""
        return super().coordinates(network, place, bench)[:1]

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        f, h, E = (1.0 + values[key] * (x - 0.5) for key in self.terms)
        return replace(wall, A0=wall.A0 * f * f, K=wall.K * (h * E) / f, K_h=wall.K_h * h / f, e=wall.e / E)


# --- the fluid ----------------------------------------------------------------------------------------------------


class FluidFriction(Effect):
    name = "fluid_friction"
    equation = "C_f becomes s C_f"
    owner = "fluid"
    places = ("all",)
    terms = {"friction_scale": Quantity("1", "friction scale s, C_f becomes s C_f", 0.0, 1e3)}
    neutral = {"friction_scale": 1.0}
    search = SearchSpec(typical={"friction_scale": 0.7}, scales=True)
    signature = "changes the mean pressure gradient along the path"
    confusable = ("terminal_reflection", "stenosis")
    separator = "P at both ends of a segment, with Q"

    def friction(self, C_f: Array, values: Values) -> Array:
        return C_f * values["friction_scale"]


class VelocityProfile(Effect):
    name = "velocity_profile"
    equation = "∂(α Q²/A)/∂x"
    owner = "fluid"
    places = ("all",)
    terms = {"alpha": Quantity("1", "convective coefficient alpha", 0.0, 2.0, tunable=False)}
    always = True
    neutral = {"alpha": 1.0}
    search = SearchSpec(typical={"alpha": 0.2})
    signature = "grows with the square of the flow; largest in systole near the inlet"
    confusable = ("junction_loss",)
    separator = "a second pulse amplitude"

    def convection(self, alpha: Array, values: Values) -> Array:
        return values["alpha"]


# Σ_n 1/(s + j²_{2,n}) over the zeros of J_2: the first three exactly (weight 1), the rest by five exponentials
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
    terms = {"unsteady_scale": Quantity("1", "factor s of the frequency-dependent wall shear", 0.0, 1e2)}
    neutral = {"unsteady_scale": 0.0}
    remembers = True
    search = SearchSpec(typical={"unsteady_scale": 1.0})
    signature = "attenuation of the waves grows as √ω"
    confusable = ("terminal_reflection",)
    separator = "attenuation of each harmonic between two sites"

    def drag(self, values: Values, points: Points) -> Drag | None:
        per_time = points.nu / points.R0**2
        shape = (-1,) + (1,) * per_time.ndim
        rate = WOMERSLEY_RATES.reshape(shape) * per_time
        weight = 4.0 * WOMERSLEY_WEIGHTS.reshape(shape) * per_time * values["unsteady_scale"]
        return Drag(np.zeros(np.broadcast_shapes(rate.shape[1:])), weight, rate)


# --- outlets and junctions ----------------------------------------------------------------------------------------


class TerminalReflection(Effect):
    name = "terminal_reflection"
    equation = "Q = A w(A) (1 - R_t)/(1 + R_t)"
    owner = "outlet"
    places = ("all", "outlet")
    terms = {"R_t": quantities(Reflection)["R_t"]}
    always = True
    neutral = {"R_t": 0.0}
    search = SearchSpec(typical={"R_t": 0.2})
    signature = "changes the size of the reflected wave and the mean P"
    confusable = ("side_branch",)
    separator = "Q near the outlet"

    def acts_on(self, owner: Any) -> bool:
        return "R_t" in quantities(owner)

    def outlet(self, numbers: Values, values: Values) -> Values:
        return {**numbers, **values} if "R_t" in numbers else numbers


class TerminalCompliance(Effect):
    """A Windkessel in place of the outlet condition. It replaces that condition, and so it has no neutral value."""

    name = "terminal_compliance"
    equation = "the outlet becomes P = P_C + R1 Q, C dP_C/dt = Q - (P_C - P_venous)/R2"
    owner = "outlet"
    places = ("outlet",)
    terms = {key: q for key, q in quantities(Windkessel).items() if not q.input}
    always = True
    neutral: ClassVar[Mapping[str, float]] = {}
    rewires = True
    search = SearchSpec(typical={"R1": 0.3, "C": 0.7, "R2": 0.3})
    signature = "changes the diastolic decay of P"
    confusable = ("wall_stiffness",)
    separator = "Q near the outlet"

    def add(self, network: Anatomy, place: str, values: Mapping[str, float]) -> Anatomy:
        check_keys(self.name, values, self.variables(network, place))
        outlet = next(o for o in network.outlets if o.segment == place)
        kept = {key: getattr(outlet, key) for key in quantities(outlet)} if isinstance(outlet, Windkessel) else {}
        given = {"P_venous": outlet.P_venous} | kept | {key: float(value) for key, value in values.items()}
        missing = [key for key in self.terms if key not in given]
        if missing:
            raise InputError(f"{self.name} at {place}: give {', '.join(missing)} too; it needs R1, C and R2.")
        return network.with_outlet(Windkessel(place, **given))

    def coordinates(self, network: Described, place: str, bench: bool = False) -> tuple[Coordinate, ...]:
        """R1, C and R2 in place of a reflection; they start from the reflection's resistance for small waves."""
        outlet = next((o for o in network.outlets if o.segment == place), None)
        if not isinstance(outlet, Reflection) or outlet.R_t > 0.99:
            return ()
        Z = small_wave_impedance(network, network.segment(place))
        total = Z * (1.0 + outlet.R_t) / (1.0 - outlet.R_t)
        start = {"R1": 0.5 * min(Z, total), "C": 0.05 / total, "R2": total - 0.5 * min(Z, total)}
        found = []
        for key, value in start.items():
            name, step = f"{place}.outlet.{key}", self.search.typical[key]
            unit = self.terms[key].unit
            found.append(Coordinate(name, SCALE, ((name, step),), -6.0 / step, 6.0 / step, unit, step, value))
        return tuple(found)


class JunctionLoss(Effect):
    name = "junction_loss"
    equation = "P + k (ρ/2) (Q/A)² is common at the junction: k = 0 static … 1 total pressure"
    owner = "junction"
    places = ("all", "junction")
    terms = {"k": Quantity("1", "pressure kept at the junction, k (0 static ... 1 total)", 0.0, 1.0)}
    always = True
    neutral = {"k": 0.0}
    search = SearchSpec(typical={"k": 1.0})
    signature = "step of the systolic pressure across one junction"
    confusable = ("stenosis",)
    separator = "P on both sides of the junction"

    def junction(self, numbers: Values, values: Values) -> Values:
        return {**numbers, **values}


ALL: tuple[Effect, ...] = (
    WallViscosity(),
    NonlinearWallViscosity(),
    NonlinearElasticity(),
    StressRelaxation(),
    FractionalViscosity(),
    LearnedWall(),
    ExternalPressure(),
    WallStiffness(),
    Taper(),
    FluidFriction(),
    VelocityProfile(),
    UnsteadyFriction(),
    TerminalReflection(),
    TerminalCompliance(),
    LearnedOutlet(),
    SideBranch(),
    Stenosis(),
    JunctionLoss(),
    ChannelLag(),
    ChannelGain(),
    ChannelOffset(),
    CatheterResonance(),
    LowPass(),
    KnownZero(),
    KnownDelay(),
)
BY_NAME: dict[str, Effect] = {effect.name: effect for effect in ALL}
