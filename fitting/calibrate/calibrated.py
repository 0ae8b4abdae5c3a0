"""The result of a calibration: common values, and the values of each recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from solver.quantities.legible import endless
from solver.quantities.units import SIGNAL_UNITS

from ..inference.unknown import Array, Unknown, quantile
from ..records.channels.noise import degrees_of_freedom
from ..results.parameter_set import ParameterSet, Value, unit_of
from ..results.provenance import engine, software

Interval = tuple[float, float]

ALL_PRIOR = 0.95  # posterior over prior standard deviation: above it, the data add no information


@dataclass(frozen=True)
class Recording:
    """One recording in a calibration.

    label : its name. which : numbers of the unknowns that affect it; names : their names without its label.
    values, ci95 : SI, of the varying unknowns, by FMU variable name. chi2, dof : of its data. channels : whitened RMS
    per channel (1 = noise); rms : the same over the beat [SI]. means : mean residual [SI] of channels in which it is
    more than a model error of means may be, the largest part of a pulsation first. harmonics : K. beats : their number.
    """

    label: str
    source: str
    sha256: str
    beats: int
    which: tuple[int, ...]
    names: tuple[str, ...]
    values: Mapping[str, float]
    ci95: Mapping[str, Interval]
    chi2: float
    dof: float
    channels: Mapping[str, float]
    rms: Mapping[str, float]
    means: Mapping[str, float]
    harmonics: int
    told: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Calibration:
    """The result. Covariances are of x (:class:`~fitting.inference.unknown.Unknown`), data and prior together.

    values, ci95 : SI, by FMU variable name, common to the recordings. shrinkage : posterior over prior standard
    deviation, None without a prior. chi2, dof : of the data, by their noise alone. model_errors : of means and of
    harmonics, relative to each channel's pulsation (rms; :mod:`fitting.inference.joint.model_error`), 0 if the model
    explains the record; the covariance includes them. singular_values : of the whitened Jacobian in prior units,
    largest first, 0 below its own error. report : undetermined parameters, active bounds, misfit, one sentence each.
    history : cost after each iteration of both searches. simulations : number of simulated parameter sets. others : the
    network's fixed parameters [SI]. zeros : values and intervals [SI] of sensors' zeros, which are no parameters of an
    FMU ("C.P.zero"). Intervals are Student's t with 4 (beats - 1) degrees of freedom per recording, from
    the estimate of the noise.
    """

    network: str
    recordings: tuple[Recording, ...]
    unknowns: tuple[Unknown, ...]
    x: Array
    covariance: Array
    values: Mapping[str, float]
    ci95: Mapping[str, Interval]
    shrinkage: tuple[float | None, ...]
    chi2: float
    dof: float
    singular_values: Array
    at_bound: tuple[str, ...]
    report: tuple[str, ...]
    history: tuple[tuple[float, ...], tuple[float, ...]]
    converged: bool
    simulations: int
    seconds: float
    others: Mapping[str, float]
    laws: Mapping[str, str]
    model_errors: tuple[float, float] = (0.0, 0.0)
    zeros: Mapping[str, tuple[float, Interval]] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """The minimised cost: -2 ln of likelihood and priors, up to a constant; χ² without a model error."""
        return self.history[1][-1]

    @property
    def sd(self) -> Array:
        """(p,) standard deviation of x."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def quantile(self) -> float:
        """Half a 95 % interval in standard deviations."""
        return quantile(noise_known([each.beats for each in self.recordings]))

    @property
    def channels(self) -> dict[str, float]:
        """Whitened RMS per channel (1 = noise), over all recordings that have it."""
        return _over_all([each.channels for each in self.recordings])

    @property
    def rms(self) -> dict[str, float]:
        """RMS residual over the beat [SI] per channel, over all recordings that have it."""
        return _over_all([each.rms for each in self.recordings])

    @property
    def undetermined(self) -> frozenset[str]:
        """Values that the data do not determine: their intervals are those of their priors, or unbounded."""
        weak = {name for u, part in zip(self.unknowns, self.shrinkage, strict=True)
                if part is not None and part > ALL_PRIOR for name, _ in u.moves}  # fmt: skip
        return frozenset(name for name, value in self.values.items() if name in weak or endless(value, self.ci95[name]))

    @property
    def harmonics(self) -> int:
        """The largest K of all recordings."""
        return max(each.harmonics for each in self.recordings)

    def of(self, i: int) -> Calibration:
        """The calibration of one recording: the common values and its own. History, report and singular values are
        those of all recordings."""
        recording = self.recordings[i]
        at = list(recording.which)
        unknowns = tuple(replace(self.unknowns[j], name=name) for j, name in zip(at, recording.names, strict=True))
        return replace(
            self, recordings=(replace(recording, which=tuple(range(len(at))), values={}, ci95={}),), unknowns=unknowns,
            x=self.x[at], covariance=self.covariance[np.ix_(at, at)], values={**self.values, **recording.values},
            ci95={**self.ci95, **recording.ci95}, shrinkage=tuple(self.shrinkage[j] for j in at),
            chi2=recording.chi2, dof=recording.dof,
        )  # fmt: skip

    def parameter_set(self, name: str | None = None, complete: bool = False) -> ParameterSet:
        """The fitted values with their intervals: start values of the network's FMU. Values that vary between
        recordings are in the sets of each, ``of(i).parameter_set()``.

        complete : include all other parameters of the network, for an FMU built with other values.
        """
        values = {each: Value(value, unit_of(each), self.ci95[each]) for each, value in self.values.items()}
        if complete:
            values |= {each: Value(x, unit_of(each)) for each, x in self.others.items()}
        of_all = set.intersection(*(set(each.which) for each in self.recordings))
        common = [i for i, u in enumerate(self.unknowns) if set(u.variables) <= set(self.values) and i in of_all]
        first, *more = self.recordings
        provenance = {
            "method": "network calibration",
            "network": self.network,
            "record": " + ".join(each.source for each in self.recordings),
            "sha256": " + ".join(each.sha256 for each in self.recordings),
            **({"columns": dict(first.told)} if first.told else {}),
            "beats": sum(each.beats for each in self.recordings),
            "unknowns": {u.name: {"x": float(x), "sd": float(s), "prior_sd": u.prior_sd, "unit": u.unit, "kind": u.kind,
                                  "moves": dict(u.moves)}
                         for u, x, s in ((self.unknowns[i], self.x[i], self.sd[i]) for i in common)},
            "covariance": self.covariance[np.ix_(common, common)].tolist(),
            "chi2_over_dof": self.chi2 / self.dof,
            "model_errors": dict(zip(("means", "harmonics"), self.model_errors, strict=True)),
            "channels": self.channels,
            "rms": {name: {"value": rms, "unit": SIGNAL_UNITS[name[-1]]} for name, rms in self.rms.items()},
            **({"zeros": {n: {"value": v, "ci95": list(ends), "unit": SIGNAL_UNITS[n.rpartition(".")[0][-1]]}
                          for n, (v, ends) in self.zeros.items()}} if self.zeros else {}),
            "undetermined": sorted(self.undetermined),
            **({"recordings": {each.label: _plain(each) for each in self.recordings}} if more else {}),
            "report": list(self.report),
            "software": software(),
            "engine": engine(),
        }  # fmt: skip
        return ParameterSet(name or f"{self.network} calibrated", values, self.laws, provenance)


def _over_all(rms: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The root mean square of each channel over the recordings that have it."""
    squares: dict[str, list[float]] = {}
    for each in rms:
        for name, value in each.items():
            squares.setdefault(name, []).append(value**2)
    return {name: float(np.sqrt(np.mean(found))) for name, found in squares.items()}


def noise_known(beats: Sequence[int]) -> float:
    """Degrees of freedom of the noise estimate from recordings with these numbers of beats."""
    return sum(degrees_of_freedom(n, at_ends=True) for n in beats)


def _plain(each: Recording) -> dict[str, Any]:
    """One recording, for the provenance of a parameter set; SI."""
    fit: dict[str, Any] = {
        "chi2_over_dof": each.chi2 / each.dof,
        "rms": dict(each.rms),
        "channels": dict(each.channels),
    }
    fit |= {"columns": dict(each.told)} if each.told else {}
    own = {name: {"value": value, "ci95": list(each.ci95[name])} for name, value in each.values.items()}
    return {"record": each.source, "sha256": each.sha256, "beats": each.beats, **fit, "values": own}
