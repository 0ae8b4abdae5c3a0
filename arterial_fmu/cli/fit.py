"""The command ``fit``: the wall of one site."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from arterial_fmu.cli.terminal.console import conclude, sentences, show
from arterial_fmu.cli.terminal.options import Force, Json, Quiet
from arterial_fmu.cli.terminal.progress import PACE, bar
from fitting.results.parameter_set import set_content, set_format, set_json
from fitting.wall.wall_model import model
from solver import NonPhysicalState, NotPeriodic
from solver.errors import InputError
from solver.io.writing import check_destinations, check_new, write_all
from solver.network.files import dumps
from solver.quantities.text import typed_quantity

from .terminal import record_options as options

if TYPE_CHECKING:
    from fitting.records.alignment.beats import Beats
    from fitting.results.estimate import Estimate
    from fitting.wall.wall_fit import WallFit


def fit_command(
    record: Annotated[Path, typer.Argument(is_eager=True, help="Record with `time [s]`, `<site>.P` and `<site>.R`.")],
    site: Annotated[str, typer.Option(help="Name of the site: AA for AA.P and AA.R.")],
    h: Annotated[str, typer.Option("--h", help='Measured wall thickness, e.g. "0.38 mm".')],
    R0: Annotated[
        str | None, typer.Option("--R0", help='Measured unstressed radius, e.g. "0.936 cm"; default: fitted.')
    ] = None,
    wall: Annotated[
        str, typer.Option("--model", help="Wall model: linear, nonlinear, extended, monotone or 'extended monotone'.")
    ] = "monotone",
    law: options.Law = None,
    eta: Annotated[float, typer.Option(help="Poisson's ratio.")] = 0.5,
    period: options.Period = None,
    part: options.Part = None,
    lag: Annotated[bool, typer.Option("--lag", help="Also fit a time lag between P and R.")] = False,
    replicates: Annotated[int, typer.Option("--bootstrap", help="Bootstrap replicates; 0: none.")] = 200,
    out: Annotated[Path | None, typer.Option(help="Write the parameter set: .json or .ssv.")] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Draw the measured loop with the linear and the chosen model.")
    ] = None,
    mapped: options.Mapped = None,
    beside: options.Beside = None,
    decimal: options.Decimal = None,
    columns: options.Columns = False,
    as_measured: options.AsMeasured = False,
    bench: Annotated[
        Path | None, typer.Option(help="Write the network file of this site's bench, for build and discover.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit the wall of one site from its pressure and radius."""
    with sentences():
        how = options.reading([record], mapped, decimal, beside, part)
        check_destinations(out, figure, bench, given=[record, *how.beside])
        _check(out, figure, replicates)
        weighed = model(wall, law or "beta")
        chosen = wall if law is None else weighed
        thickness = typed_quantity(h, "m", "--h")
        radius = None if R0 is None else typed_quantity(R0, "m", "--R0")
        T = options.seconds(period)
    from fitting.inference.models.bench_network import bench_network
    from fitting.records.plausible import Artery
    from fitting.wall.indices import indices, plain
    from fitting.wall.site_fit import bootstrap, favoured_law, fit, linear_fit

    with sentences(NonPhysicalState, NotPeriodic), bar(quiet, pace=PACE) as progress:
        progress(0.0, "reading")
        beats = options.beats_of(record, how, {site: Artery(radius, thickness)}, as_measured, T)
        given: dict[str, Any] = {"R0": radius, "eta": eta, "lag_free": lag}
        kept = fit(beats, site, thickness, chosen, **given)
        fits = [*linear_fit(kept, beats, given), kept]
        checked = bootstrap(kept, beats, replicates, progress=lambda fraction: progress(fraction, "bootstrap"))
        found = indices(kept, beats)
        notes = [*_notes(kept), *favoured_law(kept, beats, given)]
        parameters = kept.parameter_set()
        parameters = replace(parameters, provenance={**parameters.provenance, "indices": plain(found)})
        files: dict[Any, Any] = {
            bench: bench and dumps(bench_network(site, parameters, beats.T)),
            out: out and set_content(parameters, out),
            figure: figure and _drawn(fits, beats),
        }
        check_new({bench: files[bench]} if bench else {}, force)
        write_all({path: content for path, content in files.items() if path is not None})
    written = (out, figure, bench)
    shown = partial(_show, fits, kept, found, checked)
    conclude(as_json, quiet, lambda: set_json(parameters), shown, notes, written)


def _check(out: Path | None, figure: Path | None, replicates: int) -> None:
    """Raise InputError, before the work, for a file of a wrong kind or a negative number."""
    if out is not None:
        set_format(out)
    if figure is not None and figure.suffix.lower() != ".png":
        raise InputError(f"{figure}: a figure is a .png file; rename it.")
    if replicates < 0:
        raise InputError(f"--bootstrap = {replicates}: must be 0 (none) or a number of replicates, such as 200.")


def _drawn(fits: list[WallFit], beats: Beats) -> bytes:
    from fitting.pages.figures import loop_figure  # matplotlib takes a second
    from fitting.pages.style import png

    return png(loop_figure(fits, beats))


def _show(
    fits: list[WallFit], kept: WallFit, found: dict[str, Estimate], checked: dict[str, tuple[float, float]]
) -> None:
    from .tables.fits import fits_table, headline, indices_table, sensitivity_table

    show(headline(kept, found["E_inc"]), fits_table([*fits, *kept.others], kept))
    show(sensitivity_table(kept, checked), indices_table(kept.site, found))


def _notes(kept: WallFit) -> list[str]:
    """Notes on a fit, in sentences."""
    if math.isnan(kept.lag[1]):
        return list(kept.warnings)
    lag, half = 1e3 * kept.lag[0], 1.96e3 * kept.lag[1]
    which = "late" if lag > 0.0 else "early"
    note = f"{kept.site}: P is {which} by {abs(lag):.3g} ± {half:.2g} ms (95 %); the results are corrected for it, "
    return [f"{note}but check uses the record without this correction.", *kept.warnings]
