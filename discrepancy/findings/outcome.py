"""What a discrepancy study found: plain frozen data, handed from the workflow to verdict.json and to the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fitting.results.estimate import Estimate
from fitting.results.result_files import plain
from solver.displays import Shown
from solver.network.description import Network
from solver.quantities.units import SIGNAL_UNITS

from .isolability import Detectable as Detectable
from .isolability import Isolability as Isolability
from .learned_law import LearnedLaw, law_json
from .recorded import Pair, Recorded, pair_json
from .shown_map import SourceMapShown, map_json

Array = np.ndarray

VERDICTS = ("none", "effect", "ambiguous", "several", "partial", "unknown", "unusable")
ADDED = ("effect", "ambiguous", "several", "partial")  # those that add to the model
BEYOND = 2.0  # stated spreads from what all arteries have in common, from which one is said to be odd
_OUTSIDE_PRIOR = 2.0  # prior standard deviations from which a nuisance is worth a second look

Hypothesis = tuple[tuple[str, tuple[str, ...]], ...]  # effects that act together: name and places of each


@dataclass(frozen=True)
class NamedEffect:
    """An effect of the catalogue at a place. ``parameters`` by FMU variable, or ``all.<key>`` where it acts everywhere.

    equation : the term that was added. confidence : probability that the name is right, 0 … 1.
    """

    name: str
    where: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    confidence: float
    equation: str = ""


@dataclass(frozen=True)
class Candidate:
    """One hypothesis that was refitted.

    behind : -2 ln of its odds against the best (0 for the best). chi2_per_dof : of the fitted beats. held_out :
    whitened RMS on the held-out beats, NaN where it cannot be simulated with their inflow. separation : d' by which the
    data tell it from the best. in_class : cannot be ruled out. walls : "common" or "individual".
    """

    name: str
    where: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    behind: float
    chi2_per_dof: float
    held_out: float
    separation: float
    in_class: bool
    walls: str = "common"


@dataclass(frozen=True)
class Located:
    """One entry of the z map: a channel's harmonic that disagrees. ``phase`` of the residual in degrees."""

    site: str
    signal: str
    harmonic: int
    z: float
    phase: float = 0.0


@dataclass(frozen=True)
class Balance:
    """Residual of one equation over one part of the network, in noise units.

    Mass from measured flows alone; momentum as pressure drops against the simulated ones; the wall law from P and R of
    one site.
    """

    equation: str  # "mass", "momentum", "wall law"
    where: str
    z: float


@dataclass(frozen=True)
class Absorbed:
    """A nuisance that was refitted: its shift x in units of ``unit``, its prior and posterior standard deviations."""

    name: str
    x: float
    sd: float
    prior_sd: float
    unit: str = "1"

    @property
    def far(self) -> bool:
        """Whether it is so far from what it is beforehand that it is worth a second look."""
        return bool(self.prior_sd) and abs(self.x) > _OUTSIDE_PRIOR * self.prior_sd


@dataclass(frozen=True)
class OwnNumber:
    """A number of one artery or outlet: the file's, this animal's, and how far it is from what all have in common.

    file : [SI]. deviation : in the spreads that the quantity states between arteries of one animal. source : whose the
    first number is, "file" or "calibration", which stands for the file.
    """

    file: float
    now: Estimate
    deviation: float
    source: str = "file"

    @property
    def beyond(self) -> bool:
        """Whether few arteries deviate as much."""
        return abs(self.deviation) > BEYOND


@dataclass(frozen=True)
class Walls:
    """This animal's walls.

    kind : "common", where all arteries differ from the file together, or "individual". spread : by quantity, the stated
    standard deviation between arteries and the one that the record tells. arteries : by variable; both are empty where
    all is common.
    """

    kind: str = "common"
    spread: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    arteries: Mapping[str, OwnNumber] = field(default_factory=dict)


@dataclass(frozen=True)
class ChannelBeats:
    """Mean beats of one channel : (N,) [SI] at the times of the study; ``band`` one standard deviation of the mean.

    after : None where nothing was added. gap_before, gap_after : whitened RMS (1 = noise) on (fitted, held-out) beats;
    rms_before, rms_after : the same over the beat [SI].
    """

    name: str
    measured: Array
    band: Array
    before: Array
    after: Array | None
    gap_before: tuple[float, float]
    gap_after: Pair | None
    rms_before: Pair | None = None
    rms_after: Pair | None = None


@dataclass(frozen=True)
class Agreement:
    """The FMU beside the model that inference compared, with the same numbers and under the same wave.

    difference : the largest of a Fourier coefficient, of its channel's pulse; where that is. fmu, inferred : the gap
    that each leaves on (fitted, held-out) beats.
    """

    difference: float
    channel: str
    harmonic: int
    fmu: tuple[float, float]
    inferred: tuple[float, float]


@dataclass(frozen=True)
class Outcome(Shown):
    """Everything that verdict.json and report.html say.

    time : (N,) [s] of a beat. z_map : (K+1, m) standardised residuals before, mean first, channels in the order of
    ``channels``; p_value : of their global χ². candidates : best first. smallest : smallest detectable change per
    "effect at place", where the verdict is ``none``. sites : whitened RMS of each site, predicted from the others.
    gap_before, gap_after : whitened RMS by the sensors' noise alone on (fitted, held-out) beats; alone : with the first
    of two effects, where that is known. kind : "bench" or
    "network". parity : largest difference of the rebuilt FMU from the direct solver, of a channel's pulse: under the
    record's inflow, or, of a bench, under the network's own; None where that moves nothing.
    agreement : of the last FMU that ran with what was inferred; None on a bench.
    confidence : probability of the name, or that nothing is missing. remains : of ``partial``, what is left and where.
    complete : whether the search came to its end before the time limit. notes : on this animal, in sentences.
    map : where something acts that the model lacks; None where that was not asked. learned : a law of what remains, if
    one was found that its FMU bears out. written : whether there are files of it. met : of ``unknown``, whether the
    model meets the record, but only with numbers that hardly any animal has.

    As data frame: a row for each hypothesis that was refitted, best first.
    """

    verdict: str
    sentence: str
    record: str
    model: str
    kind: str
    effects: tuple[NamedEffect, ...] = ()
    members: tuple[Hypothesis, ...] = ()  # the class, best first
    reason: str | None = None
    remains: str | None = None
    confidence: float | None = None
    complete: bool = True
    met: bool = False
    map: SourceMapShown | None = None
    learned: LearnedLaw | None = None
    walls: Walls | None = None
    separating_measurement: str | None = None
    located: tuple[Located, ...] = ()
    balances: tuple[Balance, ...] = ()
    channels: tuple[ChannelBeats, ...] = ()
    time: Array = field(default_factory=lambda: np.zeros(0))
    z_map: Array = field(default_factory=lambda: np.zeros((0, 0)))
    candidates: tuple[Candidate, ...] = ()
    absorbed: tuple[Absorbed, ...] = ()
    isolability: Isolability | None = None
    smallest: Mapping[str, Detectable] = field(default_factory=dict)
    sites: Mapping[str, float] = field(default_factory=dict)
    alone: Pair | None = None
    recordings: tuple[Recorded, ...] = ()  # of several; gaps are then over those fitted, figures of the first
    gap_before: Pair | None = None
    gap_after: Pair | None = None
    parity: float | None = None
    agreement: Agreement | None = None
    p_value: float | None = None
    network_before: Network | None = None
    network_after: Network | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    written: bool = True

    @property
    def closed(self) -> Pair | None:
        """The part of the gap on (fitted, held-out) beats that what was added closes."""
        if self.gap_before is None or self.gap_after is None:
            return None
        fitted, held_out = (1.0 - after / before for before, after in zip(self.gap_before, self.gap_after, strict=True))
        return fitted, held_out

    @property
    def invisible(self) -> tuple[str, ...]:
        """Effects that these sensors cannot see."""
        return self.isolability.invisible if self.isolability else ()

    @property
    def not_judged(self) -> tuple[str, ...]:
        """Effects that nothing can be said of: those without a derivative here that were not named either."""
        named = {e.name for e in self.effects} | {name for member in self.members for name, _ in member}
        return tuple(e for e in self.isolability.not_judged if e not in named) if self.isolability else ()

    # --- in a notebook --------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"<Outcome {self.verdict}: {self.sentence}>"

    def plot(self, figure: str | None = None) -> Any:
        """A figure of the report: "map", "network", "z_map", "waveforms", "loops", "gap" or "isolability".

        Default: the first of them that this study has. Raises ValueError for one that it has not.
        """
        return self._figure(figure)


def verdict_json(outcome: Outcome) -> dict[str, Any]:
    """The plain content of verdict.json; null where a number could not be told."""
    acting, walls, a = outcome.map, outcome.walls, outcome.agreement
    content = {
        "verdict": outcome.verdict,
        "confidence": outcome.confidence,
        "complete": outcome.complete,
        "effects": outcome.effects,
        "class": [[{"name": name, "where": where} for name, where in member] for member in outcome.members],
        "located": outcome.located,
        "global_p_value": outcome.p_value,
        "map": acting and map_json(acting),
        "map_leaves": acting and acting.left,
        "learned": outcome.learned and law_json(outcome.learned),
        "gap": {
            "before": pair_json(outcome.gap_before),
            "after": pair_json(outcome.gap_after),
            "closed": pair_json(outcome.closed),
            "channels": {c.name: {"before": c.gap_before[1], "after": c.gap_after and c.gap_after[1],
                                  "rms_before": c.rms_before and c.rms_before[1],
                                  "rms_after": c.rms_after and c.rms_after[1], "unit": SIGNAL_UNITS[c.name[-1]]}
                         for c in outcome.channels},
        },
        "remains": outcome.remains,
        "walls": walls and {
            "kind": walls.kind,
            "spread": {key: {"stated": stated, "found": found} for key, (stated, found) in walls.spread.items()},
            "arteries": {name: {"file": own.file, "source": own.source, **own.now.plain, "deviation": own.deviation,
                                "beyond": own.beyond} for name, own in walls.arteries.items()},
        },
        "separating_measurement": outcome.separating_measurement,
        "invisible": outcome.invisible,
        "not_judged": outcome.not_judged,
        "reason": outcome.reason,
        "seconds": round(outcome.seconds, 1),
        "sentence": outcome.sentence,
        "held_out_sites": outcome.sites,
        "smallest_detectable": outcome.smallest,
        "fmu_against_solver": outcome.parity,
        "fmu_against_inference": a and {"difference": a.difference, "channel": a.channel, "harmonic": a.harmonic,
                                        "gap": {"fmu": pair_json(a.fmu), "inferred": pair_json(a.inferred)}},
        "absorbed": {n.name: {"x": n.x, "sd": n.sd, "prior_sd": n.prior_sd, "unit": n.unit} for n in outcome.absorbed},
        "recordings": {each.label: each.plain for each in outcome.recordings},
        "warnings": outcome.warnings,
        "notes": outcome.notes,
        "record": outcome.record,
        "model": outcome.model,
        "provenance": outcome.provenance,
    }  # fmt: skip
    return dict(plain(content))
