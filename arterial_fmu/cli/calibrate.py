"""The command ``calibrate``: fit parameters of a network to one recording of it, or to several of one animal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from arterial_fmu.cli.terminal.console import conclude, sentences, show
from arterial_fmu.cli.terminal.options import Json, NetworkName, Quiet
from arterial_fmu.cli.terminal.progress import PACE, bar
from fitting.records.channels.filters import with_filters
from fitting.records.recordings import check_one, labels_of, not_judged
from fitting.results.parameter_set import ParameterSet, read_set, set_content, set_format, set_json
from solver import NonPhysicalState, NotPeriodic
from solver.errors import InputError
from solver.io.writing import check_destinations, write_all
from solver.network.description import Network
from solver.network.doubts import network_doubts
from solver.network.files import find_network, read_network

from .terminal import record_options as options

if TYPE_CHECKING:
    from fitting.calibrate.calibrated import Calibration
    from fitting.calibrate.held_out import HeldOut
    from fitting.calibrate.multistart import Starts
    from fitting.records.alignment.beats import Beats
    from fitting.results.estimate import Estimate

Varies = Annotated[
    list[str] | None,
    typer.Option(
        help='Unknowns of --free with a value for each recording, repeatable: "*.outlet.R2", "all.outlet.R2".'
    ),
]


def calibrate_command(
    record: Annotated[
        Path, typer.Argument(is_eager=True, help="Record with `time [s]`, `inlet.Q` and P, Q or R at some sites.")
    ],
    network: NetworkName,
    free: Annotated[
        list[str] | None,
        typer.Option(
            help='Required: unknowns to fit, repeatable: "all.E", "CA.phi0:0.1" (prior sd), "CA+FA.E:none", '
            '"all.outlet.R_t".'
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Write the parameter set (.json or .ssv); with several recordings, also one for each."),
    ] = None,
    further: options.Further = None,
    varies: Varies = None,
    hold_out: options.HeldOutFiles = None,
    start: Annotated[
        Path | None, typer.Option(help="Parameter set to start from; default: the network's values.")
    ] = None,
    starts: Annotated[
        int,
        typer.Option(help="Number of searches: one from the network's values, the others from priors of double width."),
    ] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 1,
    jobs: Annotated[int, typer.Option(help="Parallel processes.")] = 1,
    scheduler: Annotated[str | None, typer.Option(help="Address of a dask cluster: tcp://host:8786.")] = None,
    mapped: options.Mapped = None,
    beside: options.Beside = None,
    decimal: options.Decimal = None,
    columns: options.Columns = False,
    as_measured: options.AsMeasured = False,
    filters: options.Filters = None,
    period: options.Period = None,
    part: options.Part = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit parameters of a network to one record, or to several records of one animal."""
    paths, judged = [record, *(further or ())], hold_out or []
    with sentences():
        check_one(beside, len(paths) + len(judged))
        how = options.reading([*paths, *judged], mapped, decimal, beside, part)
        T = options.seconds(period)
        sets = _sets(out, labels_of(paths))
        check_destinations(*sets, given=[*paths, *judged, *how.beside, network, start])
        described = read_network(find_network(network))
        described = with_filters(described if start is None else read_set(start).apply(described), filters or ())
    from fitting.calibrate.multistart import calibrate_from
    from fitting.calibrate.network_indices import network_indices
    from fitting.inference.unknown_text import parse_unknowns
    from fitting.records.plausible import arteries

    from .tables.fits import calibration_table, network_indices_table, recordings_table

    with sentences(NonPhysicalState, NotPeriodic), bar(quiet, pace=PACE) as progress:
        progress(0.0, "reading")
        unknowns = parse_unknowns(free or (), described)
        recordings, unseen = (
            [options.beats_of(path, how, arteries(described), as_measured, T) for path in files]
            for files in (paths, judged)
        )
        tried = calibrate_from(
            recordings, described, unknowns, starts, varies=varies or (), seed=seed, jobs=jobs, scheduler=scheduler,
            progress=progress,
        )  # fmt: skip
        result = tried.best
        progress(1.0, "indices of the sites")
        indices = [network_indices(result.of(i), described, beats) for i, beats in enumerate(recordings)]
        held_out, unjudged = _judged(result, unseen, described)
        extra = _provenance(filters, tried if starts > 1 else None, held_out)
        written = _parameter_sets(result, extra, indices, complete=start is not None)
        if sets:
            write_all({path: set_content(own, path) for path, own in zip(sets, written, strict=True)})

    notes = [*network_doubts(described), *result.report, *unjudged]

    def shown() -> None:
        if result.values:  # none if every parameter varies between recordings
            show(calibration_table(result))
        if len(paths) == 1:
            show(network_indices_table(result.network, indices[0]))
        show(recordings_table(result, held_out))

    conclude(as_json, quiet, lambda: set_json(written[0]), shown, notes, sets)


def _sets(out: Path | None, labels: Sequence[str]) -> list[Path]:
    """The files of the common values and, for several recordings, of each: set.json, set.A.json, set.B.json."""
    if out is None:
        return []
    set_format(out)
    return [out, *(out.with_name(f"{out.stem}.{label}{out.suffix}") for label in labels if len(labels) > 1)]


def _judged(result: Calibration, unseen: Sequence[Beats], network: Network) -> tuple[list[HeldOut], list[str]]:
    """The recordings that no fit used, and a sentence for every one that cannot be judged: the fit stands without."""
    from fitting.calibrate.held_out import judge

    found: list[HeldOut] = []
    unjudged: list[str] = []
    for beats in unseen:
        try:
            found.append(judge(result, beats, network))
        except (InputError, NonPhysicalState, NotPeriodic) as error:
            unjudged.append(not_judged(beats.source, error))
    return found, unjudged


def _provenance(filters: list[str] | None, tried: Starts | None, held_out: Sequence[HeldOut]) -> dict[str, object]:
    """What the parameter sets say of their origin beside the calibration's own. tried : of several starts."""
    found = {"filters": filters, "starts": tried and tried.plain(), "held_out": [each.plain() for each in held_out]}
    return {name: each for name, each in found.items() if each}


def _parameter_sets(
    result: Calibration, extra: dict[str, object], indices: Sequence[dict[str, dict[str, Estimate]]], complete: bool
) -> list[ParameterSet]:
    """The set of the common values and, for several recordings, that of each. indices : of the recordings."""
    whole = result.parameter_set(complete=complete)
    if len(indices) == 1:
        return [_with(whole, extra, indices[0])]
    each = [result.of(i).parameter_set(complete=complete) for i in range(len(indices))]
    return [_with(whole, extra, None), *(_with(own, extra, i) for own, i in zip(each, indices, strict=True))]


def _with(
    parameters: ParameterSet, extra: dict[str, object], found: dict[str, dict[str, Estimate]] | None
) -> ParameterSet:
    """The set with further provenance, including the physiological indices."""
    from fitting.wall.indices import plain

    indices = {} if found is None else {"indices": {site: plain(each) for site, each in found.items()}}
    return replace(parameters, provenance={**parameters.provenance, **indices, **extra})
