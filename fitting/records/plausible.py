"""Whether the numbers of a record can be those of an artery: a wrong unit is named before anything is computed.

A factor of 7.5 between kPa and mmHg, or of 10 between mm and cm, changes E by the full factor, and no fit shows it.
Every channel is therefore compared with the range of arteries of mammals, and a unit in which its numbers would be
plausible is proposed.

The mean arterial pressure of mammals is about 100 mmHg whatever their size, 200 mmHg in giraffes; their aortic peak
velocity is about 1 m/s whatever their size (Nichols, O'Rourke & Vlachopoulos, McDonald's Blood Flow in Arteries, 6th
ed. 2011). Radii go from 0.1 mm, of a mouse's femoral artery, to 30 mm, of a horse's aorta.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from solver.network.description import Network
from solver.quantities.units import of_signal

from . import limits
from .read.record import Array, Record
from .read.sensors import KINDS, UnusableRecord
from .read.titles import factor

UNITS = {"P": ("mmHg", "kPa", "Pa"), "R": ("mm", "cm", "m", "um"), "Q": ("mL/s", "L/min", "mL/min", "m^3/s")}


@dataclass(frozen=True)
class Artery:
    """What is known of an artery beside its record, None where it is not: R0 and h [m], slope dP/dR of its wall [Pa/m].

    pulse : of its pressure [Pa], by the slope and the measured radius.
    """

    R0: float | None = None
    h: float | None = None
    slope: float | None = None
    pulse: float | None = None


def arteries(network: Network) -> dict[str, Artery]:
    """The arteries of a network by the names that its channels have."""
    stiff = 1.0 - network.eta**2
    known = {s.name: Artery(s.R0, s.h, s.E * s.h / (stiff * s.R0**2)) for s in network.segments}
    sites = {site.name: known[site.segment] for site in network.sites}
    return known | sites | {"inlet": known[network.inlet.segment]}


def check_plausible(record: Record, known: Mapping[str, Artery]) -> None:
    """Raise UnusableRecord for a channel that no artery has; known : the arteries by the names of channels.

    The sentence names the unit in which its numbers would be an artery's, if there is one.
    """
    for together, (name, values) in product((False, True), record.channels.items()):
        site, _, kind = name.rpartition(".")
        artery = known.get(site, Artery())
        if together and artery.slope is not None and f"{site}.R" in record.channels:
            artery = replace(artery, pulse=artery.slope * _pulse(record.channels[f"{site}.R"]))
        fault = _fault(kind, values, artery)
        if fault:
            option = record.maps.get(name, f"{name}={name}")
            advice = _advice(name, values, record.scales.get(name, 1.0), artery, option)
            raise UnusableRecord(
                f"{record.path}: {name}: {fault}; {advice}, or --as-measured if it is truly so (a phantom, a vein)."
            )


def _advice(name: str, values: Array, scale: float, artery: Artery, option: str) -> str:
    """What may be wrong. scale : SI over the unit that was read. option : --map that reads it, without a unit."""
    kind = name.rpartition(".")[2]
    if option.endswith(".R") and artery.R0 is not None and not _fault(kind, values / 2.0, artery):
        unit = next((f" [{each}]" for each in UNITS[kind] if factor(each, KINDS[kind]) == scale), "")
        return f'its numbers are those of a diameter: give it as one, --map "{option.removesuffix(".R")}.D{unit}"'
    # no unit moves zero: a flow under the title of a pressure keeps its negative numbers
    column = "it falls to zero or below, as a flow does: check that the column is a pressure"
    doubt = kind == "P" and np.nanpercentile(values, limits.LEVELS[0]) <= 0.0
    for unit in UNITS[kind]:
        other = factor(unit, KINDS[kind]) or 1.0
        if abs(other / scale - 1.0) > 0.1 and not _fault(kind, values * (other / scale), artery):
            fits = f'its numbers fit the unit {unit}: correct the title, or --map "{option} [{unit}]"'
            return f"{column}; if it is, {fits}" if doubt else fits
    return column if doubt else "check its unit, its sensor, and whether it is of this artery"


def _pulse(values: Array) -> float:
    low, _, high = np.nanpercentile(values, limits.LEVELS)
    return float(high - low)


def _fault(kind: str, values: Array, artery: Artery) -> str:
    """Why values (n,) [SI] are no artery's, in the unit that people read; "" if they may be."""
    unit, factor = of_signal(kind)
    low, middle, high = np.nanpercentile(values, limits.LEVELS)
    pulse = high - low
    if kind == "P":
        if abs(middle) > limits.HIGHEST_MEAN:
            return f"its mean is {factor * middle:.4g} {unit}, and no artery's is beyond 300 {unit}"
        if not limits.PULSE[0] <= pulse <= limits.PULSE[1]:
            return f"its pulse is {factor * pulse:.3g} {unit}, and that of arteries from 2 to 200 {unit}"
        if 0.0 < middle < limits.LOW_MEAN and pulse < limits.SYSTEMIC * middle:
            return f"its mean is {factor * middle:.3g} {unit}, and its pulse but {pulse / middle:.2g} of that"
        if artery.pulse is not None and not 1.0 / limits.STEEP < pulse / artery.pulse < limits.STEEP:
            return f"it rises {pulse / artery.pulse:.3g} times as steeply with the radius as in the model"
    if kind == "R":
        if not limits.RADIUS[0] <= middle <= limits.RADIUS[1]:
            return f"its mean is {factor * middle:.4g} {unit}, and arteries have from 0.05 to 40 {unit}"
        if artery.R0 is not None and not 1.0 / limits.TO_R0 < middle / artery.R0 < limits.TO_R0:
            return f"its mean is {factor * middle:.4g} {unit}, and R0 is {factor * artery.R0:.4g} {unit}"
        if artery.h is not None and not limits.WALL[0] <= artery.h / middle <= limits.WALL[1]:
            return (
                f"its mean is {factor * middle:.4g} {unit} and h is {factor * artery.h:.3g} {unit}, which is "
                f"{artery.h / middle:.2g} of it, where arteries have from {limits.WALL[0]:g} to {limits.WALL[1]:g}"
            )
    if kind == "Q" and artery.R0 is not None:
        peak = max(abs(low), abs(high)) / (np.pi * artery.R0**2)
        if peak > limits.FASTEST_FLOW:
            return (
                f"its peak is {peak:.3g} m/s over the area at R0, and no artery's is beyond {limits.FASTEST_FLOW:g} m/s"
            )
    return ""
