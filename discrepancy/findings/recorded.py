"""The results for each of several recordings of one subject: plain frozen data, JSON and text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fitting.records.recordings import sizes
from fitting.results.parameter_set import quantity_of, unit_of
from solver.quantities.legible import DASH, number, shown_in
from solver.quantities.units import SIGNAL_UNITS

Pair = tuple[float, float]


def pair_json(gap: Pair | None) -> dict[str, float] | None:
    """A gap on (fitted, held-out) beats in the form of verdict.json."""
    return None if gap is None else {"fit": gap[0], "held_out": gap[1]}


@dataclass(frozen=True)
class Recorded:
    """One recording. fitted : False if it was held out whole and only its own parameters were refitted.

    period : of the beat [s]. gap_before, gap_after : whitened RMS on (fitted, held-out) beats. rms_before, rms_after :
    on the held-out beats by channel [SI]. d : d' of the added effects in the fitted beats. fallen, sd : decrease of χ²
    of the held-out beats by these effects, and its standard deviation. own : its own parameters [SI] in the model with
    the added effects, own_before : without. failed : why the FMU does not run, with or without the
    added effects, else "".
    """

    label: str
    source: str
    sha256: str
    beats: int
    period: float
    fitted: bool
    gap_before: Pair
    rms_before: Mapping[str, float]
    gap_after: Pair | None = None
    rms_after: Mapping[str, float] = field(default_factory=dict)
    d: float | None = None
    fallen: float | None = None
    sd: float | None = None
    own: Mapping[str, float] = field(default_factory=dict)
    own_before: Mapping[str, float] = field(default_factory=dict)
    failed: str = ""

    @property
    def plain(self) -> dict[str, Any]:
        """For verdict.json."""
        gap = {"before": pair_json(self.gap_before), "after": pair_json(self.gap_after)}
        rms = {
            name: {"before": x, "after": self.rms_after.get(name), "unit": SIGNAL_UNITS[name[-1]]}
            for name, x in self.rms_before.items()
        }
        return {
            "record": self.source, "sha256": self.sha256, "beats": self.beats, "fitted": self.fitted,
            "period": {"value": self.period, "unit": "s"}, "gap": gap, "rms": rms, "d_prime": self.d,
            "chi2_falls": None if self.fallen is None else {"value": self.fallen, "sd": self.sd},
            "own": {name: {"value": value, "unit": unit_of(name)} for name, value in self.own.items()},
        }  # fmt: skip


TITLES = ("recording", "rate", "gap, held-out beats", "rms of what is left", "own numbers")


def rows(recordings: Sequence[Recorded]) -> list[tuple[str, ...]]:
    """The table of the recordings, one row each, in display units."""
    return [
        (
            each.label if each.fitted else f"{each.label}, not fitted",
            f"{60.0 / each.period:.0f}/min",
            " → ".join(number(pair[1]) for pair in (each.gap_before, each.gap_after) if pair),
            sizes(each.rms_after or each.rms_before),
            _own(each.own) or DASH,
        )
        for each in recordings
    ]


def _own(numbers: Mapping[str, float]) -> str:
    """Parameters with units; equal ones of a kind are joined, "CA+FA.outlet.P_venous 5 mmHg"."""
    same: dict[tuple[str, str], list[str]] = {}
    for name, value in numbers.items():
        (where, _, key), (unit, factor) = name.partition("."), shown_in(quantity_of(name))
        same.setdefault((key, f"{number(factor * value, 4)} {unit}".rstrip()), []).append(where)
    kinds = [key for key, _ in same]
    return ", ".join(
        f"{'all' if len(where) > 1 and kinds.count(key) == 1 else '+'.join(where)}.{key} {value}"
        for (key, value), where in same.items()
    )
