"""The fitted wall of one site: values, intervals, residual, and the parameter set with the start values of an FMU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from solver.displays import Shown
from solver.laws.wall import Wall

from ..inference.models.loop import Loop
from ..inference.unknown import Array, quantile
from ..records.channels import spectral
from ..results.estimate import mixture
from ..results.parameter_set import ParameterSet, Value
from ..results.provenance import software
from . import wall_model
from .elastic_law import LawEvidence
from .errors_in_variables import Solution
from .wall_model import PARAMETERS, UNITS, WallModel, evaluate

if TYPE_CHECKING:
    from ..records.alignment.beats import Beats


@dataclass(frozen=True)
class WallFit(Shown):
    """The wall of one site.

    values : the five parameters in SI, and h and eta as given. covariance : (p, p) of ``model.free``.
    lag : delay of P relative to the wall law [s], with its standard deviation (NaN unless it was free).
    r2 : 1 - |P - F(R)|²/|P - mean P|² on the filtered radius, the paper's J. chi2, dof : of the residual, by the noise
    alone; if chi2 is larger, the covariance is scaled by chi2/dof, or contains a model error. by_lag : relative change
    of E, R0 … for a delay of P by 1 ms, if the lag was not free. ignored_noise : the values by ordinary least squares,
    which ignores the noise of R. filtered : the γ-loop. loop : the fitted mean beats, without the lag, with the model
    error. solution : details of the search, with the model error. n_beats, source, sha256,
    told : of the record. warnings : one sentence each. evidence : of the elastic laws, None if the law was given.
    others : the fits by the other laws.

    As data frame: a row for each parameter, with its 95 % interval, in SI.
    """

    site: str
    model: WallModel
    values: Mapping[str, float]
    covariance: Array
    lag: tuple[float, float]
    r2: float
    dof: int
    chi2: float
    by_lag: Mapping[str, float]
    ignored_noise: Mapping[str, float]
    filtered: spectral.Filtered
    loop: Loop
    solution: Solution
    n_beats: int
    source: str
    sha256: str
    warnings: tuple[str, ...] = ()
    told: Mapping[str, Any] = field(default_factory=dict)
    evidence: LawEvidence | None = None
    others: tuple[WallFit, ...] = ()

    @property
    def h(self) -> float:
        """Wall thickness as given [m]."""
        return self.values["h"]

    @property
    def eta(self) -> float:
        """Poisson's ratio as given."""
        return self.values["eta"]

    @property
    def model_error(self) -> float:
        """Standard deviation of the error of the law [Pa], rms over the beat; 0 if it leaves only noise."""
        return self.loop.model_error * float(np.sqrt(self.loop.N))

    @property
    def condition(self) -> float:
        """Condition number of the whitened columns, each of unit length."""
        return self.solution.condition

    def sd(self, name: str) -> float:
        """Standard deviation of a parameter; 0 for one that was given."""
        if name not in self.model.free:
            return 0.0
        i = self.model.free.index(name)
        return float(np.sqrt(self.covariance[i, i]))

    @property
    def laws(self) -> list[tuple[float, WallFit]]:
        """The fits by all laws, this one first, each with its probability."""
        if self.evidence is None:
            return [(1.0, self)]
        return [(self.evidence.probability[f.model.elastic], f) for f in (self, *self.others)]

    @property
    def alone(self) -> WallFit:
        """This fit, assuming that its law is the true one."""
        return replace(self, evidence=None, others=())

    def half(self, name: str) -> float:
        """Half the 95 % interval of a parameter if the law is the true one, by Student's t."""
        return quantile(self.dof) * self.sd(name)

    def ci95(self, name: str) -> tuple[float, float]:
        """95 % interval of a parameter: by Student's t, averaged over the laws by their probability."""
        return mixture([(p, f.values[name], f.sd(name), f.dof) for p, f in self.laws])

    @property
    def phi_1D(self) -> float:
        """φ [Pa·s] of P_v = Γ/(A0 √A) ∂A/∂t with Γ = √π φ h/(2 (1 - η²)), the usual form in 1D models: φ0 R0/R at the
        mean radius (J. Alastruey et al., J. Biomech. 44 (2011) 2250)."""
        return self.values["phi0"] * self.values["R0"] / float(self.loop.R.mean())

    @property
    def relaxation_time(self) -> tuple[float, float]:
        """φ0/E [s] and its standard deviation."""
        E, phi0 = self.values["E"], self.values["phi0"]
        i, j = self.model.free.index("E"), self.model.free.index("phi0")
        slope = np.array([-phi0 / E**2, 1.0 / E])
        return phi0 / E, float(np.sqrt(slope @ self.covariance[np.ix_([i, j], [i, j])] @ slope))

    @property
    def P_fitted(self) -> Array:
        """P of the fitted law on the most probable radius : (N,) [Pa], at the times of loop.P."""
        s = self.solution
        return evaluate(self.model, self.values, s.R, s.R_t).P

    def residual_spectrum(self) -> tuple[Array, Array, Array]:
        """Harmonic k, |residual_k| [Pa], and its expected standard deviation [Pa] : (N//2 + 1,) each."""
        size = np.abs(spectral.coefficients(self.solution.residual))
        return np.arange(len(size)), size, self.solution.expected

    def wall(self, values: Mapping[str, float] | None = None, rho: float = 1060.0) -> Wall:
        """The solver's wall of these values (default: the fitted ones)."""
        return wall_model.wall(self.model, self.values if values is None else values, rho)

    def parameter_set(self) -> ParameterSet:
        """E, R0, h and viscosities as start values of segment ``site``, with intervals and provenance."""
        fitted = {
            f"{self.site}.{name}": Value(
                self.values[name], UNITS[name], self.ci95(name) if name in self.model.free else None
            )
            for name in PARAMETERS
        }
        return ParameterSet(
            f"wall of {self.site}",
            {"network.eta": Value(self.eta, "1"), f"{self.site}.h": Value(self.h, "m"), **fitted},
            {"network.elastic_law": self.model.elastic, "network.viscous_law": self.model.viscous},
            {
                "elastic_law": self._of_laws,
                "record": self.source,
                "sha256": self.sha256,
                **({"columns": dict(self.told)} if self.told else {}),
                "model": self.model.name,
                "free": list(self.model.free),
                "beats": self.n_beats,
                **({"lag_of_P": {"value": self.lag[0], "unit": "s", "sd": self.lag[1]}} if self.lag[0] else {}),
                "phi0_in_1D_literature": {"value": self.phi_1D, "unit": "Pa.s"},
                "period": {"value": self.loop.T, "unit": "s"},
                "gamma": {"value": self.filtered.gamma, "unit": "m"},
                "kept_harmonics": list(self.filtered.kept),
                "r2": self.r2,
                "chi2_per_dof": self.chi2 / self.dof,
                **({"model_error": {"value": self.model_error, "unit": "Pa"}} if self.model_error else {}),
                "warnings": list(self.warnings),
                "software": software(),
            },
        )

    @property
    def law(self) -> str:
        """The elastic law and its lead, as a sentence without a full stop."""
        return f"elastic law {self.model.elastic}, as given" if self.evidence is None else str(self.evidence)

    @property
    def _of_laws(self) -> dict[str, Any]:
        """The law and its evidence, and the wall by the other laws, for the provenance of a set."""
        if self.evidence is None:
            return {"sentence": self.law}
        by = {f.model.elastic: {n: {"value": f.values[n], "sd": f.sd(n)} for n in f.model.free} for f in self.others}
        return {**self.evidence.plain, "by_the_others": by}

    # --- in a notebook --------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"<WallFit of {self.site}, model {self.model.name}, {self.source}>"

    def plot(self, beats: Beats | None = None) -> Any:
        """The loop, measured and fitted, and the spectrum of the residual. beats : fitted ones, each to be shown."""
        return self._figure(beats)
