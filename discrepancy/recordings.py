"""Several recordings of one animal in a study: prepared, named together, and each run through the FMUs.

A name stands only if χ² of held-out beats through the FMU falls over all recordings together and in each that shows the
effect, and rises by more than chance in none; over the recordings that were held out whole likewise, where only the
numbers that vary are refitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fitting.calibrated import labels_of
from fitting.fmu_run import RunFailed
from fitting.inference.fit import Fit, Member, projected
from fitting.inference.prior import Calibrated
from fitting.inference.several import Several
from fitting.inference.simulator import OutOfTime, Runs
from fitting.inference.terms import Term, candidates, rewired
from fitting.inference.unknown import parameter_values, precision
from fitting.record_options import not_judged
from fitting.records.record import Record
from solver.errors import InputError
from solver.network import Network
from solver.units import INFLOW

from .asked import Asked
from .confirm import confirmed_together
from .journal import Journal
from .name import COMMON, name
from .outcome import ADDED
from .recorded import Recorded
from .show import Gap, Run, fall
from .study import Study, prepare
from .summary import Shown
from .together import name_together
from .usable import check_beats, check_record, check_waves
from .verdict import Naming
from .weigh import weighed

Array = np.ndarray
_VENOUS = "*.outlet.P_venous"  # what lies behind the arteries is no part of them
FreeRun = Callable[[str, Fit, Array, Mapping[str, float], Study], Run]  # of a stage; under a wave, with start values


@dataclass(frozen=True)
class Recordings:
    """records, studies : of those that are fitted, the first of them the study's own. unseen : of those held out."""

    records: tuple[Record, ...]
    studies: tuple[Study, ...]
    unseen: tuple[tuple[Record, Study], ...] = ()
    varies: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def labels(self) -> list[str]:
        """Names of the recordings, of those held out last."""
        return labels_of([each.path for each in (*self.records, *(record for record, _ in self.unseen))])

    @property
    def whole(self) -> Several:
        """All that are fitted, as one record. Raises InputError for a number that cannot vary."""
        parts = tuple(s.problem for s in self.studies)
        beats = tuple((s.fitted, s.held_out) for s in self.studies)
        varies = (*self.varies, *(() if parts[0].site else (_VENOUS,)))
        found = Several(parts, tuple(self.labels[: len(parts)]), varies, beats)
        _ = found.added  # refuses now what cannot vary
        return found

    @property
    def terms(self) -> tuple[Term, ...]:
        """What the channels of any recording may show."""
        network, site = self.studies[0].network, self.studies[0].site
        sensors = [channel for s in self.studies for channel in s.problem.signals]
        return candidates(network, [*dict.fromkeys(sensors), *(() if site else (INFLOW,))], site)

    def named(self, journal: Journal, asked: Asked, runs: Runs) -> Naming:
        """Each by itself, in its share of the time, and then all together."""
        alone, whole, n = list[Naming](), self.whole, len(self.studies)
        for i, study in enumerate(self.studies):
            search = partial(_named, study, runs.part(1.0 / (n - i + 1.0)), asked.chosen)
            alone.append(journal.naming(study.problem, search, f"naming_{i}"))

        def together() -> Naming:
            problem = whole if asked.chosen == COMMON else whole.individual()
            return name_together(problem, alone, self.terms, runs)

        return replace(journal.naming(whole, together), map=alone[0].map)

    def only(self, journal: Journal) -> Naming | None:
        """That of the first recording by itself, which :meth:`named` has found, where no other one is fitted."""
        (study, *more) = self.studies
        return None if more else journal.naming(study.problem, partial(_named, study, Runs(), None), "naming_0")

    # --- through the FMUs ---------------------------------------------------------------------------------------------

    def judged(
        self, naming: Naming, base: Fit, first: tuple[Run, Run | None], before: FreeRun, after: FreeRun
    ) -> tuple[list[tuple[Recorded, Gap, Gap | None]], list[str]]:
        """What the FMUs leave of each recording, and why of some that were held out it is not known.

        base : without what was added. first : the runs of the first recording. before, after : run the FMU without and
        with what was added.
        """
        whole, best = naming.problem, naming.best.fit if first[1] else None
        assert isinstance(whole, Several)
        found, unjudged, seen = [], list[str](), _seen(best or base)
        for i, (record, study) in enumerate(zip(self.records, self.studies, strict=True)):
            study, fits = replace(study, problem=whole.parts[i]), (whole.of(base, i), best and whole.of(best, i))
            runs = first if i == 0 else _runs(f"{i}", study, *fits, before, after)
            d = float(np.linalg.norm(seen[whole.rows[i]]))
            found.append(self._recorded(i, record, study, fits, runs, d, whole))
        for i, (record, study) in enumerate(self.unseen, len(self.records)):
            try:
                fits = _there(whole, study, base), best and _there(whole, study, best)
                runs = _runs(f"{i}", study, *fits, before, after)
                check_waves(study, runs[0].beats)
            except (InputError, RunFailed) as error:  # the verdict stands without it
                unjudged.append(not_judged(record.path, error))
                continue
            d = float(np.linalg.norm(_seen(fits[1] or fits[0])))
            found.append(self._recorded(i, record, study, fits, runs, d, whole))
        return found, unjudged

    def _recorded(
        self, i: int, record: Record, study: Study, fits: tuple[Fit, Fit | None], runs: tuple[Run, Run | None],
        d: float, whole: Several,
    ) -> tuple[Recorded, Gap, Gap | None]:  # fmt: skip
        first, last = runs
        shown: dict[str, object] = {}
        if last is not None:
            fallen, sd = fall(study, first, last)
            rms = {channel: pair[1] for channel, pair in last.gap.rms.items()}
            shown = {"gap_after": last.gap.total, "rms_after": rms, "d": d, "fallen": fallen, "sd": sd}

        def own(fit: Fit) -> dict[str, float]:
            mine = (u for u in whole.hypothesis(fit.terms) if u.name.endswith(f" of {whole.labels[0]}"))
            vary = {v for u in mine for v in u.variables}
            return {v: x for v, x in _values(study.network, fit).items() if v in vary}

        found = Recorded(
            self.labels[i], record.path, record.sha256, study.fitted.n_beats + study.held_out.n_beats, study.fitted.T,
            i < len(self.records), first.gap.total, {c: pair[1] for c, pair in first.gap.rms.items()},
            own=own(fits[1] or fits[0]), own_before=own(fits[0]), **shown,  # type: ignore[arg-type]
        )  # fmt: skip
        return found, first.gap, None if last is None else last.gap


def recordings_of(
    record: Record, study: Study, others: Sequence[Record], unseen: Sequence[Record], asked: Asked,
    known: Calibrated | None, runs: Runs,
) -> Recordings:  # fmt: skip
    """The recordings of a study, prepared as its own.

    Raises UnusableRecord for one that cannot be used; of those held out that is a warning. Raises InputError where one
    is compared with the network and another with one wall, or for a number that cannot vary.
    """

    def prepared(other: Record) -> Study:
        check_record(other)
        found = prepare(other, study.network, asked.period, runs, known)
        check_beats(found)
        if found.site != study.site:
            raise InputError(f"{other.path}: it is of {found.site}, and {record.path} of {study.site}; give one site.")
        return found

    for other in (*others, *unseen):
        _check_alike(record, other)
    made = [prepared(other) for other in others]
    held, warnings = [], [f"{s.fitted.source}: {text}" for s in made for text in s.warnings]
    for other in unseen:
        try:
            held.append((other, prepared(other)))
        except InputError as error:
            warnings.append(not_judged(other.path, error))
    found = Recordings((record, *others), (study, *made), tuple(held), asked.varies, tuple(warnings))
    _ = found.whole  # refuses now what cannot be compared
    return found


def _named(study: Study, runs: Runs, walls: str | None) -> Naming:
    """The verdict on one recording; where the time was over before anything was known of it, only how far the model as
    given is from it: the others are not lost."""
    try:
        return name(study.problem, study.terms, runs, walls)
    except OutOfTime:
        problem = study.problem if walls == COMMON else study.problem.individual()
        (base,) = problem.refit([()])
        if base is None:
            raise
        none = weighed(problem, base, study.terms)
        return Naming("unknown", problem, none, (none,), (), {}, study.terms, 0.0, complete=False)


def _check_alike(record: Record, other: Record) -> None:
    """Raise InputError where one recording has an inflow and the other none."""
    if (INFLOW in record.channels) != (INFLOW in other.channels):
        has, lacks = (record, other) if INFLOW in record.channels else (other, record)
        raise InputError(
            f"{lacks.path}: it has no {INFLOW}, which {has.path} has; recordings of one animal are all compared with "
            f"the network, or all with one wall: record the inflow in each, or leave one out."
        )


def confirmed_by_all(
    several: Recordings, naming: Naming, base: Fit, shown: Shown, before: FreeRun, after: FreeRun
) -> tuple[Naming, Shown, tuple[Recorded, ...], tuple[str, ...]]:
    """The naming that the free runs of all recordings bear out, with the gaps over those fitted; each recording, and
    what to know of them."""
    found, unjudged = several.judged(naming, base, (shown.before, shown.after), before, after)
    fitted = [(first, last) for each, first, last in found if each.fitted]
    first, last = joined([g for g, _ in fitted]), joined([g for _, g in fitted if g]) if shown.after else None
    each = tuple(recorded for recorded, _, _ in found)
    naming = confirmed_together(naming, each, first, last)
    if naming.verdict not in ADDED:
        last, each = None, tuple(replace(r, gap_after=None, rms_after={}, own=r.own_before) for r in each)
    return naming, replace(shown, gaps=(first, last)), each, (*several.warnings, *unjudged)


def joined(gaps: Sequence[Gap]) -> Gap:
    """The gap over several recordings: root mean squares over all, of a channel over those that have it."""

    def mean(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
        fitted, held_out = np.sqrt(np.mean(np.square(pairs), axis=0))
        return float(fitted), float(held_out)

    def by_channel(each: Sequence[Mapping[str, tuple[float, float]]]) -> dict[str, tuple[float, float]]:
        return {n: mean([own[n] for own in each if n in own]) for n in dict.fromkeys(n for own in each for n in own)}

    channels, rms = by_channel([g.channels for g in gaps]), by_channel([g.rms for g in gaps])
    return Gap(mean([g.total for g in gaps]), channels, rms)


def _seen(fit: Fit) -> Array:
    """(n, …) what of the effects of a fit no other of its numbers can take up, whitened."""
    names = {u.name for t in fit.terms for u in t.unknowns}  # of which some may be held
    mine = np.array([u.name in names for u in fit.unknowns], bool)
    size = mine & np.array([u.of_size or bool(u.group) for u in fit.unknowns], bool)
    moves = ~mine & np.array([u.low < u.high for u in fit.unknowns], bool)
    prior = precision(fit.prior, fit.x)[moves]
    return projected(fit.J[:, moves], prior, (fit.J[:, size] @ fit.x[size])[:, None])[:, 0]


def _values(network: Network, fit: Fit) -> dict[str, float]:
    """The parameters of the network that a fit moves."""
    return {n: float(x) for n, x in parameter_values(fit.unknowns, rewired(network, fit.terms), fit.x).items()}


def _runs(
    stage: str, study: Study, base: Fit, best: Fit | None, before: FreeRun, after: FreeRun
) -> tuple[Run, Run | None]:
    """The free runs of a recording, under its most probable drive; a flow meter that lies drove the model before."""
    problem, measured = study.problem, study.problem.measured_wave(study.fitted)
    wave = problem.wave(study.fitted, best or base)
    lies = best is not None and any(t.is_sensor and t.place == INFLOW for t in best.terms)
    first = before(f"before_{stage}", base, measured if lies else wave, _values(study.network, base), study)
    if best is None:
        return first, None
    return first, after(f"after_{stage}", best, wave, _values(study.network, best), study)


def _there(whole: Several, study: Study, fit: Fit) -> Fit:
    """A fit to some recordings as one to another: what is in common as it is, what varies fitted there alone."""
    each = [whole.own(fit.unknowns, i) for i in range(len(whole.parts))]
    unknowns, which = each[0]
    vary = [fit.unknowns[j].name != u.name for j, u in zip(which, unknowns, strict=True)]
    x = np.mean([fit.x[at] for _, at in each], axis=0)
    held = [u if v else replace(u, low=float(y), high=float(y)) for u, v, y in zip(unknowns, vary, x, strict=True)]
    one = Several((study.problem,), (f"{study.fitted.source} alone",))
    (found,) = one.searched([Member(fit.terms, tuple(held), x)], Runs())
    if found is None:
        raise InputError("the model cannot be simulated with it")
    return found
