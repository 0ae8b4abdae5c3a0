"""The outcome of a discrepancy study: plain frozen data, from the workflow to verdict.json and the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fitting.inference.fit import Array
from fitting.results.estimate import Estimate
from fitting.results.result_files import plain
from solver.displays import Shown
from solver.laws import effects
from solver.network.description import Network
from solver.quantities.units import SIGNAL_UNITS

from .isolability import Detectable as Detectable
from .isolability import Isolability as Isolability
from .recorded import Pair, Recorded, pair_json
from .shown_map import SourceMapShown, map_json

ADDED = ("effect", "ambiguous", "several", "partial")  # verdicts that add effects to the model
BEYOND = 2.0  # stated spreads from the common value, or prior standard deviations: what is farther is reported as odd

Hypothesis = tuple[tuple[str, tuple[str, ...]], ...]  # effects that act together: name and places of each


@dataclass(frozen=True)
class NamedEffect:
    """An effect of the catalogue at a place. ``parameters`` by FMU variable, or ``all.<key>`` if it acts everywhere.

    equation : the added term. confidence : probability that the name is right, 0 … 1.
    """

    name: str
    where: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    confidence: float
    equation: str = ""


@dataclass(frozen=True)
class Candidate:
    """A refitted hypothesis.

    behind : -2 ln of its odds against the best (0 for the best). chi2_per_dof : of the fitted beats. held_out :
    whitened RMS on the held-out beats, NaN if it cannot be simulated with their inflow. separation : d' to the best.
    in_class : cannot be ruled out. walls : "common" or "individual".
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
    """A significant entry of the z map: a harmonic of a channel. ``phase`` of the residual in degrees."""

    site: str
    signal: str
    harmonic: int
    z: float
    phase: float = 0.0


@dataclass(frozen=True)
class Balance:
    """Residual of one equation over one part of the network, in noise units.

    Mass: from measured flows alone. Momentum: pressure drops against the simulated ones. Wall law: from P and R of one
    site.
    """

    equation: str  # "mass", "momentum", "wall law"
    where: str
    z: float


@dataclass(frozen=True)
class Absorbed:
    """A refitted nuisance parameter: its shift x in ``unit``, with posterior and prior standard deviations; the latter
    is 0 if it has no prior."""

    name: str
    x: float
    sd: float
    prior_sd: float
    unit: str = "1"

    @property
    def far(self) -> bool:
        """True if its shift is so large against its prior that it deserves attention."""
        return bool(self.prior_sd) and abs(self.x) > BEYOND * self.prior_sd


@dataclass(frozen=True)
class OwnNumber:
    """A parameter of one artery or outlet: of the file, of this subject, and its deviation from the common value.

    file : [SI]. deviation : in stated spreads of the quantity between arteries of one subject. source : origin of the
    first value, "file" or "calibration", which replaces the file's.
    """

    file: float
    now: Estimate
    deviation: float
    source: str = "file"

    @property
    def beyond(self) -> bool:
        """True if few arteries deviate as much."""
        return abs(self.deviation) > BEYOND


@dataclass(frozen=True)
class Walls:
    """The walls of this subject.

    kind : "common" if all arteries share one deviation from the file, or "individual". spread : by quantity, the stated
    standard deviation between arteries and the one estimated from the record. arteries : by variable. Both are empty
    for common walls.
    """

    kind: str = "common"
    spread: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    arteries: Mapping[str, OwnNumber] = field(default_factory=dict)


@dataclass(frozen=True)
class ChannelBeats:
    """Mean beats of one channel : (N,) [SI] at the times of the study; ``band`` is one standard deviation of the mean.

    after : None if nothing was added. gap_before, gap_after : whitened RMS (1 = noise) on (fitted, held-out) beats;
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
    """The FMU against the inferred model, with equal parameters and under the same wave.

    difference : the largest one of a Fourier coefficient, as a fraction of its channel's pulse, at ``channel`` and
    ``harmonic``. fmu, inferred : gaps on (fitted, held-out) beats.
    """

    difference: float
    channel: str
    harmonic: int
    fmu: tuple[float, float]
    inferred: tuple[float, float]


@dataclass(frozen=True)
class LearnedLaw:
    """A learned law with its effect on the gap.

    formula : of the added term. parameters : with 95 % intervals. seen : range of the data, by segment: lowest and
    highest strain [-] and highest strain rate [1/s]; for outlets P - P_venous [Pa] and its rate. beside : effects that
    act with it, instead : effects of a partial verdict that it replaces. before, after : the gap on (fitted, held-out)
    beats. record : path and hash. network, archive : with the law, and its FMU. kind : of the study, "bench" or
    "network". is_law : False for tables of a source over the beat. elsewhere : the gap to held-out beats, before and
    after, of each recording that was held out whole.

    A law and tables describe the recording from which they were learned. Its held-out beats are in the same state: they
    cannot distinguish a law from other physics that acts alike in this state, such as a branch that the network lacks.
    """

    name: str
    where: tuple[str, ...]
    formula: str
    before: tuple[float, float]
    after: tuple[float, float]
    record: tuple[str, str]
    network: Network = field(repr=False)
    archive: bytes = field(repr=False)
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    seen: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    beside: tuple[str, ...] = ()
    instead: tuple[str, ...] = ()
    kind: str = "network"
    is_law: bool = True
    elsewhere: Mapping[str, Pair] = field(default_factory=dict)

    @property
    def explains(self) -> bool:
        """True if it is a law and recordings that it has not seen support it."""
        return self.is_law and bool(self.elsewhere)

    @property
    def of_outlet(self) -> bool:
        """True if it is a law of outlets."""
        return effects.BY_NAME[self.name].owner == "outlet" if self.is_law else False


@dataclass(frozen=True)
class Outcome(Shown):
    """The content of verdict.json and report.html.

    time : (N,) [s] of a beat. z_map : (K+1, m) standardised residuals before, mean first, channels in the order of
    ``channels``; p_value : of their global χ². candidates : best first. smallest : smallest detectable change per
    "effect at place", for the verdict ``none``. sites : whitened RMS of each site, predicted from the others.
    gap_before, gap_after : whitened RMS by the sensors' noise alone on (fitted, held-out) beats. kind : "bench" or
    "network". parity : largest difference between the rebuilt FMU and the direct solver under the network's own inflow,
    as a fraction of a channel's pulse; None if that causes no motion. agreement : of the last FMU with the inferred
    model; None on a bench.
    confidence : probability of the name, or that nothing is missing. remains : for ``partial``, the remaining misfit
    and its place. complete : the search finished within the time limit. notes : sentences on this subject. map : source
    map; None if there is none. learned : a law of the remaining misfit that its FMU supports. written : files were
    written. met : for ``unknown``, the model explains the record only with implausible parameters.

    As data frame: a row for each refitted hypothesis, best first.
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
    recordings: tuple[Recorded, ...] = ()  # of several; gaps then cover the fitted ones, figures the first
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
        """The fraction of the gap on (fitted, held-out) beats that the added effects close."""
        if self.gap_before is None or self.gap_after is None:
            return None
        fitted, held_out = (1.0 - after / before for before, after in zip(self.gap_before, self.gap_after, strict=True))
        return fitted, held_out

    @property
    def invisible(self) -> tuple[str, ...]:
        """Effects that are invisible to these sensors."""
        return self.isolability.invisible if self.isolability else ()

    @property
    def not_judged(self) -> tuple[str, ...]:
        """Effects that were not judged: without a derivative here and not named either."""
        named = {e.name for e in self.effects} | {name for member in self.members for name, _ in member}
        return tuple(e for e in self.isolability.not_judged if e not in named) if self.isolability else ()

    # --- in a notebook --------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"<Outcome {self.verdict}: {self.sentence}>"

    def plot(self, figure: str | None = None) -> Any:
        """A figure of the report: "map", "network", "waveforms", "loops" or "isolability".

        Default: the first one that this study has. Raises ValueError for a missing one.
        """
        return self._figure(figure)


def verdict_json(outcome: Outcome) -> dict[str, Any]:
    """The plain content of verdict.json; unknown numbers are null."""
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


def law_json(law: LearnedLaw) -> dict[str, Any]:
    """The plain content of verdict.json."""
    state = "pressure" if law.of_outlet else "strain"
    return {
        "name": law.name,
        "explains": law.explains,
        "where": law.where,
        "formula": law.formula,
        "parameters": {name: each.plain for name, each in law.parameters.items()},
        "seen": {s: {state: [low, high], "rate": rate} for s, (low, high, rate) in law.seen.items()},
        "beside": law.beside,
        "instead": law.instead,
        "gap": {"before": pair_json(law.before), "after": pair_json(law.after)},
        "elsewhere": {label: {"before": before, "after": after} for label, (before, after) in law.elsewhere.items()},
    }
