"""Assemble the outcome of a study from its stages, for verdict.json and the report."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from fitting.inference.fit import Fit
from fitting.inference.hierarchy import with_widths
from fitting.inference.joint.joint_record import Several
from fitting.inference.models.network import NetworkProblem
from fitting.inference.unknown import quantile
from fitting.records.read.record import Record
from fitting.records.read.sensors import UnusableRecord
from fitting.results.provenance import engine, software
from solver.network.description import Network
from solver.quantities.legible import number
from solver.quantities.units import INFLOW

from . import thresholds
from .find.disagreement import Disagreement, find, mass_balances, momentum_balances, wall_balances
from .find.study import Study, Unusable
from .findings.isolability import isolability, smallest
from .findings.map_marks import of_sensor, plain
from .findings.outcome import Absorbed, Agreement, Balance, Candidate, ChannelBeats, NamedEffect, Outcome, Walls
from .findings.recorded import Recorded, pair_json
from .findings.shown_map import SourceMapShown, gap_shares, shown_map
from .name.individual_walls import odd_ones, walls_of
from .name.intervals import stated
from .name.verdict import Naming
from .report.verdict_text import acts_as, joined, late_drive, low_passed, separating_measurement, stands_for
from .show.fmu_validation import Gap, Run, changed, left

_SHOWN = 12  # candidates listed in the report
_ONE_SITE = "Two sensor faults at one site explain the record, but such a pair can imitate many other effects:"
_BENT = (
    "The walls may have absorbed part of the missing physics, and the search did not end with a named effect: do not "
    "use them as the subject's walls."
)


@dataclass(frozen=True)
class ValidationRuns:
    """Free runs of the first recording by the FMUs: the file ``given``, with refitted nuisances (``before``), and with
    the added effects (``after``), if the runs of all recordings support them. If effects were added, also the extended
    ``network``, its FMU (``archive``), the FMU's difference from the direct solver (``parity``) or the reason why it is
    unknown (``failure``), and the effects. agreement : of the last of these FMUs with the inferred model. gaps : before
    and after, over all fitted recordings. second : the second state that would separate the class. recordings : results
    of each of several. warnings : on recordings."""

    given: Run
    before: Run
    after: Run | None = None
    network: Network | None = None
    archive: bytes | None = None
    parity: float | None = None
    failure: str | None = None
    effects: tuple[NamedEffect, ...] = ()
    agreement: Agreement | None = None
    gaps: tuple[Gap, Gap | None] | None = None
    second: str = ""
    recordings: tuple[Recorded, ...] = ()
    warnings: tuple[str, ...] = ()


def unusable(
    error: UnusableRecord,
    record: str | os.PathLike[str],
    model: str | os.PathLike[str],
    measured: Record | UnusableRecord,
) -> Outcome:
    """The outcome for an unusable record."""
    channels = measured.channels if isinstance(measured, Record) else ()
    of_one_site = bool(channels) and INFLOW not in channels and len({n.rpartition(".")[0] for n in channels}) == 1
    return Outcome(
        verdict="unusable",
        sentence=getattr(error, "sentence", Unusable.sentence),
        record=os.fspath(record),
        model=os.fspath(model),
        kind="bench" if of_one_site else "network",
        reason=str(error),
        provenance={"software": software()},
    )


def summary(model: str | os.PathLike[str], study: Study, naming: Naming, shown: ValidationRuns) -> Outcome:
    """The outcome of all stages."""
    before, after = shown.before, shown.after
    gaps = shown.gaps or (before.gap, after.gap if after else None)
    # the remaining misfit is judged by the noise alone, without the model discrepancy that weights a partial verdict
    located, balances = disagreement(study if naming.verdict == "partial" else weighted(study, naming), before)
    base, columns, terms = naming.base.fit, naming.columns, naming.terms
    final = naming.best.fit if after else base
    walls = walls_of(study.network, final, quantile(naming.problem.dof_of_noise))
    bent, none, partial = _bent(walls, naming), naming.verdict == "none", naming.verdict == "partial"
    acting = _acting(study, naming)
    late = late_drive(shown.effects, study.problem.signals) if after and study.site is None else ""
    reading = late or (low_passed(shown.effects) if after else "")
    table = isolability(base, columns, terms)
    return Outcome(
        verdict=naming.verdict,
        sentence=sentence(naming, shown.effects, *gaps, acting, reading, study.problem.kind, table.invisible),
        confidence=naming.confidence,
        complete=naming.complete,
        met=bool(naming.only_with),
        map=acting,
        walls=walls,
        record=study.fitted.source,
        model=os.fspath(model),
        kind=study.problem.kind,
        effects=shown.effects,
        members=tuple(tuple((t.effect, t.where) for t in n.fit.terms) for n in naming.members),
        reason=None if partial or none else naming.reason,
        remains=naming.reason if partial else None,
        separating_measurement=" ".join(filter(None, (separating_measurement(naming), shown.second))) or None,
        located=located.located,
        balances=balances,
        channels=tuple(_channel(study, n, before, after) for n in study.problem.signals),
        time=study.fitted.time,
        z_map=located.z,
        candidates=_candidates(study, naming),
        absorbed=_absorbed(final),
        isolability=table,
        smallest=smallest(base, columns, terms) if none else {},
        sites=naming.problem.left_out(final),
        recordings=shown.recordings,
        gap_before=gaps[0].total,
        gap_after=gaps[1].total if gaps[1] else None,
        parity=shown.parity,
        agreement=shown.agreement,
        network_before=study.network,
        network_after=shown.network,
        p_value=global_p(study, naming, located.p_value),
        warnings=(*study.warnings, *fmu_warnings(shown), *([_BENT] if bent else []), *shown.warnings),
        notes=(*([f"{naming.reason}."] if none and naming.reason else []),
               *(() if bent else odd_ones(walls, study.network))),
        provenance={
            "record_sha256": study.fitted.sha256,
            **({"columns": dict(study.fitted.told)} if study.fitted.told else {}),
            "model": os.fspath(model),
            "beats": {"fitted": study.fitted.n_beats, "held_out": study.held_out.n_beats},
            "period": {"value": study.fitted.T, "unit": "s"},
            "gap_as_given": pair_json(shown.given.gap.total),
            "thresholds": deciding_numbers(),
            "software": software(),
            "engine": engine(),
        },
    )  # fmt: skip


def _acting(study: Study, naming: Naming) -> SourceMapShown | None:
    """The source map, with each place's share of the gap if something acts; None without a map. With several
    recordings it is that of the first."""
    if naming.map is None:
        return None
    whole = study.problem if naming.map.signals else None
    shares = gap_shares(whole, naming.map) if isinstance(whole, NetworkProblem) else ()
    first = naming.problem.labels[0] if isinstance(naming.problem, Several) else ""
    return shown_map(naming.map, study.network, study.fitted, shares, first)


def _bent(walls: Walls, naming: Naming) -> bool:
    """True if walls beyond their spreads may be distorted by missing physics: the verdict is unknown or incomplete."""
    ended = naming.complete and naming.verdict != "unknown"
    return not ended and any(own.beyond for own in walls.arteries.values())


def global_p(study: Study, naming: Naming, of_map: float) -> float:
    """p-value of the global χ² before anything is added. of_map : that of the z map.

    On a bench the pressure is the drive and has no residual, so the residual of the wall law is judged, with the errors
    of both channels.
    """
    if study.site is None:
        return of_map
    base = naming.base.fit
    return float(chdtrc(max(1, len(base.z) - len(base.x)), base.chi2))


def fmu_warnings(shown: ValidationRuns) -> tuple[str, ...]:
    """Warnings about the FMUs that ran, and about the delivered one."""
    found, a = [], shown.agreement
    if a is not None and not a.difference <= thresholds.AGREE:
        found.append(
            f"error of the program: with the same parameters and inflow, the FMU has a gap to held-out beats of "
            f"{a.fmu[1]:.3g} times the noise, and the model of the search one of {a.inferred[1]:.3g}: {a.channel} "
            f"differs by {a.difference:.1g} of its pulse at harmonic {a.harmonic} (more than {thresholds.AGREE:g}); do "
            f"not rely on this study, and report this error."
        )
    if shown.failure is not None:
        found.append(f"model.fmu does not run with its network's own inflow: {shown.failure}")
    elif shown.archive is not None and shown.parity is None:
        found.append(
            "model.fmu has no inflow of its own, as of an artery on a bench, so that nothing moves in it until a host "
            "drives it; the same wall was run as an FMU under the recorded pressure. To run model.fmu by itself, give "
            "the [inlet] of the --model file a Q_max above 0 or a curve."
        )
    elif shown.parity is not None and not shown.parity <= thresholds.AGREE:
        found.append(
            f"model.fmu differs from the direct solver by {shown.parity:.1g} of a channel's pulse (more than "
            f"{thresholds.AGREE:g}): do not rely on it, and report this error."
        )
    return tuple(found)


def deciding_numbers() -> dict[str, Any]:
    """All thresholds by name."""
    return {name: value for name, value in vars(thresholds).items() if name.isupper()}


def weighted(study: Study, naming: Naming) -> Study:
    """The study of the first recording with the last weights of the naming stage."""
    return replace(study, problem=naming.problem.first)


def disagreement(study: Study, before: Run) -> tuple[Disagreement, tuple[Balance, ...]]:
    """Where the refitted model and the record disagree beyond the noise of sensors, drive and solver.

    Also the balances of mass, momentum and wall law where the measured channels determine them.
    """
    beats, network, signals = study.fitted, study.network, study.problem.signals
    K = len(before.X) - 1
    residual = study.problem.repeated(beats, beats, K) - before.X
    covariance = study.problem.covariance(beats)[: K + 1]
    momentum = momentum_balances(signals, residual, covariance, network)
    balances = (*mass_balances(beats, network), *momentum, *wall_balances(beats, network))
    return find(signals, residual, covariance), balances


def sentence(
    naming: Naming, effects: tuple[NamedEffect, ...], before: Gap, after: Gap | None,
    acting: SourceMapShown | None = None, reading: str = "", kind: str = "network", invisible: tuple[str, ...] = (),
) -> str:  # fmt: skip
    """The verdict in one sentence, and a second one if the search was incomplete or no law explains everything.

    acting : the source map, which then describes the missing physics. reading : the simplest interpretation by a
    sensor, such as a delay of the drive or a low-pass, or "". kind : of the study. An effect that leaves more than
    noise may itself stand for what the model lacks. invisible : effects that would not show in the record.
    """
    somewhere = acting is not None and acting.acting
    if naming.verdict == "none":
        verdict = "Nothing that this record would show is missing" if invisible else "Nothing is missing"
        verdict = "Nothing is missing that held-out beats show" if naming.reason else verdict
        within = (
            f" to {number(100.0 * naming.accuracy)} % of its pulsation at each harmonic, as well as a first model can"
        )
        fits = f"the model fits the record{within if naming.accuracy else ''}"
        text = f"{verdict}: {fits}, with a gap to held-out beats of {left(before)}."
        text += f" Too small to show at typical size: {', '.join(map(plain, invisible))}." if invisible else ""
    elif naming.adds and after:
        text = _added(naming, effects, f"the gap to held-out beats {changed(before, after)}", kind)
        text += f" The simplest reading: {reading}." if reading else ""
        if acting and somewhere and naming.verdict == "partial":
            text = f"{text} {acts_as(acting, 'All missing physics together')}"
    elif naming.only_with:
        text = naming.only_with
    elif acting and somewhere and naming.verdict == "unknown":
        tried = _tried(naming)
        gap = f"the gap to held-out beats is {left(before)}"
        text = f"Something is missing: {gap}. {tried[0].upper()}{tried[1:]}. {acts_as(acting)}"
    else:
        text = f"Something is missing, and {_tried(naming)}: the gap to held-out beats is {left(before)}."
    ended = "" if naming.complete else "The time limit ended the search before all candidates were compared."
    return joined(text, ended)


def _tried(naming: Naming) -> str:
    """The result of the laws that were compared."""
    if naming.complete:
        return "no law of the catalogue explains it"
    compared = any(n.fit.terms for n in naming.ranked)
    return "none of the laws compared explains it" if compared else "no law was compared with it"


def _added(naming: Naming, effects: tuple[NamedEffect, ...], gap: str, kind: str) -> str:
    """The named effects, the change of the gap with them, and the alternatives."""
    labels = " and ".join(f"{plain(e.name)} at {', '.join(e.where)}" for e in effects)
    sensors, others = all(of_sensor(e.name) for e in effects), max(len(naming.members) - 1, 0)
    each = "pair" if naming.verdict == "several" else "candidate"
    not_excluded = f"{others} other {each}{'s' if others > 1 else ''} cannot be ruled out"
    lacks, tail = "The model lacks", ""
    loosely = f"{'both' if len(effects) > 1 else 'it'} may stand for {stands_for(kind)} that the model lacks"
    match naming.verdict:
        case _ if naming.accuracy and naming.verdict != "partial" and not sensors:
            lacks, tail = "Something acts like", f", and {loosely}" + (f"; {not_excluded}" if others else "")
        case "effect" if sensors:
            return f"The sensor is at fault, not the arteries: {labels}; with it {gap}."
        case "several" if others:
            lacks, tail = "The model lacks two effects, most likely", f", but {not_excluded}"
        case "ambiguous" if naming.of_one_site:
            lacks, tail = _ONE_SITE, f"; {not_excluded}" if others else ""
        case "ambiguous":
            lacks, tail = "The model lacks something like", f", but {not_excluded}"
        case "partial":
            lacks = _ONE_SITE if naming.of_one_site else "Something acts like"
            other = "" if naming.of_one_site else f", and {loosely}"
            tail = f", but more than noise remains{other}" + (f"; {not_excluded}" if others else "")
    return f"{lacks} {labels}: with {'both' if len(effects) > 1 else 'it'} {gap}{tail}."


def _channel(study: Study, channel: str, before: Run, after: Run | None) -> ChannelBeats:
    band = study.fitted.scatter(channel) / np.sqrt(study.fitted.n_beats)
    beat, ending = (after.beats[channel], after.gap.channels[channel]) if after else (None, None)
    measured, gap = study.fitted.mean(channel), before.gap.channels[channel]
    rms = before.gap.rms.get(channel), after.gap.rms.get(channel) if after else None
    return ChannelBeats(channel, measured, band, before.beats[channel], beat, gap, ending, *rms)


def _absorbed(fit: Fit) -> tuple[Absorbed, ...]:
    """Shifts of the common nuisance parameters: x times the step, a logarithm for a scale."""
    own = {u.name for term in fit.terms for u in term.unknowns}
    sd = np.sqrt(np.diag(with_widths(fit).covariance))
    return tuple(
        Absorbed(
            f"ln {u.name}" if u.kind == "scale" else u.name,
            float(x) * u.size, float(s) * u.size, (u.prior_sd or 0.0) * u.size, u.unit,
        )
        for u, x, s in zip(fit.unknowns, fit.x, sd, strict=True)
        if u.name not in own and not u.group
    )  # fmt: skip


def _candidates(study: Study, naming: Naming) -> tuple[Candidate, ...]:
    """The best hypotheses with the gap that each leaves on the held-out beats."""
    listed = naming.ranked[:_SHOWN]
    kept = naming.problem.held_out(study.held_out, study.fitted)
    found = []
    for n, (chi2, size) in zip(listed, kept.predict([n.fit for n in listed]), strict=True):
        parameters = {name: e for t in n.fit.terms for name, e in stated(study.network, naming, n, t).items()}
        names = " + ".join(t.effect for t in n.fit.terms)
        where = tuple(dict.fromkeys(place for t in n.fit.terms for place in t.where))
        per_dof, chi = n.fit.chi2 / max(1, len(n.fit.z) - len(n.fit.x)), float(np.sqrt(chi2 / size))
        in_class = any(n is member for member in naming.members)
        walls = "individual" if n.individual else "common"
        found.append(Candidate(names, where, parameters, n.above_best, per_dof, chi, n.separation, in_class, walls))
    return tuple(found)
