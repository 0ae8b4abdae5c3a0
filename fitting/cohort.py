"""Many animals, many sites: every recording fitted, then means, scatter and the paper's claims.

A cohort file is a CSV with a line per recording: ``animal,site,record,h [mm],R0 [mm]``. ``record`` is a file beside
it, h the measured wall thickness, R0 the measured unstressed radius (may be left empty): both are measured, R0 is
fitted all the same and compared.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import RenderableType
from scipy.stats import t as t_distribution

from solver.files import parse_quantity
from solver.network import Segment
from solver.quantity import quantities

from . import cohort_claims
from .beats import align
from .cohort_claims import Cells, Claim
from .parameter_set import ParameterSet, Value
from .provenance import software
from .records import read_record
from .regression import WallFit, fit
from .wall_model import PARAMETERS, UNITS, WallModel, model

EXTENDED = WallModel("extended monotone", "regression", "monotone", PARAMETERS)
"""The monotone model and E_NL. The quadratic ``extended`` takes the bend of a monotone viscosity for E_NL."""

MODELS = ("linear", "nonlinear", "monotone", EXTENDED.name)

QUANTITIES = {
    **UNITS,
    "R0 measured": "m",
    "phi0/E": "s",
    "phiNL/phi0": "s",
    "ENL/E": "1",
    "strain": "1",
}
"""What a table holds, with units; ``strain`` is the mean strain of the loop."""

_COLUMNS = ("animal", "site", "record", "h", "R0")


@dataclass(frozen=True)
class Entry:
    """A line of a cohort file: h and R0 [m], R0 None if it was not measured; record : path that can be opened."""

    animal: str
    site: str
    record: str
    h: float
    R0: float | None = None


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
        half = float(t_distribution.ppf(0.975, n - 1)) * sd / math.sqrt(n) if n > 1 else math.nan
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
    def virtual(self) -> bool:
        """Whether all animals are virtual, by their names."""
        return all(animal.startswith("virtual") for animal in self.animals)

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
        law = next(iter(fits.values())).model
        values = {}
        for site in self.sites:
            there = [fitted for (_, s), fitted in fits.items() if s == site]
            if there:
                values[f"{site}.h"] = _mean([fitted.h for fitted in there], "m")
                for key in PARAMETERS:
                    values[f"{site}.{key}"] = _mean([fitted.values[key] for fitted in there], UNITS[key])
        provenance = {
            "kind": "means over virtual animals (synthetic data)" if self.virtual else "means over animals",
            "model": name,
            "free": list(law.free),
            "eta": next(iter(fits.values())).eta,
            "animals": len({animal for animal, _ in fits}),
            "n": {site: sum(s == site for _, s in fits) for site in self.sites},
            "records": {r.entry.record: r.sha256 for r in self.recordings if name in r.fits},
            "failures": [f.sentence for f in self.failures if f.model in ("", name)],
            "software": software(),
        }
        laws = {"network.elastic_law": law.elastic, "network.viscous_law": law.viscous}
        return ParameterSet("means of a cohort", values, laws, provenance)

    def claims(self) -> tuple[Claim, ...]:
        """The paper's claims that the fitted models and measured radii can test."""
        main = self.main
        found = [cohort_claims.constant_relaxation_time(self.values("phi0/E"))]
        measured = self.values("R0 measured")
        ratios = {cell: R0 / measured[cell] for cell, R0 in self.values("R0").items() if cell in measured}
        if ratios:
            found.append(cohort_claims.same_radius(ratios))
        if main in ("monotone", "nonlinear"):
            found.append(cohort_claims.nonlinear_viscosity(self.values("phiNL/phi0")))
        extended = {"monotone": EXTENDED.name, "nonlinear": "extended"}.get(main, "")
        if extended in self.models and self.fits(extended):
            strain, bend = self.values("strain", extended), self.values("ENL/E", extended)
            found.append(cohort_claims.negligible_elastic_bend({cell: bend[cell] * strain[cell] for cell in bend}))
        if main != "linear" and "linear" in self.models:
            pairs = {key: (self.values(key, "linear"), self.values(key)) for key in ("E", "phi0")}
            both = {key: {c: a[c] / b[c] for c in b if c in a} for key, (a, b) in pairs.items()}
            found.append(cohort_claims.same_in_both_models(both, ("linear", main)))
        return tuple(found)

    def to_json(self) -> str:
        """All numbers as JSON text in SI; null for what one animal alone cannot tell."""
        from .cohort_report import to_json

        return to_json(self)

    def tables(self) -> list[RenderableType]:
        """What the command line prints: means by site, claims, and what could not be used."""
        from .cohort_report import tables

        return tables(self)

    def write(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write cohort.json, the mean parameter set and the figures into a folder; their paths.

        The folder is made if it is missing. Raises ValueError if it cannot be written.
        """
        from .cohort_report import write  # matplotlib takes a second

        return write(self, folder)


def read_cohort(path: str | os.PathLike[str]) -> list[Entry]:
    """The entries of a cohort file; records are looked for beside it.

    Raises ValueError, one sentence with file and line, for a missing column, cell or record, a number that is none or
    out of range, or an animal with two lines for one site.
    """
    source = os.fspath(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: not UTF-8 text (byte {error.start}); save it as CSV in UTF-8.") from None
    except OSError as error:
        raise ValueError(f"{source}: cannot be read ({error.strerror}); check the path.") from None
    rows = csv.reader(io.StringIO(text), skipinitialspace=True)
    entries: list[Entry] = []
    try:
        places, units = _header(next(rows, []))
        for row in rows:
            if any(cell.strip() for cell in row):
                where = f"line {rows.line_num}"
                entry = _entry(row, places, units, Path(path).parent, where)
                if any((e.animal, e.site) == (entry.animal, entry.site) for e in entries):
                    raise ValueError(f"{where}: {entry.animal} has a line for {entry.site} already; keep one.")
                entries.append(entry)
        if not entries:
            raise ValueError("line 2: there is no recording below the header; add a line for each.")
    except csv.Error as error:
        raise ValueError(f"{source}: line {rows.line_num}: not CSV ({error}); correct the line.") from None
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None
    return entries


def fit_cohort(
    entries: Sequence[Entry],
    models: Sequence[str] = MODELS,
    *,
    eta: float = 0.5,
    progress: Callable[[float, str], None] | None = None,
) -> Cohort:
    """Fit every recording by every model; R0 is free in all of them.

    models : names of :func:`fitting.wall_model.model`, or "extended monotone". eta : Poisson's ratio.
    progress : gets the fraction done and what comes next.
    A recording or model that cannot be used is among the failures, with its sentence. Raises ValueError for an unknown
    model, for no entries, or if no recording could be fitted.
    """
    chosen = [EXTENDED if name == EXTENDED.name else model(name) for name in dict.fromkeys(models)]
    if not chosen or not entries:
        raise ValueError("a cohort needs at least one recording and one model; give them.")
    recordings: list[Recording] = []
    failures: list[Failure] = []
    for i, entry in enumerate(entries):
        if progress:
            progress(i / len(entries), f"{entry.animal} {entry.site}")
        recording = _fit(entry, chosen, eta, failures)
        if recording is not None:
            recordings.append(recording)
    if not any(recording.fits for recording in recordings):
        raise ValueError(
            f"none of the {len(entries)} recordings of the cohort could be fitted; the first: {failures[0].sentence}"
        )
    return Cohort(tuple(each.name for each in chosen), tuple(recordings), tuple(failures))


def _fit(entry: Entry, models: list[WallModel], eta: float, failures: list[Failure]) -> Recording | None:
    """The fits of one recording; what goes wrong is added to ``failures``, None if it is the recording itself."""
    try:
        beats = align(read_record(entry.record))
        beats.site(entry.site)
    except ValueError as error:
        failures.append(Failure(entry, "", str(error)))
        return None
    fits = {}
    for each in models:
        try:
            fits[each.name] = fit(beats, entry.site, entry.h, each, eta=eta)
        except ValueError as error:
            failures.append(Failure(entry, each.name, f"{each.name} model: {error}"))
    return Recording(entry, beats.sha256, fits)


# --- reading ------------------------------------------------------------------------------------------------------


def _header(titles: Sequence[str]) -> tuple[dict[str, int], dict[str, str]]:
    """Place and unit of each column; a missing unit is SI."""
    places, units = {}, {}
    for i, title in enumerate(titles):
        match = re.fullmatch(r"([^\[\]]*?)\s*(?:\[([^\[\]]*)\])?", title.strip())
        if match and match[1] in _COLUMNS:
            if match[1] in places:
                raise ValueError(f"line 1: the column {match[1]} occurs twice; keep one.")
            places[match[1]], units[match[1]] = i, (match[2] or "").strip()
    missing = [name for name in _COLUMNS if name not in places]
    if missing:
        raise ValueError(
            f"line 1: the column {' and '.join(missing)} is missing; "
            "the header must be animal,site,record,h [mm],R0 [mm]."
        )
    return places, units


def _entry(row: list[str], places: dict[str, int], units: dict[str, str], folder: Path, where: str) -> Entry:
    cells = {name: row[i].strip() if i < len(row) else "" for name, i in places.items()}
    for name in ("animal", "site", "record", "h"):
        if not cells[name]:
            raise ValueError(f"{where}: {name} is missing; only R0 may be left empty.")
    record = folder / cells["record"]
    if not record.is_file():
        raise ValueError(f"{where}: there is no record file {record}; correct the name or remove the line.")
    lengths = {}
    for name in ("h", "R0"):
        if cells[name]:
            shown = f"{where}: {name}"
            lengths[name] = parse_quantity(f"{cells[name]} {units[name]}", "m", shown)
            quantities(Segment)[name].check(shown, lengths[name])
    return Entry(cells["animal"], cells["site"], str(record), lengths["h"], lengths.get("R0"))


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
