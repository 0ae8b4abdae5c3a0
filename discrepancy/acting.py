"""What acts in a network that the model lacks, as verdict.json and the report tell it: plain frozen data.

Found before any effect of the catalogue is asked for (:mod:`fitting.inference.source_map`): at some places an unknown
periodic term g(t) is added to the equations, or one of the subject's own numbers stands out from its kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.effect import ALL_PLACES

Array = np.ndarray


@dataclass(frozen=True)
class Spot:
    """A place of the map.

    kind : "wall", "drop", "outflow", "junction", "outlet", "channel" or "number". place : the segment, junction,
    outlet, channel or variable, or "all". label : in a sentence. at : x/L of a stretch of a segment, or None.
    """

    kind: str
    place: str
    label: str
    at: float | None = None

    @property
    def everywhere(self) -> bool:
        """Whether it is all places of a kind."""
        return self.place == ALL_PLACES


@dataclass(frozen=True)
class MapRival:
    """Places that do nearly the same in place of one; none where the record is nearly as probable without it.

    above : by how much -2 ln of the evidence is more.
    """

    spots: tuple[Spot, ...]
    above: float

    @property
    def labels(self) -> tuple[str, ...]:
        """The places in words."""
        return tuple(spot.label for spot in self.spots)


@dataclass(frozen=True)
class OddNumber:
    """A number that stands out: the file's and this subject's [unit].

    beyond : what it differs by from what all of its kind have in common, a factor, or a shift [unit] if not ``factor``.
    display : the unit that people read it in, or None for the usual one.
    """

    file: float
    value: float
    beyond: float
    factor: bool
    display: str | None = None


@dataclass(frozen=True)
class Acting:
    """What acts at one place.

    unit : SI. mean, band : (N,) g at the times of the map and its standard deviation, of the source with the largest
    RMS where the place has several; ``sources`` says how many, ``part`` which of them. Of a number that stands out
    both are empty, and ``number`` is given. pulse : peak to peak of what was measured there, of ``channel``; or None.
    rivals : what this record cannot tell it from.
    """

    spot: Spot
    unit: str
    mean: Array
    band: Array
    sources: int = 1
    part: str = ""
    channel: str = ""
    pulse: float | None = None
    number: OddNumber | None = None
    rivals: tuple[MapRival, ...] = ()

    @property
    def rms(self) -> float:
        """Of g over a beat [unit], its mean included."""
        return float(np.sqrt(np.mean(self.mean**2)))

    @property
    def steady(self) -> bool:
        """Whether it hardly changes within a beat."""
        return float(np.ptp(self.mean)) < 0.2 * self.rms


@dataclass(frozen=True)
class SourceMapShown:
    """Everything that acts.

    time : (N,) [s] of one beat of the period T [s]. explains : whether no more than noise is left with it.
    chi2_per_datum : what is left; 1 is noise.
    """

    acting: tuple[Acting, ...]
    time: Array
    T: float
    explains: bool
    chi2_per_datum: float

    @property
    def left(self) -> dict[str, Any]:
        """What is left, as verdict.json has it."""
        return {"chi2_per_datum": self.chi2_per_datum, "explains": self.explains}

    @property
    def signals(self) -> tuple[Acting, ...]:
        """Those that act in time: not numbers that stand out."""
        return tuple(a for a in self.acting if a.number is None)


def map_json(shown: SourceMapShown) -> list[dict[str, Any]]:
    """The plain content of verdict.json for each place."""
    return [_place(a) for a in shown.acting]


def _place(a: Acting) -> dict[str, Any]:
    rivals = [{"labels": list(rival.labels), "above": rival.above} for rival in a.rivals]
    where = {"kind": a.spot.kind, "where": a.spot.place, "x": a.spot.at, "label": a.spot.label, "unit": a.unit}
    if a.number is None:
        return {**where, "rms": a.rms, "rivals": rivals}
    return {**where, "rms": None, "value": a.number.value, "file": a.number.file, "rivals": rivals}
