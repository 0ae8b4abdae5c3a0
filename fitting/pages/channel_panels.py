"""Figures with a panel for each channel, in the order of places."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from solver.quantities.units import of_signal

from .style import Picture

_COLUMNS = 3  # panels in a row


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
