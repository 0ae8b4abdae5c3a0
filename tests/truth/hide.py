"""Hidden effects: names, sizes, and what each changes in the truth.

An effect is a name of the catalogue (or of the list outside it), where it acts, and one size that is zero where the
effect is absent; ``second`` holds what a size does not say. Truth files give the catalogue's own parameters, as
``<where>.<parameter>``; for walls everywhere ("all") these are the ratios phi0/E [s], phiNL/phi0 [s], ENL/E [-].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from .anatomy import Anatomy, Vessel

ALL = ("all",)

WALL = (
    "wall_viscosity",
    "nonlinear_wall_viscosity",
    "nonlinear_elasticity",
    "stress_relaxation",
    "external_pressure",
    "wall_stiffness",
    "fractional_viscosity",
)
FLOW = (
    "taper",
    "fluid_friction",
    "velocity_profile",
    "unsteady_friction",
    "terminal_reflection",
    "terminal_compliance",
    "side_branch",
    "stenosis",
    "junction_loss",
)
CHANNEL = ("channel_lag", "channel_gain", "channel_offset", "catheter_resonance")
OUTSIDE_WALL = ("cubic_rate", "strain_viscosity", "coulomb", "varying_tone")
OUTSIDE_SENSOR = ("inflow_bent", "inflow_rectified")
OUTSIDE = (*OUTSIDE_WALL, "swinging_outlet", *OUTSIDE_SENSOR, "wall_radius")

_MEAN_PRESSURE = 10e3  # [Pa], with which the size of a side branch becomes its conductance
_MEAN_FLOW = 15e-6  # [m³/s], the same


@dataclass(frozen=True)
class Effect:
    """One hidden effect.

    size, by name: wall_viscosity added φ0/E [s]; nonlinear_wall_viscosity added φ_NL/φ0 [s]; nonlinear_elasticity
    E_NL/E; stress_relaxation τ [s]; external_pressure P_ext [Pa]; wall_stiffness, fluid_friction, channel_gain: scale
    - 1; taper; velocity_profile α - 1; unsteady_friction its share; terminal_reflection what is added to R_t;
    terminal_compliance R2 C [s] of an end with the same resistance, of which ``second`` is distal; side_branch flow
    that leaks, as a share of 15 mL/s at 10 kPa; stenosis K; junction_loss k; channel_lag [s]; channel_offset in
    pulsatile standard deviations; catheter_resonance 1/f_n [s], with the damping ``second``.
    fractional_viscosity: share w of the springpot, of order ``second``, as ``wall.py`` has it.
    Outside the catalogue: cubic_rate φ3/φ0 [s²]; strain_viscosity c of
    φ0 (1 + cε); coulomb σ_c/E; varying_tone how far E wanders over the record, from the phase ``second`` on;
    swinging_outlet the swing of R_t at the phase ``second``; inflow_bent: Q (1 + size Q/Q_peak) is recorded;
    inflow_rectified: Q - size min(Q, 0); wall_radius: scale of R0 - 1.
    position, length : middle [x/L] and length [L] of the part that a stenosis, side_branch or wall_stiffness acts on;
    length 0 is that of its kind: a tenth for a stenosis, all for the others.
    """

    name: str
    where: tuple[str, ...]
    size: float
    second: float = 0.0
    position: float = 0.5
    length: float = 0.0

    @property
    def over_beats(self) -> bool:
        """Whether it makes beats differ, and is nothing in a single one."""
        return self.name == "varying_tone"

    @property
    def on_channel(self) -> bool:
        return self.name in CHANNEL or self.name.startswith("inflow")


def hide(model: Anatomy, effect: Effect) -> Anatomy:
    """The truth with an effect of walls, flow, ends or junctions. Raises KeyError for an unknown name."""
    if effect.on_channel:
        return model
    if effect.name in _VESSEL:
        return _vessels(model, effect, _VESSEL[effect.name])
    return _MODEL[effect.name](model, effect)


def _vessels(model: Anatomy, effect: Effect, change: Callable[[Vessel, Effect], Vessel]) -> Anatomy:
    chosen = [v for v in model.vessels if effect.where == ALL or v.name in effect.where]
    return model.with_vessels(*(change(v, effect) for v in chosen))


def _part(key: str, effect: Effect, length: float) -> dict[str, Any]:
    """Where an effect of a part of a vessel acts; length : of its kind."""
    return {f"{key}_position": effect.position, f"{key}_length": effect.length or length}


def _leak(vessel: Vessel, effect: Effect) -> float:
    """Conductance per length of the part that leaks [m²/(Pa s)]."""
    start, stop = replace(vessel, **_part("leak", effect, 1.0)).part("leak")
    return effect.size * _MEAN_FLOW / (_MEAN_PRESSURE * vessel.L * (stop - start))


_VESSEL: dict[str, Callable[[Vessel, Effect], Vessel]] = {
    "wall_viscosity": lambda v, x: replace(v, phi0=v.phi0 + x.size * v.E),
    "nonlinear_wall_viscosity": lambda v, x: replace(v, r=v.r + x.size),
    "nonlinear_elasticity": lambda v, x: replace(v, e=v.e + x.size),
    "stress_relaxation": lambda v, x: replace(v, tau=x.size),
    "external_pressure": lambda v, x: replace(v, P_ext=x.size),
    "wall_stiffness": lambda v, x: replace(v, E_scale=1.0 + x.size, **_part("E", x, 1.0)),
    "taper": lambda v, x: replace(v, taper=x.size),
    "side_branch": lambda v, x: replace(v, leak=_leak(v, x), **_part("leak", x, 1.0)),
    "stenosis": lambda v, x: replace(v, K=x.size, **_part("K", x, 0.1)),
    "fractional_viscosity": lambda v, x: replace(v, springpot=x.size, order=x.second),
    "cubic_rate": lambda v, x: replace(v, phi3=x.size * v.phi0),
    "strain_viscosity": lambda v, x: replace(v, c=x.size),
    "coulomb": lambda v, x: replace(v, coulomb=x.size * v.E),
    "wall_radius": lambda v, x: replace(v, R0=v.R0 * (1.0 + x.size)),
}


def _reflection(model: Anatomy, effect: Effect) -> Anatomy:
    ends = [e for e in model.ends if effect.where == ALL or e.vessel in effect.where]
    return model.with_ends(*(replace(e, R_t=min(max(e.R_t + effect.size, -0.95), 0.97)) for e in ends))


def _compliance(model: Anatomy, effect: Effect) -> Anatomy:
    end = model.end(effect.where[0])
    vessel = model.vessel(end.vessel)
    K = vessel.E * vessel.h / ((1.0 - model.eta**2) * vessel.R0)
    A0 = 3.141592653589793 * vessel.R0**2
    resistance = (model.rho * K / 2.0) ** 0.5 / A0 * (1.0 + end.R_t) / (1.0 - end.R_t)  # ρ c0/A0 and its mismatch
    R2 = effect.second * resistance
    return model.with_ends(replace(end, kind="impedance", R1=resistance - R2, R2=R2, C=effect.size / R2))


def _junction(model: Anatomy, effect: Effect) -> Anatomy:
    def changed(k: float, name: str) -> float:
        return effect.size if effect.where == ALL or name in effect.where else k

    return replace(model, joins=tuple(replace(j, k=changed(j.k, j.inflow[0])) for j in model.joins))


def _swing(model: Anatomy, effect: Effect) -> Anatomy:
    ends = [e for e in model.ends if effect.where == ALL or e.vessel in effect.where]
    return model.with_ends(*(replace(e, swing=effect.size, swing_phase=effect.second) for e in ends))


_MODEL: dict[str, Callable[[Anatomy, Effect], Anatomy]] = {
    "fluid_friction": lambda m, x: replace(m, friction=m.friction * (1.0 + x.size)),
    "velocity_profile": lambda m, x: replace(m, alpha=m.alpha + x.size),
    "unsteady_friction": lambda m, x: replace(m, unsteady=x.size),
    "terminal_reflection": _reflection,
    "terminal_compliance": _compliance,
    "junction_loss": _junction,
    "swinging_outlet": _swing,
    "varying_tone": lambda m, x: replace(m, tone=x.size, tone_phase=x.second),
}


def parameters(model: Anatomy, effect: Effect) -> dict[str, float]:
    """The catalogue's parameters of an effect that is hidden in ``model`` (the truth), SI; by ``<where>.<name>``."""
    if effect.name in _RATIOS and effect.where == ALL:
        key, ratio = _RATIOS[effect.name]
        return {f"all.{key}": ratio(model.vessels[0])} | {f"{v.name}.{key}": _value(v, key) for v in model.vessels}
    if effect.name in _PARTS:
        key, part, length = _PARTS[effect.name]
        found = {name: {key: getattr(model.vessel(name), key)} for name in effect.where}
        if (effect.position, effect.length or length) != (0.5, length):
            found = {name: held | _part(part, effect, length) for name, held in found.items()}
        return {f"{name}.{key}": value for name, held in found.items() for key, value in held.items()}
    if effect.name in _KEYS:
        key = _KEYS[effect.name]
        if effect.where == ALL:
            return {f"all.{key}": _value(model.vessels[0], key)}
        held = {f"{name}.{key}": _value(model.vessel(name), key) for name in effect.where}
        return held | {f"{name}.{key}_position": effect.position for name in effect.where if effect.length}
    plain = {
        "fluid_friction": ("friction_scale", 1.0 + effect.size),
        "velocity_profile": ("alpha", model.alpha),
        "unsteady_friction": ("unsteady_scale", model.unsteady),
        "junction_loss": ("k", effect.size),
        "channel_lag": ("lag", effect.size),
        "channel_gain": ("gain", 1.0 + effect.size),
    }
    if effect.name in plain:
        key, value = plain[effect.name]
        return {f"{name}.{key}": value for name in effect.where}
    if effect.name in ("terminal_reflection", "terminal_compliance"):
        keys = ("R_t",) if effect.name == "terminal_reflection" else ("R1", "C", "R2")
        ends = [e for e in model.ends if effect.where == ALL or e.vessel in effect.where]
        return {f"{e.vessel}.{key}": getattr(e, key) for e in ends for key in keys}
    if effect.name == "catheter_resonance":
        return {f"{effect.where[0]}.f_n": 1.0 / effect.size, f"{effect.where[0]}.zeta": effect.second}
    return {f"{name}.size": effect.size for name in effect.where}  # no parameter of the catalogue


def springpot_of(w: float, a: float, T: float) -> tuple[float, float]:
    """The catalogue's share of a springpot, whose reference is 10 rad/s, of a wall with share w of order a in a beat of
    T [s], and the factor by which its phi0 differs."""
    q = w * (0.2 * 3.141592653589793 / T) ** (1.0 - a)
    return q / (1.0 - w + q), 1.0 - w + q


_RATIOS: dict[str, tuple[str, Callable[[Vessel], float]]] = {
    "wall_viscosity": ("phi0", lambda v: v.phi0 / v.E),
    "nonlinear_wall_viscosity": ("phiNL", lambda v: v.r),
    "nonlinear_elasticity": ("ENL", lambda v: v.e),
}
_KEYS = {
    "wall_viscosity": "phi0",
    "nonlinear_wall_viscosity": "phiNL",
    "nonlinear_elasticity": "ENL",
    "stress_relaxation": "tau",
    "external_pressure": "P_ext",
    "taper": "taper",
}
_PARTS = {
    "wall_stiffness": ("E_scale", "E", 1.0),
    "side_branch": ("leak", "leak", 1.0),
    "stenosis": ("K", "K", 0.1),
}


def _value(vessel: Vessel, key: str) -> float:
    if key == "phiNL":
        return vessel.r * vessel.phi0
    return vessel.e * vessel.E if key == "ENL" else getattr(vessel, key)
