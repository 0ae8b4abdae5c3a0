"""The evidence of a record for the elastic laws, in numbers and in words; :mod:`fitting.wall.site_fit` computes it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
