"""This animal's walls: every number of every artery and outlet as the record has it, beside the network file's."""

from __future__ import annotations

import numpy as np

from fitting.inference.fit import Fit
from fitting.inference.hierarchy import Linear, with_widths
from fitting.inference.prior import calibrated
from fitting.inference.terms import rewired
from fitting.inference.unknown import interval
from solver.network import Network
from solver.quantity import Quantity

from .outcome import OwnNumber, Walls

_TOLD = 3  # odd numbers with a sentence of their own


def walls_of(network: Network, fit: Fit, quantile: float) -> Walls:
    """What a fit says of every artery and outlet; only of the kind where all have it in common.

    The deviation of a number is what its own unknowns move it by, beside what moves all together. quantile : half a
    95 % interval in standard deviations.
    """
    named = {u for term in fit.terms for u in term.unknowns}  # what an effect has of its own is no deviation
    own = np.array([bool(u.group) and u not in named for u in fit.unknowns], bool)
    if not own.any():
        return Walls()
    fit = with_widths(fit)
    whole = rewired(network, fit.terms)
    file, nominal, known = network.parameters(), whole.parameters(), whole.parameter_quantities()
    arteries, told = {}, calibrated(fit.unknowns)
    deviate = {variable for u, mine in zip(fit.unknowns, own, strict=True) if mine for variable in u.variables}
    for name in (name for name in nominal if name in deviate and known[name].individual > 0.0):
        now = interval(fit.unknowns, name, nominal[name], known[name], fit.x, fit.covariance, quantile)
        moved = np.array([dict(u.moves).get(name, 0.0) for u in fit.unknowns])[own] @ fit.x[own]
        source = "calibration" if name in told else "file"
        arteries[name] = OwnNumber(file[name], now, float(moved / known[name].individual), source)
    return Walls("individual", _spread(fit, known), arteries)


def _spread(fit: Fit, known: dict[str, Quantity]) -> dict[str, tuple[float, float]]:
    """The stated spread of every quantity between arteries, and the one that makes the record most probable."""
    sizes = {name.rpartition(".")[2]: q.individual for name, q in known.items()}
    return {group: (sizes[group], width * sizes[group]) for group, width in Linear.of(fit).inferred().of.items()}


def odd_ones(walls: Walls, network: Network) -> list[str]:
    """A sentence for each of the numbers farthest beyond the stated spread, and one for all the others."""
    odd = sorted((name for name, own in walls.arteries.items() if own.beyond),
                 key=lambda name: -abs(walls.arteries[name].deviation))  # fmt: skip
    told, rest = odd[:_TOLD], odd[_TOLD:]
    said = [_odd(name, walls.arteries[name], network) for name in told]
    if rest:
        said.append(f"Beyond their stated spreads, and this subject's own, are also {', '.join(rest)}; see its walls.")
    return said


def _odd(name: str, own: OwnNumber, network: Network) -> str:
    quantity, more = network.parameter_quantities()[name], own.now.value - own.file
    scaled = quantity.low >= 0.0 and own.file > 0.0
    by = f"{100.0 * abs(more) / own.file:.0f} %" if scaled else f"{abs(more):.2g}"
    side = "above" if more > 0.0 else "below"
    return (
        f"{name}: the {quantity.description} is {by} {side} the {own.source}'s, {abs(own.deviation):.1f} stated "
        "spreads from what all have in common: this subject's own, not counted as an effect."
    )
