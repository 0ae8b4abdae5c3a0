"""The ends of a network: the relation between the total pressure P and the flow Q there, one class a kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from .quantity import Quantity, quantity


def _venous_pressure(description: str) -> Any:
    pressure = Quantity("Pa", description, -1e5, 1e6, nominal=1e3, display="mmHg", input=True)
    return field(default=0.0, kw_only=True, metadata={"quantity": pressure})


@dataclass(frozen=True)
class Outlet:
    """The end of a segment. Subclasses state the relation between the total pressure P and the flow Q there."""

    segment: str
    P_venous: float = _venous_pressure("venous pressure P_venous")
    terms: Mapping[str, float] = field(default_factory=dict, hash=False, kw_only=True)

    OWNER: ClassVar[str] = "outlet"


@dataclass(frozen=True)
class Reflection(Outlet):
    """Q = A_e w(A_e) (1 - R_t)/(1 + R_t), A_e = elastic⁻¹(P - P_venous), w = ∫ c/A dA from A0.

    For the β-law w = 4 (c - c0), as in the paper's code."""

    R_t: float = quantity(None, "1", "reflection coefficient R_t", -0.999, 1.0, spread=0.2, refit=("network",))


@dataclass(frozen=True)
class Windkessel(Outlet):
    """Three-element Windkessel: P = P_C + R1 Q, C dP_C/dt = Q - (P_C - P_venous)/R2."""

    R1: float = quantity(None, "Pa.s/m^3", "proximal resistance R1", 0.0, 1e15, nominal=1e8, display="mmHg.s/mL")
    C: float = quantity(None, "m^3/Pa", "compliance C", 1e-16, 1.0, nominal=1e-9, display="mL/mmHg")
    R2: float = quantity(
        None, "Pa.s/m^3", "distal resistance R2", 1.0, 1e15, nominal=1e9, display="mmHg.s/mL", refit=("network",)
    )


@dataclass(frozen=True)
class Resistance(Outlet):
    """Pure resistance: P - P_venous = R Q."""

    R: float = quantity(
        None, "Pa.s/m^3", "resistance R", 1.0, 1e15, nominal=1e9, display="mmHg.s/mL", refit=("network",)
    )


@dataclass(frozen=True)
class Pressure(Outlet):
    """Prescribed pressure: P = P_venous."""

    P_venous: float = _venous_pressure("prescribed pressure P_venous")


OUTLETS: tuple[type[Outlet], ...] = (Reflection, Windkessel, Resistance, Pressure)
