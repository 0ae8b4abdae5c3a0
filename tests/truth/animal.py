"""What every record's animal has of its own: common scales of its walls and loads, and where asked each wall by itself.

Common to all walls are a scale of E and one of phi0, and on the bench one of R0; common to all ends is a shift of R_t.
Individual walls deviate from these besides: every vessel's E, phi0 and R0 by a factor exp(x), every end's R_t by a
shift, each by itself. A case's ``walls`` multiplies the standard deviations of ``INDIVIDUAL``; 0 is no such spread.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from .anatomy import Anatomy, End, Vessel

SPREAD = {"E": 0.2, "phi0": 0.2, "R_t": 0.1, "R0": 0.01}  # standard deviations of what is common
INDIVIDUAL = {"E": 0.08, "phi0": 0.2, "R0": 0.02, "R_t": 0.02}  # of what each wall and end has by itself

_FURTHEST = 3.0  # standard deviations


@dataclass(frozen=True)
class Nuisance:
    """Scales of E, phi0 and R0, a shift of R_t; ``own``: the same of one vessel or end, by "CA.E" or "CA.R_t"."""

    E: float = 1.0
    phi0: float = 1.0
    R_t: float = 0.0
    R0: float = 1.0
    own: Mapping[str, float] = field(default_factory=dict)

    def applied(self, model: Anatomy) -> Anatomy:
        """The model of this animal, before anything is hidden in it."""
        vessels = tuple(self._vessel(v) for v in model.vessels)
        return replace(model, vessels=vessels, ends=tuple(self._end(e) for e in model.ends))

    def _vessel(self, v: Vessel) -> Vessel:
        E, phi0, R0 = (self.own.get(f"{v.name}.{key}", 1.0) for key in ("E", "phi0", "R0"))
        return replace(v, E=v.E * self.E * E, phi0=v.phi0 * self.phi0 * phi0, R0=v.R0 * self.R0 * R0)

    def _end(self, e: End) -> End:
        shift = self.R_t + self.own.get(f"{e.vessel}.R_t", 0.0)
        return replace(e, R_t=float(np.clip(e.R_t + shift, -0.9, 0.95)))

    def moved(self, change: Mapping[str, float]) -> Nuisance:
        """The animal with its numbers changed: logarithms of scales, shifts of R_t; names as in ``priors``."""
        common = {name: x for name, x in change.items() if "." not in name}
        own = {name: x for name, x in change.items() if "." in name}
        return replace(
            self,
            **{name: _changed(getattr(self, name), name, x) for name, x in common.items()},
            own={**self.own, **{name: _changed(self.own.get(name, _none(name)), name, x) for name, x in own.items()}},
        )


def _none(name: str) -> float:
    return 0.0 if name.endswith("R_t") else 1.0


def _changed(value: float, name: str, x: float) -> float:
    return value + x if name.endswith("R_t") else value * np.exp(x)


def priors(kind: str, model: Anatomy, walls: float) -> dict[str, float]:
    """Standard deviations of everything that an animal may have of its own, by name; of scales, of their logarithms.

    On the bench there is one wall, whose own scale and the common one are the same number.
    """
    if kind == "bench":
        return {name: float(np.hypot(SPREAD[name], walls * INDIVIDUAL[name])) for name in ("E", "phi0", "R0")}
    common = {name: SPREAD[name] for name in ("E", "phi0", "R_t")}
    return common | (individual(model, walls) if walls else {})


def individual(model: Anatomy, walls: float) -> dict[str, float]:
    """Standard deviations of what each vessel and end has by itself, by name."""
    names = [f"{v.name}.{key}" for v in model.vessels for key in ("E", "phi0", "R0") if key != "phi0" or v.phi0 > 0.0]
    names += [f"{e.vessel}.R_t" for e in model.ends if e.kind == "reflection"]
    return {name: walls * INDIVIDUAL[name.rpartition(".")[2]] for name in names}


def nuisance(rng: np.random.Generator, kind: str) -> Nuisance:
    """What is common to an animal's walls and ends."""
    z = np.clip(rng.standard_normal(4), -_FURTHEST, _FURTHEST)
    E, phi0 = np.exp(SPREAD["E"] * z[0]), np.exp(SPREAD["phi0"] * z[1])
    if kind == "bench":
        return Nuisance(float(E), float(phi0), R0=float(np.exp(SPREAD["R0"] * z[3])))
    return Nuisance(float(E), float(phi0), R_t=float(SPREAD["R_t"] * z[2]))


def walls_of_its_own(rng: np.random.Generator, animal: Nuisance, model: Anatomy, walls: float) -> Nuisance:
    """The animal with every wall and end off by itself."""
    spread = individual(model, walls)
    z = np.clip(rng.standard_normal(len(spread)), -_FURTHEST, _FURTHEST)
    return animal.moved({name: float(sd * x) for (name, sd), x in zip(spread.items(), z, strict=True)})
