"""Figures of a study: a tornado of every number at a site, and bands of its waveforms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from arterial_fmu.study.batch import POINTS
from fitting.pages.panels import Drawing, by_place, drawing, shown
from fitting.pages.style import BLACK, BLUE, ORANGE, SKY, STYLE

from .outcome import Study

_COLUMNS = 3
_MOST = 12  # bars of a panel
_HEIGHT, _HEAD = 0.24, 0.75  # inches: height of a bar, and of the space around the bars of a panel


def figures(study: Study, sites: Sequence[str]) -> dict[str, Drawing]:
    """The figures by file name: waveforms of the sites, and a tornado of each."""
    drawn = {}
    with rc_context(STYLE):
        channels = [name for name in study.plan.waves if name.split(".")[0] in sites]
        if channels:
            drawn["waveforms"] = _bands(study, channels)
        for site in sites:
            names = [name for name in study.plan.measures if name.split(".")[0] == site and study.indices(name)]
            if names:
                drawn[f"tornado_{site}"] = _tornado(study, site, names)
    return drawn


def _bands(study: Study, channels: Sequence[str]) -> Drawing:
    """5–95 % and 25–75 % of the sets at every moment of the beat, and their median."""
    figure, panels = by_place(channels)
    time = np.linspace(0.0, study.plan.model.T, POINTS + 1)
    for name, panel in panels.items():
        low, lower, middle, upper, high = shown(name, *study.bands[name])
        panel.fill_between(time, low, high, color=SKY, alpha=0.35, linewidth=0)
        panel.fill_between(time, lower, upper, color=BLUE, alpha=0.45, linewidth=0)
        panel.plot(time, middle, color=BLACK)
        panel.margins(x=0)
    handles = [
        Line2D([], [], color=BLACK, label="median"),
        Patch(color=BLUE, alpha=0.45, linewidth=0, label="25–75 %"),
        Patch(color=SKY, alpha=0.35, linewidth=0, label="5–95 %"),
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=3)
    return drawing(figure, "Beats of all parameter sets: the median and percentile bands at every instant.")


def _tornado(study: Study, site: str, names: Sequence[str]) -> Drawing:
    """A panel for each number: bars of the indices, the largest total one on top."""
    bars = min(_MOST, len(study.plan.varied))
    rows = -(-len(names) // _COLUMNS)
    size = (3.6 * _COLUMNS, rows * (_HEAD + _HEIGHT * bars) + 0.4)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True).ravel()
    for panel, name in zip(axes, names, strict=False):
        _bars(panel, study, name, bars)
    for panel in axes[len(names) :]:
        panel.set_axis_off()
    for panel in axes[max(0, len(names) - _COLUMNS) : len(names)]:
        panel.set_xlabel("share of the variance")
    handles = [
        Patch(color=SKY, label="total"),
        Patch(color=ORANGE, label="first: alone"),
        Line2D([], [], color=BLACK, linewidth=0.8, label="95 % interval"),
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=3)
    omitted = len(study.plan.varied) - bars
    more = f" The {omitted} smallest are not drawn." if omitted > 0 else ""
    return drawing(figure, f"{site}: the share of each number's variance that a parameter explains.{more}")


def _bars(panel: Axes, study: Study, name: str, most: int) -> None:
    found = sorted(study.indices(name), key=lambda index: index.ST)[-most:]
    at = np.arange(len(found))
    whisker = {"ecolor": BLACK, "elinewidth": 0.8, "capsize": 1.5}
    panel.barh(at + 0.19, [i.ST for i in found], 0.36, xerr=[i.ST_conf for i in found], color=SKY, error_kw=whisker)
    panel.barh(at - 0.19, [i.S1 for i in found], 0.36, xerr=[i.S1_conf for i in found], color=ORANGE, error_kw=whisker)
    panel.axvline(0.0, color=BLACK, linewidth=0.6)
    panel.set_yticks(at, [i.varied for i in found])
    panel.set_ylim(-0.6, len(found) - 0.4)
    panel.tick_params(axis="y", length=0)
    panel.locator_params(axis="x", nbins=5)
    panel.set_title(name.partition(".")[2].replace(".", " "), loc="left")
