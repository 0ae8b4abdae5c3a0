"""The failed records, with the numbers that explain each failure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from solver.network.description import Network

from . import words as w
from .tables import SEPARABLE

Line = dict[str, Any]


def failures(lines: Sequence[Line], network: Network) -> str:
    """The failures: false alarms, wrong single names, visible and separable effects without the right name, errors."""
    parts, made = [], w.judged(lines)
    singles = w.of(made, "single")
    chosen = {
        "false alarms": [x for x in w.of(made, "null") if w.detected(x)],
        "single and wrong": [x for x in singles if w.wrong(x)],
        "d′ ≥ 6, not in the class": [x for x in w.of(made, "single", 6.0) if not w.in_class(x) and not w.wrong(x)],
        "separable, not on top": [
            x for x in w.of(made, "single", 12.0)
            if w.separation(x) >= SEPARABLE and w.in_class(x) and not w.named_right(x)],
        "separable, right but not single": [
            x for x in w.of(made, "single", 12.0)
            if w.separation(x) >= SEPARABLE and w.named_right(x) and not w.single(x)],
        "right name, wrong place": [
            x for x in w.of(made, "single", 30.0) if w.named_right(x) and not w.adjacent_place(x, network)],
        "outside, named": [x for x in w.of(made, "outside", 6.0) if w.committed(x)],
        "pairs not both": [x for x in w.of(made, "pair", 30.0) if not w.both_named(x)],
        "errors": [x for x in lines if x.get("error")],
    }  # fmt: skip
    for title, own in chosen.items():
        parts.append(f"### {title}: {len(own)}\n\n" + "\n".join(f"- {_said(x)}" for x in own))
    return "\n\n".join(parts) + "\n"


def _said(x: Line) -> str:
    hidden = " + ".join(
        f"{e['name']}@{','.join(e['where'])} {e['size']:.3g} (d′ {e.get('d_prime', float('nan')):.3g})"
        for e in x["effects"]
    )
    if x.get("error"):
        return f"{x['kind']} {x['index']}: {hidden or 'null'}: {x['verdict']}: {x['error']}"
    tops = "; ".join(
        " + ".join(f"{t['name']}@{','.join(t['where'])}" for t in h["terms"])
        + f" {h['score']:.1f} (cost {h['cost']:.0f}, misfit {h['misfit']:.1f}, p {h['probability']:.2g})"
        for h in x["top"][:3]
    )
    setting = f"{x['channels']}, {x['dB']:g} dB, {x['base']}, {x['elastic_law']}/{x['viscous_law']}"
    rival = f", sep {w.separation(x):.3g} from {x['rival']}" if x.get("rival") else ""
    before = f"none {x['base_score']:.1f} (misfit {x['base_misfit']:.1f})"
    return f"{x['kind']} {x['index']} [{setting}]: {hidden or 'null'}{rival} → {x['verdict']}: {tops}; {before}"
