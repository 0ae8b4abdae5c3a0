"""The command ``check``: run an FMU with a parameter set, and compare it with a record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from arterial_fmu.cli.terminal.console import conclude, say, sentences
from arterial_fmu.cli.terminal.options import Json, Quiet, networks_for
from arterial_fmu.cli.terminal.progress import PACE, bar
from fitting.results.parameter_set import read_set
from solver import NonPhysicalState, NotPeriodic
from solver.io.exit_codes import HostDied
from solver.io.writing import check_destinations
from solver.network.files import find_network
from solver.tracing.native import check_backend

from .terminal import record_options as options


def check_command(
    parameters: Annotated[Path, typer.Argument(help="Parameter set: .json, .ssv or the name of a bundled one.")],
    fmu: Annotated[
        Path,
        typer.Argument(
            help="The FMU of a network or of a bench; or a network, of which an FMU is then built.",
            autocompletion=networks_for,
        ),
    ],
    record: Annotated[
        Path, typer.Argument(is_eager=True, help="Record of the network, or P and R of the bench's site.")
    ],
    mapped: options.Mapped = None,
    beside: options.Beside = None,
    decimal: options.Decimal = None,
    columns: options.Columns = False,
    as_measured: options.AsMeasured = False,
    out: Annotated[Path, typer.Option(help="Folder for check.html and check.json.")] = Path("check"),
    period: options.Period = None,
    part: options.Part = None,
    filters: options.Filters = None,
    backend: options.FMUBackend = "auto",
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run an FMU with a parameter set in a fresh process and compare it with a record."""
    with sentences():
        how = options.reading([record], mapped, decimal, beside, part)
        given, T = read_set(parameters), options.seconds(period)
        find_network(fmu)
        check_backend(backend)
    from fitting.check.fmu_check import check
    from fitting.check.fmu_run import RunFailed
    from fitting.pages.check_page import FILES, write_check
    from fitting.records.read.record import read_record

    with sentences(NonPhysicalState, NotPeriodic, RunFailed, HostDied), bar(quiet, pace=PACE) as progress:
        check_destinations(*(out / file for file in FILES), given=[parameters, fmu, record, *how.beside], folders=True)
        report = check(
            given, fmu, read_record(record, how), period=T, filters=filters or (), as_measured=as_measured,
            backend=backend, progress=lambda what: progress(0.0, what),
        )  # fmt: skip
        page = write_check(report, out)
    conclude(as_json, quiet, report.to_json, lambda: say(report.title), report.warnings, [page])
