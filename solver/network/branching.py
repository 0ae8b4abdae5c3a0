"""Branching of arteries: virtual branches by Murray's law and matched admittance, and the reflection at a junction.

The paper adds three virtual arteries to the aorta. Their radius follows from Murray's law and their Young's modulus
from the condition that the junction reflects nothing; this module computes both from the measured arteries.

C. D. Murray: The physiological principle of minimum work. I. The vascular system and the cost of blood volume,
Proc. Natl. Acad. Sci. 12 (1926) 207-214, doi:10.1073/pnas.12.3.207.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from ..errors import InputError
from ..quantities.quantity import quantities
from .description import Fluid, Network, Segment


def murray_radius(parent: Segment, siblings: Iterable[Segment]) -> float:
    """Radius [m] of the branch that completes a junction by Murray's law, R_p³ = Σ R_c³ (Murray 1926).

    parent, siblings : the artery that flows in, and the other arteries that flow out.
    Raises ValueError if the siblings alone reach or exceed R_p³.
    """
    siblings = list(siblings)
    rest = parent.R0**3 - sum(s.R0**3 for s in siblings)
    if rest <= 0.0:
        raise InputError(
            f"{' and '.join(f'{s.name}.R0 = {s.R0:g} m' for s in siblings)}: too large for Murray's law at the end of "
            f"{parent.name} with R0 = {parent.R0:g} m, which leaves no room for a further branch (sum of R0^3 must be "
            f"below {parent.R0**3:g} m^3); check the radii or leave the branch out."
        )
    return math.cbrt(rest)


def matched_modulus(parent: Segment, siblings: Iterable[Segment], R0: float, h: float) -> float:
    """Young's modulus E [Pa] of the branch that makes the junction well matched, Y_p = Σ Y_c.

    From Y = A0/(ρ c0) and c0² = E h/(2 (1-η²) ρ R0) the branch needs E = 2 (1-η²) π² R0⁵/(ρ h Y²), Y = Y_p - Σ Y_s.
    ρ and η are common to all arteries and cancel.

    R0, h : radius and wall thickness of the branch [m].
    Raises ValueError if the siblings alone admit as much as the parent or more.
    """
    siblings = list(siblings)
    rho, eta = 1.0, 0.0
    Y_parent, Y_siblings = admittance(parent, rho, eta), sum(admittance(s, rho, eta) for s in siblings)
    if Y_siblings >= Y_parent:
        raise InputError(
            f"{_names(siblings)}: the admittance at the end of {parent.name} is {Y_siblings / Y_parent:.4g} of "
            f"{parent.name}'s, so no further branch can match it (the ratio must be below 1); "
            f"check R0, h and E of {_names(siblings)} and {parent.name} or leave the branch out."
        )
    Y = Y_parent - Y_siblings
    return 2.0 * (1.0 - eta**2) * math.pi**2 * R0**5 / (rho * h * Y**2)


def virtual_branch(
    parent: Segment, siblings: Iterable[Segment], h: float, L: float, phi0: float = 0.0, name: str = "VA"
) -> Segment:
    """The branch that completes a junction by Murray's law (R0) and without reflection (E).

    parent, siblings : the artery that flows in, and the other arteries that flow out.
    h, L : wall thickness and length of the branch [m]. phi0 : its wall viscosity [Pa·s]. name : its name.
    Raises ValueError if no such branch exists or a value is outside the range of
    :class:`solver.network.description.Segment`.
    """
    siblings = list(siblings)
    allowed = quantities(Segment)
    for key, value in {"h": h, "L": L, "phi0": phi0}.items():
        allowed[key].check(f"{name}.{key}", value)
    R0 = murray_radius(parent, siblings)
    E = matched_modulus(parent, siblings, R0, h)
    for key, value in {"R0": R0, "E": E}.items():
        allowed[key].check(f"{name}.{key}", value)
    return Segment(name, L=L, R0=R0, h=h, E=E, phi0=phi0)


def admittance(segment: Segment, rho: float = Fluid.rho, eta: float = Network.eta) -> float:
    """Characteristic admittance Y = A0/(ρ c0) [m³/(Pa·s)] of an elastic artery at its reference radius.

    c0² = E h/(2 (1-η²) ρ R0), which is 2 E h/(3 ρ R0) for η = 0.5. rho : [kg/m³]. eta : Poisson's ratio.
    """
    c0 = math.sqrt(segment.E * segment.h / (2.0 * (1.0 - eta**2) * rho * segment.R0))
    return math.pi * segment.R0**2 / (rho * c0)


def reflection_coefficient(parents: Iterable[Segment], children: Iterable[Segment]) -> float:
    """Γ = (Σ Y_p - Σ Y_c)/(Σ Y_p + Σ Y_c): reflected over incident pressure at a junction of elastic arteries.

    0 is well matched, 1 a closed end, -1 an open one. ρ and η are common to all arteries and cancel. For several
    parents it is the coefficient of equal waves that arrive in all of them together. Linear waves, no wall viscosity.
    Raises ValueError if there are no parents.
    """
    parents = list(parents)
    if not parents:
        raise InputError("reflection coefficient: no parents; name at least one artery that flows in.")
    Y_parents, Y_children = sum(map(admittance, parents)), sum(map(admittance, children))
    return (Y_parents - Y_children) / (Y_parents + Y_children)


def _names(segments: list[Segment]) -> str:
    return " and ".join(s.name for s in segments)
