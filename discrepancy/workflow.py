"""The workflow: find where model and record disagree, name the missing effect, add it, show that the gap shrinks.

The output folder receives its files at the end, the verdict last. Until then ``<out>/.state`` has the finished stages.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any

from fitting.calibrate.calibration_prior import Prior
from fitting.check.fmu_build import build_fmu
from fitting.check.fmu_run import RunFailed, read_fmu
from fitting.first.fitted import spread
from fitting.first.options import FirstOptions, is_first
from fitting.inference.extended_network import extended
from fitting.inference.fit import Array, Fit
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
from solver import NonPhysicalState
from solver.errors import InputError
from solver.laws import effects as catalogue
from solver.network.description import Network, to_dict
from solver.network.doubts import network_doubts
from solver.network.files import write_network
from solver.simulate import Progress

from .add.learning import NOTHING, Learnt, law_of, learns
from .assemble import ValidationRuns, deciding_numbers, summary, unusable, weighted
from .checkpoint import Journal
from .find.model_source import OF_FIRST, first_of, read_model
from .find.plausibility import check_record, check_waves
from .find.study import Study, Unjudged, Unusable
from .findings.map_marks import entry
from .findings.outcome import LearnedLaw, NamedEffect, Outcome
from .findings.recorded import Recorded
from .name.individual_walls import subject_without
from .name.intervals import stated
from .name.model_selection import name
from .name.verdict import Naming
from .options import COMMON, TIME_LIMIT, Asked
from .plan.second_state import second_state
from .recordings import FreeRuns, drives, recordings_of
from .report.page import check_folder, write_study
from .report.verdict_text import with_law
from .show.fmu_validation import Run, agreement, free_run, parity

_LEARNING = 0.3  # of the time limit: further time for learning a law


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
    backend: str = "auto",
    first: FirstOptions | None = None,
    progress: Progress = lambda fraction, label: None,
) -> Outcome:
    """Find, name, add and show; writes verdict.json, report.html and figures into ``out``, and model.toml and model.fmu
    if an effect was added.

    record : a file; ``reading`` assigns its columns. filters : of its channels, "inlet.Q=lowpass 10 Hz", beside those
    of the model. as_measured : accept values that are implausible for an artery. further : other recordings of the same
    subject. Walls, geometry, sensors and effects are common; ``varies``, "*.outlet.R2", names parameters of which each
    recording has its own value. hold_out : recordings that no fit uses, for validation. model : a network file, the
    name of a bundled network, or an FMU; None: a first model is made from the record, with the options ``first``, and
    written as ``<out>/first.toml``. period : of the beat [s], estimated by default. walls : "common" or "individual";
    by default the more probable. prior : the result of ``arterial-fmu calibrate``; its values and covariance replace
    those of the network file and the stated spreads. time_limit : for naming and every later refit [s]; after it the
    best answer so far is given. Learning a law of the remaining misfit may take three tenths of it more. Single
    simulations for set-up and validation (FMUs, candidates on held-out beats) are not included. backend : of the FMUs
    that validate, "numpy", "native" or "auto" (:func:`fitting.check.fmu_build.build_fmu`); model.fmu is in any case the
    one that ``arterial-fmu build`` makes. jobs : number of simulating processes, this one included. The others import
    this package and nothing of the calling script, which needs no ``if __name__ == "__main__"``. progress : called with
    the fraction done and the stage. An interrupted study continues where it stopped. Raises ValueError for a file, a
    model or a prior that cannot be read, for a folder that cannot be written, and while an effect of a script is in the
    catalogue, because the processes that build FMUs do not know it. A readable record that cannot be used
    gives the verdict "unusable", which does not overwrite the study of a usable record; without a model it is rejected.
    """
    started = time.perf_counter()
    asked = Asked(
        period, walls, prior, time_limit, jobs, tuple(filters), tuple(further), tuple(varies), tuple(hold_out),
        backend, first or FirstOptions(),
    )  # fmt: skip
    asked.check()
    _check_code()
    if model is not None and asked.first.given:
        raise InputError(
            f"{os.fspath(model)}: a model is given, so that no first model is made; leave it out, or the options of a "
            f"first model ({', '.join(asked.first.given)})."
        )
    check_one(reading.beside if reading else (), len(asked.others) + 1)
    outcome, fmu, journal = _studied(record, model, Path(out), asked, reading, as_measured, progress)
    outcome = replace(outcome, seconds=time.perf_counter() - started)
    outcome = write_study(outcome, fmu, Path(out), progress)
    if journal is not None:
        journal.close()
    return outcome


def _check_code() -> None:
    """Raise ValueError for an effect of a script: the processes that build FMUs do not import the script."""
    for kind in (type(effect) for effect in catalogue.ALL):
        if kind.__module__.partition(".")[0] != "solver":
            raise InputError(
                f"effect {kind.name}: its class {kind.__name__} is in {kind.__module__}, and discover builds its FMUs "
                "in processes that know only the package solver; move the class and its entry into "
                "solver/laws/effects.py."
            )


def _studied(
    record: str | os.PathLike[str], model: str | os.PathLike[str] | None, folder: Path, asked: Asked,
    reading: Reading | None, as_measured: bool, progress: Progress,
) -> tuple[Outcome, bytes | None, Journal | None]:  # fmt: skip
    """The outcome, the FMU to deliver, and the journal of the study; without FMU or journal if it is unusable."""
    described = None if model is None else read_model(model)
    measured, *others = (_read(each, reading) for each in (record, *asked.others))
    notes: list[str] = []
    if model is None:
        check_folder(folder, [record, asked.prior, *asked.others])
        model, notes = first_of(measured, folder, asked.period, as_measured, asked.first)
    network = with_filters(described or read_model(model), asked.filters)
    known = asked.known(network, measured if isinstance(measured, Record) else None)
    if known is None and asked.walls != COMMON and is_first(network):
        known = Prior(network, spread(network))
        notes.append(OF_FIRST)
    options = asked.plain  # with the calibration as it is now: its file may change or vanish during the study
    check_folder(folder, [record, *(reading.beside if reading else ()), model, asked.prior, *asked.others])
    journal = fmu = None
    try:
        records, unjudged = _usable([measured, *others], asked, network, as_measured)
        notes += unjudged
        measured = records[0]
        given = [measured.sha256, dict(measured.told), to_dict(network), os.fspath(model), [r.sha256 for r in records]]
        journal = Journal(folder, [*given, options, deciding_numbers(), software()])
        outcome, fmu = _Work(records, network, Path(model), journal, asked, known, progress).run()
    except UnusableRecord as error:
        outcome = unusable(error, record, model, measured)
    doubts = known.doubts(measured) if known and isinstance(measured, Record) else ()
    notes += [each for each in network_doubts(network) if each not in notes]
    warnings = tuple(dict.fromkeys((*notes, *doubts, *outcome.warnings)))
    outcome = replace(outcome, provenance={**outcome.provenance, "asked": options}, warnings=warnings)
    return outcome, fmu, journal


def _read(record: str | os.PathLike[str], reading: Reading | None) -> Record | UnusableRecord:
    """The record, or the reason why its content cannot be used. Raises ValueError for a file that cannot be read."""
    try:
        return read_record(record, reading)
    except UnusableRecord as error:
        return error


def _usable(
    read: Sequence[Record | UnusableRecord], asked: Asked, network: Network, as_measured: bool
) -> tuple[list[Record], list[str]]:
    """The records that pass the checks for a network, and a sentence for every held-out one that does not. Raises
    UnusableRecord for a fitted one."""
    records, unjudged = list[Record](), list[str]()
    for i, each in enumerate(read):
        try:
            if isinstance(each, UnusableRecord):
                raise each
            if not as_measured:
                check_plausible(each, arteries(network))
            records.append(each)
        except UnusableRecord as error:
            if i <= len(asked.further):
                raise
            unjudged.append(not_judged(asked.others[i - 1], error))
    check_record(records[0])
    return records, unjudged


class _Work:
    """One study from its records to its outcome."""

    def __init__(
        self, records: Sequence[Record], network: Network, model: Path, journal: Journal, asked: Asked,
        known: Prior | None, progress: Progress,
    ) -> None:  # fmt: skip
        self.model, self.journal, self.asked, self.progress = model, journal, asked, progress
        self.network, calibrated = (network, None) if known is None else (known.network, known.calibrated)
        progress(0.02, "cutting the beats")
        runs = Runs(Meter(lambda simulations: progress(0.08, f"{simulations} simulations")))
        self.recordings = recordings_of(records, self.network, asked, calibrated, runs)
        self.study = self.recordings.studies[0]

    def run(self) -> tuple[Outcome, bytes | None]:
        """All stages: the outcome, and the FMU to deliver of the extended network if an effect was added."""
        with TemporaryDirectory(prefix="discrepancy_", ignore_cleanup_errors=True) as place:
            self.place = Path(place)
            return self._run()

    def _run(self) -> tuple[Outcome, bytes | None]:
        given = self._fmu(self.network, "given")
        # before the long search: the record may be of another network, or its channels of two clocks
        self.progress(0.1, "running the file as it is")
        as_given = []
        for i, each in enumerate(self.recordings.studies):
            wave = each.problem.measured_wave(each.fitted)
            as_given.append(self._free(given, f"given_{i}" if i else "given", NOTHING, wave, {}, each))
            check_waves(each, as_given[-1].beats)
        naming = self._name()
        network, fmu = self.network, given
        if naming.adds:
            self.progress(0.75, "rebuilding the FMU")
            network = extended(self.network, naming.best.fit)
            fmu = self._fmu(network, "extended")
        self.progress(0.82, f"running the {'extended FMU' if naming.adds else 'model with this subject’s walls'}")
        base = subject_without(naming)
        runs = FreeRuns(partial(self._kept, given), partial(self._kept, fmu), as_given)
        found = naming.best.fit if naming.adds else None
        naming, shown = self.recordings.judged(naming, base, runs)
        last, study, best = shown.after or shown.before, weighted(self.study, naming), found if shown.after else None
        wave = drives(study, base, found)[shown.after is not None]  # also if they do not bear the name out
        shown = replace(shown, agreement=agreement(study, best or base, wave, last))
        if shown.after is not None:
            shown = self._with_model(replace(shown, network=network), naming, fmu)
        law = self._law(naming, last, best or base, network_fmu=fmu if shown.after else given)
        self.progress(0.92, "comparing the candidates with the held-out beats")
        shown = replace(shown, second=self.journal.stage("second_state", lambda: second_state(naming)))
        outcome = with_law(summary(self.model, self.study, naming, shown), law)
        ran = {"FMUs run": " and ".join(dict.fromkeys(read_fmu(each).tool for each in (given, fmu)))}
        return replace(outcome, provenance={**outcome.provenance, **ran}), shown.archive

    # --- stages -------------------------------------------------------------------------------------------------------

    def _name(self) -> Naming:
        limit, begun = self.asked.time_limit, monotonic()
        last = f"the search ends by {datetime.now() + timedelta(seconds=limit):%H:%M:%S}, then the FMUs run"
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
            raise Unjudged(
                f"{self.study.fitted.source}: the time limit of {limit:g} s was over before the model as given was "
                "refitted to this record, which may be fit for use; allow more time, say --time-limit "
                f'"{math.ceil(max(TIME_LIMIT, 2.0 * limit) / 60.0)} min".'
            ) from None

    def _with_model(self, shown: ValidationRuns, naming: Naming, ran: Path) -> ValidationRuns:
        """Adds the effects, and the FMU to deliver of the extended network with its difference from the solver."""
        assert shown.network is not None
        self.progress(0.9, "comparing the extended FMU with the solver")
        fmu = self._whole(shown.network, "model", ran)
        difference = failure = None
        try:
            difference = parity(fmu, shown.network)
        except (RunFailed, NonPhysicalState, InputError) as error:
            failure = str(error)
        best, sure = naming.best, naming.confidence
        each = ((t, stated(self.network, naming, best, t)) for t in best.fit.terms)
        effects = tuple(NamedEffect(t.effect, t.where, found, sure, entry(t.effect).equation) for t, found in each)
        return replace(shown, archive=fmu.read_bytes(), parity=difference, failure=failure, effects=effects)

    def _law(self, naming: Naming, before: Run, without: Fit, network_fmu: Path) -> LearnedLaw | None:
        """A law of the remaining misfit, if only one recording is fitted.

        before, without, network_fmu : the run without a law, its fit and its FMU.
        """
        if len(self.recordings.studies) > 1 or not learns(naming):
            return None
        built = dict[str, Path]()

        def run(own: Study, network: Network, fit: Fit) -> tuple[Run, Callable[[], bytes]]:
            stage = "described" if network.sources else "learned"
            fmu = built[stage] = self._fmu(network, stage)
            run = self._kept(fmu, stage, fit, own.problem.wave(own.fitted, fit), {}, own)
            return run, lambda: self._whole(network, f"{stage}_model", fmu).read_bytes()

        def unseen(law: Learnt) -> list[Recorded]:
            def ran(fmu: Path, stage: str, *rest: Any) -> Run:
                return self._kept(fmu, f"law_{stage}", *rest)

            runs = FreeRuns(partial(ran, network_fmu), partial(ran, built["learned"]))
            return self.recordings.unseen_by(without, law, runs)

        until = max(self.deadline, monotonic() + _LEARNING * self.asked.time_limit)
        return law_of(self.study, naming, before, run, unseen, self.asked.jobs, until, self.journal.stage)

    # --- FMUs ---------------------------------------------------------------------------------------------------------

    def _fmu(self, network: Network, stage: str) -> Path:
        """The FMU to run: of the network, or of the bench of its site."""
        part = self.study.problem.part(network)
        as_it_is = self.asked.prior is None and self.model.suffix.lower() == ".fmu"
        return (
            self.model
            if part is network and stage == "given" and as_it_is
            else self._built(part, stage, self.asked.backend)
        )

    def _whole(self, network: Network, stage: str, ran: Path) -> Path:
        """The FMU to deliver, of the whole network and pythonfmu's: the one that ran, unless that is of a bench or
        another kind."""
        alike = self.asked.backend == "numpy" and self.study.problem.part(network) is network
        return ran if alike else self._built(network, stage, "numpy")

    def _built(self, network: Network, stage: str, backend: str) -> Path:
        file = self.place / f"{stage}.toml"
        write_network(network, file)
        return build_fmu(file, self.place / stage, backend)

    def _free(self, fmu: Path, stage: str, fit: Fit, wave: Array, starts: Mapping[str, float], study: Study) -> Run:
        """The free run of a stage; a failure makes the study unusable."""
        try:
            return self._kept(fmu, stage, fit, wave, starts, study)
        except RunFailed as error:
            raise Unusable(f"{study.fitted.source}: the model does not run with this record: {error}") from None

    def _kept(self, fmu: Path, stage: str, fit: Fit, wave: Array, starts: Mapping[str, float], study: Study) -> Run:
        return self.journal.stage(f"run_{stage}", lambda: free_run(fmu, study, fit, wave, starts))
