"""Waveforms as a table of ranges, as columns of a data frame, and as a figure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from difflib import get_close_matches

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.lines import Line2D

from fitting.pages.panels import by_place
from fitting.pages.style import BLUE, STYLE, Picture
from solver.errors import InputError
from solver.quantities.legible import number
from solver.quantities.units import of_signal
from solver.waveforms import Waveforms

from .tables import table

Array = np.ndarray

_PLACES = 12  # drawn by default
_ROWS = 60  # of the table
_DIGITS = 5


def html(result: Waveforms) -> str:
    """Minimum, mean and maximum of every variable, in its display unit."""
    rows = [_row(name, values) for name, values in result.items()]
    more = [f"{len(rows) - _ROWS} further variables are not shown."] if len(rows) > _ROWS else []
    return table(_title(result), ("variable", "unit", "least", "mean", "largest"), rows[:_ROWS], (*more, *result.notes))


def columns(result: Waveforms) -> Mapping[str, Array]:
    """Columns by heading ("CA.P [Pa]"), in SI: members of a batch one below the other, with their number in front."""
    size = _size(result)
    if size is None:
        return {"time [s]": result.time, **{result.heading(name): values for name, values in result.items()}}
    n = len(result.time)
    found = {"member": np.repeat(np.arange(size), n), "time [s]": np.tile(result.time, size)}
    for name, values in result.items():
        found[result.heading(name)] = np.broadcast_to(values, (size, n)).ravel()
    return found


def figure(result: Waveforms, *names: str) -> Picture:
    """A panel for each variable; for a batch, a curve for each member, coloured from the first to the last."""
    waveforms = _named(result, names) if names else _usual(result)
    size = _size(result) or 1
    colours = [BLUE] if size == 1 else colormaps["viridis"](np.linspace(0.0, 0.9, size))
    with rc_context(STYLE):
        drawn, panels = by_place(waveforms)
        for name, panel in panels.items():
            values = of_signal(name)[1] * np.broadcast_to(result[name], (size, len(result.time)))
            for curve, colour in zip(values, colours, strict=True):
                panel.plot(result.time, curve, color=colour)
            panel.margins(x=0)
        if size > 1:
            ends = [Line2D([], [], color=colours[i], label=f"member {i % size}") for i in (0, -1)]
            drawn.legend(handles=ends, loc="outside upper left", ncols=2)
    return drawn


def _title(result: Waveforms) -> str:
    size, last = _size(result), float(result.time[-1] - result.time[0])
    how = (
        ""
        if math.isnan(result.change)
        else f": beat {result.beats}, changed by {number(result.change, 2)} from the last"
    )
    batch = "" if size is None else f"{size} parameter sets, "
    return f"Waveforms of {batch}{len(result)} variables, {len(result.time)} times over {number(last, 4)} s{how}"


def _row(name: str, values: Array) -> tuple[str, ...]:
    unit, factor = of_signal(name)
    numbers = (factor * float(x) for x in (values.min(), values.mean(), values.max()))
    return (name, unit, *(number(x, _DIGITS) for x in numbers))


def _size(result: Waveforms) -> int | None:
    """The number of parameter sets of a batch, None for one run."""
    return next((len(values) for values in result.values() if values.ndim == 2), None)


def _usual(result: Waveforms) -> list[str]:
    """P and Q of inlets and sites; R and the outlets must be named."""
    places: dict[str, list[str]] = {}
    for name in result:
        place, _, signal = name.rpartition(".")
        if signal in "PQ" and not place.endswith(".outlet"):
            places.setdefault(place, []).append(name)
    return [name for of_place in list(places.values())[:_PLACES] for name in of_place]


def _named(result: Waveforms, names: Sequence[str]) -> list[str]:
    """Variables by their names or by that of their place. Raises ValueError."""
    found: dict[str, None] = {}
    places = [name.rpartition(".")[0] for name in result]
    for asked in names:
        mine = [name for name, place in zip(result, places, strict=True) if asked in (name, place)]
        if not mine:
            near = get_close_matches(asked, [*result, *places], 1)
            hint = f"did you mean {near[0]}?" if near else "its iteration gives all names."
            raise InputError(f"{asked}: no variable or place of this result; {hint}")
        found |= dict.fromkeys(mine)
    return list(found)
