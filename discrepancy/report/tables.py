"""Numbers of a study as text in display units, and the tables of the page."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fitting.inference.fit import Array
from fitting.results.estimate import Estimate
from solver.laws import effects
from solver.quantities.legible import DASH, number, rounded
from solver.quantities.quantity import Quantity
from solver.quantities.units import of_signal, readable

from ..findings.map_marks import effect_text
from ..findings.outcome import ChannelBeats, Outcome

_LOUD = 3.0  # smallest |z| for which the z map has a column
_FEWEST_HARMONICS = 12
_MOST_POINTS = 400  # of a curve on the page
_OF_A_SPREAD = 0.1  # resolution of a printed deviation, in spreads


# --- classes of |z| and of separations: the same in figures and on the page --------------------------------------


@dataclass(frozen=True)
class Scale:
    """Classes of a non-negative number: class i from bounds[i] to bounds[i+1], the last without an upper bound."""

    name: str
    bounds: tuple[float, ...]
    # Brewer's Blues, white first: light to dark also in grey and to colour-blind readers
    colours: ClassVar = ("#ffffff", "#deebf7", "#c6dbef", "#9ecae1", "#6baed6", "#3182bd", "#08519c")

    def index(self, value: float) -> int:
        """The class of a value."""
        return max(bisect_right(self.bounds, value) - 1, 0)

    def colour(self, value: float) -> str:
        """The colour of a value."""
        return str(self.colours[self.index(value)])

    @property
    def texts(self) -> list[str]:
        """The classes in words."""
        between = [f"{low:g} – {high:g}" for low, high in zip(self.bounds[1:], self.bounds[2:], strict=False)]
        return [f"< {self.bounds[1]:g}", *between, f"> {self.bounds[-1]:g}"]


Z = Scale("|z|", (0.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0))
APART = Scale("separation d′", (0.0, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0))


# --- contents of an outcome ---------------------------------------------------------------------------------------


def loop_sites(outcome: Outcome) -> list[str]:
    """Sites where both pressure and radius were measured."""
    names = [channel.name for channel in outcome.channels]
    return [name[:-2] for name in names if name.endswith(".P") and f"{name[:-2]}.R" in names]


def period(outcome: Outcome) -> float:
    """The period [s] of the beat whose samples are at ``outcome.time``."""
    time = outcome.time
    return float(time[-1] - time[0]) * len(time) / (len(time) - 1)


def channel_z(outcome: Outcome) -> dict[str, float]:
    """Largest |z| of every channel that was compared."""
    columns = np.abs(outcome.z_map).T
    return {
        channel.name: float(np.nanmax(column, initial=0.0))
        for channel, column in zip(outcome.channels, columns, strict=False)
    }


def harmonics_shown(outcome: Outcome) -> int:
    """Number of rows of the z map, the mean included: up to the last one with a large |z|, and a few at least."""
    loud = np.flatnonzero((np.abs(np.nan_to_num(outcome.z_map)) > _LOUD).any(axis=1))
    wanted = max(_FEWEST_HARMONICS, int(loud[-1]) if loud.size else 0)
    return min(len(outcome.z_map), wanted + 1)


# --- numbers ------------------------------------------------------------------------------------------------------


def estimate_text(name: str, estimate: Estimate) -> tuple[str, str]:
    """(value with unit, 95 % interval) of a parameter in its display unit, rounded to the digits of the interval."""
    return _estimate_text(estimate, _quantity(name))


def _quantity(name: str) -> Quantity | None:
    """The quantity in the catalogue of a parameter of an effect."""
    key = name.rpartition(".")[2]
    return next((e.terms[key] for e in effects.ALL if key in e.terms), None)


def description(name: str) -> str:
    """The description in the catalogue of a parameter of an effect."""
    quantity = _quantity(name)
    return quantity.description if quantity else ""


def _estimate_text(estimate: Estimate, quantity: Quantity | None, least: float = 0.0) -> tuple[str, str]:
    """The same for a quantity, None for a ratio with another unit. least : smallest width [SI] of the interval."""
    display = quantity.display if quantity and quantity.unit == estimate.unit else None
    unit, factor = readable(estimate.unit, display)
    value, low, high = (factor * x for x in (estimate.value, *estimate.ci95))
    width = max(high - low, factor * least)
    value_text, low_text, high_text = (rounded(x, 0.5 * width) for x in (value, low, high))
    bounded = math.isfinite(low) and math.isfinite(high) and (low_text != high_text or not least)
    interval = f"{low_text} … {high_text}" if bounded else DASH
    return f"{value_text} {unit}".strip(), interval


def percent(value: float | None) -> str:
    """A fraction in per cent, never rounded to 100 %."""
    if value is None or not math.isfinite(value):
        return DASH
    return "> 99 %" if value >= 0.995 else f"{100 * value:.0f} %"


def gap_unit(outcome: Outcome) -> str:
    """The unit of a gap, and the reason why fitted and held-out beats have different gaps."""
    sentence = (
        "A gap is the RMS of model minus mean beat, over channels and harmonics, in units of the noise of that mean."
    )
    beats = outcome.provenance.get("beats")
    if not beats:
        return sentence
    fitted, held_out = beats["fitted"], beats["held_out"]
    return (
        f"{sentence} The mean of {held_out} held-out beats is noisier than that of {fitted} fitted beats, so that the "
        f"same misfit gives a gap {number(math.sqrt(fitted / held_out), 2)} times smaller there."
    )


def gap_text(pair: tuple[float, float] | None) -> tuple[str, str]:
    """Gap on (fitted, held-out) beats."""
    return (DASH, DASH) if pair is None else (times_noise(pair[0]), times_noise(pair[1]))


def times_noise(value: float) -> str:
    """A whitened RMS, or χ² per degree of freedom."""
    return f"{value:.2f}" if 0.0 <= value < 100.0 else number(value)


def class_texts(outcome: Outcome) -> list[str]:
    """Every hypothesis of the class in words, with its effects together; none for a class of one."""
    if len(outcome.members) < 2:
        return []
    return [" with ".join(effect_text(name, where) for name, where in member) for member in outcome.members]


def pulse_text(channel: ChannelBeats) -> str:
    """The measured pulse of a channel."""
    unit, factor = of_signal(channel.name)
    return f"{number(factor * float(np.ptp(channel.measured)))} {unit}"


# --- rows ---------------------------------------------------------------------------------------------------------


def wall_rows(outcome: Outcome) -> list[dict[str, Any]]:
    """Every parameter of every artery and outlet: the value of the file, or of a calibration, and this animal's."""
    rows, quantities = [], _quantities(outcome)
    for name, own in (outcome.walls.arteries if outcome.walls else {}).items():
        known = quantities.get(name)
        # where no differences between arteries were found, an interval is that of no deviation
        stated, found = (outcome.walls.spread if outcome.walls else {}).get(name.rpartition(".")[2], (0.0, 1.0))
        width = 0.0 if found else 2.0 * _OF_A_SPREAD * stated * (1.0 if _shifted(known) else abs(own.file))
        value, interval = _estimate_text(own.now, known, width)
        file = _estimate_text(Estimate(own.file, own.now.unit, (own.file, own.file)), known)[0]
        file += " (calibration)" if own.source == "calibration" else ""
        deviation = f"{round(own.deviation, 1) + 0.0:+.1f}".replace("-", "−").replace("+0.0", "0.0")
        texts = {"name": name, "file": file, "value": value, "interval": interval, "deviation": deviation}
        rows.append({**texts, "beyond": own.beyond})
    return rows


def _quantities(outcome: Outcome) -> Mapping[str, Quantity]:
    return outcome.network_before.parameter_quantities() if outcome.network_before else {}


def _shifted(quantity: Quantity | None) -> bool:
    """True if a parameter deviates by a shift, not by a factor, because it may be negative."""
    return quantity is not None and quantity.low < 0.0


def spread_text(outcome: Outcome) -> str:
    """A sentence with the spread between the arteries of this animal, by quantity, beside the stated spread."""
    spread = outcome.walls.spread if outcome.walls else {}
    if outcome.walls is None or not spread:
        return ""
    if not any(found for _, found in spread.values()):
        return "Beyond the common changes, the arteries do not differ."
    quantities = _quantities(outcome)
    shifted = {n.rpartition(".")[2] for n in outcome.walls.arteries if _shifted(quantities.get(n))}
    each = "; ".join(
        f"{key} {number(found, 2)} (stated {number(stated, 2)})" for key, (stated, found) in spread.items()
    )
    absolute = ", ".join(key for key in spread if key in shifted)
    parts = "relative" + (f", absolute for {absolute}" if absolute else "")
    return f"Standard deviations between arteries, {parts}: {each}."


def beats(outcome: Outcome) -> dict[str, Any]:
    """The mean beats for the interactive plot, in display units, closed and thinned; ``first``: the largest |z|."""
    time = outcome.time
    if len(time) < 2 or not outcome.channels:
        return {}
    step = -(-len(time) // _MOST_POINTS)

    def short(values: Array, factor: float) -> list[float | None]:
        closed = factor * np.append(values[::step], values[0])
        return [float(f"{x:.6g}") if math.isfinite(x) else None for x in closed.tolist()]

    channels = []
    for channel in outcome.channels:
        unit, factor = of_signal(channel.name)
        curves = {key: getattr(channel, key) for key in ("measured", "band", "before", "after")}
        short_curves = {key: None if curve is None else short(curve, factor) for key, curve in curves.items()}
        channels.append({"name": channel.name, "unit": unit, **short_curves})
    times = np.append(time[::step] - time[0], period(outcome))
    worst = channel_z(outcome)
    first = max(worst, key=worst.__getitem__) if worst else channels[0]["name"]
    return {"time": [float(f"{t:.6g}") for t in times.tolist()], "channels": channels, "first": first}
