"""The command ``run``: run an FMU from its start to a stop time."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from arterial_fmu.cli.terminal.console import conclude, faults, ranges, right, sentences, show
from arterial_fmu.cli.terminal.options import Json, Quiet, files_for, one_command
from arterial_fmu.cli.terminal.progress import bar
from fitting.results.parameter_set import read_set
from fmu_src.importer.run import Array, FMUError, Input, check_inputs, drive_of, read_description, run_fmu
from solver.errors import InputError
from solver.io.writing import check_destinations, write_whole
from solver.network.files import parse_quantity, read_text
from solver.quantities.legible import significant
from solver.quantities.text import assignments
from solver.quantities.units import readable

_ROWS = 24  # of the table: a network of many sites has hundreds of variables


def main(
    fmu: Annotated[Path, typer.Argument(help="The FMU.", autocompletion=files_for)],
    inputs: Annotated[
        Path | None, typer.Option(help='CSV: "time [s]", then inputs such as "inlet.Q [mL/s]", interpolated linearly.')
    ] = None,
    start_values: Annotated[
        Path | None,
        typer.Option(help="Parameter set (.json, .ssv) of fit or calibrate, or JSON object of numbers in SI."),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help='A start value, e.g. "CA.phi0=0 kPa*s"; repeatable.'),
    ] = None,
    stop_time: Annotated[str, typer.Option(help="Run from 0 to this time.")] = "2.5 s",
    step: Annotated[str, typer.Option(help="Communication step.")] = "1 ms",
    out: Annotated[Path, typer.Option(help="CSV of time, inputs and outputs, in SI.")] = Path("result.csv"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run an FMU of an arterial network from its start to a stop time; without --inputs its own inflow drives it."""
    with sentences(FMUError):
        check_destinations(out, given=[fmu, inputs, start_values])
        variables = {variable.name: variable for variable in read_description(fmu).modelVariables}
        drive = drive_of(variables, fmu)
        end = parse_quantity(stop_time, "s", "--stop-time")
        starts = _read_start_values(start_values) if start_values else {}
        starts |= assignments(set_ or [], _units(variables))
        known = _read_inputs(inputs, variables, fmu, end) if inputs else {}
        with bar(quiet, f"running {fmu.name}") as progress:
            result = run_fmu(
                fmu,
                known.pop(drive, np.zeros_like if inputs else None),
                end,
                step=parse_quantity(step, "s", "--step"),
                start_values=starts,
                inputs=known,
                progress=lambda fraction: progress(fraction, fmu.name),
            )
        _write_result(out, result, variables)
    columns = {name: values for name, values in result.items() if name != "time"}
    found = ranges(result["time"], columns, {name: variables[name].unit for name in columns})
    displays = {name: variables[name].displayUnit for name in columns}
    document = {"fmu": str(fmu), "variables": found, "written": [str(out)]}
    conclude(
        as_json, quiet, lambda: document, lambda: show(ranges_table(fmu.name, found, end, displays)), written=[out]
    )


def ranges_table(
    name: str, found: Mapping[str, Mapping[str, Any]], end: float, displays: Mapping[str, str | None]
) -> Table:
    """Range and time mean of the variables, in their display units; of a large network of the first ones."""
    rest = f", first {_ROWS} of {len(found)} variables" if len(found) > _ROWS else ""
    table = Table("variable", "unit", *map(right, ("min", "max", "mean")), title=f"{name}: {end:g} s{rest}")
    for variable, each in islice(found.items(), _ROWS):
        unit, factor = readable(each["unit"] or "", displays.get(variable))
        table.add_row(variable, unit, *(significant(factor * each[key], 4) for key in ("min", "max", "mean")))
    return table


def _read_inputs(path: Path, variables: Mapping[str, Any], fmu: Path, stop_time: float) -> dict[str, Input]:
    """Piecewise linear inputs by name, in SI. Raises ValueError, one sentence with file and line."""
    rows = list(csv.reader(read_text(path).splitlines()))
    titles = [re.fullmatch(r"\s*([^\s\[]+)\s*(?:\[(.*)\])?\s*", title) for title in rows[0]] if rows else []
    names = [match[1] if match else "" for match in titles]
    if len(rows) < 2 or names[0] != "time" or len(set(names)) < len(names):
        raise InputError(f'{path}: must begin with the line "time [s],inlet.Q [m^3/s]", each name once, then numbers.')
    for i, row in enumerate(rows[1:], 2):
        if len(row) != len(names) or not all(map(_finite, row)):
            raise InputError(f"{path}: line {i}: must hold {len(names)} finite numbers; correct it.")
    table = np.array(rows[1:], float)
    check_inputs(names[1:], variables, fmu)
    for k, match in enumerate(titles):
        if match and match[2]:
            unit = "s" if k == 0 else variables[names[k]].unit
            table[:, k] *= parse_quantity(f"1 {match[2]}", unit, f"{path}: {names[k]}")
    time = table[:, 0]
    if (np.diff(time) <= 0.0).any():
        raise InputError(f"{path}: line {int(np.argmax(np.diff(time) <= 0.0)) + 3}: the time must increase; sort it.")
    if time[0] > 0.0 or time[-1] < stop_time * (1.0 - 1e-12):
        raise InputError(
            f"{path}: covers {time[0]:g} s to {time[-1]:g} s, but the run is from 0 to {stop_time:g} s; "
            "give inputs for all of it or stop earlier."
        )

    def linear(values: Array) -> Input:
        return lambda t: np.interp(t, time, values)

    return {name: linear(table[:, k]) for k, name in enumerate(names) if k}


def _finite(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _units(variables: Mapping[str, Any]) -> dict[str, tuple[str, str | None]]:
    """The SI unit and the display unit of every number."""
    return {name: (v.unit or "1", v.displayUnit) for name, v in variables.items() if v.type in ("Real", "Float64")}


def _read_start_values(path: Path) -> dict[str, float | str]:
    """Start values of a parameter set, or of a JSON object. Raises ValueError."""
    if path.suffix.lower() == ".ssv":
        return read_set(path).start_values()
    try:
        values = json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error}); correct it.") from None
    if isinstance(values, dict) and isinstance(values.get("values"), dict):
        return read_set(path).start_values()
    if not isinstance(values, dict) or not all(
        isinstance(value, str | float | int) and not isinstance(value, bool) for value in values.values()
    ):
        raise InputError(f'{path}: must be a JSON object of numbers and texts, such as {{"CA.phi0": 0}}.')
    return values


def _write_result(path: Path, result: Mapping[str, Array], variables: Mapping[str, Any]) -> None:
    titles = [f"{name} [{'s' if name == 'time' else variables[name].unit}]" for name in result]
    rows = (",".join(map(repr, row)) for row in np.column_stack(list(result.values())).tolist())
    write_whole(path, "\n".join([",".join(titles), *rows]) + "\n")


if __name__ == "__main__":
    with faults():
        one_command(main)()
