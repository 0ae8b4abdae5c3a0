"""Every command by name, with its function and its sentence for --help; imports happen on first use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer

from ..packages import check_own


@dataclass(frozen=True)
class Command:
    """A command: the package behind it, its function or group of sub-commands as "module:name" of ``arterial_fmu``, and
    its sentence."""

    package: str
    where: str
    does: str


COMMANDS: Mapping[str, Command] = {
    "solve": Command("solver", "cli.solve:main", "Simulate a network of arteries."),
    "list": Command("solver", "cli.networks:list_networks", "List the included networks."),
    "import": Command("solver", "cli.networks:importers", "Make a network file of another format."),
    "export": Command("solver", "cli.networks:export_csv", "Write a network as a table, or as a network file."),
    "build": Command("build_fmu", "cli.build:app", "Build FMUs of arteries, hearts, bodies and whole systems."),
    "run": Command("fmu_src", "cli.run:main", "Run an FMU from its start to a stop time."),
    "doctor": Command("fmu_src", "cli.doctor:main", "Check whether an FMU runs here, and list what is missing."),
    "virtual": Command(
        "fitting", "cli.cohort:virtual_command", "Make synthetic records of a cohort of virtual animals."
    ),
    "fit": Command("fitting", "cli.fit:fit_command", "Fit the wall of one site from its pressure and radius."),
    "cohort": Command("fitting", "cli.cohort:cohort_command", "Fit many subjects at many sites, and test claims."),
    "first": Command("fitting", "cli.first:first_command", "Make a first model from a recording."),
    "calibrate": Command("fitting", "cli.calibrate:calibrate_command", "Fit parameters of a network to recordings."),
    "check": Command("fitting", "cli.check:check_command", "Compare an FMU with a record, for a parameter set."),
    "discover": Command(
        "discrepancy",
        "cli.discover:discover_command",
        "Find, name and add the physics that a model lacks.",
    ),
    "isolability": Command(
        "discrepancy", "cli.discover:isolability_command", "Predict which effects sensors can distinguish."
    ),
    "study": Command("arterial_fmu", "study.command:main", "Vary parameters, and report which of them matter where."),
}


def load(name: str) -> Any:
    """The command object of typer."""
    from arterial_fmu.cli.terminal.console import sentences
    from arterial_fmu.cli.terminal.options import one_command

    module, _, attribute = COMMANDS[name].where.partition(":")
    with sentences(ImportError):
        check_own(COMMANDS[name].package)
    found = getattr(import_module(f"arterial_fmu.{module}"), attribute)
    return typer.main.get_command(found if isinstance(found, typer.Typer) else one_command(found, name))
