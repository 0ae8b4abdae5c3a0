"""One record of the bank: generated, diagnosed, and compared with its truth as plain data."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, replace

import numpy as np

from discrepancy import thresholds
from discrepancy.add.learning import NOTHING
from discrepancy.find.study import Study, Unusable
from discrepancy.name.individual_walls import subject_without
from discrepancy.name.intervals import stated
from discrepancy.name.scoring import Named
from discrepancy.name.verdict import Naming
from discrepancy.options import TIME_LIMIT
from discrepancy.recordings import FreeRuns, Recordings
from discrepancy.show.fmu_validation import Run
from discrepancy.show.fmu_validation import gap as gap_of
from fitting.check.fmu_run import RunFailed
from fitting.inference.fit import Array, Fit
from fitting.inference.places import Place
from fitting.inference.runs import Runs
from fitting.inference.source_maps.source_map import SourceMap
from fitting.records.read.record import Record
from solver.simulate import BROKEN
from tests.judged import judge
from tests.truth.anatomy import anatomy
from tests.truth.bench import NoPeriodicRadius
from tests.truth.detect import detect
from tests.truth.hide import hide, parameters
from tests.truth.network import NoPeriodicFlow
from tests.truth.plan import seed_of
from tests.truth.records import Case, Made, make

from .words import NOT_JUDGED, NOT_MADE, Line

SHOWN = 6  # hypotheses of the ranking that a line keeps


def row(kind: str, seed: int, index: int, case: Case, group: str = "standard", least: float = 0.0) -> Line:
    """The line of one record. What goes wrong is said in "error", by the generator or by the workflow. least : d' that
    every effect must have for the record to be judged."""
    line: Line = {"index": index, "kind": kind, "seed": seed, "group": group, "channels": case.channels, "dB": case.dB,
                  "base": case.base, "elastic_law": case.elastic_law, "viscous_law": case.viscous_law,
                  "walls": case.walls, "sensors": case.sensors, "varying": list(case.varying),
                  "effects": [asdict(e) for e in case.effects]}  # fmt: skip
    try:
        made = make(case, seed_of(kind, seed, index))
        seen = detect(made, least)
    except (NoPeriodicFlow, NoPeriodicRadius) as error:
        return line | {"error": f"generator: {error}", "verdict": NOT_MADE}
    for effect, told, d_prime, zero in zip(
        line["effects"], made.truth["effects"], seen.d_prime, _zeros(made), strict=True
    ):
        effect |= {"parameters": told["parameters"], "zeros": zero, "d_prime": d_prime}
    line |= {"separation": finite(seen.separation), "rival": seen.rival,
             "place_separation": finite(seen.place_separation), "place_rival": seen.place_rival,
             "nuisance": made.truth["nuisance"]}  # fmt: skip
    if min(seen.d_prime, default=0.0) < least:
        return line | {"verdict": NOT_JUDGED}
    record = Record(f"record {index}", "", made.time, made.channels, {})
    start = time.process_time()
    try:
        study, naming = judge(record, made.base, runs=Runs(deadline=start + TIME_LIMIT, clock=time.process_time))
        seconds = time.process_time() - start
        line |= {"seconds": seconds} | verdict_of(study, borne_out(record, study, naming))
    except Unusable as error:
        return line | {"verdict": "unusable", "error": str(error), "seconds": time.process_time() - start}
    except Exception as error:  # the bank goes on: a crash on one record is a result, and is counted
        text = f"{type(error).__name__}: {error}"
        return line | {"verdict": "crashed", "error": text, "seconds": time.process_time() - start}
    return line


def borne_out(record: Record, study: Study, naming: Naming) -> Naming:
    """The naming as `discover` ends it: a name stands only if the gap to the held-out beats falls. The model of the
    search stands in for its FMU, from which `discover` reports a difference of 1e-3 of a pulse as an error of the
    program. A bench is left as it is."""
    if study.site is not None:
        return naming

    def run(stage: str, fit: Fit, wave: Array, starts: Mapping[str, float], study: Study) -> Run:
        X = study.problem.answer(wave, fit)
        if X is None:
            raise RunFailed(f"{stage}: no periodic beat was found.")
        return Run(X, {}, gap_of(study, X))

    try:
        given = run("given", NOTHING, study.problem.measured_wave(study.fitted), {}, study)
    except RunFailed as error:
        raise Unusable(f"{record.path}: the model does not run with this record: {error}") from None
    runs = FreeRuns(run, run, [given])
    return Recordings((record,), (study,)).judged(naming, subject_without(naming), runs)[0]


def verdict_of(study: Study, naming: Naming) -> Line:
    """The named effects, with the numbers behind them."""
    return {
        "verdict": naming.verdict,
        "reason": naming.reason,
        "held": naming.walls,
        "complete": naming.complete,
        "confidence": naming.confidence if naming.ranked else None,
        "base_score": naming.base.score,
        "base_misfit": naming.base.misfit,
        "class": [_terms(n) for n in naming.members],
        "top": [_hypothesis(study, naming, n) for n in naming.ranked[:SHOWN]],
        "gap": gap(study, naming),
        "map": None if naming.map is None else _map(naming.map),
    }


def _map(found: SourceMap) -> Line:
    """The places of the source map, and indistinguishable alternatives."""
    alike = [[_spot(p) for p in r.places] for r in found.rivals if r.above < thresholds.RULED_OUT]
    return {"places": [_spot(p) for p in found.places], "explains": found.explains, "alike": alike}


def _spot(place: Place) -> Line:
    return {"kind": place.kind, "name": place.name, "at": place.at}


def _terms(n: Named) -> list[Line]:
    return [{"name": t.effect, "where": list(t.where)} for t in n.fit.terms]


def _hypothesis(study: Study, naming: Naming, n: Named) -> Line:
    found = {name: e for term in n.fit.terms for name, e in stated(study.network, naming, n, term).items()}
    return {
        "terms": _terms(n),
        "score": n.score,
        "cost": n.fit.cost,
        "misfit": n.misfit,
        "probability": n.probability,
        "separation": n.separation,
        "converged": n.fit.converged,
        "parameters": {name: {"value": e.value, "ci95": list(e.ci95)} for name, e in found.items()},
    }


def gap(study: Study, naming: Naming) -> Line:
    """Whitened RMS of the model as given, of the one with nuisances refitted, and of the best: fitted and held-out."""
    base, best = naming.base.fit, naming.best.fit
    fits = {"given": replace(base, x=np.zeros_like(base.x)), "refitted": base, "best": best}
    fitted = {"refitted": _rms(base.chi2, len(base.z)), "best": _rms(best.chi2, len(best.z))}
    try:
        held = held_out(study, fits)
    except BROKEN as error:
        return {"fit": fitted, "held_out": {}, "error": str(error)}
    return {"fit": fitted, "held_out": held}


def held_out(study: Study, fits: dict[str, Fit]) -> dict[str, float]:
    """Whitened RMS of the held-out beats under the parameters found from the others, by the noise that those showed
    alone: what errors of the model a verdict allows for does not count as closed."""
    kept = study.problem.held_out(study.held_out, study.fitted)
    predicted = zip(fits, kept.predict(list(fits.values())), strict=True)
    return {key: _rms(chi2, n) for key, (chi2, n) in predicted if not math.isnan(chi2)}


def _rms(chi2: float, n: float) -> float:
    return math.sqrt(chi2 / n)


def _zeros(made: Made) -> list[dict[str, float]]:
    """The parameters of each effect where it is absent, by name; 0 where the catalogue has no neutral value."""
    healthy = made.nuisance.applied(anatomy(made.base))
    zeros = []
    for effect in made.case.effects:
        known = (
            parameters(hide(healthy, replace(effect, size=0.0)), replace(effect, size=0.0))
            if _neutral(effect.name)
            else {}
        )
        zeros.append({name: known.get(name, 0.0) for name in parameters_of(made, effect.name)})
    return zeros


def _neutral(name: str) -> bool:
    return name not in ("catheter_resonance", "terminal_compliance")


def parameters_of(made: Made, name: str) -> dict[str, float]:
    """The true parameters of the effect of that name."""
    return next(e["parameters"] for e in made.truth["effects"] if e["name"] == name)


def finite(x: float) -> float | None:
    """Replace infinity, which JSON does not support."""
    return x if math.isfinite(x) else None
