"""Every command by name: where its function is, and what it does. Nothing is imported before it is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer

from .packages import check_own


@dataclass(frozen=True)
class Command:
    """A command: its function, or its command line of several, as "module:name", and a sentence for --help."""

    where: str
    does: str


COMMANDS: Mapping[str, Command] = {
    "solve": Command("solver.__main__:main", "Simulate a network of arteries."),
    "list": Command("solver.commands:list_networks", "The networks that come along."),
    "import": Command("solver.commands:importers", "Make a network file of another format."),
    "export": Command("solver.commands:export_csv", "Write a network as a table with one row per vessel."),
    "build": Command("build_fmu:app", "Build FMUs of arteries and of what they are coupled to."),
    "run": Command("fmu_src.run:main", "Run an FMU from its start to a stop time."),
    "doctor": Command("fmu_src.doctor:main", "Say whether an FMU runs here and what is missing."),
    "virtual": Command("fitting.__main__:virtual_command", "Make a cohort of virtual animals: synthetic records."),
    "fit": Command("fitting.__main__:fit_command", "Fit the wall of one site from its pressure and radius."),
    "cohort": Command("fitting.__main__:cohort_command", "Fit many subjects at many sites, and test claims."),
    "first": Command("fitting.first.command:first_command", "Make a first model from a recording."),
    "calibrate": Command(
        "fitting.calibrate_command:calibrate_command", "Find parameters of a network from records of it."
    ),
    "check": Command("fitting.__main__:check_command", "Compare an FMU that has a parameter set with a record."),
    "discover": Command("discrepancy.__main__:discover_command", "Find, name and add what a model lacks."),
    "isolability": Command("discrepancy.__main__:isolability_command", "What sensors could tell apart, beforehand."),
    "study": Command("arterial_fmu.study.command:main", "Vary parameters: which of them matter where."),
}


def load(name: str) -> Any:
    """The command itself, as typer runs it."""
    from solver.console import sentences
    from solver.options import one_command

    module, _, attribute = COMMANDS[name].where.partition(":")
    with sentences(ImportError):
        check_own(module.partition(".")[0])
    found = getattr(import_module(module), attribute)
    return typer.main.get_command(found if isinstance(found, typer.Typer) else one_command(found, name))
