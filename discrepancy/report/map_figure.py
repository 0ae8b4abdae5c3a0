"""The figure of the source map: the network with marked places, and the terms g(t) over one beat."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from fitting.inference.places import NUMBER, Place
from fitting.pages.network_drawing import below, draw
from fitting.pages.style import BLUE, FAINT, ORANGE, PURPLE, TEXT, VERMILION, Picture
from solver.laws.effect import CHANNEL, JUNCTION, OUTLET
from solver.layout import Lane, lanes
from solver.network.description import Network
from solver.quantities.units import readable

from ..findings.map_marks import Mark, site_of
from ..findings.outcome import Outcome
from ..findings.shown_map import Acting, SourceMapShown
from .map_text import axis_label, phrase

Array = np.ndarray

_COLOURS = (VERMILION, BLUE, PURPLE)  # of what acts; ORANGE of what cannot be told from it
_KINDS = {OUTLET: "outlet", JUNCTION: "junction", CHANNEL: "channel"}
_WIDE, _HIGH = 4.0, 1.9  # inches of a beat
_BESIDE = 0.8  # x/L of the mark of what acts in a segment that is marked already
_COLUMNS, _NARROW = 6.0, 7.6  # of a network that has beats beside it, not above: segments in a row, inches


def map_figure(outcome: Outcome, shown: SourceMapShown, network: Network) -> tuple[Picture, str]:
    """Left the network, right a panel for each place with its g(t)."""
    found = [(a.place, _colour(i)) for i, a in enumerate(shown.acting)]
    found += [(place, ORANGE) for a in shown.acting for rival in a.rivals for place in rival.places]
    marked = [(mark(place, colour is not ORANGE), colour) for place, colour in found]

    def colour_at(kind: str, place: str) -> str | None:
        """The colour of the first mark at a place."""
        return next((colour for mark, colour in marked if mark.is_at(kind, place)), None)

    beside = max(max(lane.x0, lane.x1) for lane in lanes(network)) <= _COLUMNS
    most = {"widest": _NARROW} if beside and shown.signals else {}
    figure, axes, drawn = draw(network, colour_at, **most)
    sites(axes, network, drawn, [c.name for c in outcome.channels], colour_at)
    for (place, colour), (there, _) in zip(found, marked, strict=True):
        at = place.at if place.at is not None else _BESIDE * (colour_at(there.kind, there.place) != colour)
        if at and there.place in drawn:  # 0 : all along it
            x, y = drawn[there.place].at(at)
            axes.plot([x], [y], "D", ms=9, mfc=colour, mec="white", mew=1.2, zorder=6)
    _beats(figure, axes, shown, beside)
    handles = [Line2D([], [], color=_colour(i), lw=6, label=a.place.label) for i, a in enumerate(shown.acting)]
    if len(found) > len(shown.acting):
        handles.append(Line2D([], [], color=ORANGE, lw=6, label="not distinguishable"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    beats = " and the missing terms over one beat, with a band of ± 1 standard deviation" if shown.signals else ""
    return figure, (
        "The network of the model, flow from left to right, with the places where the missing physics acts"
        f"{beats}. Marked: {', '.join(a.place.label for a in shown.acting)}. A circle is a measured site; the letters "
        "are the measured signals."
    )


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


def _colour(i: int) -> str:
    return _COLOURS[i % len(_COLOURS)]


def _beats(figure: Picture, axes: Axes, shown: SourceMapShown, beside: bool) -> None:
    """A panel for each signal, beside a narrow network or above a wide one."""
    n = len(shown.signals)
    if not n:
        return
    width, height = figure.get_size_inches()
    if beside:
        figure.set_size_inches(width + _WIDE, max(height, _HIGH * n + 0.5))
        grid = figure.add_gridspec(n, 2, width_ratios=(width, _WIDE))
        axes.set_subplotspec(grid[:, 0])
        places = [grid[i, 1] for i in range(n)]
    else:
        figure.set_size_inches(width, height + _HIGH + 0.4)
        grid = figure.add_gridspec(2, n, height_ratios=(_HIGH, height))
        axes.set_subplotspec(grid[1, :])
        places = [grid[0, i] for i in range(n)]
    for i, a in enumerate(shown.acting):
        if a.number is None:
            _beat(figure.add_subplot(places.pop(0)), a, shown, _colour(i))


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
    panel.set_ylabel(axis_label(a))
