"""The command ``doctor``: whether an FMU runs here, as a table."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Column, Table

from arterial_fmu.cli.terminal.console import put, say, sentences, show
from arterial_fmu.cli.terminal.options import Json, files_for
from arterial_fmu.cli.terminal.progress import bar
from fmu_src.importer.doctor import EXIT, FATAL, INSTALL, NOTE, OK, PROBLEM, START, Finding, examine, state


def main(
    fmu: Annotated[Path, typer.Argument(help="The FMU.", autocompletion=files_for)],
    python: Annotated[str, typer.Option(help="The Python that will run it.")] = sys.executable,
    as_json: Json = False,
) -> None:
    """Check whether an FMU runs here, and list what is missing. Exit codes: 0 it runs, 1 it does not, 2 it is not an
    FMU of this project."""
    with sentences(), bar(False, f"{fmu.name}: one step of it"):
        findings = examine(fmu, python)
    if as_json:
        put({"state": state(findings), "findings": [asdict(finding) for finding in findings]})
    else:
        _print(fmu, findings)
    raise typer.Exit(EXIT[state(findings)])


def _print(fmu: Path, findings: list[Finding]) -> None:
    table = Table(
        "", Column("found; what to do", overflow="fold"), title=f"{fmu}", title_justify="left", show_lines=True
    )
    style = {OK: "green", NOTE: "yellow", PROBLEM: "red", FATAL: "bold red"}
    lines = []
    for finding in findings:
        remedy = finding.remedy
        for begin, what in ((START, "Start hosts in C, C++, … with: "), (INSTALL, "Install numpy with: ")):
            if remedy.startswith(begin):  # on a separate line, to be copied
                lines.append(what + remedy.removeprefix(begin))
                remedy = "see below"
        mark = f"[{style[finding.state]}]{finding.what}: {finding.state}[/]"
        table.add_row(mark, _plain(finding.found) + (f"\n→ {_plain(remedy)}" if remedy else ""))
    show(table)
    for line in lines:
        say(line)


def _plain(text: str) -> str:
    """Text of a file, without terminal markup."""
    return "".join(letter if letter.isprintable() else "?" for letter in text).replace("[", "\\[")
