"""Outlet conditions: each kind is one class with its numbers, the load it puts on the flow, and its impedance.

A kind defines the relation between the pressure P (elastic plus viscous) and the flow Q at the end of a segment, for
all outlets of that kind at once: its methods take the numbers by key as arrays (B, n), and the walls there. A new kind
is one class and its entry in ``OUTLETS``, with a row for each number in docs/network-file.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from ..quantities.quantity import Quantity, quantity
from .wall import Wall

Array = np.ndarray
Numbers = Mapping[str, Array]
Condition = tuple[Array, Array, Array]


@dataclass(frozen=True)
class Load:
    """The condition at the end of an implicit stage: scale Q = flow(P - P_b), arrays (B, n) or numbers.

    flow [scale · m³/s] : of P - P_b [Pa]; slope : its derivative. The pressure behind the outlet is
    P_b = keep P_C + give P_venous, and a stored pressure P_C becomes P_b + charge Q.
    """

    scale: Array | float
    flow: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    keep: Array | float = 0.0
    give: Array | float = 1.0
    charge: Array | float = 0.0

    def beside(self, outflow: Callable[[Array], tuple[Array, Array]]) -> Load:
        """The same with a further flow of P - P_b [m³/s], which comes with its derivative."""
        return replace(
            self,
            flow=lambda P: self.flow(P) + self.scale * outflow(P)[0],
            slope=lambda P: self.slope(P) + self.scale * outflow(P)[1],
        )


def _venous_pressure(description: str) -> Any:
    pressure = Quantity("Pa", description, -1e5, 1e6, nominal=1e3, display="mmHg", input=True)
    return field(default=0.0, kw_only=True, metadata={"quantity": pressure})


def _resistance(description: str) -> Any:
    facts = {"nominal": 1e9, "display": "mmHg.s/mL", "refit": ("network",), "individual": 0.1}
    return quantity(None, "Pa.s/m^3", description, 1.0, 1e15, **facts)


@dataclass(frozen=True)
class Outlet:
    """The common part of all kinds: an end of a segment. ``symbol`` and ``noun`` name the kind in drawings and
    documents; ``stores`` : it has a stored pressure P_C, which follows from its ``capacity``."""

    segment: str
    P_venous: float = _venous_pressure("venous pressure P_venous")
    terms: Mapping[str, float] = field(default_factory=dict, hash=False, kw_only=True)

    OWNER: ClassVar[str] = "outlet"
    symbol: ClassVar[str]
    noun: ClassVar[str]
    stores: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        missing = [name for name in ("symbol", "noun") if not hasattr(cls, name)]
        given = {name for base in cls.__mro__[: cls.__mro__.index(Outlet)] for name in vars(base)}
        missing += [name for name in ("load", "condition") if name not in given]
        if missing:
            raise TypeError(f"{cls.__name__}: this kind of outlet lacks {', '.join(missing)}; state them in its class.")
        cls.stores = cls.capacity.__func__ is not Outlet.capacity.__func__  # type: ignore[attr-defined]

    @property
    def label(self) -> str:
        """Its label in a drawing."""
        return self.symbol

    @classmethod
    def load(cls, numbers: Numbers, wall: Wall, tau: float) -> Load:
        """The condition over an implicit stage of length tau [s]."""
        raise NotImplementedError

    @classmethod
    def condition(cls, numbers: Numbers, wall: Wall, P_0: Array, omega: Array, Z_ref: Array) -> Condition:
        """Coefficients of a F + b P' = r at angular frequencies omega : (n_omega,) [rad/s], each (B, n_omega, n).

        P' [Pa] : amplitude about P_0 : (B, 1), at ω = 0 its mean. F = -Z_ref Q [Pa], Z_ref : (B, 1, 1) [Pa·s/m³].
        """
        raise NotImplementedError

    @classmethod
    def capacity(cls, numbers: Numbers) -> Array:
        """Volume behind the end of the segment per stored pressure P_C : (B, n) [m³/Pa]."""
        return np.zeros_like(numbers["P_venous"])

    @classmethod
    def venous_flow(cls, numbers: Numbers, P_C: Array, Q: Array) -> Array:
        """The flow [m³/s] to P_venous, where Q : (B, n) [m³/s] leaves the segment."""
        return Q

    @classmethod
    def unreachable(cls, numbers: Numbers, wall: Wall, P: Array) -> Array:
        """Where the pressure P : (B, n) [Pa] cannot occur at the outlet."""
        return np.zeros(np.broadcast_shapes(P.shape, wall.A0.shape), bool)


@dataclass(frozen=True)
class Reflection(Outlet):
    """Q = A_e w(A_e) (1 - R_t)/(1 + R_t), A_e = elastic⁻¹(P - P_venous), w = ∫ c/A dA from A0.

    For the β-law w = 4 (c - c0), as in the paper's code."""

    R_t: float = quantity(
        None, "1", "reflection coefficient R_t", -0.999, 1.0, spread=0.2, refit=("network",), individual=0.03
    )

    symbol = "R_t"
    noun = "reflection"

    @property
    def label(self) -> str:
        return f"R_t = {self.R_t:g}"

    @classmethod
    def load(cls, numbers: Numbers, wall: Wall, tau: float) -> Load:
        kappa = (1.0 - numbers["R_t"]) / (1.0 + numbers["R_t"])

        def flow(P: Array) -> Array:
            return kappa * wall.riemann_flow(P)

        def slope(P: Array) -> Array:
            A = wall.area(P)  # d(A w)/dP = (w + c)/(dP/dA)
            return kappa * (wall.riemann_velocity(A) + wall.wave_speed(A)) / wall.stiffness(A)

        return Load(1.0, flow, slope)

    @classmethod
    def condition(cls, numbers: Numbers, wall: Wall, P_0: Array, omega: Array, Z_ref: Array) -> Condition:
        # the tangent at P_0
        load, P = cls.load(numbers, wall, 0.0), P_0 - numbers["P_venous"]
        b = load.slope(P)[:, None] * Z_ref
        return np.ones_like(b), b, -load.flow(P)[:, None] * Z_ref * steady(omega)

    @classmethod
    def unreachable(cls, numbers: Numbers, wall: Wall, P: Array) -> Array:
        with np.errstate(invalid="ignore"):
            return ~(wall.wave_speed(wall.area(P - numbers["P_venous"])) > 0.0)


def _linear_load(Z: Array | float, wall: Wall, **store: Array) -> Load:
    """Z Q = P - P_b, both sides divided by the impedance of the segment, so that Z may be 0."""
    characteristic = wall.rho * wall.c0 / wall.A0
    slope = 1.0 / characteristic
    return Load(Z / characteristic, lambda P: slope * P, lambda P: slope, **store)


def _linear_condition(Z: Array, numbers: Numbers, P_0: Array, omega: Array, Z_ref: Array) -> Condition:
    """P - P_venous = Z Q, with Z : (B, n_omega, n)."""
    mean = (numbers["P_venous"] - P_0)[:, None] * steady(omega)
    return Z / Z_ref, np.ones(Z.shape), mean


def steady(omega: Array) -> Array:
    """(n_omega, 1): 1 where ω = 0, else 0."""
    return np.where(omega == 0.0, 1.0, 0.0)[:, None]


@dataclass(frozen=True)
class Windkessel(Outlet):
    """Three-element Windkessel: P = P_C + R1 Q, C dP_C/dt = Q - (P_C - P_venous)/R2."""

    R1: float = quantity(
        None, "Pa.s/m^3", "proximal resistance R1", 0.0, 1e15, nominal=1e8, display="mmHg.s/mL", individual=0.2
    )
    C: float = quantity(None, "m^3/Pa", "compliance C", 1e-16, 1.0, nominal=1e-9, display="mL/mmHg", individual=0.2)
    R2: float = _resistance("distal resistance R2")

    symbol = "RCR"
    noun = "Windkessel"

    @classmethod
    def load(cls, numbers: Numbers, wall: Wall, tau: float) -> Load:
        store = tau / numbers["C"]  # P_C by a backward Euler step of length τ
        keep = 1.0 / (1.0 + store / numbers["R2"])
        charge = keep * store
        return _linear_load(numbers["R1"] + charge, wall, keep=keep, give=charge / numbers["R2"], charge=charge)

    @classmethod
    def capacity(cls, numbers: Numbers) -> Array:
        return numbers["C"]

    @classmethod
    def venous_flow(cls, numbers: Numbers, P_C: Array, Q: Array) -> Array:
        return (P_C - numbers["P_venous"]) / numbers["R2"]

    @classmethod
    def condition(cls, numbers: Numbers, wall: Wall, P_0: Array, omega: Array, Z_ref: Array) -> Condition:
        R1, C, R2 = (numbers[key][:, None] for key in ("R1", "C", "R2"))
        return _linear_condition(R1 + R2 / (1.0 + 1j * omega[:, None] * C * R2), numbers, P_0, omega, Z_ref)


@dataclass(frozen=True)
class Resistance(Outlet):
    """Pure resistance: P - P_venous = R Q."""

    R: float = _resistance("resistance R")

    symbol = "R"
    noun = "resistance"

    @classmethod
    def load(cls, numbers: Numbers, wall: Wall, tau: float) -> Load:
        return _linear_load(numbers["R"], wall)

    @classmethod
    def condition(cls, numbers: Numbers, wall: Wall, P_0: Array, omega: Array, Z_ref: Array) -> Condition:
        return _linear_condition(numbers["R"][:, None] + 0.0 * omega[:, None], numbers, P_0, omega, Z_ref)


@dataclass(frozen=True)
class Pressure(Outlet):
    """Prescribed pressure: P = P_venous."""

    P_venous: float = _venous_pressure("prescribed pressure P_venous")

    symbol = "P"
    noun = "prescribed pressure"

    @classmethod
    def load(cls, numbers: Numbers, wall: Wall, tau: float) -> Load:
        return _linear_load(np.zeros_like(wall.A0), wall)

    @classmethod
    def condition(cls, numbers: Numbers, wall: Wall, P_0: Array, omega: Array, Z_ref: Array) -> Condition:
        nothing = np.zeros_like(numbers["P_venous"])[:, None] * omega[:, None]
        return _linear_condition(nothing, numbers, P_0, omega, Z_ref)


OUTLETS: tuple[type[Outlet], ...] = (Reflection, Windkessel, Resistance, Pressure)
