"""The loop: find where model and record disagree, name the missing effect, add it, show that the gap shrinks.

The folder gets its files when all of them are made, the verdict last; ``<out>/.state`` has what is done till then.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from time import monotonic

import numpy as np

from fitting.fmu_run import RunFailed
from fitting.inference.added import extended
from fitting.inference.fit import Fit
from fitting.inference.simulator import Meter, OutOfTime, Runs
from fitting.inference.unknown import parameter_values
from fitting.prior import Prior
from fitting.provenance import software
from fitting.records.columns import Reading
from fitting.records.filters import with_filters
from fitting.records.plausible import arteries, check_plausible
from fitting.records.record import Record, read_record
from fitting.records.sensors import UnusableRecord
from fitting.result_files import check_unmixed, json_text
from fitting.threads import single_threaded
from fitting.workers import Workers
from solver import NonPhysicalState, Settings
from solver.errors import InputError
from solver.files import dumps, write_network
from solver.network import Network, to_dict
from solver.units import INFLOW
from solver.writing import check_destinations, make_folder, write_folder

from . import thresholds as at
from .asked import TIME_LIMIT, Asked
from .confirm import agreement, confirmed
from .first import first_of
from .intervals import stated
from .journal import Journal
from .learned_text import FILES, learned_files, with_law
from .learning import law_of, learns
from .name import name
from .outcome import ADDED, NamedEffect, Outcome, Round, verdict_json
from .outliers import animal_without
from .places import entry
from .show import Run, free_run, own_parity, parity
from .source import build_fmu, read_model
from .study import Study, Unusable, prepare
from .summary import Shown, decided, summary, unusable, weighted
from .usable import check_beats, check_record, check_waves
from .verdict import Naming

Array = np.ndarray
Progress = Callable[[float, str], None]

_STATE = ".state"  # the journal's folder
_FILES = ("model.toml", "model.fmu", *FILES, "report.html", "verdict.json")  # of a study, as they are written


@single_threaded
def discover(
    record: str | os.PathLike[str],
    model: str | os.PathLike[str] | None,
    out: str | os.PathLike[str],
    *,
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
    """Find, name, add and show; writes verdict.json, report.html and figures into ``out``, and where an effect was
    added model.toml and model.fmu.

    record : a file, and ``reading`` which of its columns is what. filters : of its channels, "inlet.Q=lowpass 10 Hz",
    beside those of the model. as_measured : values that no artery has are taken as they are.
    model : a network file, the name of a bundled network, or an FMU; None: a first one is made of the record and
    written as ``<out>/first.toml``. period : of the beat [s], found by default. walls : "common" or "individual", by
    default as the record is more probable. prior : the result of ``arterial-fmu calibrate``, whose values and
    covariance stand for the network file's and its spreads.
    time_limit : of naming and of every refit after it [s]; then the best answer so far is given. Learning a law of what
    remains may take three tenths of it more. What is simulated once to set up or to show it (FMUs, candidates on
    held-out beats) comes on top. jobs : processes that simulate, this one among them; the others import this package
    and nothing of the calling script, which needs no ``if __name__ == "__main__"``. progress : told the fraction done
    and the stage. An interrupted study goes on where it was.
    Raises ValueError for a file, a model or a prior that cannot be read and for a folder that cannot be written. A
    record that can be read and not be used is a verdict, which replaces no study of another record; without a model it
    is refused.
    """
    started, folder = time.perf_counter(), Path(out)
    asked = Asked(period, walls, prior, time_limit, jobs, tuple(filters))
    asked.check()
    described = None if model is None else read_model(model)
    measured = _read(record, reading)
    said: list[str] = []
    if model is None:
        _check_folder(folder, [record, prior])
        model, *said = first_of(measured, folder, period, as_measured)
    network = with_filters(described or read_model(model), asked.filters)
    known = asked.known(network, measured if isinstance(measured, Record) else None)
    told = asked.plain  # the calibration as it is now: at the end its file may be another, or gone
    progress = _rising(progress)
    _check_folder(folder, [record, *(reading.beside if reading else ()), model, prior])
    journal = None
    try:
        if isinstance(measured, UnusableRecord):
            raise measured
        if not as_measured:
            check_plausible(measured, arteries(network))
        check_record(measured)
        given = [measured.sha256, dict(measured.told), to_dict(network), os.fspath(model)]
        journal = Journal(folder, [*given, told, decided(), software()])
        outcome, fmu = _Work(measured, network, Path(model), journal, asked, known, progress).run()
    except UnusableRecord as error:
        outcome, fmu = unusable(str(error), record, model, measured), None
    outcome = replace(
        outcome,
        seconds=time.perf_counter() - started,
        provenance={**outcome.provenance, "asked": told},
        warnings=(
            *said,
            *(known.doubts(measured) if known and isinstance(measured, Record) else ()),
            *outcome.warnings,
        ),
    )
    if outcome.verdict == "unusable" and _holds_study(folder):
        kept = f"{folder}: nothing was written; it holds an earlier study of a record that could be used."
        outcome = replace(outcome, warnings=(*outcome.warnings, kept), written=False)
    else:
        _write(outcome, fmu, folder, progress)
    if journal is not None:
        journal.close()
    return outcome


def _check_folder(folder: Path, given: Iterable[str | os.PathLike[str] | None]) -> None:
    """Make the folder of a study; raise ValueError now, not after all work, if something there is in its way.

    given : the files that the study is of, which it neither replaces nor removes.
    """
    check_unmixed(folder, "discover")
    for path in (folder / _STATE, folder / "figures"):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file where a study has a folder; move it, or give another --out.")
    for path in (folder / file for file in _FILES):
        if path.is_dir():
            raise InputError(f"{path}: is a folder where a study has a file; move it, or give another --out.")
    check_destinations(*(folder / file for file in _FILES), given=given, folders=True)
    make_folder(folder)


def _read(record: str | os.PathLike[str], reading: Reading | None) -> Record | UnusableRecord:
    """The record, or why its content cannot be used. Raises ValueError for a file that cannot be read."""
    try:
        return read_record(record, reading)
    except UnusableRecord as error:
        return error


def _rising(progress: Progress) -> Progress:
    """The same progress, which never goes back."""
    reached = 0.0

    def tell(fraction: float, label: str) -> None:
        nonlocal reached
        reached = max(reached, fraction)
        progress(reached, label)

    return tell


class _Work:
    """One study from its record to its outcome."""

    def __init__(
        self, record: Record, network: Network, model: Path, journal: Journal, asked: Asked, known: Prior | None,
        progress: Progress,
    ) -> None:  # fmt: skip
        self.record, self.model, self.journal, self.asked, self.progress = record, model, journal, asked, progress
        self.network = network if known is None else known.network
        progress(0.02, "cutting the beats")
        runs = Runs(Meter(lambda simulations: progress(0.08, f"{simulations} simulations")))
        self.study = prepare(record, self.network, asked.period, runs, None if known is None else known.calibrated)
        check_beats(self.study)
        self.place = Path(tempfile.mkdtemp(prefix="discrepancy_"))

    def run(self) -> tuple[Outcome, bytes | None]:
        """All stages: the outcome, and the FMU of the extended network where an effect was added."""
        try:
            return self._run()
        finally:
            shutil.rmtree(self.place, ignore_errors=True)

    def _run(self) -> tuple[Outcome, bytes | None]:
        study = self.study
        fmu = self._fmu(self.network, "given")
        # a record may be of another network, or its channels of two clocks: seen before the long search
        self.progress(0.1, "running the file as it is")
        wave = study.problem.measured_wave(study.fitted)
        given = self._free(fmu, "given", _nothing(), wave, {})
        check_waves(study, given.beats)
        naming = self._name()
        study = weighted(study, naming)
        added = naming.verdict in ADDED
        best = naming.best.fit if added else naming.base.fit
        self.progress(0.75, "running the model with this subject's walls")
        wave = study.problem.wave(study.fitted, best)
        base = animal_without(study.problem, best, naming.base.fit) if added else None
        base = naming.base.fit if base is None else base
        # a flow meter that is found to lie drove the model before
        drove = study.problem.measured_wave(study.fitted) if _has_sensor(best, INFLOW) else wave
        before = self._free(fmu, "before", base, drove, _moved(self.network, base), study)
        shown = Shown(given, before, agreement=agreement(study, base, drove, before))
        if added:
            extended = self._add(study, naming, wave, shown)
            naming = confirmed(study, naming, before, extended.after)
            shown = extended if naming.verdict in ADDED else shown
        else:
            naming = confirmed(study, naming, before, None)
        until = max(self.deadline, monotonic() + at.LEARNING * self.asked.time_limit)
        without, told = shown.after or shown.before, (self.asked.jobs, until, self.journal.stage)
        law = law_of(self.study, naming, without, self.record, self._with_law, *told) if learns(naming) else None
        self.progress(0.92, "comparing the candidates with the held-out beats")
        return with_law(summary(self.record, self.model, self.study, naming, shown), law), shown.archive

    # --- stages -------------------------------------------------------------------------------------------------------

    def _name(self) -> Naming:
        problem, limit, begun = self.study.problem, self.asked.time_limit, monotonic()
        last = f"done by {datetime.now() + timedelta(seconds=limit):%H:%M:%S} at the latest"
        self.progress(0.2, f"naming, time limit {limit:g} s")

        def told(simulations: int) -> None:
            part = max(1.0 - 0.5 ** (simulations / 300.0), min((monotonic() - begun) / limit, 1.0))
            self.progress(0.2 + 0.5 * part, f"naming, {simulations} simulations, {last}")

        self.deadline = begun + limit
        try:
            with Workers(self.asked.jobs) as workers:
                runs = Runs(Meter(told), self.deadline, monotonic, workers)
                return self.journal.naming(problem, lambda: name(problem, self.study.terms, runs, self.asked.chosen))
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

    def _free(
        self, fmu: Path, stage: str, fit: Fit, wave: Array, starts: Mapping[str, float], study: Study | None = None
    ) -> Run:
        """The free run of a stage, without which there is no study."""
        try:
            return self._kept(fmu, stage, fit, wave, starts, study or self.study)
        except RunFailed as error:
            raise Unusable(f"{self.record.path}: the model does not run with this record: {error}") from None

    def _kept(self, fmu: Path, stage: str, fit: Fit, wave: Array, starts: Mapping[str, float], study: Study) -> Run:
        return self.journal.stage(f"run_{stage}", lambda: free_run(fmu, study, fit, wave, starts))

    def _add(self, study: Study, naming: Naming, wave: Array, shown: Shown) -> Shown:
        """With the extended network, its FMU and its free run."""
        self.progress(0.82, "rebuilding the FMU")
        best = naming.best.fit
        network = extended(self.network, best)
        fmu = self._fmu(network, "extended")
        self.progress(0.88, "running the extended FMU")
        after = self._free(fmu, "after", best, wave, {}, study)
        self.progress(0.9, "comparing the extended FMU with the solver")
        difference = failure = None
        if study.problem.part(network) is network:
            steps = max(8, int(np.ceil(study.fitted.T / Settings().dt - 1e-3)))
            settings = Settings(dt=study.fitted.T / steps)
            physical = free_run(fmu, study, _nothing(), wave, {}) if _has_sensor(best) else after
            difference = parity(network, study, wave, physical, settings)
            archive = fmu.read_bytes()
        else:
            fmu = self._built(network, "model")
            archive = fmu.read_bytes()
            try:
                difference = own_parity(fmu, network)
            except (RunFailed, NonPhysicalState, InputError) as error:
                failure = str(error)
        rounds = self._rounds(study, naming, shown.before, after)
        alike = agreement(study, best, wave, after)
        return Shown(shown.given, shown.before, after, network, archive, difference, failure, rounds, alike)

    def _with_law(self, own: Study, network: Network, fit: Fit) -> tuple[Run, bytes]:
        """The free run of a learned law's FMU, and the FMU that is delivered."""
        fmu = self._fmu(network, "learned")
        run = self._kept(fmu, "learned", fit, own.problem.wave(own.fitted, fit), {}, own)
        whole = own.problem.part(network) is network
        return run, (fmu if whole else self._built(network, "learned_model")).read_bytes()

    def _rounds(self, study: Study, naming: Naming, before: Run, after: Run) -> tuple[Round, ...]:
        """One round per effect; what the first of several leaves is that of the best hypothesis with it alone.

        That is refitted in what is left of the time limit. Where it is over, or the FMU does not run with the first
        alone, it is not told.
        """
        best = naming.best
        named = []
        for t in best.fit.terms:
            parameters = stated(self.network, naming, best, t)
            named.append(NamedEffect(t.effect, t.where, parameters, naming.confidence, entry(t.effect).equation))
        if len(named) < 2:
            return (Round(named[0], before.gap.total, after.gap.total),)
        alone = middle = None
        with suppress(OutOfTime):
            runs = Runs(deadline=self.deadline, clock=monotonic)
            (alone,) = naming.problem.refit([(best.fit.terms[0],)], naming.base.fit, runs)
        if alone is not None:
            fmu, wave = self._fmu(extended(self.network, alone), "middle"), study.problem.wave(study.fitted, best.fit)
            with suppress(RunFailed):
                middle = self._kept(fmu, "middle", alone, wave, {}, study).gap.total
        first, second = named
        last = Round(second, middle or before.gap.total, after.gap.total)
        return Round(first, before.gap.total, middle), last


def _nothing() -> Fit:
    """The hypothesis that nothing is missing and nothing moves."""
    empty = np.zeros(0)
    return Fit((), (), empty, empty, np.zeros((0, 0)), np.zeros(0, int), np.zeros(0, int))


def _has_sensor(fit: Fit, place: str | None = None) -> bool:
    """Whether a sensor is one of its terms, at a place or anywhere."""
    return any(term.is_sensor and place in (None, term.place) for term in fit.terms)


def _moved(network: Network, fit: Fit) -> dict[str, float]:
    """Start values of the parameters that a fit without terms moves."""
    return {name: float(value) for name, value in parameter_values(fit.unknowns, network, fit.x).items()}


def _write(outcome: Outcome, fmu: bytes | None, folder: Path, progress: Progress) -> None:
    """All files of a study, the verdict last; those of an earlier one that this verdict does not have are removed.

    A folder with a verdict.json always holds the files that belong to it.
    """
    from . import report  # matplotlib takes a second

    progress(0.94, "writing the report")
    files: dict[str, str | bytes] = {}
    if outcome.network_after is not None and fmu is not None:
        files = {"model.toml": dumps(outcome.network_after), "model.fmu": fmu}
    files |= learned_files(outcome.learned, outcome.map if outcome.verdict in ("unknown", "partial") else None)
    files |= report.report_files(outcome) | {"verdict.json": json_text(verdict_json(outcome))}
    write_folder(folder, files, gone={*report.figure_files(), *_FILES} - set(files))
    progress(1.0, "done")


def _holds_study(folder: Path) -> bool:
    """Whether a study is in a folder whose record could be used."""
    try:
        return bool(json.loads((folder / "verdict.json").read_text(encoding="utf-8"))["verdict"] != "unusable")
    except (OSError, ValueError, LookupError, TypeError):
        return (folder / "model.toml").exists()
