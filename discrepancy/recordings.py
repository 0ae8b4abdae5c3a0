"""Several recordings of one subject in a study: prepared, named together, and each run through the FMUs.

A name stands only if χ² of held-out beats through the FMU falls over all fitted recordings together and in each that
shows the effect, and rises by more than chance in none. The same must be true of recordings that were held out whole;
for these, only the parameters that vary are refitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from fitting.check.fmu_run import RunFailed
from fitting.inference.fit import Array, Fit, Member
from fitting.inference.hypothesis import Calibrated, PlacedEffect, rewired
from fitting.inference.joint.joint_record import Several
from fitting.inference.runs import OutOfTime, Runs
from fitting.inference.unknown import parameter_values
from fitting.records.read.record import Record
from fitting.records.recordings import labels_of, not_judged
from solver.errors import InputError
from solver.network.description import Network
from solver.quantities.units import INFLOW

from .add.learning import Learnt, in_range
from .assemble import ValidationRuns
from .checkpoint import Journal
from .find.plausibility import check_beats, check_record, check_waves
from .find.study import Study, prepare
from .findings.recorded import Recorded
from .name.confirmation import confirmed
from .name.model_selection import name_together
from .name.scoring import weighed, whitened_response
from .name.verdict import Naming
from .options import COMMON, Asked
from .show.fmu_validation import Gap, Run, fall, held_out, of_coefficients

_FILE = "the file as it is"
_VENOUS = "*.outlet.P_venous"  # venous pressures are no property of the arteries
FreeRun = Callable[[str, Fit, Array, Mapping[str, float], Study], Run]  # of stage, fit, wave, start values and study
Ran = tuple[Recorded, Run, Run | None]  # a recording, and its runs without and with the added effects
Namer = Callable[..., Naming]  # :func:`discrepancy.name.model_selection.name`


@dataclass(frozen=True)
class FreeRuns:
    """before, after : run the FMU without and with the added effects. given : runs of the file as it is, under each
    fitted recording."""

    before: FreeRun
    after: FreeRun
    given: Sequence[Run] = ()


@dataclass(frozen=True)
class Recordings:
    """records, studies : the fitted ones; the first is the study's own. unseen : the held-out ones."""

    records: tuple[Record, ...]
    studies: tuple[Study, ...]
    unseen: tuple[tuple[Record, Study], ...] = ()
    varies: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def alone(self) -> bool:
        """True if there is only one recording."""
        return len(self.records) + len(self.unseen) == 1

    @property
    def labels(self) -> list[str]:
        """Names of the recordings; the held-out ones last."""
        return labels_of([each.path for each in (*self.records, *(record for record, _ in self.unseen))])

    @property
    def whole(self) -> Several:
        """All fitted recordings as one record. Raises InputError for a parameter that cannot vary."""
        parts = tuple(s.problem for s in self.studies)
        beats = tuple((s.fitted, s.held_out) for s in self.studies)
        varies = (*self.varies, *(() if parts[0].site else (_VENOUS,)))
        found = Several(parts, tuple(self.labels[: len(parts)]), varies, beats)
        _ = found.added  # raises the error now
        return found

    @property
    def terms(self) -> tuple[PlacedEffect, ...]:
        """Candidates for the channels of all recordings."""
        found: dict[str, PlacedEffect] = {}
        for study in self.studies:
            found = {t.label: t for t in study.terms} | found
        return tuple(found.values())

    def named(self, journal: Journal, asked: Asked, runs: Runs, name: Namer) -> Naming:
        """Name each fitted recording by itself, in its share of the time, then all together. name : names one."""
        if len(self.studies) == 1:
            (study,) = self.studies
            return journal.stage("naming", lambda: name(study.problem, study.terms, runs, asked.chosen))
        alone, whole, n = list[Naming](), self.whole, len(self.studies)
        for i, study in enumerate(self.studies):
            search = partial(_named, name, study, runs.part(1.0 / (n - i + 1.0)), asked.chosen)
            alone.append(journal.stage(f"naming_{i}", search))

        def together() -> Naming:
            problem = whole if asked.chosen == COMMON else whole.individual()
            return name_together(problem, alone, self.terms, runs)

        return replace(journal.stage("naming", together), map=alone[0].map)

    # --- through the FMUs ---------------------------------------------------------------------------------------------

    def judged(self, naming: Naming, base: Fit, runs: FreeRuns) -> tuple[Naming, ValidationRuns]:
        """The naming if the free runs of all recordings support it, with these runs.

        base : fit without the added effects. Its walls may have absorbed so much that the FMU does not run with them,
        though record and file are sound: the periodic solution of the fit stands in for its run, and without one the
        run of the file, with which no name stands.
        """
        found, unjudged = self.each(naming, base, runs)
        unjudged += [
            f"{r.source}: {r.failed} The gap is that of {first.stands_in}; do not use these walls."
            for r, first, _ in found
            if first.stands_in
        ]
        fitted = [(first.gap, last and last.gap) for each, first, last in found if each.fitted]
        ran = naming.adds and all(last for _, last in fitted)
        gaps = joined([first for first, _ in fitted]), joined([last for _, last in fitted if last]) if ran else None
        each = tuple(recorded for recorded, _, _ in found)
        naming = confirmed(naming, each, *gaps, [study.losses for study in self.studies])
        _, first, last = found[0]
        if not naming.adds:
            last, gaps = None, (gaps[0], None)
            each = tuple(replace(r, gap_after=None, rms_after={}, own=r.own_before) for r in each)
        warnings, each = (*self.warnings, *unjudged), () if self.alone else each
        return naming, ValidationRuns(runs.given[0], first, last, gaps=gaps, recordings=each, warnings=warnings)

    def each(self, naming: Naming, base: Fit, runs: FreeRuns) -> tuple[list[Ran], list[str]]:
        """The free runs of each recording, and sentences on held-out ones that could not be judged."""
        found, unjudged = list[Ran](), list[str]()
        for i, (record, study) in enumerate((*zip(self.records, self.studies, strict=True), *self.unseen)):
            fitted = i < len(self.records)
            try:
                ran = self._run(i, study, naming, base, runs)
                if ran[0].failed and not fitted:
                    raise RunFailed(ran[0].failed)
                found.append(ran)
            except (InputError, RunFailed) as error:
                if fitted:
                    raise
                unjudged.append(not_judged(record.path, error))  # the verdict does not depend on it
        return found, unjudged

    def _run(self, i: int, study: Study, naming: Naming, base: Fit, runs: FreeRuns) -> Ran:
        """The free runs of one recording, without and with the added effects."""
        fitted, whole = i < len(self.records), naming.problem if isinstance(naming.problem, Several) else None

        def there(fit: Fit) -> Fit:
            return _refitted(self.whole, study, fit) if not fitted else whole.of(fit, i) if whole else fit

        if fitted:
            study = replace(study, problem=whole.parts[i] if whole else naming.problem.first)
        without, best = there(base), there(naming.best.fit) if naming.adds else None
        found = self._through(i, study, without, best, runs)
        if best is None or not (whole and fitted) or found[2] is None:
            return found
        response = whitened_response(naming.best.fit, best.terms)[whole.rows[i]]
        return replace(found[0], d=float(np.linalg.norm(response))), *found[1:]

    def unseen_by(self, base: Fit, law: Learnt, runs: FreeRuns) -> list[Recorded]:
        """The free runs of the recordings that are held out whole, without and with a learned law. Recordings that
        cannot be simulated are omitted: a warning of the verdict already reports them. base : fit without the law.
        """
        found = list[Recorded]()
        for i, (_, study) in enumerate(self.unseen, len(self.records)):
            ranged = replace(study, problem=in_range(study.problem, law.ranges))
            with suppress(InputError, RunFailed):
                fits = _refitted(self.whole, study, base), _refitted(self.whole, ranged, law.fit)
                found.append(self._through(i, ranged, *fits, runs)[0])
        return found

    def _through(self, i: int, study: Study, without: Fit, best: Fit | None, runs: FreeRuns) -> Ran:
        """The free runs of a recording through the FMUs: of its fits without effects and, if there are any, with."""
        fitted = i < len(self.records)
        drive, wave = drives(study, without, best)
        stage = f"_{i}" if i else ""
        failed = ""
        try:
            first = runs.before(f"before{stage}", without, drive, moved(study.network, without), study)
        except RunFailed as error:
            failed = f"without effect, the FMU does not run with the walls that were fitted: {error}"
            if (X := study.problem.answer(drive, without)) is not None:
                first = of_coefficients(study, X, "the periodic solution")
            elif i < len(runs.given):  # under the weights of this study, which are not those of the file's own run
                first = of_coefficients(study, runs.given[i].X, _FILE)
            else:
                raise
        if not fitted:
            check_waves(study, first.beats)
        own, own_before = ({} if self.alone else _own(self.whole, study, fit) for fit in (best or without, without))
        recorded = Recorded(
            self.labels[i], study.fitted.source, study.fitted.sha256, study.fitted.n_beats + study.held_out.n_beats,
            study.fitted.T, fitted, first.gap.total, held_out(first.gap.rms), own=own, own_before=own_before,
            failed=failed,
        )  # fmt: skip
        if best is None or first.stands_in == _FILE:
            return recorded, first, None
        # the FMU with the effects has the values of the first recording
        try:
            last = runs.after(f"after{stage}", best, wave, moved(study.network, best) if i else {}, study)
        except RunFailed as error:
            return replace(recorded, failed=f"its FMU does not run with this record: {error}"), first, None
        fallen, sd = fall(study, first.X, last.X)
        response = whitened_response(best, best.terms)
        recorded = replace(
            recorded, gap_after=last.gap.total, rms_after=held_out(last.gap.rms), fallen=fallen, sd=sd,
            d=float(np.linalg.norm(response)),
        )  # fmt: skip
        return recorded, first, last


def recordings_of(
    records: Sequence[Record], network: Network, asked: Asked, known: Calibrated | None, runs: Runs
) -> Recordings:
    """The recordings of a study: its own, those fitted with it, and held-out ones.

    Raises UnusableRecord for an unusable recording; for a held-out one this is only a warning. Raises InputError if
    some are compared with the network and others with one wall, or for a parameter that cannot vary.
    """

    def prepared(other: Record) -> Study:
        found = prepare(other, network, asked.period, runs, known)
        check_beats(found)
        return found

    def alike(other: Record) -> Study:
        check_record(other)
        found = prepared(other)
        if found.site != study.site:
            raise InputError(f"{other.path}: it is of {found.site}, and {record.path} of {study.site}; give one site.")
        return found

    n, record = 1 + len(asked.further), records[0]
    study = prepared(record)
    for other in records[1:]:
        _check_alike(record, other)
    made = [alike(other) for other in records[1:n]]
    held_out, warnings = [], [f"{s.fitted.source}: {text}" for s in made for text in s.warnings]
    for other in records[n:]:
        try:
            held_out.append((other, alike(other)))
        except InputError as error:
            warnings.append(not_judged(other.path, error))
    found = Recordings(tuple(records[:n]), (study, *made), tuple(held_out), asked.varies, tuple(warnings))
    if not found.alone:
        _ = found.whole  # raises the error now
    return found


def _named(name: Namer, study: Study, runs: Runs, walls: str | None) -> Naming:
    """The verdict on one recording. If the time limit comes before any result, only the misfit of the model as given,
    so that the results of the other recordings are not lost."""
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
    """Raise InputError if only one of two recordings has an inflow."""
    if (INFLOW in record.channels) != (INFLOW in other.channels):
        has, lacks = (record, other) if INFLOW in record.channels else (other, record)
        raise InputError(
            f"{lacks.path}: it has no {INFLOW}, which {has.path} has; recordings of one animal are all compared with "
            f"the network, or all with one wall: record the inflow in each, or leave one out."
        )


def joined(gaps: Sequence[Gap]) -> Gap:
    """The gap over several recordings: root mean squares over all recordings, of a channel over the recordings that
    have it."""

    def mean(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
        fitted, held_out = np.sqrt(np.mean(np.square(pairs), axis=0))
        return float(fitted), float(held_out)

    def by_key(part: str) -> dict[Any, tuple[float, float]]:
        each = [getattr(gap, part) for gap in gaps]
        return {n: mean([own[n] for own in each if n in own]) for n in dict.fromkeys(n for own in each for n in own)}

    in_error = [g.in_error for g in gaps if g.in_error is not None]  # of all, or none: they have one network
    parts = {part: by_key(part) for part in ("channels", "rms", "pulsation", "above")}
    return Gap(mean([g.total for g in gaps]), in_error=mean(in_error) if in_error else None, **parts)


def _own(whole: Several, study: Study, fit: Fit) -> dict[str, float]:
    """The fitted values of the parameters that vary, for one recording."""
    effects = [u for t in fit.terms for u in t.unknowns]
    vary = {v for u in fit.unknowns if u not in effects and whole.differs(u) for v in u.variables}
    return {v: x for v, x in moved(study.network, fit).items() if v in vary}


def moved(network: Network, fit: Fit) -> dict[str, float]:
    """The parameters of the network that a fit changes."""
    return {n: float(x) for n, x in parameter_values(fit.unknowns, rewired(network, fit.terms), fit.x).items()}


def drives(study: Study, base: Fit, best: Fit | None) -> tuple[Array, Array]:
    """The waves that drive the FMUs without and with the effects: the most probable one. If a fault of the flow meter
    is named, the measured inflow drives the former."""
    wave = study.problem.wave(study.fitted, best or base)
    lies = best is not None and any(t.is_sensor and t.place == INFLOW for t in best.terms)
    return study.problem.measured_wave(study.fitted) if lies else wave, wave


def _refitted(whole: Several, study: Study, fit: Fit) -> Fit:
    """A fit to the fitted recordings, transferred to a held-out one: the common unknowns stay fixed, and the varying
    ones are fitted to it, from their mean."""
    each = [whole.own(fit.unknowns, i) for i in range(len(whole.parts))]
    unknowns, x = each[0][0], np.mean([fit.x[which] for _, which in each], axis=0)
    present = {v for u in unknowns for v in u.variables}
    more = tuple(u for u in whole.added if not set(u.variables) & present)
    effects = [u for t in fit.terms for u in t.unknowns]
    kept = (
        u if whole.differs(u) and u not in effects else replace(u, low=float(value), high=float(value))
        for u, value in zip(unknowns, x, strict=True)
    )
    member = Member(fit.terms, (*kept, *more), np.append(x, np.zeros(len(more))))
    single = Several((study.problem,), (f"{study.fitted.source} alone",))
    (found,) = single.searched_from([member], Runs())
    if found is None:
        raise InputError("the model cannot be simulated with it")
    return found
