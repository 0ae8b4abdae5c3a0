"""What makes the numbers of a network doubtful without making them wrong, in sentences."""

from __future__ import annotations

from .description import Network

THIN = 0.2  # h/R0, above which a thick wall yields 31 % more than a thin one, and the moduli differ by a quarter


def more_than_thin(x: float) -> float:
    """How many times as much an incompressible cylinder yields as a thin wall of the same modulus, by Lamé:
    (1 + x)²/(1 + x/2), x = h/R0, R0 its inner radius. Source: Bergel, J. Physiol. 156 (1961) 445."""
    return (1.0 + x) ** 2 / (1.0 + 0.5 * x)


def network_doubts(network: Network) -> tuple[str, ...]:
    """Sentences on values that the equations take, though they do not hold for them; usually none."""
    thick = sorted((s for s in network.segments if s.h > THIN * s.R0), key=lambda s: s.R0 / s.h)
    if not thick:
        return ()
    s, x = thick[0], thick[0].h / thick[0].R0
    others = f" (and {len(thick) - 1} more)" if len(thick) > 1 else ""
    return (
        f"segment {s.name}{others}: h/R0 = {x:.2g}, and the theory of thin walls holds up to {THIN:g}; a real wall of "
        f"this E would yield {more_than_thin(x) - 1.0:.0%} more to its pressure, so correct h or R0, or "
        "take E as a number that only fits this model.",
    )
