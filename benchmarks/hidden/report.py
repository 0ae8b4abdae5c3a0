"""The report of the bank, in Markdown: targets against measurements, and on a second page the tables behind them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from solver.network.description import Network
from solver.network.files import write_whole

from . import animals
from . import tables as t
from . import words as w
from .calibration import reliability
from .words import Line

TITLES = {
    "standard": "Standard records",
    "walls": "Individual walls",
    "sensors": "Noise in the sensors' units",
    "varying": "Varying beats",
    "offcentre": "Localised effects off centre",
    "outside_walls": "Outside the catalogue, individual walls",
    "own": "An outlier, individual walls",
    "elastic": "Individual walls without viscosity",
    "pairs": "Two effects, individual walls",
    "three": "Three pressures, individual walls",
}
BEGIN, END = "<!-- measured by benchmarks/hidden_effects.py -->\n", "<!-- end -->"


def targets(lines: Sequence[Line], network: Network) -> str:
    """Targets against measurements, group by group; rows without records are left out."""
    parts = []
    for name, own in _groups(lines):
        table = animals.standard(own, network) if name == "standard" else animals.GROUPS[name](own)
        parts += [f"## {TITLES[name]}", table]
    return "\n\n".join(parts) + "\n"


def behind(lines: Sequence[Line], network: Network) -> str:
    """The records, with the hashes of the sources that judged them, and what the verdicts were. network : its junctions
    define adjacency."""
    parts = [origin(lines)]
    for name, own in _groups(lines):
        parts += [f"## {TITLES[name]}: verdicts", *_by_kind(name, own, network)]
    return "\n\n".join(parts) + "\n"


def _groups(lines: Sequence[Line]) -> Iterator[tuple[str, list[Line]]]:
    made = w.judged(lines)
    for name in ("standard", *animals.GROUPS):
        own = [x for x in made if w.group(x) == name]
        if own:
            yield name, own


def _by_kind(group: str, lines: Sequence[Line], network: Network) -> list[str]:
    parts = []
    for kind in ("bench", "network"):
        own = [x for x in lines if x["kind"] == kind]
        if own:
            parts += [f"### {kind.capitalize()}: {len(own)} records", t.verdicts(own)]
            sections = _sections(kind, own, network) if group == "standard" else _short(own)
            parts += [part for title, table in sections for part in (f"#### {title}", table)]
    return parts


def _short(own: Sequence[Line]) -> Iterator[tuple[str, str]]:
    """The results of a group other than the standard one, besides its targets."""
    if w.of(own, "single"):
        yield "Power", t.power(own)
        yield "By effect", t.by_effect(own)
    if w.of(own, "pair"):
        yield "Two effects", t.pairs(own)
    yield "Confidence", reliability(own)
    yield "Gap closed by the named effects", t.closed(own)
    if w.of(own, "outside"):
        yield "Outside the catalogue", t.outside(own)


def _sections(kind: str, own: Sequence[Line], network: Network) -> Iterator[tuple[str, str]]:
    yield "Power", t.power(own)
    yield "Confusion of effects", t.confusion(own)
    yield "By effect", t.by_effect(own)
    if kind == "network":
        yield "Places", t.places(own, network)
    yield "Effects that are not distinguished", t.ambiguous(own)
    yield "Confidence", reliability(own)
    yield "Gap closed by the named effects", t.closed(own)
    yield "Parameters of the added term", t.parameters(own)
    yield "Two effects", t.pairs(own)
    yield "Outside the catalogue", t.outside(own)


def origin(lines: Sequence[Line]) -> str:
    """A description of the records."""
    said = []
    for group, kind, seed in sorted({_plan(x) for x in lines}):
        own = [x for x in lines if _plan(x) == (group, kind, seed)]
        lost, small = (sum(x["verdict"] == which for x in own) for which in (w.NOT_MADE, w.NOT_JUDGED))
        without = f" ({lost} without a periodic state, excluded)" if lost else ""
        without += f" ({small} with too small a d′, excluded before any verdict)" if small else ""
        sources = ", ".join(sorted({x["sources"] for x in own}))
        said.append(f"{len(own)} {group} {kind} records of seed {seed}{without}, sources {sources}")
    return "; ".join(said) + "."


def _plan(x: Line) -> tuple[str, str, int]:
    return w.group(x), x["kind"], x["seed"]


def write(text: str, page: Path) -> None:
    """Insert the tables between the marks of the page. Raises ValueError if it has none."""
    before, begin, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(
            f"{page} has no marks {BEGIN.strip()} and {END}; restore them, so that the tables have a place."
        )
    write_whole(page, f"{before}{BEGIN}\n{text}\n{END}{after}")
