"""The plan of a study: its parameter sets and batches, independent of the processes that run them.

Saltelli's design: base N, two independent points A and B of a scrambled Sobol' sequence, and for each of D parameters A
with that one of B: N (D + 2) sets in N groups. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259-270.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from arterial_fmu.study.batch import WAVES, Array, measures
from fmu_src import __version__
from solver.errors import InputError

from .models import NetworkModel, StudyModel
from .varied import Varied

FORMAT = 1  # of the files of a study
_CHECKED = 16  # sets that are also run with finer steps
_CHECKED_OF = 32  # at most one set out of this number


@dataclass(frozen=True)
class Plan:
    """base : N, a power of 2. sites : those of the results."""

    model: StudyModel
    varied: tuple[Varied, ...]
    base: int
    seed: int
    sites: tuple[str, ...]

    @property
    def group(self) -> int:
        """Sets of a group, D + 2: A, D mixtures, B."""
        return len(self.varied) + 2

    @property
    def size(self) -> int:
        """The number of parameter sets."""
        return self.base * self.group

    @cached_property
    def problem(self) -> dict[str, Any]:
        """The varied parameters in SALib's format."""
        bounds = [[each.low, each.high] for each in self.varied]
        return {"num_vars": len(self.varied), "names": [each.name for each in self.varied], "bounds": bounds}

    @cached_property
    def x(self) -> Array:
        """(size, D) the varied parameters of every set."""
        from SALib.sample import sobol

        return np.asarray(sobol.sample(self.problem, self.base, calc_second_order=False, seed=self.seed))

    def parameters(self, sets: Array) -> dict[str, Array]:
        """Values (n,) [SI] by parameter, of some sets (n,)."""
        x = self.x[sets]
        return {name: v for i, each in enumerate(self.varied) for name, v in each.values(x[:, i]).items()}

    @property
    def batches(self) -> list[Array]:
        """The sets of every batch: fixed, because a member of a batch depends on the others to round-off."""
        return [np.arange(at, min(at + self.model.batch, self.size)) for at in range(0, self.size, self.model.batch)]

    @property
    def checked(self) -> Array:
        """The sets that are also run with finer steps; none for a model without finer steps."""
        if self.model.finer() is None:
            return np.arange(0)
        n = max(1, min(_CHECKED, self.size // _CHECKED_OF, self.base))
        return np.arange(n) * (self.base // n) * self.group

    @property
    def measures(self) -> dict[str, str]:
        """The numbers of every set and their SI units."""
        return measures(self.sites, self.model.channels)

    @property
    def waves(self) -> tuple[str, ...]:
        """The channels whose beats are kept."""
        return tuple(f"{s}.{kind}" for s in self.sites for kind in WAVES if f"{s}.{kind}" in self.model.channels)

    @property
    def manifest(self) -> Mapping[str, Any]:
        """All that the results depend on, as plain data."""
        return {
            "format": FORMAT,
            "version": __version__,
            "model": dict(self.model.identity),
            "varied": {v.name: {"range": v.text, "low": v.low, "high": v.high, "unit": v.unit} for v in self.varied},
            "base": self.base,
            "seed": self.seed,
            "sites": list(self.sites),
            "batch": self.model.batch,
        }


def base_of(samples: int, D: int) -> int:
    """The largest power of two N with N (D + 2) <= samples. Raises ValueError if N would be below 2."""
    least = 2 * (D + 2)
    if samples < least:
        ranges = "1 range needs" if D == 1 else f"{D} ranges need"
        raise InputError(
            f"--samples = {samples}: {ranges} {least} parameter sets at least, thousands for narrow intervals."
        )
    return 1 << ((samples // (D + 2)).bit_length() - 1)


def sites_of(model: StudyModel, text: str | None) -> tuple[str, ...]:
    """The given sites, "MD,CA", or all. Raises ValueError for an unknown site."""
    places = dict.fromkeys(name.rpartition(".")[0] for name in model.channels)
    there = tuple(place for place in places if "." not in place and place != "inlet")
    if text is None:
        return there
    asked = tuple(dict.fromkeys(part.strip() for part in text.split(",")))
    for site in asked:
        if site not in there:
            raise InputError(f"--sites {text}: {model.name} has no site {site!r}; use some of {', '.join(there)}.")
    return asked


def plan_of(model: StudyModel, varied: Sequence[Varied], samples: int, seed: int, sites: str | None) -> Plan:
    """The plan of a study. Raises ValueError for invalid options, or if SALib is missing."""
    try:
        import SALib  # noqa: F401
    except ImportError:
        raise InputError("study: SALib is not installed; run pip install 'arterial-fmu[study]'.") from None
    if not 0 <= seed < 2**32:
        raise InputError(f"--seed = {seed}: must be a whole number from 0 to {2**32 - 1}.")
    where = sites_of(model, sites)
    if isinstance(model, NetworkModel):
        model = model.at(where).resolving(varied)
    return Plan(model, tuple(varied), base_of(samples, len(varied)), seed, where)
