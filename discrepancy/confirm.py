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
from .show import Gap, Run, fall, gap
from .study import Study
from .verdict import Naming
from .wording import changed

Array = np.ndarray


def confirmed(study: Study, naming: Naming, before: Run, after: Run | None) -> Naming:
    """The naming, if the runs bear it out; else without a name, the reason made of the numbers.

    Nor is it ``none`` where the model meets the record only as an animal that there hardly is.
    """
    naming = _borne_out(study, naming, before, after)
    odd = implausible(naming.base.fit) if naming.verdict == "none" else {}
    return _without(naming, "unknown", met_only_with(odd)) if odd else naming


def confirmed_together(naming: Naming, each: Sequence[Recorded], before: Gap, after: Gap | None) -> Naming:
    """The naming of several recordings, if the runs of all bear it out.

    χ² of held-out beats falls by more than chance over all recordings together and in each in which the effect has a d'
    of 12, with which it does in 96 %, and rises by more than chance in none; over those that were held out likewise.
    before, after : over all that are fitted.
    """
    if naming.verdict not in (*ADDED, "unknown"):
        return naming
    if before.total[1] <= at.NO_GAP:
        reason = (
            f"without an effect the gap to held-out beats is {before.total[1]:.3g} times the noise, no more than noise"
        )
        return _without(naming, "none", reason)
    if after is None:
        return naming
    nearest = f"{label_text(naming.best.label)} comes nearest, but with it the gap of the FMU to held-out beats"
    for some in ([r for r in each if r.fitted], [r for r in each if not r.fitted]):
        if why := _not_fallen(some):
            return _without(naming, "unknown", f"{nearest} {changed(before, after)}: {why}")
    if naming.verdict == "partial" and after.total[1] > (1.0 - at.PART_CLOSED) * before.total[1]:
        return _without(naming, "unknown", f"{nearest} {changed(before, after)}: most of it remains")
    return naming


def _not_fallen(each: Sequence[Recorded]) -> str:
    """Why some recordings do not bear a name out; "" where they do, or are none."""
    told = [(r, r.fallen, r.sd) for r in each if r.fallen is not None and r.sd is not None]
    if not told:
        return ""
    fallen, sd = sum(f for _, f, _ in told), math.sqrt(sum(s**2 for _, _, s in told))
    if fallen <= at.FALL * sd:
        return f"over {', '.join(r.label for r, _, _ in told)} {_no_fall(fallen, sd)}"
    for r, own, spread in told:
        if own < -at.FALL * spread or ((r.d or 0.0) >= at.VISIBLE and own <= at.FALL * spread):
            return f"in {r.label} {_no_fall(own, spread)}"
    return ""


def met_only_with(odd: Mapping[str, float]) -> str:
    """Numbers that no animal has, with their distances in stated spreads."""
    them = ", ".join(f"{name} {abs(x):.2g} stated spreads {'above' if x > 0 else 'below'}" for name, x in odd.items())
    return f"the model meets the record only with {them} the file's"


def _borne_out(study: Study, naming: Naming, before: Run, after: Run | None) -> Naming:
    """The naming, if the runs bear it out: the gap falls by more than chance, and of a part by most of it."""
    if naming.verdict not in (*ADDED, "unknown"):
        return naming
    left = before.gap.total[1]
    if left <= at.NO_GAP:
        found = f"{label_text(naming.best.label)} was found but not named" if after else "no effect was named"
        reason = f"{found}: without it the gap to held-out beats is {left:.3g} times the noise, no more than noise"
        return _without(naming, "none", reason)
    if after is None:
        return naming
    fallen, sd = fall(study, before, after)
    nearest = f"{label_text(naming.best.label)} comes nearest, but with it the gap of the FMU to held-out beats"
    changes = f"{nearest} {changed(before.gap, after.gap)}"
    if fallen <= at.FALL * sd:
        return _without(naming, "unknown", f"{changes}: {_no_fall(fallen, sd)}")
    if naming.verdict == "partial" and after.gap.total[1] > (1.0 - at.PART_CLOSED) * left:
        return _without(naming, "unknown", f"{changes}: most of it remains")
    return naming


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
