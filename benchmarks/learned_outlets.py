"""Outlets that no law of the catalogue describes: what laws of their state and tables leave of held-out beats.

    python benchmarks/learned_outlets.py [--records 10] [--json FILE]

Records of the sheep by the generator of tests/truth, the first of the tuning plan of group outside_walls (networks,
every wall off by itself) in which a reflection swings with time over the beat, R_t + s sin 2π(t/T - p), with a d' of 30
or more. Of each a source map is made, and from it what `discover` offers where nothing of the catalogue explains it: a
law of the outlet's state if one is worth its price, and tables. Gaps to held-out beats are whitened RMS: through the
FMU by the noise of the sensors, and (held out) by all noise, that of the inflow too, of which 1 is what the true law,
an R_t that swings, would leave. Nothing is asserted.
"""

from __future__ import annotations

import time
from typing import Annotated, Any

import typer

from benchmarks.learned import fmu_of, record_of, rms
from benchmarks.table import JsonFile, start, store, tabulate
from discrepancy.add.described import NOTHING, described, with_network
from discrepancy.add.learning import learnt, stands
from discrepancy.find.study import prepare
from discrepancy.name.scoring import weighed
from discrepancy.name.verdict import Naming
from fitting.inference.extended_network import extended
from fitting.inference.models.network import NetworkProblem
from fitting.inference.runs import Runs
from fitting.inference.source_maps.source_map import source_map
from tests.truth.detect import detect
from tests.truth.plan import GROUPS, seed_of, whole
from tests.truth.records import Case, make

VISIBLE = 30.0  # d'
Row = dict[str, Any]


def row(index: int, case: Case) -> Row | None:
    """One record, if what it hides is visible."""
    made = make(case, seed_of("network", GROUPS["outside_walls"].tuning, index))
    d_prime = detect(made).d_prime[0]
    if d_prime < VISIBLE:
        return None
    begun, study = time.process_time(), prepare(record_of(made), made.base)
    assert isinstance(study.problem, NetworkProblem)
    problem = study.problem.individual()
    found = source_map(problem)
    (base,) = problem.refit([()])
    assert base is not None
    none = weighed(problem, base, study.terms)
    naming = Naming("unknown", problem, none, (none,), (), {}, study.terms, 0.5, map=found)
    before, _ = fmu_of(study, extended(study.network, base), base)
    law = learnt(study, naming, Runs())
    kept = law and stands(study, law, before, record_of(made), fmu_of)
    tables = described(study, naming, before, record_of(made), fmu_of)
    held = study.problem.held_out(study.held_out, study.fitted)
    left = [rms(held, base), tables and rms(with_network(held, tables.network), NOTHING)]
    return {
        "index": index, "place": case.effects[0].where[0], "channels": case.channels, "dB": case.dB, "d_prime": d_prime,
        "swing": case.effects[0].size, "map": [place.label for place in found.places], "before": before.gap.total[1],
        "law": law and [law.term.place, *law.keys], "law_gap": kept and kept.after[1],
        "tables": tables and tables.after[1], "held_out": left, "seconds": time.process_time() - begun,
    }  # fmt: skip


def main(
    records: Annotated[int, typer.Option(help="Visible ones that are judged.")] = 10,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    plan = whole("network", "outside_walls", GROUPS["outside_walls"].tuning)
    cases = [(i, c) for i, c in enumerate(plan) if c.effects[0].name == "swinging_outlet"]
    columns = ("record", "outlet", "channels, dB", "d′", "map", "before", "law", "with it", "tables", "held out", "s")
    lines = []
    found = list[Row]()
    for index, case in cases:
        if len(found) == records:
            break
        r = row(index, case)
        if r is None:
            continue
        found.append(r)
        gaps = [f"{r[key]:.2f}" if r[key] else "–" for key in ("law_gap", "tables")]
        what = f"{r['channels']}, {r['dB']:.0f}", f"{r['d_prime']:.0f}", "; ".join(r["map"]), f"{r['before']:.2f}"
        held = " → ".join(f"{x:.2f}" if x else "–" for x in r["held_out"])
        lines.append((index, r["place"], *what, " ".join(r["law"] or ["–"]), *gaps, held, f"{r['seconds']:.0f}"))
        store(json_file, found)
    tabulate("an outlet that swings with time: gap to held-out beats, 1 is noise", columns, lines, width=170)
    near = sum((r["held_out"][1] or 99.0) <= 1.3 for r in found)
    print(f"tables within 1.3 times the noise: {near} of {len(found)}")


if __name__ == "__main__":
    start(main)
