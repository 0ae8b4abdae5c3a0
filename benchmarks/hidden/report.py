"""The report of the bank, in Markdown: targets against what was measured, and the tables behind them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from solver.network import Network

from . import tables as t
from . import words as w
from .targets import targets

Line = dict[str, Any]


def report(lines: Sequence[Line], network: Network) -> str:
    """All tables that the lines have records for. network : whose junctions say what is adjacent."""
    lines = w.judged(lines)
    kinds = [kind for kind in ("bench", "network") if any(x["kind"] == kind for x in lines)]
    parts = [targets(lines, network)]
    for kind in kinds:
        own = [x for x in lines if x["kind"] == kind]
        title = f"{kind.capitalize()} records: {len(own)}"
        parts.append(f"## {title}\n\n{t.verdicts(own)}")
        parts.append(f"### Power\n\n{t.power(own)}")
        parts.append(f"### Which effect is taken for which\n\n{t.confusion(own)}")
        if kind == "bench":
            parts.append(f"### By effect\n\n{t.by_effect(own)}")
        else:
            parts.append(f"### By effect\n\n{t.by_effect(own)}\n\n### Places\n\n{t.places(own, network)}")
        parts.append(f"### What cannot be told apart\n\n{t.ambiguous(own)}")
        parts.append(f"### Confidence\n\n{t.reliability(own)}")
        parts.append(f"### Parameters of the added term\n\n{t.parameters(own)}")
        parts.append(f"### Outside the catalogue\n\n{t.outside(own)}")
    return "\n\n".join(parts) + "\n"
