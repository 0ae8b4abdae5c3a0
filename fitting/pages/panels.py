"""Figures of many channels: a panel for each, a legend, and the image for a page."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from solver.quantities.units import of_signal

from .style import BLACK, SKY, VERMILION, Picture, png

Array = np.ndarray

MEASURED, SIMULATED, BAND = BLACK, VERMILION, SKY
DASHED = (0, (4, 2))
Curve = tuple[str, str, Any]  # text of the legend (empty: none), colour, line style
_COLUMNS, _LOOPS = 3, 4  # panels in a row
_MOST_POINTS = 1000  # of a curve on the page
_PIXELS = 100  # an inch of figure on the page; the image itself has twice as many


@dataclass(frozen=True)
class Drawing:
    """One figure as PNG, its width on the page [pixels], and its caption."""

    png: bytes
    width: int
    caption: str

    @property
    def source(self) -> str:
        """The PNG as a data URL."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")


def shown(name: str, *beats: Array) -> tuple[Array, ...]:
    """Beats in their display unit, closed (the first sample also ends the beat) and thinned for the page."""
    step = max(1, len(beats[0]) // _MOST_POINTS)
    return tuple(np.append(beat[::step], beat[0]) * of_signal(name)[1] for beat in beats)


def by_place(names: Sequence[str]) -> tuple[Picture, dict[str, Axes]]:
    """A panel for each channel; if places have several channels, each place begins a row."""
    places = [name.rpartition(".")[0] for name in names]
    several = len(set(places)) < len(places)
    cells: dict[str, tuple[int, int]] = {}
    row, column = 0, -1
    for i, name in enumerate(names):
        column += 1
        if column == _COLUMNS or (several and i and places[i] != places[i - 1]):
            row, column = row + 1, 0
        cells[name] = (row, column)
    columns = 1 + max(column for _, column in cells.values())
    figure = Picture(figsize=(3.6 * max(2, columns), 1.9 * (row + 1) + 0.4), layout="constrained")
    grid = figure.add_gridspec(row + 1, columns)
    panels = {name: figure.add_subplot(grid[cell]) for name, cell in cells.items()}
    for name, panel in panels.items():
        panel.set_title(name, loc="left")
        panel.set_ylabel(of_signal(name)[0])
        panel.locator_params(nbins=4)
        if cells[name][0] == max(r for r, c in cells.values() if c == cells[name][1]):
            panel.set_xlabel("time [s]")
        else:
            panel.tick_params(labelbottom=False)  # the same times as below it
    return figure, panels


def waveforms(
    T: float,
    beats: Mapping[str, Sequence[Array | None]],
    bands: Mapping[str, Array],
    curves: Sequence[Curve],
    band: str,
) -> tuple[Picture, dict[str, Axes]]:
    """A panel for each channel: its beats [SI], one for each curve, and a band of ± 2 ``bands`` about the first."""
    figure, panels = by_place(list(beats))
    for name, panel in panels.items():
        for beat, (_, color, style) in zip(beats[name], curves, strict=True):
            if beat is not None:
                (y,) = shown(name, beat)
                panel.plot(np.linspace(0.0, T, len(y)), y, color=color, linestyle=style)
        middle, half = shown(name, *(x for x in (beats[name][0], bands[name]) if x is not None))
        time = np.linspace(0.0, T, len(middle))
        panel.fill_between(time, middle - 2 * half, middle + 2 * half, color=BAND, alpha=0.45, linewidth=0)
        panel.margins(x=0)
    legend(figure, *curves, band=band)
    return figure, panels


def loops(sites: Mapping[str, Sequence[tuple[Array, Array] | None]], curves: Sequence[Curve]) -> Picture:
    """Pressure against radius of each site: (P, R) [SI], one for each curve."""
    columns = min(_LOOPS, len(sites))
    rows = -(-len(sites) // columns)
    figure = Picture(figsize=(2.8 * max(2, columns), 2.4 * rows + 0.4), layout="constrained")
    for i, (site, pairs) in enumerate(sites.items()):
        panel = figure.add_subplot(rows, columns, i + 1)
        for pair, (_, color, style) in zip(pairs, curves, strict=True):
            if pair is not None:
                panel.plot(*shown("R", pair[1]), *shown("P", pair[0]), color=color, linestyle=style)
        panel.set_title(site, loc="left")
        panel.locator_params(axis="x", nbins=4)  # radii of many digits do not touch
        panel.set_xlabel(f"radius [{of_signal('R')[0]}]")
        panel.set_ylabel(f"pressure [{of_signal('P')[0]}]")
    legend(figure, *curves)
    return figure


def legend(figure: Figure, *curves: Curve, band: str = "") -> None:
    """A legend above the panels of the curves and, if it has a text, of the band."""
    handles: list[Any] = [Line2D([], [], color=c, linestyle=style, label=text) for text, c, style in curves if text]
    if band:
        handles.append(Patch(color=BAND, alpha=0.45, linewidth=0, label=band))
    figure.legend(handles=handles, loc="outside upper left", ncols=4)


def drawing(figure: Figure, caption: str) -> Drawing:
    """The figure for the page."""
    return Drawing(png(figure, 2 * _PIXELS), round(figure.get_figwidth() * _PIXELS), caption)
