"""Many animals, many sites: every recording fitted, then means, scatter and the paper's claims."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver.errors import InputError

from ..inference.unknown import quantile
from ..parameter_set import ParameterSet, Value
from ..provenance import software
from ..records.align import align
from ..records.columns import Reading
from ..records.record import read_record
from ..tasks import done
from ..wall import fit
from ..wall_fit import WallFit
from ..wall_model import PARAMETERS, UNITS, model
from . import claims as cohort_claims
from .claims import Cells, Claim
from .file import Entry, read_cohort

__all__ = ["Cohort", "Entry", "fit_cohort", "read_cohort"]

MODELS = ("linear", "nonlinear", "monotone", "extended monotone")

QUANTITIES = {
    **UNITS,
    "R0 measured": "m",
    "phi0/E": "s",
    "phiNL/phi0": "s",
    "ENL/E": "1",
    "strain": "1",
}
"""What a table holds, with units; ``strain`` is the mean strain of the loop."""


@dataclass(frozen=True)
class Recording:
    """An entry and its fits by model name; a model that does not fit is missing here and among the failures."""

    entry: Entry
    sha256: str
    fits: Mapping[str, WallFit]


@dataclass(frozen=True)
class Failure:
    """What could not be used, and why; model is empty if it is the whole recording."""

    entry: Entry
    model: str
    sentence: str


@dataclass(frozen=True)
class Summary:
    """Mean over n animals, standard deviation between them, and 95 % interval of the mean (NaN for one animal)."""

    mean: float
    sd: float
    n: int
    ci95: tuple[float, float]

    @staticmethod
    def of(values: Sequence[float]) -> Summary:
        n, mean = len(values), float(np.mean(values))
        sd = float(np.std(values, ddof=1)) if n > 1 else math.nan
        half = quantile(n - 1) * sd / math.sqrt(n) if n > 1 else math.nan
        return Summary(mean, sd, n, (mean - half, mean + half))


@dataclass(frozen=True)
class Cohort:
    """The fits of all recordings. models : names, in the order asked for."""

    models: tuple[str, ...]
    recordings: tuple[Recording, ...]
    failures: tuple[Failure, ...]

    @property
    def main(self) -> str:
        """The model that results are quoted from: monotone if it could be fitted, else nonlinear, else the first."""
        fitted = [name for name in self.models if self.fits(name)]
        return next((name for name in ("monotone", "nonlinear") if name in fitted), fitted[0])

    @property
    def sites(self) -> tuple[str, ...]:
        """In the order of the cohort file."""
        return tuple(dict.fromkeys(each.entry.site for each in self.recordings))

    @property
    def animals(self) -> tuple[str, ...]:
        """In the order of the cohort file."""
        return tuple(dict.fromkeys(each.entry.animal for each in self.recordings))

    @property
    def virtual(self) -> tuple[str, ...]:
        """The animals that are virtual: their name, or that of one of their record files, begins with "virtual"."""
        entries = [r.entry for r in self.recordings]
        marked = {e.animal for e in entries for name in (e.animal, Path(e.record).name) if name.startswith("virtual")}
        return tuple(animal for animal in self.animals if animal in marked)

    @property
    def data(self) -> str:
        """What every result is labelled with: "measured", "virtual (synthetic)", or how many animals are virtual."""
        k, n = len(self.virtual), len(self.animals)
        if 0 < k < n:
            return f"mixed: {k} of {n} {self.noun}s {'is' if k == 1 else 'are'} virtual"
        return "virtual (synthetic)" if k else "measured"

    @property
    def label(self) -> str:
        """ "11 animals, measured": how many, and what their data are."""
        n = len(self.animals)
        return f"{n} {self.noun}{'' if n == 1 else 's'}, {self.data}"

    @property
    def noun(self) -> str:
        """What the file calls those whom it records."""
        return self.recordings[0].entry.noun

    def fits(self, model: str | None = None) -> dict[tuple[str, str], WallFit]:
        """The fits of one model by (animal, site). Raises ValueError for a model that was not fitted."""
        name = self.main if model is None else model
        if name not in self.models:
            raise ValueError(f"model {name!r} was not fitted; use one of {', '.join(self.models)}.")
        return {(r.entry.animal, r.entry.site): r.fits[name] for r in self.recordings if name in r.fits}

    def values(self, quantity: str, model: str | None = None) -> Cells:
        """A quantity of ``QUANTITIES`` in SI by (animal, site), where it is known."""
        if quantity == "R0 measured":
            entries = (r.entry for r in self.recordings)
            return {(e.animal, e.site): e.R0 for e in entries if e.R0 is not None}
        return {cell: _quantity(fitted, quantity) for cell, fitted in self.fits(model).items()}

    def table(self, model: str | None = None) -> dict[str, dict[str, Summary]]:
        """Mean, standard deviation and n by site and quantity; no entry where no recording gives it."""
        result: dict[str, dict[str, Summary]] = {site: {} for site in self.sites}
        for quantity in QUANTITIES:
            cells = self.values(quantity, model)
            for site in self.sites:
                values = [value for (_, s), value in cells.items() if s == site]
                if values:
                    result[site][quantity] = Summary.of(values)
        return result

    def mean_set(self, model: str | None = None) -> ParameterSet:
        """The means over animals as start values, with the 95 % intervals of these means, and the mean h.

        Raises ValueError for a model that fits nothing.
        """
        name = self.main if model is None else model
        fits = self.fits(name)
        if not fits:
            raise ValueError(f"the {name} model fits no recording of the cohort; use another model.")
        first = next(iter(fits.values()))
        law = first.model
        values = {"network.eta": Value(first.eta, "1")}
        for site in self.sites:
            there = [fitted for (_, s), fitted in fits.items() if s == site]
            if there:
                values[f"{site}.h"] = _mean([fitted.h for fitted in there], "m")
                for key in PARAMETERS:
                    values[f"{site}.{key}"] = _mean([fitted.values[key] for fitted in there], UNITS[key])
        provenance = {
            "kind": f"means over {self.noun}s",
            "data": self.data,
            "model": name,
            "free": list(law.free),
            "animals": len({animal for animal, _ in fits}),
            "n": {site: sum(s == site for _, s in fits) for site in self.sites},
            "records": {r.entry.record: r.sha256 for r in self.recordings if name in r.fits},
            **({"columns": dict(first.told)} if first.told else {}),
            "failures": [f.sentence for f in self.failures if f.model in ("", name)],
            "software": software(),
        }
        laws = {"network.elastic_law": law.elastic, "network.viscous_law": law.viscous}
        return ParameterSet("means of a cohort", values, laws, provenance)

    def claims(self) -> tuple[Claim, ...]:
        """The paper's claims that the fitted models and measured radii can test."""
        main, found = self.main, []
        if len(self.sites) > 1:  # at one alone there is nothing to be the same as
            found.append(cohort_claims.constant_relaxation_time(self.values("phi0/E")))
        measured = self.values("R0 measured")
        ratios = {cell: R0 / measured[cell] for cell, R0 in self.values("R0").items() if cell in measured}
        if ratios:
            found.append(cohort_claims.same_radius(ratios))
        if main in ("monotone", "nonlinear"):
            found.append(cohort_claims.nonlinear_viscosity(self.values("phiNL/phi0")))
        extended = {"monotone": "extended monotone", "nonlinear": "extended"}.get(main, "")
        if extended in self.models and self.fits(extended):
            strain, bend = self.values("strain", extended), self.values("ENL/E", extended)
            claim = cohort_claims.negligible_elastic_bend({cell: bend[cell] * strain[cell] for cell in bend})
            found.append(self._without_lost(claim, extended))
        if main != "linear" and "linear" in self.models and self.fits("linear"):
            pairs = {key: (self.values(key, "linear"), self.values(key)) for key in ("E", "phi0")}
            both = {key: {c: a[c] / b[c] for c in b if c in a} for key, (a, b) in pairs.items()}
            found.append(self._without_lost(cohort_claims.same_in_both_models(both, ("linear", main)), "linear"))
        return tuple(replace(claim, text=claim.text.replace("subject", self.noun)) for claim in found)

    def _without_lost(self, claim: Claim, model: str) -> Claim:
        """The claim, that says so if recordings are left out of it: they may be the very ones that speak against it."""
        lost = [cell for cell in self.fits() if cell not in self.fits(model)]
        if not lost:
            return claim
        cells = ", ".join(" ".join(cell) for cell in lost)
        return replace(claim, text=f"{claim.text} Without {cells}, where the {model} model could not be fitted.")


def fit_cohort(
    entries: Sequence[Entry],
    models: Sequence[str] = MODELS,
    *,
    elastic: str = "regression",
    eta: float = 0.5,
    reading: Reading | None = None,
    jobs: int | None = 1,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Cohort:
    """Fit every recording by every model; R0 is free in all of them.

    models, elastic : names of :func:`fitting.wall_model.model`. eta : Poisson's ratio.
    reading : of every record. jobs, scheduler : who fits (:func:`fitting.tasks.done`). progress : gets the fraction
    done and the recording.
    A recording or model that cannot be used is among the failures, with its sentence. Raises ValueError for an unknown
    model, for no entries, or if no recording could be fitted.
    """
    names = tuple(dict.fromkeys(models))
    for name in names:
        model(name, elastic)
    if not names or not entries:
        raise ValueError("a cohort needs at least one recording and one model; give them.")
    tasks = [_Task(entry, names, elastic, eta, reading) for entry in entries]
    found: list[_Found | None] = [None] * len(tasks)
    if progress:
        progress(0.0, f"{entries[0].animal} {entries[0].site}")
    for n, (i, each) in enumerate(done(_fit, tasks, jobs, scheduler), 1):
        found[i] = each
        if progress:
            progress(n / len(entries), f"{entries[i].animal} {entries[i].site}")
    fitted = [each for each in found if each is not None]
    recordings = tuple(each.recording for each in fitted if each.recording is not None)
    failures = tuple(failure for each in fitted for failure in each.failures)
    if not any(recording.fits for recording in recordings):
        raise ValueError(
            f"none of the {len(entries)} recordings of the cohort could be fitted; the first: {failures[0].sentence}"
        )
    return Cohort(names, recordings, failures)


@dataclass(frozen=True)
class _Task:
    """A recording, the models by which it is fitted, and how."""

    entry: Entry
    models: tuple[str, ...]
    elastic: str
    eta: float
    reading: Reading | None


@dataclass(frozen=True)
class _Found:
    """The fits of a recording, and what went wrong; None if it is the recording itself."""

    recording: Recording | None
    failures: tuple[Failure, ...] = ()


def _fit(task: _Task) -> _Found:
    """The fits of one recording."""
    entry = task.entry
    try:
        beats = align(read_record(entry.record, task.reading))
        beats.site(entry.site)
    except InputError as error:
        return _Found(None, (Failure(entry, "", str(error)),))
    fits, failures = {}, []
    for name in task.models:
        try:
            fits[name] = fit(beats, entry.site, entry.h, model(name, task.elastic), eta=task.eta)
        except InputError as error:
            failures.append(Failure(entry, name, f"{name} model: {error}"))
    return _Found(Recording(entry, beats.sha256, fits), tuple(failures))


# --- numbers ----------------------------------------------------------------------------------------------------


def _quantity(fitted: WallFit, name: str) -> float:
    if name == "strain":
        return float(fitted.loop.R.mean() / fitted.values["R0"]) - 1.0
    over, _, under = name.partition("/")
    return fitted.values[over] / (fitted.values[under] if under else 1.0)


def _mean(values: Sequence[float], unit: str) -> Value:
    """Their mean; without interval where they do not scatter: given rather than fitted, or one animal."""
    summary = Summary.of(values)
    return Value(summary.mean, unit, summary.ci95 if summary.sd > 0.0 else None)
