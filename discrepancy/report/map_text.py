"""The source map in sentences."""

from __future__ import annotations

import numpy as np

from fitting.inference.places import Place
from solver.laws.effect import CHANNEL, JUNCTION, OUTLET, WALL
from solver.quantities.legible import number
from solver.quantities.units import printed, readable

from ..findings.shown_map import Acting, SourceMapShown

Array = np.ndarray

_MOST = 3  # places that one cannot be told from, by name
# what acts at a place whose label only names it
_AS = {
    WALL: "a pressure in",
    JUNCTION: "a drop of pressure at",
    OUTLET: "a further flow through",
    CHANNEL: "a further signal of",
}


def acts_as(shown: SourceMapShown, it: str = "It") -> str:
    """What acts where, how large and when, and what cannot be told from it, in a few sentences; "" where nothing does.

    it : what is said to act.
    """
    said = []
    if shown.signals:
        said.append(f"{it} acts as {', and as '.join(_signal(a, shown.time) for a in shown.signals)}.")
    said += [f"{_odd(a)}." for a in shown.acting if a.number is not None]
    return " ".join([*said, *(_alike(a, len(shown.acting) > 1) for a in shown.acting if a.rivals)])


def map_sentences(shown: SourceMapShown) -> list[str]:
    """What the map says, and what it leaves."""
    left = f"χ² is {number(shown.chi2_per_datum)} per datum"
    if not shown.acting and shown.explains:
        return [f"Nothing acts beyond noise: {left} with the subject’s own numbers alone."]
    if not shown.acting:
        return [f"No place was found where something acts, and yet more than noise is left: {left}."]
    return [
        acts_as(shown, "What the model lacks"),
        f"With that, {'only noise' if shown.explains else 'more than noise'} is left: {left}.",
    ]


def phrase(place: Place) -> str:
    """What acts, and where."""
    return f"{_AS[place.kind]} {place.label}" if place.kind in _AS else place.label


def _signal(a: Acting, time: Array) -> str:
    unit, factor = readable(a.unit)
    pulse = f", {number(100.0 * a.rms / a.pulse, 2)} % of the pulse of {a.channel}" if a.pulse else ""
    size = f"{phrase(a.place)} of {number(factor * a.rms, 2)} {unit} (rms{pulse})"
    size += "" if a.share is None else f", {number(100.0 * a.share, 2)} % of the gap (of its χ²)"
    size += f", {a.part} (the strongest of {a.sources} such terms)" if a.part else ""
    if a.steady:
        return f"{size}, nearly the same throughout the beat"
    size = f"{size}, largest at {number(float(time[np.argmax(np.abs(a.mean))]), 2)} s"
    return f"{size}, {number(100.0 * a.phase[1], 2)} % of its energy in {a.phase[0]}" if a.phase else size


def _odd(a: Acting) -> str:
    """A number that stands out."""
    odd = a.number
    assert odd is not None
    unit, factor = readable(a.unit, odd.display)
    value, file, shift = (f"{number(factor * x)} {unit}".rstrip() for x in (odd.value, odd.file, abs(odd.beyond)))
    off = f"{number(odd.beyond, 2)} times" if odd.factor else f"{shift} {'above' if odd.beyond > 0.0 else 'below'}"
    if odd.only:
        return f"{a.place.name} is {value}; the file says {file}"
    return f"{a.place.name} stands out from its kind: {value}, {off} what goes with the others (the file: {file})"


def _alike(a: Acting, several: bool) -> str:
    """What a record cannot tell from what acts at a place."""
    it = phrase(a.place) if several else "it"
    others = [" with ".join(map(phrase, rival.places)) for rival in a.rivals if rival.places]
    if len(others) > _MOST:
        others = [*others[:_MOST], f"{len(others) - _MOST} other places"]
    *first, last = others or [""]
    named = f"{', '.join(first)} or {last}" if first else last
    said = [f"This record cannot tell {it} from {named}."] if others else []
    if any(not rival.places for rival in a.rivals):
        said.append(f"It is nearly as probable without {it}.")
    return " ".join(said)


def axis_label(a: Acting) -> str:
    """Of the axis of what acts."""
    return f"g [{readable(a.unit)[0] or printed(a.unit)}]"
