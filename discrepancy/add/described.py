"""If no law is found: a network with the source map's signals as tables, which describe the record without explaining
it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace

import numpy as np

from fitting.check.fmu_run import RunFailed
from fitting.inference.fit import Array, Fit
from fitting.inference.forward import Single
from fitting.inference.models.bench import Bench
from fitting.inference.models.network import NetworkProblem
from fitting.inference.source_maps.source_map import SourceMap
from fitting.inference.unknown import parameter_values
from solver.errors import InputError
from solver.mesh.sources import BY_KIND, Source
from solver.network.curve import Curve
from solver.network.description import Network
from solver.network.table_source import KINDS, TableSource

from .. import thresholds as at
from ..find.study import Study
from ..findings.outcome import LearnedLaw
from ..findings.recorded import Pair
from ..name.verdict import Naming
from ..show.fmu_validation import Run
from ..show.gap import fall, gap

Runner = Callable[[Study, Network, Fit], tuple[Run, Callable[[], bytes]]]

_NONE = np.zeros(0)
NOTHING = Fit((), (), _NONE, _NONE, np.zeros((0, 0)), np.zeros(0, int), np.zeros(0, int))  # the network without changes
_NAMES = {kind: name for name, kind in BY_KIND.items()}


def described(study: Study, naming: Naming, before: Run, run: Runner) -> LearnedLaw | None:
    """The tables of a map, if their FMU shrinks the gap to the held-out beats by more than chance and closes most of
    it. None for a bench, and if only sensors and outlying parameters act.

    before : the run without them. run : as in :func:`discrepancy.add.learning.law_of`.
    """
    found = naming.map
    if found is None or study.problem.site is not None:
        return None
    try:
        if not (tables := tuple(tables_of(found, study.fitted.T))):
            return None
        values = {name: float(x) for name, x in parameter_values(found.unknowns, study.network, found.x).items()}
        network = replace(study.network.with_parameters(values), sources=tables)
        own = replace(study, problem=with_network(study.problem, network))
        after, archive = run(own, network, NOTHING)
    except (RunFailed, InputError):
        return None
    if (remaining_gap := gap_that_falls(study, before, after)) is None:
        return None
    return LearnedLaw(
        name="table_source",
        kind=study.problem.kind,
        where=tuple(dict.fromkeys(table.segment for table in tables)),
        formula=" and ".join(dict.fromkeys(s.place.label for s in found.signals if s.place.sources)),
        before=remaining_gap,
        after=after.gap.total,
        record=(study.fitted.source, study.fitted.sha256),
        network=network,
        archive=archive(),
        is_law=False,
    )


def gap_that_falls(study: Study, before: Run, after: Run, explains: bool = False) -> Pair | None:
    """The gap of the run ``before`` on (fitted, held-out) beats if that to the held-out beats falls by more than chance
    in the run ``after`` and, unless this ``explains`` the record, most of it closes; else None."""
    remaining, (fallen, sd) = gap(study, before.X).total, fall(study, before.X, after.X)
    closes = explains or after.gap.total[1] <= (1.0 - at.PART_CLOSED) * remaining[1]
    return remaining if fallen > at.FALL * sd and closes else None


def with_network(problem: Single, network: Network) -> Single:
    """The same problem with another network of the same topology."""
    if isinstance(problem, NetworkProblem):
        return replace(problem, simulator=replace(problem.simulator, network=network))
    assert isinstance(problem, Bench)
    return replace(problem, network=network)


def tables_of(found: SourceMap, T: float) -> Iterator[TableSource]:
    """The tables of all sources that are in the equations, over beats of T [s]."""
    for signal in found.signals:
        for source, g in zip(signal.place.sources, signal.g.T, strict=False):
            if type(source) in _NAMES:
                yield _table(source, g, T)


def _table(source: Source, g: Array, T: float) -> TableSource:
    """g : (K+1,) harmonics."""
    kind = _NAMES[type(source)]
    how = {f.name: float(getattr(source, f.name)) for f in fields(source) if f.name != "place"}
    series = Curve.series(KINDS[kind][0], float(g[0].real), 2.0 * g[1:].real, -2.0 * g[1:].imag, T)
    return TableSource(kind, source.place, series, how)
