"""What makes the numbers of a network doubtful without making them wrong, in sentences."""

from __future__ import annotations

from .description import Network

# The walls' law is that of a thin one, p ∝ E h/R0. A thick, incompressible tube of inner radius R0 yields by Lamé
# 2 (1 + x)²/(2 + x) times as much, x = h/R0: 31 % more at the usual limit of 0.2
THIN = 0.2


def network_doubts(network: Network) -> tuple[str, ...]:
    """Sentences on values that the equations take, though they do not hold for them; usually none."""
    thick = sorted((s for s in network.segments if s.h > THIN * s.R0), key=lambda s: s.R0 / s.h)
    if not thick:
        return ()
    s, x = thick[0], thick[0].h / thick[0].R0
    others = f" (and {len(thick) - 1} more)" if len(thick) > 1 else ""
    return (
        f"segment {s.name}{others}: h/R0 = {x:.2g}, and the theory of thin walls holds up to {THIN:g}; a real wall of "
        f"this E would yield {2.0 * (1.0 + x) ** 2 / (2.0 + x) - 1.0:.0%} more to its pressure, so correct h or R0, or "
        "take E as a number that only fits this model.",
    )
