"""Many animals, many sites: every recording fitted, then means, scatter and the paper's claims."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from solver.errors import InputError

from ..inference.unknown import quantile
from ..parallel.tasks import done
from ..records.alignment.align import align
from ..records.alignment.beats import Beats
from ..records.plausible import Artery, check_plausible
from ..records.read.columns import Reading
from ..records.read.record import read_record
from ..results.estimate import mixture
from ..results.parameter_set import ParameterSet, Value
from ..results.provenance import software
from ..wall.elastic_law import LawEvidence
from ..wall.indices import E_inc
from ..wall.site_fit import evidence, fit, weighing_model
from ..wall.wall_fit import WallFit
from ..wall.wall_model import PARAMETERS, UNITS, fitted_laws, model
from . import claims as cohort_claims
from .claims import Cells, Claim
from .file import Entry, read_cohort

__all__ = ["Cohort", "Entry", "fit_cohort", "read_cohort"]

MODELS = ("linear", "nonlinear", "monotone", "extended monotone")

QUANTITIES = {
    "E_inc": "Pa",
    **UNITS,
    "R0 measured": "m",
    "phi0/E": "s",
    "phiNL/phi0": "s",
    "ENL/E": "1",
    "strain": "1",
}
"""The quantities of a table, with units; E_inc at the mean pressure; ``strain`` is the mean strain of the loop."""


@dataclass(frozen=True)
class Recording:
    """An entry and its fits by model name; a model that cannot be fitted is among the failures instead.

    evidence : of the elastic laws in this recording alone, None if the law was given or no law has a fit.
    """

    entry: Entry
    sha256: str
    fits: Mapping[str, WallFit]
    evidence: LawEvidence | None = None


@dataclass(frozen=True)
class Failure:
    """An unusable recording or model, and the reason; model is empty for a whole recording."""

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
    """The fits of all recordings by one elastic law.

    models : names, in the given order. evidence : of the laws in all recordings together, None if the law was given.
    others : the same cohort by the other laws.
    """

    models: tuple[str, ...]
    recordings: tuple[Recording, ...]
    failures: tuple[Failure, ...]
    elastic: str
    evidence: LawEvidence | None = None
    others: tuple[Cohort, ...] = ()

    @property
    def law(self) -> str:
        """The elastic law and its lead, as a sentence without a full stop."""
        return f"elastic law {self.elastic}, as given" if self.evidence is None else str(self.evidence)

    @property
    def laws(self) -> list[tuple[float, Cohort]]:
        """The cohort by all laws, this one first, each with its probability."""
        if self.evidence is None:
            return [(1.0, self)]
        return [(self.evidence.probability[each.elastic], each) for each in (self, *self.others)]

    @property
    def main(self) -> str:
        """The model of the quoted results, among those that could be fitted."""
        return _main([name for name in self.models if self.fits(name)])

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
        """The label of every result: "measured", "virtual (synthetic)", or the number of virtual animals."""
        k, n = len(self.virtual), len(self.animals)
        if 0 < k < n:
            return f"mixed: {k} of {n} {self.noun}s {'is' if k == 1 else 'are'} virtual"
        return "virtual (synthetic)" if k else "measured"

    @property
    def label(self) -> str:
        """ "11 animals, measured": their number and the kind of data."""
        n = len(self.animals)
        return f"{n} {self.noun}{'' if n == 1 else 's'}, {self.data}"

    @property
    def noun(self) -> str:
        """The title of the file's first column."""
        return self.recordings[0].entry.noun

    def fits(self, model: str | None = None) -> dict[tuple[str, str], WallFit]:
        """The fits of one model by (animal, site). Raises ValueError for a model that was not fitted."""
        name = self.main if model is None else model
        if name not in self.models:
            raise InputError(f"model {name!r} was not fitted; use one of {', '.join(self.models)}.")
        return {(r.entry.animal, r.entry.site): r.fits[name] for r in self.recordings if name in r.fits}

    def values(self, quantity: str, model: str | None = None) -> Cells:
        """A quantity of ``QUANTITIES`` in SI by (animal, site), if known."""
        if quantity == "R0 measured":
            entries = (r.entry for r in self.recordings)
            return {(e.animal, e.site): e.R0 for e in entries if e.R0 is not None}
        return {cell: _quantity(fitted, quantity) for cell, fitted in self.fits(model).items()}

    def table(self, model: str | None = None) -> dict[str, dict[str, Summary]]:
        """Mean, standard deviation and n by site and quantity; no entry without a recording."""
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

        Raises ValueError for a model without a fit.
        """
        name = self.main if model is None else model
        fits = self.fits(name)
        if not fits:
            raise InputError(f"the {name} model fits no recording of the cohort; use another model.")
        first = next(iter(fits.values()))
        law = first.model
        values = {"network.eta": Value(first.eta, "1")}
        for site in self.sites:
            by_law = [(p, [f for (_, s), f in c.fits(name).items() if s == site]) for p, c in self.laws]
            if by_law[0][1]:
                weighted = [(p, there) for p, there in by_law if there]
                values[f"{site}.h"] = _mean([(p, [fitted.h for fitted in there]) for p, there in weighted], "m")
                for key in PARAMETERS:
                    numbers = [(p, [fitted.values[key] for fitted in there]) for p, there in weighted]
                    values[f"{site}.{key}"] = _mean(numbers, UNITS[key])
        provenance = {
            "kind": f"means over {self.noun}s",
            "elastic_law": {"sentence": self.law} if self.evidence is None else self.evidence.plain,
            "E_inc": {
                site: {"value": row["E_inc"].mean, "unit": "Pa"} for site, row in self.table(name).items() if row
            },
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
        if len(self.sites) > 1:  # a single site cannot be compared
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
        """The claim, with a note on excluded recordings, because these might contradict it."""
        lost = [cell for cell in self.fits() if cell not in self.fits(model)]
        if not lost:
            return claim
        cells = ", ".join(" ".join(cell) for cell in lost)
        return replace(claim, text=f"{claim.text} Without {cells}, where the {model} model could not be fitted.")


def fit_cohort(
    entries: Sequence[Entry],
    models: Sequence[str] = MODELS,
    *,
    elastic: str | None = None,
    eta: float = 0.5,
    reading: Reading | None = None,
    as_measured: bool = False,
    jobs: int | None = 1,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Cohort:
    """Fit every recording by every model; R0 is free in all of them.

    models, elastic : names of :func:`fitting.wall.wall_model.model`. eta : Poisson's ratio. Without ``elastic`` every
    law is fitted, and the evidence of all recordings together selects one for the cohort.
    reading : of every record. as_measured : accept values that no artery has. jobs, scheduler : as in
    :func:`fitting.parallel.tasks.done`. progress : called with the finished fraction and the recording.
    The failures list unusable recordings and models, with their sentences. Raises ValueError for an unknown model, for
    no entries, or if no recording could be fitted.
    """
    names, laws = tuple(dict.fromkeys(models)), fitted_laws() if elastic is None else (elastic,)
    for name in names:
        model(name, laws[0])
    if not names or not entries:
        raise InputError("a cohort needs at least one recording and one model; give them.")
    fitted = partial(_fit, models=names, laws=laws, eta=eta, reading=reading, as_measured=as_measured)
    found: list[dict[str, _Found]] = [{} for _ in entries]
    if progress:
        progress(0.0, f"{entries[0].animal} {entries[0].site}")
    for n, (i, each) in enumerate(done(fitted, entries, jobs, scheduler), 1):
        found[i] = each
        if progress:
            progress(n / len(entries), f"{entries[i].animal} {entries[i].site}")
    by_law = {}
    for law in laws:
        recordings = tuple(one for each in found if (one := each[law].recording) is not None)
        by_law[law] = Cohort(names, recordings, tuple(lost for each in found for lost in each[law].failures), law)
    first = by_law[laws[0]]
    if not any(recording.fits for cohort in by_law.values() for recording in cohort.recordings):
        raise InputError(
            f"none of the {len(entries)} recordings of the cohort could be fitted; the first: "
            f"{first.failures[0].sentence}"
        )
    evidences = [each.evidence for each in first.recordings if each.evidence is not None]
    if not evidences:
        return next(cohort for cohort in by_law.values() if any(each.fits for each in cohort.recordings))
    together = LawEvidence.together(evidences)
    others = tuple(cohort for law, cohort in by_law.items() if law in together.of and law != together.kept)
    return replace(by_law[together.kept], evidence=together, others=others)


@dataclass(frozen=True)
class _Found:
    """The fits of a recording by one law, and its failures; None if the recording itself is unusable."""

    recording: Recording | None
    failures: tuple[Failure, ...] = ()


def _fit(
    entry: Entry, models: tuple[str, ...], laws: tuple[str, ...], eta: float, reading: Reading | None, as_measured: bool
) -> dict[str, _Found]:
    """The fits of one recording by elastic law."""
    try:
        record = read_record(entry.record, reading)
        if not as_measured:
            check_plausible(record, {entry.site: Artery(entry.R0, entry.h)})
        beats = align(record)
        beats.site(entry.site)
    except InputError as error:
        return dict.fromkeys(laws, _Found(None, (Failure(entry, "", str(error)),)))
    fits: dict[str, dict[str, WallFit]] = {law: {} for law in laws}
    failures: dict[str, list[Failure]] = {law: [] for law in laws}
    for name in models:
        for law in laws:
            try:
                fits[law][name] = fit(beats, entry.site, entry.h, model(name, law), eta=eta)
            except InputError as error:
                failures[law].append(Failure(entry, name, f"{name} model: {error}"))
    evidence = _evidence(entry, models, eta, beats, fits) if len(fits) > 1 else None
    return {law: _Found(Recording(entry, beats.sha256, fits[law], evidence), tuple(failures[law])) for law in laws}


def _evidence(
    entry: Entry, models: tuple[str, ...], eta: float, beats: Beats, fits: Mapping[str, Mapping[str, WallFit]]
) -> LawEvidence | None:
    """The evidence for the laws in one recording, by the comparison model; None if no wall describes it."""
    name = weighing_model(_main(models))
    if name in models:
        weights = [each[name] for each in fits.values() if name in each]
        return evidence(weights, tuple(law for law, each in fits.items() if name not in each)) if weights else None
    try:
        return fit(beats, entry.site, entry.h, _main(models), eta=eta).evidence
    except InputError:  # it is among the failures already
        return None


def _main(models: Sequence[str]) -> str:
    """The model of the quoted results: monotone if present, else nonlinear, else the first."""
    return next((name for name in ("monotone", "nonlinear") if name in models), models[0])


# --- numbers ----------------------------------------------------------------------------------------------------


def _quantity(fitted: WallFit, name: str) -> float:
    if name == "E_inc":
        return E_inc(fitted).value
    if name == "strain":
        return float(fitted.loop.R.mean() / fitted.values["R0"]) - 1.0
    over, _, under = name.partition("/")
    return fitted.values[over] / (fitted.values[under] if under else 1.0)


def _mean(by_law: Sequence[tuple[float, Sequence[float]]], unit: str) -> Value:
    """The mean of the first law's values, with an interval averaged over the laws by their probability.

    Without interval if values do not scatter: given rather than fitted, or one animal.
    """
    weighted = [(p, Summary.of(values)) for p, values in by_law]
    first = weighted[0][1]
    parts = [(p, each.mean, each.sd / math.sqrt(each.n), each.n - 1.0) for p, each in weighted if each.n > 1]
    return Value(first.mean, unit, mixture(parts) if first.sd > 0.0 else None)
