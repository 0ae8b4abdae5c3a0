"""The bank of hidden effects: success rates of find and name on records from an independent generator.

    python benchmarks/hidden_effects.py run    --kind bench --tuning --jobs 2
    python benchmarks/hidden_effects.py run    --kind network --group walls --tuning
    python benchmarks/hidden_effects.py report --tuning [--write]

The records come from ``tests/truth``, which shares no numerical code with the solver; only the report knows the hidden
effects. ``tests/truth/plan.py`` fixes the plan, the sizes and the seeds, ``discrepancy/thresholds.py`` the thresholds;
the reported seed is not run while they are tuned. Each record appends one JSON line when it finishes, so a killed run
can be resumed.
"""

from __future__ import annotations

import signal
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.hidden.bank import ROOT, Bank, read, sources_hash
from benchmarks.hidden.calibration import diagram
from benchmarks.hidden.report import behind, targets
from benchmarks.hidden.report import write as put
from benchmarks.table import one_thread
from solver import load
from tests.truth.plan import GROUPS

app = typer.Typer(add_completion=False, help="Records with hidden effects: judge them, and report.")


class Kind(StrEnum):
    bench = "bench"
    network = "network"


def _known(group: str) -> str:
    """A group of records by its name."""
    if group not in GROUPS:
        raise typer.BadParameter(f"{group}: must be one of {', '.join(GROUPS)}.")
    return group


KindOption = Annotated[Kind, typer.Option(help="Which records.")]
GroupOption = Annotated[str, typer.Option(callback=_known, help="Which group of records; see tests/truth/plan.py.")]
Tuning = Annotated[bool, typer.Option("--tuning/--reported", help="Which seed: of tuning, or of the reported run.")]
Out = Annotated[Path | None, typer.Option(help="The file of lines; build/hidden_<kind>_<seed>.jsonl if not given.")]


def _seed(group: str, tuning: bool) -> int:
    return GROUPS[group].tuning if tuning else GROUPS[group].reported


def _path(kind: str, group: str, seed: int) -> Path:
    middle = kind if group == "standard" else f"{group}_{kind}"
    return ROOT / "build" / f"hidden_{middle}_{seed}.jsonl"


@app.command()
def run(
    kind: KindOption,
    group: GroupOption = "standard",
    tuning: Tuning = True,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first records of the plan.")] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    out: Out = None,
    least: Annotated[float, typer.Option(min=0.0, help="Only records whose effects all have this d' or more.")] = 0.0,
    first: Annotated[int, typer.Option(min=0, help="Index of the plan to begin at, after records seen before.")] = 0,
) -> None:
    """Diagnose the records of the plan that are not yet in the file."""
    seed = _seed(group, tuning)
    if kind.value not in GROUPS[group].records:
        raise SystemExit(f"group {group} has no {kind.value} records; give --kind network.")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that its processes end with it
    try:
        path = out or _path(kind.value, group, seed)
        bank = Bank(path, kind.value, seed, sources_hash(), group)
        bank.run(limit, jobs, least, first)
    except ValueError as error:
        raise SystemExit(str(error)) from None
    except KeyboardInterrupt:
        raise SystemExit("stopped; the same command goes on from here.") from None


@app.command()
def report(
    tuning: Tuning = True,
    kind: Annotated[Kind | None, typer.Option(help="Only these records.")] = None,
    out: Annotated[list[Path] | None, typer.Option(help="Files of lines; may be given twice.")] = None,
    write: Annotated[bool, typer.Option("--write", help="Put the tables into docs/hidden-effects*.md.")] = False,
) -> None:
    """Print the tables of all records diagnosed so far."""
    known = [(k.value, name, _seed(name, tuning)) for name, g in GROUPS.items() for k in Kind if k.value in g.records]
    paths = out or [_path(*each) for each in known]
    lines = [x for path in paths for x in read(path) if kind is None or x["kind"] == kind.value]
    if not lines:
        raise SystemExit(f"{', '.join(map(str, paths))}: no records; run the bank first.")
    pages = {
        "hidden-effects": targets(lines, load("sheep")),
        "hidden-effects-tables": behind(lines, load("sheep")),
    }
    print(*pages.values(), sep="\n")
    if write:
        for name, text in pages.items():
            put(text, ROOT / "docs" / f"{name}.md")
        (ROOT / "docs" / "images" / "reliability.png").write_bytes(diagram(lines))


if __name__ == "__main__":
    with one_thread():
        app()
