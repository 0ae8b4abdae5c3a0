"""Confirmation of a verdict by free runs of FMUs on held-out beats, which may withdraw a name.

No effect is named that does not shrink the gap to held-out beats, and nothing is ruled out by a model that explains the
record only with implausible values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from solver.quantities.legible import number
from solver.quantities.units import MMHG

from .. import thresholds as at
from ..findings.map_marks import label_text
from ..findings.recorded import Recorded
from ..show.fmu_validation import Gap, changed
from .individual_walls import implausible
from .verdict import Naming


def confirmed(
    naming: Naming, each: Sequence[Recorded], before: Gap, after: Gap | None, losses: Sequence[Mapping[str, float]] = ()
) -> Naming:
    """The naming if the free runs support it; otherwise without a name, with the numbers as the reason.

    The FMU with the effects must run. χ² of held-out beats must fall by more than chance over all recordings together
    and in each in which the effect has a d' of 12 (it then falls in 96 %), and rise by more than chance in none; the
    same holds for recordings held out as a whole. If the gap without the effects is only noise, the same test names an
    effect, because χ² reveals it before the gap of all data does. The test names no partial effect then, and none in a
    network with a stated error, which may take any form. A partial effect must close most of the gap. A verdict
    ``none`` becomes unknown if the model explains the record only with implausible parameters, or if it is a first
    model, whose radii are free, and a mean pressure falls by more than arteries make it.

    each : results per recording. before, after : over all fitted ones. losses : of mean pressure
    [Pa] by channel that are larger than in arteries, per recording.
    """
    naming = _borne_out(naming, each, before, after)
    if naming.verdict != "none":
        return naming
    if odd := implausible(naming.base.fit):
        return _only_with(naming, _far(odd), "it is another subject, or the catalogue lacks the effect")
    largest = {name: max(each.get(name, 0.0) for each in losses) for each in losses for name in each}
    if largest:
        lost = " and ".join(f"{x / MMHG:.2g} mmHg on the way to {name}" for name, x in largest.items())
        consequence = "the zero or the height of a sensor is off, or an artery is narrowed"
        return _only_with(naming, f"arteries so narrow that the mean pressure falls by {lost}", consequence)
    return naming


def _borne_out(naming: Naming, each: Sequence[Recorded], before: Gap, after: Gap | None) -> Naming:
    best, left = label_text(naming.best.label), before.total[1]
    none = naming.verdict == "none"
    failed = "" if before.is_noise else next((r.failed for r in each if r.failed and (none or r.gap_after is None)), "")
    if failed and none:
        return _without(naming, "unknown", f"the model fits the record, but this cannot be judged: {failed}")
    if not naming.adds and naming.verdict != "unknown":
        return naming
    fitted, unseen = ([r for r in each if r.fitted is mine] for mine in (True, False))
    why = "" if after is None else not_fallen(fitted, len(each) > 1) or not_fallen(unseen)
    if before.is_noise and (after is None or why or before.in_error is not None or naming.verdict == "partial"):
        found = f"{best} was found but not named" if after else "no effect was named"
        more = "no more than noise"
        if before.in_error is not None:
            more = f"{before.in_error[1]:.3g} times noise and stated error of the model together"
        reason = f"{found}: without it the gap to held-out beats is {left:.3g} times the noise, {more}"
        return _without(naming, "none", reason)
    if failed:
        nearest = f"{best} comes nearest, but cannot be judged" if naming.best.label else "no effect can be judged"
        return _without(naming, "unknown", f"{nearest}: {failed}")
    if after is None:
        return naming
    if not why and naming.verdict == "partial" and after.total[1] > (1.0 - at.PART_CLOSED) * left:
        why = "most of it remains" + _closed_above(before, after)
    if why:
        nearest = f"{best} comes nearest, but with it the gap of the FMU to held-out beats {changed(before, after)}"
        return _without(naming, "unknown", f"{nearest}: {why}")
    return naming


def _closed_above(before: Gap, after: Gap) -> str:
    """The lowest harmonic from which on an effect closes most of the gap, in words; "" if it does so nowhere.

    An effect of high harmonics, such as that of a catheter, is hidden in the whole gap by a network that is wrong in
    the low ones.
    """
    for k, (_, first) in before.above.items():
        last = after.above.get(k, (math.inf, math.inf))[1]
        if first > at.NO_GAP and last <= (1.0 - at.PART_CLOSED) * first:
            return f", but from harmonic {k} on it falls from {number(first)} to {number(last)} times the noise"
    return ""


def not_fallen(each: Sequence[Recorded], labelled: bool = True) -> str:
    """The reason why some recordings do not support a name or a law; "" if they do, or if there are none."""
    compared = [(r, r.fallen, r.sd) for r in each if r.fallen is not None and r.sd is not None]
    if not compared:
        return ""
    fallen, sd = sum(f for _, f, _ in compared), math.sqrt(sum(s**2 for _, _, s in compared))
    if fallen <= at.FALL * sd:
        over = f"over {', '.join(r.label for r, _, _ in compared)} " if labelled else ""
        return over + _no_fall(fallen, sd)
    for r, own, spread in compared:
        if own < -at.FALL * spread or ((r.d or 0.0) >= at.VISIBLE and own <= at.FALL * spread):
            return f"in {r.label} {_no_fall(own, spread)}"
    return ""


def _only_with(naming: Naming, implausible_values: str, consequence: str) -> Naming:
    """The verdict ``unknown`` of a model that explains the record only with implausible values."""
    reason = f"the model fits the record only with {implausible_values}"
    sentence = f"{reason[0].upper()}{reason[1:]}: {consequence}."
    return replace(_without(naming, "unknown", reason), only_with=sentence)


def _far(odd: Mapping[str, float]) -> str:
    """Implausible parameters with their distances in stated spreads, in words."""
    them = ", ".join(f"{name} {abs(x):.2g} stated spreads {'above' if x > 0 else 'below'}" for name, x in odd.items())
    return f"{them} the file's"


def _no_fall(fallen: float, sd: float) -> str:
    """The change of χ² of the held-out beats with its standard deviation, if it does not fall by more than chance."""
    if fallen < -at.FALL * sd:
        return f"chi2 rises by {-fallen:.3g} ± {sd:.2g}"
    return f"chi2 {'rises' if fallen < 0.0 else 'falls'} by {abs(fallen):.3g} ± {sd:.2g}, no more than chance"


def _without(naming: Naming, verdict: str, reason: str) -> Naming:
    """The naming without a name. The confidence is the probability that the name was wrong, at most one half."""
    doubt = 1.0 - naming.confidence if naming.adds else naming.confidence
    return replace(naming, verdict=verdict, members=(), confidence=min(doubt, at.SUREST["incomplete"]), reason=reason)
