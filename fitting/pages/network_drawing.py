"""A drawing of a network from left to right, on its own axes."""

from __future__ import annotations

from collections.abc import Callable

from matplotlib import rc_context
from matplotlib.axes import Axes

from solver.layout import Lane, lanes
from solver.network.description import Network

from .style import ARTERY, FAINT, STYLE, TEXT, Picture

Mark = Callable[[str, str], str | None]
"""The colour of a marked place, or None, from its kind ("segment", "outlet", "junction", "channel") and its name."""

_LETTER = 0.075  # inches of a name


def figure(network: Network) -> Picture:
    """Vessels with width by radius, inlets as arrows, outlets as bars, and the sites with their names."""
    with rc_context(STYLE):
        drawn, axes, at = draw(network)
        for site in network.sites:
            x, y = at[site.segment].at(site.position)
            axes.plot([x], [y], "o", ms=6, mfc="white", mec=TEXT, mew=1.0, zorder=5)
            if site.name != site.segment:
                below(axes, site.name, x, y)
    return drawn


def draw(
    network: Network, mark: Mark = lambda kind, place: None, widest: float = 14.0
) -> tuple[Picture, Axes, dict[str, Lane]]:
    """The figure, its axes, and the lane of each segment; marked places have their colour. widest : inches."""
    drawn = {lane.segment.name: lane for lane in lanes(network)}
    columns = max(max(lane.x0, lane.x1) for lane in drawn.values())
    rows = max(lane.y for lane in drawn.values())
    width = min(widest, max(7.0, 2.2 + 1.9 * columns))
    picture = Picture(figsize=(width, 1.5 + 0.6 * rows), layout="constrained")
    axes = picture.add_subplot()
    axes.set_axis_off()
    axes.set_xlim(-0.35, columns + 0.35)
    axes.set_ylim(rows + 0.7, -0.7)
    under = _names_below(list(drawn.values()), width / (columns + 0.7))
    for name, lane in drawn.items():
        _vessel(axes, lane, mark("segment", name), above=name not in under)
        if lane.outlet is not None:
            colour = mark("outlet", name)
            axes.plot([lane.x1], [lane.y1], "|", ms=16, mew=5.0 if colour else 1.8, color=colour or FAINT, zorder=4)
    for junction in network.junctions:
        lane, colour = drawn[junction.name], mark("junction", junction.name)
        if colour:
            axes.plot([lane.x1], [lane.y1], "o", ms=17, mfc="none", mec=colour, mew=3.0, zorder=4)
    for inlet in network.inlets:
        root, colour = drawn[inlet.segment], mark("channel", inlet.drive.rpartition(".")[0])
        axes.annotate(
            "",
            (root.x0, root.y0),
            (-28.0, 0.0),
            textcoords="offset points",
            arrowprops={"arrowstyle": "-|>", "color": colour or TEXT, "lw": 3.0 if colour else 1.4},
        )
    return picture, axes, drawn


def below(axes: Axes, text: str, x: float, y: float) -> None:
    """A small text under a site."""
    axes.annotate(text, (x, y), (0.0, -17.0), textcoords="offset points", ha="center", fontsize=7.5, color=FAINT)


def _names_below(drawn: list[Lane], column: float) -> set[str]:
    """Every other name in a row of vessels that are shorter than their names. column : inches."""
    below: set[str] = set()
    ends: dict[tuple[float, float], str] = {}
    for lane in sorted(drawn, key=lambda lane: lane.x0):
        name, before = lane.segment.name, ends.get((lane.x0, lane.y))
        long = max(len(name), len(before or "")) * _LETTER > abs(lane.x1 - lane.x0) * column
        if before and before not in below and long:
            below.add(name)
        ends[lane.x1, lane.y1] = name
    return below


def _vessel(axes: Axes, lane: Lane, colour: str | None, above: bool) -> None:
    """A line with width by radius."""
    width = 3.0 + 7.0 * lane.relative_radius
    if colour:
        axes.plot(*lane.path.T, color=colour, lw=width + 8, solid_capstyle="butt", alpha=0.95, zorder=1)
    axes.plot(*lane.path.T, color=ARTERY, lw=width, solid_capstyle="butt" if lane.outlet else "round", zorder=2)
    axes.annotate(
        lane.segment.name,
        (lane.middle, lane.y),
        (0.0, (0.5 * width + 6.0) * (1.0 if above else -1.0)),
        textcoords="offset points",
        ha="center",
        va="bottom" if above else "top",
        fontsize=9,
        fontweight="bold" if colour else "normal",
        color=TEXT,
        zorder=6,
    )
