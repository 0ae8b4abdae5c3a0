"""The figures of a study: source map and its terms, network with marked places, waveforms, loops, separations.

Every function returns a picture and its caption; :func:`figures` calls the functions for which there are data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.lines import Line2D

from fitting.inference.places import NUMBER, Place
from fitting.pages.network_drawing import below, draw
from fitting.pages.panels import DASHED, Curve, Drawing, drawing, loops, waveforms
from fitting.pages.style import BLACK, BLUE, FAINT, ORANGE, PURPLE, STYLE, TEXT, VERMILION, Picture
from solver.errors import InputError
from solver.laws.effect import CHANNEL, JUNCTION, OUTLET
from solver.layout import Lane, lanes
from solver.network.description import Network
from solver.quantities.units import printed, readable

from ..findings.isolability import INSEPARABLE
from ..findings.map_marks import Mark, label_text, marks, site_of
from ..findings.outcome import Isolability, Outcome
from ..findings.shown_map import Acting, SourceMapShown
from .tables import APART, Z, channel_z, loop_sites, period
from .verdict_text import phrase

Captioned = tuple[Picture, str]

NAMES = ("map", "terms", "network", "waveforms", "loops", "isolability")
_CURVES: tuple[Curve, ...] = (("measured", BLACK, "-"), ("before", VERMILION, DASHED), ("after", BLUE, (0, (1, 1))))
_COLOURS = (VERMILION, BLUE, PURPLE)  # of what acts; ORANGE of what cannot be told from it
_KINDS = {OUTLET: "outlet", JUNCTION: "junction", CHANNEL: "channel"}
_WIDE, _HIGH = 3.6, 1.9  # inches of a beat
_BESIDE = 0.8  # x/L of the mark of what acts in a segment that is marked already
_COLUMNS, _NARROW = 6.0, 7.6  # of a network that has beats beside it, not below: segments in a row, inches
_MOST_FRAMED = 60  # cells in a row that still have room for a frame


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
        "terms": partial(terms_figure, acting, network) if network and acting and acting.signals else None,
        "network": partial(_network, outcome, network) if network else None,
        "waveforms": partial(_waveforms, outcome) if outcome.channels else None,
        "loops": partial(_loops, outcome) if loop_sites(outcome) else None,
        "isolability": partial(_isolability, table) if table and table.labels else None,
    }
    return {name: draw for name, draw in drawn.items() if draw}


def _network(outcome: Outcome, network: Network) -> Captioned:
    """Vessels from left to right, the places of the effects marked, every measured site in the colour of its z."""
    marked, worst = marks(outcome), channel_z(outcome)
    # marks of named effects precede those of the class
    colour_at = partial(_colour_at, [(mark, VERMILION if mark.named else ORANGE) for mark in marked])
    figure, axes, drawn = draw(network, colour_at)
    sites(axes, network, drawn, worst, colour_at, lambda names: Z.colour(max(worst[name] for name in names)), 11.0)
    handles = [
        Line2D([], [], marker="o", ls="", ms=9, mfc=colour, mec=TEXT, label=text if i else f"site: |z| {text}")
        for i, (colour, text) in enumerate(zip(Z.colours, Z.texts, strict=True))
    ]
    for named, colour, label in ((True, VERMILION, "missing effect"), (False, ORANGE, "possible place")):
        if any(mark.named == named for mark in marked):
            handles.append(Line2D([], [], color=colour, lw=6, label=label))
    columns = min(len(handles), int(figure.get_figwidth() / 1.3))  # a network of one tube has a narrow figure
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)
    places = ", ".join(dict.fromkeys(mark.text for mark in marked))
    return (
        figure,
        "The network of the model, flow from left to right. A circle is a measured site, as dark as its largest |z|; "
        f"the letters are the measured signals. {f'Marked: {places}.' if places else 'No place is marked.'}",
    )


# --- the source map ---------------------------------------------------------------------------------------------------


def map_figure(outcome: Outcome, shown: SourceMapShown, network: Network) -> Captioned:
    """The network with the places where something acts."""
    found = [(a.place, _colour(i)) for i, a in enumerate(shown.acting)]
    found += [(place, ORANGE) for a in shown.acting for rival in a.rivals for place in rival.places]
    marked = [(mark(place, colour is not ORANGE), colour) for place, colour in found]
    # a vessel has the colour of what acts all along it, before that of a point of it, which has a diamond
    first = sorted(zip(found, marked, strict=True), key=lambda each: (each[0][1] is ORANGE, each[0][0].at is not None))
    colour_at = partial(_colour_at, [there for _, there in first])
    narrow = {"widest": _NARROW} if _is_narrow(network) and shown.signals else {}
    figure, axes, drawn = draw(network, colour_at, **narrow)
    sites(axes, network, drawn, [c.name for c in outcome.channels], colour_at)
    for (place, colour), (there, _) in reversed(first):  # above its rivals
        at = place.at if place.at is not None else _BESIDE * (colour_at(there.kind, there.place) != colour)
        if at and there.place in drawn:  # 0 : all along it
            x, y = drawn[there.place].at(at)
            axes.plot([x], [y], "D", ms=9, mfc=colour, mec="white", mew=1.2, zorder=6)
    handles = [Line2D([], [], color=_colour(i), lw=6, label=a.place.label) for i, a in enumerate(shown.acting)]
    if len(found) > len(shown.acting):
        handles.append(Line2D([], [], color=ORANGE, lw=6, label="not distinguishable"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure, (
        "The network of the model, flow from left to right, with the places where the missing physics acts. Marked: "
        f"{', '.join(a.place.label for a in shown.acting)}. A circle is a measured site; the letters are the measured "
        "signals."
    )


def terms_figure(shown: SourceMapShown, network: Network) -> Captioned:
    """A panel with g(t) for each place: one above the other beside a narrow network, else in a row."""
    signals = [(a, _colour(i)) for i, a in enumerate(shown.acting) if a.number is None]
    rows, columns = (len(signals), 1) if _is_narrow(network) else (1, len(signals))
    figure = Picture(figsize=(_WIDE * columns, _HIGH * rows + 0.2), layout="constrained")
    for i, (a, colour) in enumerate(signals):
        _beat(figure.add_subplot(rows, columns, i + 1), a, shown, colour)
    return figure, "The missing terms over one beat, with a band of ± 1 standard deviation."


def _is_narrow(network: Network) -> bool:
    """True if the terms have room beside the drawing."""
    return max(max(lane.x0, lane.x1) for lane in lanes(network)) <= _COLUMNS


def sites(
    axes: Axes, network: Network, drawn: Mapping[str, Lane], channels: Iterable[str],
    edge: Callable[[str, str], str | None], face: Callable[[list[str]], str] = lambda names: "white", size: float = 7.0,
) -> None:  # fmt: skip
    """The measured sites, with the letters of the measured signals. face : by the channels of a site."""
    measured = list(channels)
    for site in network.sites:
        names = [name for name in measured if name.rpartition(".")[0] == site.name]
        if names:
            x, y = drawn[site.segment].at(site.position)
            colour = edge("channel", site.name)
            width = 3.0 if colour else 1.0
            axes.plot([x], [y], "o", ms=size, mfc=face(names), mec=colour or TEXT, mew=width, zorder=5)
            below(axes, " ".join(name[-1] for name in names), x, y)


def mark(place: Place, named: bool) -> Mark:
    """The position of a mark; for an outlier its artery or outlet."""
    if place.kind == NUMBER:
        owner, *rest = place.name.split(".")
        return Mark("outlet" if "outlet" in rest[:-1] else "segment", owner, named, place.label)
    kind = _KINDS.get(place.kind, "segment")
    return Mark(kind, site_of(place.name) if kind == "channel" else place.name, named, place.label)


def _colour_at(marked: Sequence[tuple[Mark, str]], kind: str, place: str) -> str | None:
    """The colour of the first mark at a place."""
    return next((colour for mark, colour in marked if mark.is_at(kind, place)), None)


def _colour(i: int) -> str:
    return _COLOURS[i % len(_COLOURS)]


def _beat(panel: Axes, a: Acting, shown: SourceMapShown, colour: str) -> None:
    """g(t) with its band, closed."""
    factor = readable(a.unit)[1]
    mean, band = (factor * np.append(x, x[0]) for x in (a.mean, a.band))
    time = np.append(shown.time, shown.T)
    panel.axhline(0.0, color=FAINT, lw=0.6)
    panel.fill_between(time, mean - band, mean + band, color=colour, alpha=0.25, linewidth=0)
    panel.plot(time, mean, color=colour)
    panel.margins(x=0)
    title = phrase(a.place) + (f"\n{a.part}" if a.part else "")
    panel.set_title(title[0].upper() + title[1:], loc="left")
    panel.set_xlabel("time [s]")
    panel.set_ylabel(f"g [{readable(a.unit)[0] or printed(a.unit)}]")


def _isolability(isolability: Isolability) -> Captioned:
    """Separation of every pair of effects, in classes; NaN is grey."""
    n = len(isolability.labels)
    side = float(np.clip(0.2 * n, 2.0, 9.5))
    separation = np.array(isolability.separation, float)
    np.fill_diagonal(separation, np.nan)
    figure = Picture(figsize=(max(side + 3.4, 7.2), side + 2.2), layout="constrained")
    axes = figure.add_subplot(facecolor="#e6e6e6")
    look: dict[str, Any] = {
        "cmap": ListedColormap(APART.colours),
        "norm": BoundaryNorm([*APART.bounds, np.inf], len(APART.colours)),
    }
    edge, ends = "#d0d0d0" if n <= _MOST_FRAMED else "none", np.arange(n + 1) - 0.5
    axes.pcolormesh(ends, ends, np.ma.masked_invalid(separation), edgecolors=edge, linewidth=0.5, **look)
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)
    handles = [
        Line2D([], [], marker="s", ls="", ms=9, mfc=colour, mec="#888888", label=text)
        for colour, text in zip(APART.colours, APART.texts, strict=True)
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=len(handles), title=APART.name, columnspacing=0.9)
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
