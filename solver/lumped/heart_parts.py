"""The parts of a left heart: chambers, valves and rhythm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

from ..quantities.quantity import quantity, with_values
from .arithmetic import Number, cos, require, select


def within_a_beat(phase: Number) -> Number:
    """A phase between -1 and 2, as one between 0 and 1."""
    return select(phase < 0.0, phase + 1.0, select(phase < 1.0, phase, phase - 1.0))


@dataclass(frozen=True)
class Chamber:
    """An elastic chamber. Times are fractions of a beat, which begins with the contraction of the ventricle."""

    E_max: float = quantity(None, "Pa/m^3", "largest elastance", 1e3, 1e11, nominal=1e8, display="mmHg/mL")
    E_min: float = quantity(None, "Pa/m^3", "smallest elastance", 1e3, 1e11, nominal=1e7, display="mmHg/mL")
    V_0: float = quantity(None, "m^3", "volume at the pressure P_0", 0.0, 1e-2, nominal=1e-5, display="mL")
    P_0: float = quantity(None, "Pa", "pressure at the volume V_0", -1e4, 1e4, nominal=100.0, display="mmHg")
    begin: float = quantity(None, "1", "begin of the contraction, part of a beat", 0.0, 1.0)
    rise: float = quantity(None, "1", "duration of the contraction, part of a beat", 0.01, 0.6)
    fall: float = quantity(None, "1", "duration of the relaxation, part of a beat", 0.01, 0.4)

    def elastance(self, phase: Number, contractility: Number = 1.0) -> Number:
        """E [Pa/m³] at a phase of the beat, 0 to 1."""
        since = within_a_beat(phase - self.begin)
        rising = 0.5 - 0.5 * cos(math.pi * since / self.rise)
        falling = 0.5 + 0.5 * cos(math.pi * (since - self.rise) / self.fall)
        active = select(since < self.rise, rising, select(since < self.rise + self.fall, falling, 0.0))
        return self.E_min + (contractility * self.E_max - self.E_min) * active


@dataclass(frozen=True)
class Ventricle(Chamber):
    """An ejecting chamber, with the pressure P_0 + E (V - V_0) - R Q at the outflow Q."""

    R: float = quantity(
        None, "Pa.s/m^3", "resistance of the ejecting ventricle (source resistance)", 0.0, 1e9, nominal=1e6,
        display="mmHg.s/mL",
    )  # fmt: skip


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
    """Heart rate, contractility and density of blood."""

    rate: float = quantity(None, "Hz", "heart rate, beats per second", 0.1, 10.0)
    contractility: float = quantity(1.0, "1", "factor of the largest elastance of the ventricle", 0.01, 10.0)
    rho: float = quantity(1060.0, "kg/m^3", "density of blood", 500.0, 2000.0, nominal=1e3, tunable=False)


@dataclass(frozen=True)
class Aorta:
    """The root of the aorta."""

    curvature: float = quantity(0.2, "1", "β: how much the port's pressure changes with the curvature of Q", 0.0, 0.5)


@dataclass(frozen=True)
class Filling:
    """The inflow from the veins into the atrium."""

    R: float = quantity(None, "Pa.s/m^3", "resistance", 0.0, 1e9, nominal=1e6, display="mmHg.s/mL")


@dataclass(frozen=True)
class Heart:
    """A left heart. reference : the source of its numbers."""

    name: str
    reference: str
    heart: Pace
    left_ventricle: Ventricle
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
        return {f.name: part for f in fields(self) if is_dataclass(part := getattr(self, f.name))}

    def with_values(self, values: Mapping[str, Any]) -> Heart:
        """The heart with the parameters in ``values``; raises ValueError if they are inconsistent."""
        heart = replace(self, **{key: with_values(key, owner, values) for key, owner in self.groups.items()})
        for key in ("left_ventricle", "left_atrium"):
            chamber = getattr(heart, key)
            require(
                chamber.rise + chamber.fall <= 1.0,
                f"{key}.rise + {key}.fall = %g: contraction and relaxation must end within a beat, so at most 1; "
                "shorten them.",
                chamber.rise + chamber.fall,
            )
        return heart
