"""What free runs of the FMUs leave of a name: nothing is named that does not shrink the gap to held-out beats.

And whether the FMU is the model that inference compared: one model has one gap.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fitting.inference.fit import Fit

from . import thresholds as at
from .outcome import ADDED, Agreement
from .outliers import implausible
from .places import label_text
from .recorded import Recorded
from .show import Gap, Run, gap
from .study import Study
from .verdict import Naming
from .wording import changed

Array = np.ndarray


def confirmed(naming: Naming, each: Sequence[Recorded], before: Gap, after: Gap | None) -> Naming:
    """The naming, if the free runs bear it out; else without a name, the reason made of the numbers.

    χ² of held-out beats falls by more than chance over all recordings together and in each in which the effect has a d'
    of 12, with which it does in 96 %, and rises by more than chance in none; over those that were held out whole
    likewise. Of a part it closes most of the gap. Nor is it ``none`` where the model meets the record only as an animal
    that there hardly is. each : recording, with what its runs leave. before, after : over all that are fitted.
    """
    naming = _borne_out(naming, each, before, after)
    odd = implausible(naming.base.fit) if naming.verdict == "none" else {}
    return _without(naming, "unknown", met_only_with(odd)) if odd else naming


def _borne_out(naming: Naming, each: Sequence[Recorded], before: Gap, after: Gap | None) -> Naming:
    if naming.verdict not in (*ADDED, "unknown"):
        return naming
    best, left = label_text(naming.best.label), before.total[1]
    if left <= at.NO_GAP:
        found = f"{best} was found but not named" if after else "no effect was named"
        reason = f"{found}: without it the gap to held-out beats is {left:.3g} times the noise, no more than noise"
        return _without(naming, "none", reason)
    if after is None:
        return naming
    why = _not_fallen([r for r in each if r.fitted], len(each) > 1) or _not_fallen([r for r in each if not r.fitted])
    if not why and naming.verdict == "partial" and after.total[1] > (1.0 - at.PART_CLOSED) * left:
        why = "most of it remains"
    if why:
        nearest = f"{best} comes nearest, but with it the gap of the FMU to held-out beats {changed(before, after)}"
        return _without(naming, "unknown", f"{nearest}: {why}")
    return naming


def _not_fallen(each: Sequence[Recorded], labelled: bool = True) -> str:
    """Why some recordings do not bear a name out; "" where they do, or are none."""
    told = [(r, r.fallen, r.sd) for r in each if r.fallen is not None and r.sd is not None]
    if not told:
        return ""
    fallen, sd = sum(f for _, f, _ in told), math.sqrt(sum(s**2 for _, _, s in told))
    if fallen <= at.FALL * sd:
        over = f"over {', '.join(r.label for r, _, _ in told)} " if labelled else ""
        return over + _no_fall(fallen, sd)
    for r, own, spread in told:
        if own < -at.FALL * spread or ((r.d or 0.0) >= at.VISIBLE and own <= at.FALL * spread):
            return f"in {r.label} {_no_fall(own, spread)}"
    return ""


def met_only_with(odd: Mapping[str, float]) -> str:
    """Numbers that no animal has, with their distances in stated spreads."""
    them = ", ".join(f"{name} {abs(x):.2g} stated spreads {'above' if x > 0 else 'below'}" for name, x in odd.items())
    return f"the model meets the record only with {them} the file's"


def _no_fall(fallen: float, sd: float) -> str:
    """What χ² of the held-out beats does, with its standard deviation, where it does not fall by more than chance."""
    if fallen < -at.FALL * sd:
        return f"chi2 rises by {-fallen:.3g} ± {sd:.2g}"
    return f"chi2 {'rises' if fallen < 0.0 else 'falls'} by {abs(fallen):.3g} ± {sd:.2g}, no more than chance"


def _without(naming: Naming, verdict: str, reason: str) -> Naming:
    """Without a name, as sure as the name was not, and no surer than not."""
    doubt = 1.0 - naming.confidence if naming.verdict in ADDED else naming.confidence
    return replace(naming, verdict=verdict, members=(), confidence=min(doubt, at.INCOMPLETE), reason=reason)


def agreement(study: Study, fit: Fit, wave: Array, run: Run) -> Agreement | None:
    """An FMU's run beside what inference holds of the same hypothesis under the same wave; None where it holds nothing.

    Both solve the same equations, by steps in time and by harmonic balance.
    """
    X = study.problem.answer(wave, fit)
    if X is None:
        return None
    X = X[: len(run.X)]
    pulse = np.array([np.ptp(study.fitted.mean(name)) for name in study.problem.signals])
    apart = np.abs(run.X - X) / pulse
    k, i = (int(n) for n in np.unravel_index(int(apart.argmax()), apart.shape))
    return Agreement(float(apart[k, i]), study.problem.signals[i], k, run.gap.total, gap(study, X).total)
