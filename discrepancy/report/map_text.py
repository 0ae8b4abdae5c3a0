"""The source map in sentences: where unexplained terms act, how large they are, and when in the beat."""

from __future__ import annotations

import numpy as np

from fitting.inference.fit import Array
from fitting.inference.places import Place
from solver.laws.effect import CHANNEL, JUNCTION, OUTLET, WALL
from solver.quantities.legible import number
from solver.quantities.units import printed, readable

from ..findings.shown_map import Acting, SourceMapShown

_MOST = 3  # rival places that a sentence names
# what acts at a place whose label only names it
_AS = {
    WALL: "a pressure in",
    JUNCTION: "a drop of pressure at",
    OUTLET: "an additional flow through",
    CHANNEL: "an additional signal of",
}


def acts_as(shown: SourceMapShown, it: str = "It") -> str:
    """What acts at which place, how large, when in the beat and with which share of the gap; then the places that the
    record cannot distinguish from it. Several signals make a list with a line each. "" if nothing acts.

    it : the subject of the sentence.
    """
    signals = [_signal(a, shown.time) for a in shown.signals]
    numbers = [f"{_odd(a)}." for a in shown.acting if a.number is not None]
    rivals = [_alike(a, len(shown.acting) > 1) for a in shown.acting if a.rivals]
    if len(signals) > 1:
        return "\n".join([f"{it} acts as:", *(f"- {text}" for text in signals), *numbers, *rivals])
    return " ".join([*(f"{it} acts as {text}." for text in signals), *numbers, *rivals])


def joined(text: str, more: str) -> str:
    """Two texts as one: on a new line if either of them is a list, with one signal a line."""
    gap = "\n" if "\n" in text else " "
    return f"{text}{gap}{more}" if more else text


def map_sentences(shown: SourceMapShown) -> list[str]:
    """The source map in sentences, and the χ² that remains with it."""
    left = f"χ² is {number(shown.chi2_per_datum)} per datum"
    if not shown.acting and shown.explains:
        return [f"No place shows a residual beyond noise: {left} with the subject’s own numbers alone."]
    if not shown.acting:
        return [f"The residual exceeds the noise, but no place explains it: {left}."]
    return [
        acts_as(shown, "The missing physics"),
        f"With these terms, {'only noise' if shown.explains else 'more than noise'} remains: {left}.",
    ]


def phrase(place: Place) -> str:
    """The quantity that acts, with its place."""
    return f"{_AS[place.kind]} {place.label}" if place.kind in _AS else place.label


def _signal(a: Acting, time: Array) -> str:
    """One signal: place, size, time in the beat, share of the gap."""
    unit, factor = readable(a.unit)
    pulse = f" ({number(100.0 * a.rms / a.pulse, 2)} % of the pulse of {a.channel})" if a.pulse else ""
    part = f", {a.part} (the strongest of {a.sources} such terms)" if a.part else ""
    size = f"{phrase(a.place)}: {number(factor * a.rms, 2)} {unit} rms{pulse}{part}"
    share = "" if a.share is None else f"; {number(100.0 * a.share, 2)} % of the gap (χ²)"
    if a.steady:
        return f"{size}, nearly constant over the beat{share}"
    peak = f"{size}, largest at {number(float(time[np.argmax(np.abs(a.mean))]), 2)} s"
    phase = f", {number(100.0 * a.phase[1], 2)} % of its energy in {a.phase[0]}" if a.phase else ""
    return f"{peak}{phase}{share}"


def _odd(a: Acting) -> str:
    """A parameter whose value differs from the others of its kind."""
    odd = a.number
    assert odd is not None
    unit, factor = readable(a.unit, odd.display)
    value, file, shift = (f"{number(factor * x)} {unit}".rstrip() for x in (odd.value, odd.file, abs(odd.beyond)))
    off = f"{number(odd.beyond, 2)} times" if odd.factor else f"{shift} {'above' if odd.beyond > 0.0 else 'below'}"
    if odd.only:
        return f"{a.place.name} is {value}; the file has {file}"
    return f"{a.place.name} is an outlier: {value}, {off} the value expected from the others (the file has {file})"


def _alike(a: Acting, several: bool) -> str:
    """The places that the record cannot distinguish from the place of a signal."""
    it = phrase(a.place) if several else "it"
    others = [" with ".join(map(phrase, rival.places)) for rival in a.rivals if rival.places]
    if len(others) > _MOST:
        others = [*others[:_MOST], f"{len(others) - _MOST} other places"]
    *first, last = others or [""]
    named = f"{', '.join(first)} or {last}" if first else last
    sentences = [f"This record cannot distinguish {it} from {named}."] if others else []
    if any(not rival.places for rival in a.rivals):
        sentences.append(f"The record is nearly as probable without {it}.")
    return " ".join(sentences)


def axis_label(a: Acting) -> str:
    """The label of the axis of a signal."""
    return f"g [{readable(a.unit)[0] or printed(a.unit)}]"
