"""The figures of a study: source map, network with marked places, z map, waveforms, loops, gap, separations.

Every function returns a picture and its caption; :func:`figures` calls those whose data there are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from fitting.pages.network_drawing import draw
from fitting.pages.panels import DASHED, Curve, Drawing, drawing, loops, waveforms
from fitting.pages.style import BLACK, BLUE, FAINT, ORANGE, STYLE, TEXT, VERMILION, Picture
from solver.errors import InputError
from solver.network.description import Network

from ..findings.isolability import INSEPARABLE
from ..findings.map_marks import label_text, marks
from ..findings.outcome import Isolability, Outcome
from .map_figure import map_figure, sites
from .tables import APART, Scale, Z, channel_z, harmonics_shown, loop_sites, period

Array = np.ndarray
Captioned = tuple[Picture, str]

BEFORE, AFTER = VERMILION, BLUE
NAMES = ("map", "network", "z_map", "waveforms", "loops", "gap", "isolability")
_CURVES: tuple[Curve, ...] = (("measured", BLACK, "-"), ("before", BEFORE, DASHED), ("after", AFTER, (0, (1, 1))))
_MOST_TICKS = 36  # numbers below the z map that do not touch
_MOST_FRAMED = 60  # cells in a row that still have room for a frame
_GAPS = (0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)  # that the axis of gaps names


def figures(outcome: Outcome) -> dict[str, Drawing]:
    """The figures by file name (of :data:`NAMES`), without those that have no data."""
    with rc_context(STYLE):
        return {name: drawing(*drawn()) for name, drawn in _there(outcome).items()}


def figure(outcome: Outcome, name: str | None = None) -> Picture:
    """A figure of matplotlib, by default the first. Raises ValueError for one without data."""
    there = _there(outcome)
    name = name or next(iter(there), "any")
    if name not in there:
        raise InputError(f"{name}: no such figure of this study; it has {', '.join(there) or 'none'}.")
    with rc_context(STYLE):
        return there[name]()[0]


def _there(outcome: Outcome) -> dict[str, Callable[[], Captioned]]:
    """The drawing functions of the figures with data, in the order of NAMES."""
    network = outcome.network_before if outcome.kind == "network" else None
    acting, table = outcome.map, outcome.isolability
    drawn: dict[str, Callable[[], Captioned] | None] = {
        "map": partial(map_figure, outcome, acting, network) if network and acting and acting.acting else None,
        "network": partial(_network, outcome, network) if network else None,
        "z_map": partial(_z_map, outcome) if outcome.z_map.size else None,
        "waveforms": partial(_waveforms, outcome) if outcome.channels else None,
        "loops": partial(_loops, outcome) if loop_sites(outcome) else None,
        "gap": partial(_gap, outcome) if outcome.channels else None,
        "isolability": partial(_isolability, table) if table and table.labels else None,
    }
    return {name: draw for name, draw in drawn.items() if draw}


def _network(outcome: Outcome, network: Network) -> Captioned:
    """Vessels from left to right, the places of the effects marked, every measured site in the colour of its z."""
    marked, worst = marks(outcome), channel_z(outcome)

    def colour_at(kind: str, place: str) -> str | None:
        """The colour of the first mark there; marks of named effects precede those of the class."""
        return next((VERMILION if mark.named else ORANGE for mark in marked if mark.is_at(kind, place)), None)

    figure, axes, drawn = draw(network, colour_at)
    sites(axes, network, drawn, worst, colour_at, lambda names: Z.colour(max(worst[name] for name in names)), 11.0)
    handles = [
        Line2D([], [], marker="o", ls="", ms=9, mfc=colour, mec=TEXT, label=text if i else f"site: |z| {text}")
        for i, (colour, text) in enumerate(zip(Z.colours, Z.texts, strict=True))
    ]
    for named, colour, label in ((True, VERMILION, "missing effect"), (False, ORANGE, "possible place")):
        if any(mark.named == named for mark in marked):
            handles.append(Line2D([], [], color=colour, lw=6, label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    places = ", ".join(dict.fromkeys(mark.text for mark in marked))
    return (
        figure,
        "The network of the model, flow from left to right. A circle is a measured site, as dark as its largest |z|; "
        f"the letters are the measured signals. {f'Marked: {places}.' if places else 'No place is marked.'}",
    )


# --- maps of classes --------------------------------------------------------------------------------------------------


def _z_map(outcome: Outcome) -> Captioned:
    """Channels by harmonics, in classes of |z|; significant entries are framed."""
    harmonics = harmonics_shown(outcome)
    names = [channel.name for channel in outcome.channels[: outcome.z_map.shape[1]]]
    size = (float(np.clip(2.4 + 0.3 * harmonics, 7.2, 13.0)), 1.3 + 0.24 * len(names))
    figure, axes = _classes(np.abs(outcome.z_map[:harmonics]).T, Z, size)
    axes.set_yticks(range(len(names)), names)
    step = next(n for n in (1, 2, 5, 10) if harmonics <= _MOST_TICKS * n or n == 10)
    numbered = range(step, harmonics, step)
    axes.set_xticks([0, *numbered], ["mean", *map(str, numbered)])
    axes.tick_params(length=0, labelsize=8)
    axes.set_xlabel("harmonic of the beat")
    for at in outcome.located:
        name = f"{at.site}.{at.signal}"
        if name in names and at.harmonic < harmonics:
            corner = (at.harmonic - 0.5, names.index(name) - 0.5)
            axes.add_patch(Rectangle(corner, 1.0, 1.0, fill=False, ec=BLACK, lw=1.6, zorder=3, clip_on=False))
    return (
        figure,
        "|z|, the residual over its standard deviation, of every channel and harmonic before an effect was added. "
        "Framed: the largest that are significant after correction for all channels and harmonics.",
    )


def _isolability(isolability: Isolability) -> Captioned:
    """Separation of every pair of effects, in classes."""
    n = len(isolability.labels)
    side = float(np.clip(0.2 * n, 2.0, 9.5))
    separation = np.array(isolability.separation, float)
    np.fill_diagonal(separation, np.nan)
    figure, axes = _classes(separation, APART, (max(side + 3.4, 7.2), side + 2.2))
    fontsize = float(np.clip(72 * side / n * 0.8, 3.0, 8.0))
    labels = [label_text(label) for label in isolability.labels]
    axes.set_xticks(range(n), labels, rotation=90, fontsize=fontsize)
    axes.set_yticks(range(n), labels, fontsize=fontsize)
    axes.tick_params(length=0)
    axes.set_xlabel("refitted effect")
    axes.set_ylabel("true effect, of typical size")
    return (
        figure,
        f"Separation d′ of every pair of {n} effects by these sensors, each at its most visible place. Below "
        f"{INSEPARABLE:g}, the effect of a row is not distinguishable from that of the column.",
    )


def _classes(values: Array, scale: Scale, size: tuple[float, float]) -> tuple[Picture, Axes]:
    """A map of values by the classes of a scale, with a legend; NaN is grey."""
    figure = Picture(figsize=size, layout="constrained")
    axes = figure.add_subplot(facecolor="#e6e6e6")
    rows, columns = values.shape
    norm = BoundaryNorm([*scale.bounds, np.inf], len(scale.colours))
    edge = "#d0d0d0" if max(rows, columns) <= _MOST_FRAMED else "none"
    corners, cells = (np.arange(columns + 1) - 0.5, np.arange(rows + 1) - 0.5), np.ma.masked_invalid(values)
    axes.pcolormesh(*corners, cells, cmap=ListedColormap(scale.colours), norm=norm, edgecolors=edge, linewidth=0.5)
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)
    handles = [
        Line2D([], [], marker="s", ls="", ms=9, mfc=colour, mec="#888888", label=text)
        for colour, text in zip(scale.colours, scale.texts, strict=True)
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=len(handles), title=scale.name, columnspacing=0.9)
    return figure, axes


# --- beats ------------------------------------------------------------------------------------------------------------


def _waveforms(outcome: Outcome) -> Captioned:
    """Every channel: measured mean beat with its band, the model before, and after."""
    curves = _curves(outcome)
    beats = {c.name: (c.measured, c.before, c.after)[: len(curves)] for c in outcome.channels}
    bands = {c.name: c.band for c in outcome.channels}
    figure, _ = waveforms(period(outcome), beats, bands, curves, "± 2 sd of the mean")
    return figure, "Mean beats of every channel. The band is ± 2 standard deviations of the measured mean."


def _loops(outcome: Outcome) -> Captioned:
    """Pressure against radius of every site with both."""
    beats = {c.name: (c.measured, c.before, c.after) for c in outcome.channels}
    pairs = {
        site: [
            None if P is None or R is None else (P, R)
            for P, R, _ in zip(beats[f"{site}.P"], beats[f"{site}.R"], _curves(outcome), strict=False)
        ]
        for site in loop_sites(outcome)
    }
    return loops(pairs, _curves(outcome)), "Pressure against radius, mean beats."


def _curves(outcome: Outcome) -> tuple[Curve, ...]:
    """Measured, before, and after if an effect was added."""
    return _CURVES if any(channel.after is not None for channel in outcome.channels) else _CURVES[:2]


def _gap(outcome: Outcome) -> Captioned:
    """Whitened RMS of every channel on held-out beats (filled) and fitted beats (hollow), before and after."""
    names = [channel.name for channel in outcome.channels]
    figure = Picture(figsize=(8.0, 1.3 + 0.24 * len(names)), layout="constrained")
    axes = figure.add_subplot()
    before, after = [c.gap_before for c in outcome.channels], [c.gap_after for c in outcome.channels]
    _gaps_of(axes, before, "before", "o", BEFORE)
    _gaps_of(axes, after, "after", "D", AFTER)
    axes.axvline(1.0, color=FAINT, lw=0.9, ls=DASHED)
    axes.set_xscale("log")
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(axis="y", color="#e6e6e6", lw=0.6)
    low, high = axes.get_xlim()
    axes.set_xlim(low := min(low, 0.5), high := max(high, 5.0))
    ticks = [t for t in _GAPS if low <= t <= high]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    axes.set_xlabel("whitened RMS of the gap (1 = noise)")
    figure.legend(loc="outside upper left", ncols=4)
    return figure, "Gap of every channel in units of its sensor's noise; 1 is noise alone."


def _gaps_of(axes: Axes, pairs: Sequence[tuple[float, float] | None], label: str, marker: str, colour: str) -> None:
    """The gaps of the channels, a row each."""
    known = [(row, *pair) for row, pair in enumerate(pairs) if pair is not None]
    if known:
        rows, fitted, held_out = zip(*known, strict=True)
        axes.plot(fitted, rows, marker, mfc="white", mec=colour, ms=7, label=f"{label}, fitted")
        axes.plot(held_out, rows, marker, color=colour, ms=5, label=f"{label}, held out")
