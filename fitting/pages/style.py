"""The style of figures, with colours that colour-blind readers can distinguish."""

from __future__ import annotations

import io
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind readers can distinguish
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
# vessels, and texts on them
ARTERY, TEXT, FAINT = "#c9ccd1", "#1a1a1a", "#555555"

STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
}


def png(figure: Figure, dpi: int = 160) -> bytes:
    """The figure as PNG; the bytes do not contain the version of matplotlib.

    Drawn once: ``savefig`` draws it twice, the first time for the layout alone.
    """
    stream, canvas, usual = io.BytesIO(), FigureCanvasAgg(figure), figure.dpi
    figure.set_dpi(dpi)
    try:
        canvas.print_png(stream, metadata={"Software": None})
    finally:
        figure.set_dpi(usual)
    return stream.getvalue()


class Picture(Figure):
    """A figure that a notebook displays directly, without pyplot."""

    def _repr_png_(self) -> bytes:
        return png(self, 100)
