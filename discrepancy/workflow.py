"""The workflow: find where model and record disagree, name the missing effect, add it, show that the gap shrinks.

The output folder receives its files at the end, the verdict last. Until then ``<out>/.state`` has the finished stages.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from time import monotonic

import numpy as np

from fitting.calibrate.calibration_prior import Prior
from fitting.check.fmu_run import RunFailed
from fitting.inference.extended_network import extended
from fitting.inference.fit import Fit
from fitting.inference.runs import Meter, OutOfTime, Runs
from fitting.parallel.threads import single_threaded
from fitting.parallel.workers import Workers
from fitting.records.channels.filters import with_filters
from fitting.records.plausible import arteries, check_plausible
from fitting.records.read.columns import Reading
from fitting.records.read.record import Record, read_record
from fitting.records.read.sensors import UnusableRecord
from fitting.records.recordings import check_one, not_judged
from fitting.results.provenance import software
from solver import NonPhysicalState, Settings
from solver.errors import InputError
from solver.network.description import Network, to_dict
from solver.network.files import write_network
from solver.quantities.units import INFLOW

from .add.described import NOTHING
from .add.learning import law_of, learns
from .assemble import Shown, deciding_numbers, summary, unusable, weighted
from .checkpoint import Journal
from .find.model_source import build_fmu, first_of, read_model
from .find.plausibility import check_record, check_waves
from .find.study import Study, Unusable
from .findings.learned_law import LearnedLaw
from .findings.map_marks import entry
from .findings.outcome import ADDED, NamedEffect, Outcome
from .findings.recorded import Pair
from .name.individual_walls import animal_without
from .name.intervals import stated
from .name.model_selection import name
from .name.verdict import Naming
from .options import TIME_LIMIT, Asked
from .plan.second_state import second_state
from .recordings import moved, recordings_of
from .report.learned_text import with_law
from .report.page import check_folder, holds_study, write_study
from .show.fmu_validation import Run, agreement, free_run, own_parity, parity

_LEARNING = 0.3  # of the time limit: further time for learning a law

Array = np.ndarray
Progress = Callable[[float, str], None]


@single_threaded
def discover(
    record: str | os.PathLike[str],
    model: str | os.PathLike[str] | None,
    out: str | os.PathLike[str],
    *,
    further: Iterable[str | os.PathLike[str]] = (),
    varies: Iterable[str] = (),
    hold_out: Iterable[str | os.PathLike[str]] = (),
    period: float | None = None,
    walls: str | None = None,
    prior: str | os.PathLike[str] | None = None,
    time_limit: float = TIME_LIMIT,
    jobs: int = 1,
    reading: Reading | None = None,
    filters: Iterable[str] = (),
    as_measured: bool = False,
    progress: Progress = lambda fraction, label: None,
) -> Outcome:
    """Find, name, add and show; writes verdict.json, report.html and figures into ``out``, and model.toml and model.fmu
    if an effect was added.

    record : a file; ``reading`` assigns its columns. filters : of its channels, "inlet.Q=lowpass 10 Hz", beside those
    of the model. as_measured : accept values that are implausible for an artery.
    further : other recordings of the same subject. Walls, geometry, sensors and effects are common; ``varies``,
    "*.outlet.R2", names parameters that each recording has of its own. hold_out : recordings that no fit uses, for
    validation.
    model : a network file, the name of a bundled network, or an FMU; None: a first model is made from the record and
    written as ``<out>/first.toml``. period : of the beat [s], estimated by default. walls : "common" or "individual";
    by default the more probable. prior : the result of ``arterial-fmu calibrate``; its values and covariance replace
    those of the network file and the stated spreads.
    time_limit : for naming and every later refit [s]; after it the best answer so far is given. Learning a law of the
    remaining misfit may take three tenths of it more. Single simulations for set-up and validation (FMUs, candidates on
    held-out beats) are not included. jobs : number of simulating processes, this one included. The others import this
    package and nothing of the calling script, which needs no ``if __name__ == "__main__"``. progress : called with the
    fraction done and the stage. An interrupted study continues where it stopped.
    Raises ValueError for a file, a model or a prior that cannot be read and for a folder that cannot be written. A
    readable record that cannot be used gives the verdict "unusable", which does not overwrite the study of a usable
    record; without a model it is refused.
    """
    started, folder = time.perf_counter(), Path(out)
    asked = Asked(
        period, walls, prior, time_limit, jobs, tuple(filters), tuple(further), tuple(varies), tuple(hold_out)
    )
    asked.check()
    others = [*asked.further, *asked.hold_out]
    check_one(reading.beside if reading else (), len(others) + 1)
    described = None if model is None else read_model(model)
    measured = _read(record, reading)
    also = [_read(each, reading) for each in others]
    said: list[str] = []
    if model is None:
        check_folder(folder, [record, prior, *others])
        model, *said = first_of(measured, folder, period, as_measured)
    network = with_filters(described or read_model(model), asked.filters)
    known = asked.known(network, measured if isinstance(measured, Record) else None)
    told = asked.plain  # the calibration as it is now: its file may change or vanish during the study
    progress = _rising(progress)
    check_folder(folder, [record, *(reading.beside if reading else ()), model, prior, *others])
    journal = None
    try:
        records, n = list[Record](), 1 + len(asked.further)
        for i, each in enumerate((measured, *also)):
            try:
                records.append(_usable(each, network, as_measured))
            except UnusableRecord as error:
                if i < n:
                    raise
                said.append(not_judged(others[i - 1], error))
        measured = records[0]
        check_record(measured)
        given = [measured.sha256, dict(measured.told), to_dict(network), os.fspath(model), [r.sha256 for r in records]]
        journal = Journal(folder, [*given, told, deciding_numbers(), software()])
        outcome, fmu = _Work(records, network, Path(model), journal, asked, known, progress).run()
    except UnusableRecord as error:
        outcome, fmu = unusable(str(error), record, model, measured), None
    doubts = known.doubts(measured) if known and isinstance(measured, Record) else ()
    outcome = replace(
        outcome,
        seconds=time.perf_counter() - started,
        provenance={**outcome.provenance, "asked": told},
        warnings=(*said, *doubts, *outcome.warnings),
    )
    if outcome.verdict == "unusable" and holds_study(folder):
        kept = f"{folder}: nothing was written; it holds an earlier study of a record that could be used."
        outcome = replace(outcome, warnings=(*outcome.warnings, kept), written=False)
    else:
        write_study(outcome, fmu, folder, progress)
    if journal is not None:
        journal.close()
    return outcome


def _read(record: str | os.PathLike[str], reading: Reading | None) -> Record | UnusableRecord:
    """The record, or the reason why its content cannot be used. Raises ValueError for a file that cannot be read."""
    try:
        return read_record(record, reading)
    except UnusableRecord as error:
        return error


def _usable(read: Record | UnusableRecord, network: Network, as_measured: bool) -> Record:
    """A record that passes the checks for a network. Raises UnusableRecord otherwise."""
    if isinstance(read, UnusableRecord):
        raise read
    if not as_measured:
        check_plausible(read, arteries(network))
    return read


def _rising(progress: Progress) -> Progress:
    """The same progress, but never decreasing."""
    reached = 0.0

    def tell(fraction: float, label: str) -> None:
        nonlocal reached
        reached = max(reached, fraction)
        progress(reached, label)

    return tell


class _Work:
    """One study from its records to its outcome. extended_fmu : the FMU with the added effects."""

    extended_fmu = Path()

    def __init__(
        self, records: Sequence[Record], network: Network, model: Path, journal: Journal, asked: Asked,
        known: Prior | None, progress: Progress,
    ) -> None:  # fmt: skip
        self.record, self.model, self.journal, self.asked, self.progress = records[0], model, journal, asked, progress
        self.network, calibrated = (network, None) if known is None else (known.network, known.calibrated)
        progress(0.02, "cutting the beats")
        runs = Runs(Meter(lambda simulations: progress(0.08, f"{simulations} simulations")))
        self.recordings = recordings_of(records, self.network, asked, calibrated, runs)
        self.study = self.recordings.studies[0]
        self.place = Path(tempfile.mkdtemp(prefix="discrepancy_"))

    def run(self) -> tuple[Outcome, bytes | None]:
        """All stages: the outcome, and the FMU of the extended network if an effect was added."""
        try:
            return self._run()
        finally:
            shutil.rmtree(self.place, ignore_errors=True)

    def _run(self) -> tuple[Outcome, bytes | None]:
        fmu = self._fmu(self.network, "given")
        # before the long search: the record may be of another network, or its channels of two clocks
        self.progress(0.1, "running the file as it is")
        as_given = []
        for i, each in enumerate(self.recordings.studies):
            wave = each.problem.measured_wave(each.fitted)
            as_given.append(self._free(fmu, f"given_{i}" if i else "given", NOTHING, wave, {}, each))
            check_waves(each, as_given[-1].beats)
        naming = self._name()
        study = weighted(self.study, naming)
        added = naming.verdict in ADDED
        best = naming.best.fit if added else naming.base.fit
        self.progress(0.75, "running the model with this subject's walls")
        wave = study.problem.wave(study.fitted, best)
        base = naming.nearest
        if base is None and added:
            base = animal_without(study.problem, best, naming.base.fit)
        base = naming.base.fit if base is None else base
        # if a fault of the flow meter is named, the measured inflow drove the model before
        drove = study.problem.measured_wave(study.fitted) if _has_sensor(best, INFLOW) else wave
        before = self._free(fmu, "before", base, drove, moved(self.network, base), study)
        without = agreement(study, base, drove, before)
        shown = Shown(as_given[0], before, agreement=without)
        if added:
            shown = self._add(study, naming, wave, shown)
        self.progress(0.91, "judging by the held-out beats")
        runners = partial(self._free, fmu), partial(self._free, self.extended_fmu)
        naming, shown, recordings, unjudged = self.recordings.judged(naming, base, shown, *runners)
        if naming.verdict not in ADDED:
            shown = Shown(as_given[0], before, agreement=without, gaps=shown.gaps)
        law = self._law(naming, shown.after or shown.before)
        self.progress(0.92, "comparing the candidates with the held-out beats")
        second = self.journal.stage("second_state", lambda: second_state(naming))
        outcome = summary(self.record, self.model, self.study, naming, replace(shown, second=second))
        outcome = with_law(outcome, law)
        return replace(outcome, recordings=recordings, warnings=(*outcome.warnings, *unjudged)), shown.archive

    def _law(self, naming: Naming, before: Run) -> LearnedLaw | None:
        """A law of the remaining misfit, if only one recording is fitted."""
        alone = naming if self.recordings.alone else self.recordings.only(self.journal, name)
        if alone is None or not learns(naming):
            return None
        until = max(self.deadline, monotonic() + _LEARNING * self.asked.time_limit)
        told = self.asked.jobs, until, self.journal.stage
        return law_of(self.study, alone, before, self.record, self._with_law, *told)

    # --- stages -------------------------------------------------------------------------------------------------------

    def _name(self) -> Naming:
        limit, begun = self.asked.time_limit, monotonic()
        last = f"done by {datetime.now() + timedelta(seconds=limit):%H:%M:%S} at the latest"
        self.progress(0.2, f"naming, time limit {limit:g} s")

        def told(simulations: int) -> None:
            part = max(1.0 - 0.5 ** (simulations / 300.0), min((monotonic() - begun) / limit, 1.0))
            self.progress(0.2 + 0.5 * part, f"naming, {simulations} simulations, {last}")

        self.deadline = begun + limit
        try:
            with Workers(self.asked.jobs) as workers:
                runs = Runs(Meter(told), self.deadline, monotonic, workers)
                return self.recordings.named(self.journal, self.asked, runs, name)
        except OutOfTime:
            raise Unusable(
                f"{self.record.path}: the time limit of {limit:g} s was over before the model as given was refitted to "
                f"this record, which may be fit for use; allow more time, say --time-limit "
                f'"{math.ceil(max(TIME_LIMIT, 2.0 * limit) / 60.0)} min".'
            ) from None

    def _fmu(self, network: Network, stage: str) -> Path:
        """The FMU to run: of the network, or of the bench of its site."""
        part = self.study.problem.part(network)
        as_it_is = self.asked.prior is None and self.model.suffix.lower() == ".fmu"
        if part is network and stage == "given" and as_it_is:
            return self.model
        return self._built(part, stage)

    def _built(self, network: Network, stage: str) -> Path:
        file = self.place / f"{stage}.toml"
        write_network(network, file)
        return build_fmu(file, self.place / stage)

    def _free(self, fmu: Path, stage: str, fit: Fit, wave: Array, starts: Mapping[str, float], study: Study) -> Run:
        """The free run of a stage; a failure makes the study unusable."""
        try:
            return self._kept(fmu, stage, fit, wave, starts, study)
        except RunFailed as error:
            raise Unusable(f"{study.fitted.source}: the model does not run with this record: {error}") from None

    def _kept(self, fmu: Path, stage: str, fit: Fit, wave: Array, starts: Mapping[str, float], study: Study) -> Run:
        return self.journal.stage(f"run_{stage}", lambda: free_run(fmu, study, fit, wave, starts))

    def _add(self, study: Study, naming: Naming, wave: Array, shown: Shown) -> Shown:
        """Adds the extended network, its FMU and its free run."""
        self.progress(0.82, "rebuilding the FMU")
        best = naming.best.fit
        network = extended(self.network, best)
        fmu = self.extended_fmu = self._fmu(network, "extended")
        self.progress(0.88, "running the extended FMU")
        after = self._free(fmu, "after", best, wave, {}, study)
        self.progress(0.9, "comparing the extended FMU with the solver")
        difference = failure = None
        if study.problem.part(network) is network:
            steps = max(8, int(np.ceil(study.fitted.T / Settings().dt - 1e-3)))
            settings = Settings(dt=study.fitted.T / steps)
            physical = free_run(fmu, study, NOTHING, wave, {}) if _has_sensor(best) else after
            difference = parity(network, study, wave, physical, settings)
            archive = fmu.read_bytes()
        else:
            fmu = self._built(network, "model")
            archive = fmu.read_bytes()
            try:
                difference = own_parity(fmu, network)
            except (RunFailed, NonPhysicalState, InputError) as error:
                failure = str(error)
        alone = self._alone(study, naming) if len(best.terms) > 1 else None
        alike = agreement(study, best, wave, after)
        return Shown(
            shown.given, shown.before, after, network, archive, difference, failure, self._named(naming), alone, alike
        )

    def _with_law(self, own: Study, network: Network, fit: Fit) -> tuple[Run, bytes]:
        """The free run of a learned law's FMU, and the FMU to deliver."""
        stage = "described" if network.sources else "learned"
        fmu = self._fmu(network, stage)
        run = self._kept(fmu, stage, fit, own.problem.wave(own.fitted, fit), {}, own)
        whole = own.problem.part(network) is network
        return run, (fmu if whole else self._built(network, f"{stage}_model")).read_bytes()

    def _named(self, naming: Naming) -> tuple[NamedEffect, ...]:
        """The effects of the best hypothesis with their estimates."""
        best, sure = naming.best, naming.confidence
        each = ((t, stated(self.network, naming, best, t)) for t in best.fit.terms)
        return tuple(NamedEffect(t.effect, t.where, found, sure, entry(t.effect).equation) for t, found in each)

    def _alone(self, study: Study, naming: Naming) -> Pair | None:
        """The gap with only the first effect of a pair, refitted within the rest of the time limit; None if time runs
        out or the FMU fails."""
        alone, best = None, naming.best.fit
        with suppress(OutOfTime):
            runs = Runs(deadline=self.deadline, clock=monotonic)
            (alone,) = naming.problem.refit([(best.terms[0],)], naming.base.fit, runs)
        if alone is not None:
            fmu, wave = self._fmu(extended(self.network, alone), "middle"), study.problem.wave(study.fitted, best)
            with suppress(RunFailed):
                return self._kept(fmu, "middle", alone, wave, {}, study).gap.total
        return None


def _has_sensor(fit: Fit, place: str | None = None) -> bool:
    """True if a term of the fit is a sensor fault, at the given place or anywhere."""
    return any(term.is_sensor and place in (None, term.place) for term in fit.terms)
