"""The report of the bank, in Markdown: targets against what was measured, and the tables behind them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from solver.files import write_whole
from solver.network import Network

from . import tables as t
from . import through_fmu
from . import words as w
from .targets import targets

Line = dict[str, Any]

BEGIN, END = "<!-- measured by benchmarks/hidden_effects.py -->\n", "<!-- end -->"


def report(lines: Sequence[Line], network: Network, through: Sequence[Line] = ()) -> str:
    """All tables that the lines have records for. network : whose junctions say what is adjacent. through : the lines
    of a sample that went through the rebuilt FMUs."""
    made = w.judged(lines)
    parts = [origin(lines), "## Targets", targets(made, network)]
    for kind in ("bench", "network"):
        own = [x for x in made if x["kind"] == kind]
        if own:
            parts += [f"## {kind.capitalize()}: {len(own)} records", t.verdicts(own)]
            parts += [part for title, table in _sections(kind, own, network) for part in (f"### {title}", table)]
    if through:
        parts += ["## Through the rebuilt FMUs", through_fmu.table(through)]
    return "\n\n".join(parts) + "\n"


def _sections(kind: str, own: Sequence[Line], network: Network) -> Iterator[tuple[str, str]]:
    yield "Power", t.power(own)
    yield "Which effect is taken for which", t.confusion(own)
    yield "By effect", t.by_effect(own)
    if kind == "network":
        yield "Places", t.places(own, network)
    yield "What is not told apart", t.ambiguous(own)
    yield "Confidence", t.reliability(own)
    yield "Parameters of the added term", t.parameters(own)
    yield "Two effects", t.pairs(own)
    yield "Outside the catalogue", t.outside(own)
    if kind == "bench":
        yield "Sparse regression on the same records", t.comparator(own)


def origin(lines: Sequence[Line]) -> str:
    """Which records these are."""
    said = []
    for kind, seed in sorted({(x["kind"], x["seed"]) for x in lines}):
        own = [x for x in lines if (x["kind"], x["seed"]) == (kind, seed)]
        lost = sum(x["verdict"] == "not made" for x in own)
        without = f" ({lost} without a periodic state, left out)" if lost else ""
        said.append(f"{len(own)} {kind} records of seed {seed}{without}, sources {', '.join(_hashes(own))}")
    return "; ".join(said) + "."


def _hashes(lines: Sequence[Line]) -> list[str]:
    return sorted({x["sources"] for x in lines})


def write(text: str, page: Path) -> None:
    """Put the tables where the page has its marks. Raises ValueError if it has none."""
    before, begin, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(
            f"{page} has no marks {BEGIN.strip()} and {END}; restore them, so that the tables have a place."
        )
    write_whole(page, f"{before}{BEGIN}\n{text}\n{END}{after}")
