"""The network drawn as SVG and as PNG. Not part of the FMU's code."""

from __future__ import annotations

import io
from html import escape

from solver.layout import BEND, Lane, lanes
from solver.network.description import Network

ARTERY, OUTLET, TEXT, FAINT = "#b3363b", "#27496d", "#1d1f22", "#6b7078"
_COLOURS = 64  # of the PNG


def network_svg(network: Network) -> str:
    """The network as an SVG element."""
    drawn = lanes(network)
    named = {lane.segment.name: lane for lane in drawn}
    longest = max(len(s.name) for s in network.segments)
    wide, tall, left, right, top = max(165, 10 * longest + 80), 48, 90, 110, 36
    width = left + wide * max(max(lane.x0, lane.x1) for lane in drawn) + right
    height = 2 * top + tall * max(lane.y for lane in drawn)

    def x(column: float) -> float:
        return left + wide * column

    def y(row: float) -> float:
        return top + tall * row

    def text(at: tuple[float, float], content: str, **attributes: str) -> str:
        more = "".join(f' {key.replace("_", "-")}="{value}"' for key, value in attributes.items())
        return f'<text x="{at[0]:.1f}" y="{at[1]:.1f}"{more}>{escape(content)}</text>'

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
        f'height="{height:.0f}" role="img" aria-label="Network {escape(network.name)}" font-size="13">'
    ]
    for lane in drawn:
        points = " ".join(f"{x(a):.1f},{y(b):.1f}" for a, b in lane.path.tolist())
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{ARTERY}" stroke-linecap="round" '
            f'stroke-linejoin="round" stroke-width="{_width(lane, 14.0):.1f}"/>'
        )
    for inlet in network.inlets:
        root = named[inlet.segment]
        tip = x(root.x0) - 10, y(root.y0)
        parts.append(
            f'<path d="M{tip[0] - 26:.1f},{tip[1]:.1f} H{tip[0]:.1f} m-7,-5 l8,5 l-8,5" fill="none" stroke="{OUTLET}" '
            'stroke-width="2"/>'
        )
        parts.append(text((tip[0] - 30, tip[1] + 4), inlet.drive, text_anchor="end", fill=OUTLET))
    for lane in drawn:
        middle, above = x(lane.middle), y(lane.y)
        gap = _width(lane, 14.0) / 2
        s = lane.segment
        parts.append(text((middle, above - gap - 5), s.name, text_anchor="middle", font_weight="600", fill=TEXT))
        size = f"{100 * s.L:.3g} cm, R0 {1e3 * s.R0:.3g} mm"
        parts.append(text((middle, above + gap + 12), size, text_anchor="middle", font_size="10", fill=FAINT))
        if lane.outlet is not None:
            at, half = (x(lane.x1), y(lane.y1)), gap + 5
            parts.append(
                f'<path d="M{at[0] + gap + 3:.1f},{at[1] - half:.1f} v{2 * half:.1f}" stroke="{OUTLET}" '
                'stroke-width="3"/>'
            )
            parts.append(text((at[0] + gap + 10, at[1] + 4), lane.outlet.label, font_size="11", fill=OUTLET))
    for site in network.sites:
        a, b = named[site.segment].at(site.position)
        parts.append(
            f'<circle cx="{x(a):.1f}" cy="{y(b):.1f}" r="3.2" fill="#fff" stroke="{TEXT}" stroke-width="1.4">'
            f"<title>site {escape(site.name)}</title></circle>"
        )
    return "\n".join([*parts, "</svg>"])


def _width(lane: Lane, widest: float) -> float:
    return max(widest * lane.relative_radius, 0.1 * widest)


def model_png(network: Network) -> bytes:
    """The network as a PNG of 400 x 250 pixels; the same bytes for the same network."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    drawn = lanes(network)
    named = {lane.segment.name: lane for lane in drawn}
    columns, rows = max(max(lane.x0, lane.x1) for lane in drawn), max(lane.y for lane in drawn)
    longest = max(len(s.name) for s in network.segments)
    # points: what fits the level part of a lane (72 points an inch, letters 0.6 wide) and its height
    level = 1.0 - BEND if rows else 1.0
    size = min(9.0, 3.4 * 72 / (columns + 0.6) * level / (0.6 * longest), 2.3 * 72 / (rows + 1.0) / 2.4)
    widest = min(7.0, 1.2 * 72 / (rows + 1.0))
    with matplotlib.rc_context(dict(matplotlib.rcParamsDefault)):
        figure = Figure(figsize=(4.0, 2.5), dpi=100)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        axes.set_xlim(-0.07 * (columns + 0.2) - 0.1, 1.04 * columns + 0.1)
        axes.set_ylim(rows + 0.6, -0.75)
        for lane in drawn:
            a, b = lane.path.T
            cap = "round" if lane.outlet is None else "butt"
            axes.plot(a, b, color=ARTERY, lw=_width(lane, widest), solid_capstyle=cap, solid_joinstyle="round")
            if lane.outlet is not None:
                axes.plot([lane.x1], [lane.y1], marker="|", ms=1.6 * widest + 3, mew=2.0, color=OUTLET)
            if size >= 4.0:
                at, above = (lane.middle, lane.y), (0.0, 0.5 * _width(lane, widest) + 1.5)
                axes.annotate(lane.segment.name, at, above, textcoords="offset points", ha="center", fontsize=size)
        for site in network.sites:
            a, b = named[site.segment].at(site.position)
            axes.plot([a], [b], marker="o", ms=0.45 * widest, mfc="white", mec=TEXT, mew=0.7)
        for inlet in network.inlets:
            root = named[inlet.segment]
            axes.annotate(
                "",
                (root.x0, root.y0),
                (-26.0, 0.0),
                textcoords="offset points",
                arrowprops={"arrowstyle": "-|>", "color": OUTLET, "lw": 1.5, "shrinkB": widest / 2 + 1},
            )
        canvas.draw()
        # a few colours and the steps between them: half the bytes
        image = (
            Image.frombytes("RGBA", canvas.get_width_height(), bytes(canvas.buffer_rgba()))
            .convert("RGB")
            .quantize(_COLOURS)
        )
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()
