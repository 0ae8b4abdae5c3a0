"""A learned law in words and files; without a law, the terms of the source map as a table."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

from solver.network.files import dumps
from solver.quantities.legible import number
from solver.quantities.units import MMHG

from ..findings.map_marks import label_text, places_text
from ..findings.outcome import LearnedLaw, Outcome
from ..findings.shown_map import SourceMapShown
from .map_text import joined

MODEL, FMU, TABLE = "model_learned.toml", "model_learned.fmu", "source.csv"
DESCRIBED, ITS_FMU = "model_described.toml", "model_described.fmu"
FILES = (MODEL, FMU, DESCRIBED, ITS_FMU, TABLE)


def law_text(law: LearnedLaw) -> str:
    """A law in two sentences: its formula with the parameters and the gap that it closes, and its range of validity.
    Tables over the beat take one sentence."""
    if not law.explains:
        return (
            f"No law was found for it. Tables over the beat ({law.formula}) close {number(100.0 * law.closed, 2)} % of "
            f"the gap to held-out beats (from {number(law.before[1])} to {number(law.after[1])} times the noise): "
            f"{DESCRIBED} describes this record and is not an explanation."
        )
    numbers = ", ".join(f"{name} = {each}" for name, each in law.parameters.items())
    before, after = number(law.before[1]), number(law.after[1])
    beside = f", beside {' and '.join(map(label_text, law.beside))}," if law.beside else ""
    beside = f" in place of {' and '.join(map(label_text, law.instead))}" if law.instead else beside
    return (
        f"A law learned from this record for the {'outlet' if law.of_outlet else 'wall'} of {places_text(law.where)}"
        f"{beside} closes "
        f"{number(100.0 * law.closed, 2)} % of the gap to held-out beats (from {before} to {after} times the noise): "
        f"{law.formula}, {numbers}. The record covers {_seen(law)}; no other record has confirmed the law."
    )


def with_law(outcome: Outcome, law: LearnedLaw | None) -> Outcome:
    """An outcome with the law, if there is one, and with the law's sentences."""
    if law is None:
        return outcome
    return replace(outcome, learned=law, sentence=joined(outcome.sentence, law_text(law)))


def _seen(law: LearnedLaw) -> str:
    """The range of states from which the law was learned."""
    lows, highs, rates = zip(*law.seen.values(), strict=True)
    low, high, rate = min(lows), max(highs), max(rates)
    if law.of_outlet:
        return f"pressures of {number(low / MMHG, 2)} to {number(high / MMHG, 2)} mmHg above P_venous"
    return f"strains from {number(low, 2)} to {number(high, 2)} and rates up to {number(rate, 2)}/s"


def learned_files(law: LearnedLaw | None, shown: SourceMapShown | None) -> dict[str, str | bytes]:
    """The network with the law or the tables, with its origin in a comment, and its FMU. Without a law also the terms
    of the source map as a table with its band, which describes the record and is not an explanation."""
    files: dict[str, str | bytes] = {}
    if law is not None:
        model, fmu = (MODEL, FMU) if law.explains else (DESCRIBED, ITS_FMU)
        source = f"# From {law.record[0]} (sha256 {law.record[1]}).\n"
        files = {model: f"# {law_text(law)}\n{source}\n{dumps(law.network)}", fmu: law.archive}
    signals = shown is not None and shown.signals and not (law and law.explains)
    return files | {TABLE: _table(shown)} if shown is not None and signals else files


def _table(shown: SourceMapShown) -> str:
    """g(t) of every place with its standard deviation, in SI, over one beat."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    head = ["time [s]"]
    for a in shown.signals:
        name = a.place.label + (f" ({a.part})" if a.part else "")
        head += [f"{name} [{a.unit}]", f"sd of {name} [{a.unit}]"]
    writer.writerow(head)
    columns = [shown.time, *(c for a in shown.signals for c in (a.mean, a.band))]
    writer.writerows([f"{x:.9g}" for x in row] for row in zip(*columns, strict=True))
    return text.getvalue()
