"""The loop: find where model and record disagree, name the missing effect, add it, show that the gap shrinks.

Everything is made in memory and in ``<out>/.state`` first; the folder gets its files when all of them are there.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fitting.fmu_run import RunFailed
from fitting.network_data import mean_beat
from fitting.provenance import software
from fitting.records import Record, read_record
from fitting.threads import single_threaded
from fitting.units import INFLOW
from solver import Settings
from solver.effects import BY_NAME
from solver.files import dumps, write_network
from solver.network import Network, to_dict

from . import thresholds
from .add import estimates, extended, named
from .find import Found, find, mass_balances, momentum_balances, wall_balances
from .fits import Fit
from .isolability import isolability, smallest
from .journal import Journal, decode_naming, decode_run, encode_naming, encode_run
from .name import Naming, name, quantile
from .network import NetworkProblem
from .outcome import Absorbed, Balance, Candidate, Channel, NamedEffect, Outcome, Round
from .separating import separating_measurement
from .show import Gap, Run, bench_of, drive, free_run, parity
from .source import build_fmu, read_model
from .study import Study, Unusable, prepare
from .subset import leave_one_site_out
from .terms import values
from .usable import check_beats, check_pressures, check_radii, check_record, check_stiffness, check_waves

Array = np.ndarray
Progress = Callable[[float, str], None]

_SHOWN = 12  # candidates in the report


@dataclass(frozen=True)
class Discovery:
    """The outcome, and the files that go with it: model.toml and model.fmu where an effect was added."""

    outcome: Outcome
    network: Network | None
    fmu: bytes | None


@single_threaded
def discover(
    record: str | os.PathLike[str],
    model: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    period: float | None = None,
    progress: Progress = lambda fraction, label: None,
) -> Outcome:
    """Find, name, add and show; writes verdict.json, report.html and figures into ``out``, and where an effect was
    added model.toml and model.fmu.

    record : a CSV file. model : a network file, the name of a bundled network, or an FMU. period : of the beat [s],
    found by default. progress : told the fraction done and the stage. An interrupted study goes on where it was.
    Raises ValueError for a model that cannot be read and for a folder that cannot be written. A record that cannot
    be used is a verdict.
    """
    started, folder = time.perf_counter(), Path(out)
    network = read_model(model)
    measured = _read(record)
    progress = _rising(progress)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{folder}: cannot be made ({error.strerror}); give another directory.") from None
    journal = None
    try:
        if isinstance(measured, Unusable):
            raise measured
        check_record(measured)
        journal = Journal(folder, _key(measured, network, model, period))
        found = _Work(measured, network, Path(model), journal, period, progress).run()
    except Unusable as error:
        found = Discovery(_unusable(str(error), record, model, measured), None, None)
    outcome = replace(found.outcome, seconds=time.perf_counter() - started)
    _write(replace(found, outcome=outcome), folder, progress)
    if journal is not None:
        journal.close()
    return outcome


def _key(record: Record, network: Network, model: str | os.PathLike[str], period: float | None) -> list[Any]:
    decided = {k: v for k, v in vars(thresholds).items() if k.isupper()}
    return [record.sha256, to_dict(network), os.fspath(model), period, decided, software()]


def _read(record: str | os.PathLike[str]) -> Record | Unusable:
    """The record, or why its content cannot be used. Raises ValueError if there is no such file."""
    try:
        return read_record(record)
    except ValueError as error:
        if not Path(record).is_file():
            raise
        return Unusable(str(error))


def _rising(progress: Progress) -> Progress:
    """The same progress, which never goes back."""
    reached = 0.0

    def tell(fraction: float, label: str) -> None:
        nonlocal reached
        reached = max(reached, fraction)
        progress(reached, label)

    return tell


def _unusable(
    reason: str, record: str | os.PathLike[str], model: str | os.PathLike[str], measured: Record | Unusable
) -> Outcome:
    return Outcome(
        verdict="unusable",
        sentence="This record cannot be used with this model.",
        record=os.fspath(record),
        model=os.fspath(model),
        kind="bench" if isinstance(measured, Record) and INFLOW not in measured.channels else "network",
        reason=reason,
        provenance={"software": software()},
    )


class _Work:
    """One study from its record to its outcome."""

    def __init__(
        self, record: Record, network: Network, model: Path, journal: Journal, period: float | None, progress: Progress
    ) -> None:
        self.record, self.network, self.model, self.journal = record, network, model, journal
        self.progress = progress
        progress(0.02, "cutting the beats")
        self.study = prepare(record, network, period, lambda label: progress(0.08, label))
        check_beats(self.study)
        check_radii(self.study)
        check_pressures(self.study)
        check_stiffness(self.study)
        self.place = Path(tempfile.mkdtemp(prefix="discrepancy_"))

    def run(self) -> Discovery:
        """All stages."""
        try:
            return self._run()
        finally:
            shutil.rmtree(self.place, ignore_errors=True)

    def _run(self) -> Discovery:
        study = self.study
        fmu = self._fmu(self.network, "given")
        given = None
        if study.site is None:  # a network's record may be of another one: seen before the long search
            self.progress(0.1, "running the model as given")
            given = self._free(fmu, "given", _nothing(), study.fitted.mean(INFLOW), {})
            check_waves(study, given.beats)
        naming = self._name()
        study = replace(study, problem=naming.problem)  # type: ignore[arg-type]
        added = naming.verdict in ("effect", "ambiguous", "several")
        best = naming.best.fit if added else naming.base.fit
        self.progress(0.75, "running the model with its nuisances refitted")
        wave = drive(study, best)
        base = naming.base.fit
        before = self._free(fmu, "before", base, wave, _moved(self.network, base), study)
        if given is None:
            check_waves(study, before.beats)
        network: Network | None = None
        archive: bytes | None = None
        after: Run | None = None
        difference: float | None = None
        rounds: tuple[Round, ...] = ()
        if added:
            network, archive, after, difference, rounds = self._add(study, naming, wave, before)
        outcome = self._outcome(study, naming, given, before, after, network, difference, rounds)
        return Discovery(outcome, network, archive)

    # --- stages -------------------------------------------------------------------------------------------------------

    def _name(self) -> Naming:
        self.progress(0.2, "naming")
        problem = self.study.problem
        if isinstance(problem, NetworkProblem):
            problem.simulator.tell = lambda label: self.progress(0.2 + 0.5 * _saturating(label), f"naming, {label}")
        return self.journal.stage(
            "naming",
            lambda: name(problem, self.study.terms),
            encode_naming,
            lambda data: decode_naming(data, problem),
        )

    def _fmu(self, network: Network, stage: str) -> Path:
        """The FMU to run: of the network, or of the bench of its site."""
        if self.study.site is None and stage == "given" and self.model.suffix.lower() == ".fmu":
            return self.model
        if self.study.site is not None:
            network = bench_of(network, self.study.site)
        file = self.place / f"{stage}.toml"
        write_network(network, file)
        return build_fmu(file, self.place / stage)

    def _free(
        self, fmu: Path, stage: str, fit: Fit, wave: Array, starts: Mapping[str, float], study: Study | None = None
    ) -> Run:
        try:
            return self.journal.stage(
                f"run_{stage}",
                lambda: free_run(fmu, study or self.study, fit, wave, starts),
                encode_run,
                decode_run,
            )
        except RunFailed as error:
            raise Unusable(f"{self.record.path}: the model does not run with this record: {error}") from None

    def _add(
        self, study: Study, naming: Naming, wave: Array, before: Run
    ) -> tuple[Network, bytes, Run, float | None, tuple[Round, ...]]:
        """The extended network, its FMU, its free run, the FMU's difference from the direct solver (of a network), and
        the rounds."""
        self.progress(0.82, "rebuilding the FMU")
        best = naming.best.fit
        network = extended(self.network, best)
        fmu = self._fmu(network, "extended")
        self.progress(0.88, "running the extended FMU")
        after = self._free(fmu, "after", best, wave, {}, study)
        difference = None
        if study.site is None:
            steps = max(8, int(np.ceil(study.fitted.T / Settings().dt - 1e-3)))
            settings = Settings(dt=study.fitted.T / steps)
            physical = free_run(fmu, study, _nothing(), wave, {}) if _has_sensor(best) else after
            difference = parity(network, study, wave, physical, settings)
            archive = fmu.read_bytes()
        else:
            file = self.place / "model.toml"
            write_network(network, file)
            archive = build_fmu(file, self.place / "model").read_bytes()
        return network, archive, after, difference, self._rounds(study, naming, before, after)

    def _rounds(self, study: Study, naming: Naming, before: Run, after: Run) -> tuple[Round, ...]:
        """One round per effect; what the first of several leaves is that of the best hypothesis with it alone."""
        half, best = quantile(naming.problem), naming.best
        effects = [named(best.fit, t, best.probability, half) for t in best.fit.terms]
        if len(effects) == 1:
            return (Round(effects[0], before.gap.total, after.gap.total),)
        (alone,) = naming.problem.refit([(best.fit.terms[0],)], naming.base.fit)
        if alone is None:
            return (Round(effects[0], before.gap.total, None), Round(effects[1], before.gap.total, after.gap.total))
        middle = extended(self.network, alone)
        run = self._free(self._fmu(middle, "middle"), "middle", alone, drive(study, best.fit), {}, study)
        return (
            Round(effects[0], before.gap.total, run.gap.total),
            Round(effects[1], run.gap.total, after.gap.total),
        )

    # --- what it comes to ---------------------------------------------------------------------------------------------

    def _outcome(
        self,
        study: Study,
        naming: Naming,
        given: Run | None,
        before: Run,
        after: Run | None,
        network: Network | None,
        difference: float | None,
        rounds: tuple[Round, ...],
    ) -> Outcome:
        half = quantile(naming.problem)
        located = located_in(study, before)
        seen = [t for t in naming.terms if t.label in naming.columns]
        table = isolability(naming.base.fit, naming.columns, seen)
        best = naming.best
        effects = tuple(r.added for r in rounds if r.added is not None)
        members = tuple((t.effect, t.where) for n in naming.members for t in n.fit.terms)
        least = smallest(naming.base.fit, naming.columns, seen) if naming.verdict == "none" else {}
        return Outcome(
            verdict=naming.verdict,
            sentence=sentence(naming, effects, before.gap, after.gap if after else None),
            record=self.record.path,
            model=os.fspath(self.model),
            kind=study.kind,
            effects=effects,
            members=tuple(dict.fromkeys(members)),
            reason=naming.reason,
            separating_measurement=separating_measurement(naming, study) if naming.verdict == "ambiguous" else None,
            located=located.located,
            balances=_balances(study, before),
            channels=tuple(_channel(study, n, before, after) for n in study.problem.signals),
            time=study.fitted.time,
            z_map=located.z,
            candidates=_candidates(study, naming, half),
            absorbed=_absorbed(best.fit if after else naming.base.fit),
            isolability=table,
            smallest={term.label: term.unknowns[0].estimate(x, 0.0, 1.0) for term, x in least.values()},
            sites=_left_out(naming, best.fit if after else naming.base.fit),
            rounds=rounds,
            gap_before=before.gap.total,
            gap_after=after.gap.total if after else None,
            parity=difference,
            network_before=self.network,
            network_after=network,
            warnings=study.fitted.warnings,
            provenance=self._provenance(given),
        )

    def _provenance(self, given: Run | None) -> dict[str, Any]:
        return {
            "record_sha256": self.record.sha256,
            "model": os.fspath(self.model),
            "beats": {"fitted": self.study.fitted.n_beats, "held_out": self.study.held_out.n_beats},
            "period": {"value": self.study.fitted.T, "unit": "s"},
            **({"gap_as_given": {"fit": given.gap.total[0], "held_out": given.gap.total[1]}} if given else {}),
            "thresholds": {k: v for k, v in vars(thresholds).items() if k.isupper()},
            "software": software(),
        }


def located_in(study: Study, before: Run) -> Found:
    """Where the refitted model and the record disagree, by all that is noise: sensors, drive and solver."""
    problem = study.problem
    K = len(before.X) - 1
    residual = mean_beat(study.fitted, problem.signals, K) - before.X
    if isinstance(problem, NetworkProblem):
        return find(problem.signals, residual, problem.target.covariance[: K + 1])
    covariance = study.fitted.covariance(problem.signals)[: K + 1]
    return find(problem.signals, residual, covariance)


def _balances(study: Study, before: Run) -> tuple[Balance, ...]:
    """Mass, momentum and wall law where the measured channels tell them."""
    beats, network, problem = study.fitted, study.network, study.problem
    if not isinstance(problem, NetworkProblem):
        return wall_balances(beats, network)
    K = len(before.X) - 1
    residual = mean_beat(beats, problem.names, K) - before.X
    momentum = momentum_balances(problem.names, residual, problem.target.covariance[: K + 1], network)
    return (*mass_balances(beats, network), *momentum, *wall_balances(beats, network))


def _left_out(naming: Naming, fit: Fit) -> dict[str, float]:
    return leave_one_site_out(naming.problem, fit) if isinstance(naming.problem, NetworkProblem) else {}


def sentence(naming: Naming, effects: tuple[NamedEffect, ...], before: Gap, after: Gap | None) -> str:
    """The verdict in one sentence."""
    gap = (
        f"the gap to held-out beats falls from {before.total[1]:.3g} to {after.total[1]:.3g} times the noise"
        if after
        else ""
    )
    labels = " and ".join(f"{e.name.replace('_', ' ')} at {', '.join(e.where)}" for e in effects)
    match naming.verdict:
        case "none":
            return f"The model meets the record: the gap is {before.total[1]:.3g} times the noise; nothing is missing."
        case "effect":
            if BY_NAME[effects[0].name].owner == "channel":
                return f"A sensor explains it, no artery: {labels}; with it {gap}."
            return f"The model lacks {labels}: with it {gap}."
        case "several":
            return f"The model lacks {labels}: with both {gap}."
        case "ambiguous":
            others = len(naming.members) - 1
            return (
                f"The model lacks something like {labels}: with it {gap}, but {others} other "
                f"candidate{'s' if others > 1 else ''} cannot be ruled out."
            )
    return f"Something is missing that the catalogue does not explain: {naming.reason}."


def _nothing() -> Fit:
    """The hypothesis that nothing is missing and nothing moves."""
    empty = np.zeros(0)
    return Fit((), (), empty, empty, np.zeros((0, 0)), empty, np.zeros(0, int), np.zeros(0, int))


def _has_sensor(fit: Fit) -> bool:
    return any(term.is_sensor for term in fit.terms)


def _moved(network: Network, fit: Fit) -> dict[str, float]:
    """Start values of the parameters that a fit without terms moves."""
    nominal = network.parameters()
    return {n: float(v) for n, v in values(fit.unknowns, fit.x, nominal).items() if n in nominal}


def _saturating(label: str) -> float:
    count = int("".join(c for c in label if c.isdigit()) or 0)
    return 1.0 - 0.5 ** (count / 60.0)


def _channel(study: Study, channel: str, before: Run, after: Run | None) -> Channel:
    unit = {"P": "Pa", "Q": "m^3/s", "R": "m"}[channel.rpartition(".")[2]]
    band = study.fitted.scatter(channel) / np.sqrt(study.fitted.n_beats)
    return Channel(
        channel,
        unit,
        study.fitted.mean(channel),
        band,
        before.beats[channel],
        after.beats[channel] if after else None,
        before.gap.channels[channel],
        after.gap.channels[channel] if after else None,
    )


def _absorbed(fit: Fit) -> tuple[Absorbed, ...]:
    """What the nuisances took: x times its step, as logarithm of a scale or as a shift."""
    own = {u.name for term in fit.terms for u in term.unknowns}
    sd = np.sqrt(np.diag(fit.covariance))
    return tuple(
        Absorbed(f"ln {u.name}" if u.kind == "scale" else u.name, float(x) * u.size, float(s) * u.size, u.size, u.unit)
        for u, x, s in zip(fit.unknowns, fit.x, sd, strict=True)
        if u.name not in own
    )


def _candidates(study: Study, naming: Naming, half: float) -> tuple[Candidate, ...]:
    """The best hypotheses, each with what it leaves of the held-out beats."""
    shown = naming.ranked[:_SHOWN]
    kept = study.problem.held_out(study.held_out, study.fitted)
    found = []
    for n, (chi2, size) in zip(shown, kept.predict([n.fit for n in shown]), strict=True):
        parameters = {name: e for t in n.fit.terms for name, e in estimates(n.fit, t, half).items()}
        names = " + ".join(t.effect for t in n.fit.terms)
        where = tuple(dict.fromkeys(place for t in n.fit.terms for place in t.where))
        dof = max(1, len(n.fit.z) - len(n.fit.x))
        left = float(np.sqrt(chi2 / size))
        found.append(
            Candidate(names, where, parameters, n.above_best, n.fit.chi2 / dof, left, n.separation, n in naming.members)
        )
    return tuple(found)


def _write(found: Discovery, folder: Path, progress: Progress) -> None:
    """All files of a study; those of an earlier one that this verdict does not have are removed."""
    import json

    from solver.files import write_whole

    from .outcome import verdict_json
    from .report import write_report  # matplotlib takes a second

    progress(0.94, "writing the report")
    text = json.dumps(verdict_json(found.outcome), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    for stale in ("model.toml", "model.fmu"):
        (folder / stale).unlink(missing_ok=True)
    if found.network is not None and found.fmu is not None:
        write_whole(folder / "model.toml", dumps(found.network))
        write_whole(folder / "model.fmu", found.fmu)
    write_report(found.outcome, folder)
    write_whole(folder / "verdict.json", text)
    progress(1.0, "done")
