"""Figures that all reports share."""

from __future__ import annotations

import io
import itertools

import numpy as np
from matplotlib import rc_context

from fitting.pages.panels import loops
from fitting.pages.style import STYLE, Picture, png


def test_a_figure_is_what_matplotlib_saves() -> None:
    """Byte for byte, with a layout to be found; the figure keeps its resolution."""
    stream, (one, two) = io.BytesIO(), (Picture(figsize=(2.0, 1.5), layout="constrained") for _ in range(2))
    for picture in (one, two):
        picture.add_subplot().set_ylabel("pressure [mmHg]")
        picture.suptitle("one")
    two.savefig(stream, format="png", dpi=160, metadata={"Software": None})
    usual = one.dpi
    assert png(one) == stream.getvalue() and one.dpi == usual


def test_radii_below_loops_do_not_touch() -> None:
    """Seven loops of 2.730 to 2.741 mm, of which marks may have five digits: a digit's width apart at least."""
    pair = (np.array([0.0, 1500.0, 0.0]), np.array([2.73025e-3, 2.7412e-3, 2.73025e-3]))
    with rc_context(STYLE):
        picture = loops({f"S{i}": [pair] for i in range(7)}, [("measured", "k", "-")])
        picture.savefig(io.BytesIO(), dpi=160)
    for axes in picture.axes:
        low, high = axes.get_xlim()
        labels = [text for text in axes.get_xticklabels() if low <= text.get_position()[0] <= high]
        boxes = [text.get_window_extent() for text in labels]
        digit = boxes[0].width / len(labels[0].get_text())
        assert len(boxes) >= 2 and all(left.x1 + digit < right.x0 for left, right in itertools.pairwise(boxes))
