"""Selection of the elastic law by the evidence of a record, in numbers and in words.

Every law is fitted to the same loop. By Laplace's approximation its evidence is

    -2 ln p(loop | law) = Σ z²/c - ln det S,

with the whitened residual z of the harmonics above their noise, and the covariance S of ln E, ln R0, ln φ0, φ_NL/φ0 and
E_NL/E, whose priors are flat and the same for all laws. The true radius has Jeffreys' prior, uniform along the loop in
units of the noise of both channels, so ln det V does not enter. With a flat prior of the radius it would enter, and
with one of the pressure its negative; either would favour a law for its effect on harmonics that contain only noise.

c is 1 if a law describes the loop, otherwise the mean of z² of the best one (quasi-likelihood; R. W. M. Wedderburn,
Biometrika 61 (1974) 439). The misfit of the best law beyond noise is added to c: it is a single error, however many
harmonics it affects, and a law may have absorbed only a part of it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtri

from solver.network.description import Segment
from solver.quantities.quantity import quantities

from ..records.channels import spectral

if TYPE_CHECKING:
    from .wall_fit import WallFit

DECIDED = math.log(20.0)
"""Lead in ln evidence above which a law is called decided: odds of 20 to 1, "strong" by R. E. Kass and A. E. Raftery,
J. Am. Stat. Assoc. 90 (1995) 773. The wrong law reached it in 1 of 1600 virtual recordings (docs/fitting.md)."""

MISFIT = 1e-3  # probability of a larger χ² below which a model does not describe the loop


@dataclass(frozen=True)
class LawEvidence:
    """The evidence of a record for the elastic laws.

    of : ln evidence by name of the law, 0 for the most probable. refused : laws without a wall that fits the loop.
    """

    of: Mapping[str, float]
    refused: tuple[str, ...] = ()

    @property
    def kept(self) -> str:
        """The most probable law."""
        return max(self.of, key=lambda law: self.of[law])

    @property
    def lead(self) -> float:
        """Its lead over the next law; infinite if there is no other."""
        return -max((x for law, x in self.of.items() if law != self.kept), default=-math.inf)

    @property
    def decided(self) -> bool:
        return self.lead >= DECIDED

    @property
    def probability(self) -> dict[str, float]:
        """The probability of each law, for equal prior probabilities."""
        weights = {law: math.exp(x) for law, x in self.of.items()}
        return {law: w / sum(weights.values()) for law, w in weights.items()}

    def __str__(self) -> str:
        """The law and its lead, as a sentence without a full stop."""
        refused = f"; no wall of the {' or '.join(self.refused)} law was found" if self.refused else ""
        if len(self.of) == 1:
            return f"elastic law {self.kept}, the only one with a fit{refused}"
        if self.decided:
            lead = f"{self.lead:.3g} (a lead of {DECIDED:.2g} decides)"
            return f"elastic law {self.kept}: ln evidence leads by {lead}{refused}"
        chances = " and ".join(f"{law} {100.0 * p:.0f} %" for law, p in self.probability.items())
        return (
            f"the data cannot distinguish the elastic laws: {self.kept} leads by {self.lead:.2g} in ln evidence "
            f"(a lead of {DECIDED:.2g} decides); {chances} probable; intervals hold either law{refused}"
        )

    @property
    def plain(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {"sentence": str(self), "ln_evidence": dict(self.of), "decided": self.decided, "no_fit": self.refused}

    @staticmethod
    def together(records: Sequence[LawEvidence]) -> LawEvidence:
        """The evidence of several records for a common law, from those where every law has a fit."""
        fits = Counter(law for each in records for law in each.of)
        whole = [each for each in records if not each.refused]
        if not whole:
            kept = fits.most_common(1)[0][0]
            return LawEvidence({kept: 0.0}, tuple({law for each in records for law in each.refused} - {kept}))
        sums = {law: sum(each.of[law] for each in whole) for law in fits}
        best = max(sums.values())
        return LawEvidence({law: x - best for law, x in sums.items()})


_ABOVE_NOISE = 4.0  # standard deviations: threshold for harmonics of P and R


def weighing_model(name: str) -> str:
    """The model for the comparison of laws, with φ_NL free, because missing nonlinear viscosity resembles a nonlinear
    elastic law."""
    return "extended monotone" if name.startswith("extended") else "monotone"


def evidence(fits: Sequence[WallFit], refused: Sequence[str] = ()) -> LawEvidence:
    """The evidence from fits of one loop, one per law. refused : laws without a fit."""
    missed, dof = min(map(_missed, fits)), 2 * _harmonics(fits[0]) + 1 - len(fits[0].model.free)
    c = max(1.0, missed / dof) + max(0.0, missed - float(chdtri(dof, MISFIT)))
    ln = {f.model.elastic: -0.5 * (_missed(f) / c - _log_volume(f)) for f in fits}
    best = max(ln.values())
    return LawEvidence({law: x - best for law, x in ln.items()}, tuple(refused))


def _harmonics(fitted: WallFit) -> int:
    """K, the last harmonic with both P and R above their noise; at least enough to fit the wall."""
    loop = fitted.loop
    sizes = (np.abs(spectral.coefficients(x)) for x in (loop.P, loop.R))
    noise = (np.sqrt(loop.noise[:, i, i].real) for i in (0, 1))
    above = (np.flatnonzero(x > _ABOVE_NOISE * sd) for x, sd in zip(sizes, noise, strict=True))
    return max(len(fitted.model.free), min(int(k.max(initial=0)) for k in above))


def _missed(fitted: WallFit) -> float:
    """Σ z² up to harmonic K."""
    k, size, expected = fitted.residual_spectrum()
    z2 = np.where(k, 2.0, 1.0) * (size / expected) ** 2
    return float(z2[: _harmonics(fitted) + 1].sum())


def _log_volume(fitted: WallFit) -> float:
    """ln det S."""
    free, values = fitted.model.free, fitted.values
    scale = np.ones(len(fitted.solution.covariance))  # a lag, which is last, has one unit for all laws
    scale[: len(free)] = [values[quantities(Segment)[name].ratio_to or name] for name in free]
    return float(np.linalg.slogdet(fitted.solution.covariance / np.outer(scale, scale))[1])
