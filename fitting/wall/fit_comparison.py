"""Comparisons for the fit of one site: with the linear model, and with the elastic law that the record favours."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from ..inference.models.loop import NoFit
from ..records.alignment.beats import Beats
from .site_fit import fit
from .wall_fit import WallFit
from .wall_model import model


def linear_fit(kept: WallFit, beats: Beats, options: dict[str, Any]) -> list[WallFit]:
    """The linear model's fit, for comparison with that of another model; empty if there is none.

    options : of :func:`~fitting.wall.site_fit.fit`, as for ``kept``.
    """
    with suppress(NoFit):
        if kept.model.name != "linear":
            return [fit(beats, kept.site, kept.h, model("linear", kept.model.elastic), **options)]
    return []


def favoured_law(kept: WallFit, beats: Beats, options: dict[str, Any]) -> list[str]:
    """A sentence if the record favours a law other than the given one. options : as for :func:`linear_fit`."""
    with suppress(NoFit):
        if kept.evidence is None:
            best = fit(beats, kept.site, kept.h, kept.model.name, **options)
            if best.evidence is not None and best.evidence.decided and best.model.elastic != kept.model.elastic:
                return [f"{kept.site}: --law {kept.model.elastic} was given, but the record favours {best.law}."]
    return []
