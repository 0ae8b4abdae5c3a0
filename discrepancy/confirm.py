"""What free runs of the FMUs leave of a name: nothing is named that does not shrink the gap to held-out beats.

And whether the FMU is the model that inference compared: one model has one gap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fitting.inference.fit import Fit

from . import thresholds as at
from .gap_words import changed
from .outcome import ADDED, Agreement
from .outliers import implausible
from .places import label_text
from .show import Run, fall, gap
from .study import Study
from .verdict import Naming

Array = np.ndarray


def confirmed(study: Study, naming: Naming, before: Run, after: Run | None) -> Naming:
    """The naming, if the runs bear it out; else without a name, the reason made of the numbers.

    Nor is it ``none`` where the model meets the record only as an animal that there hardly is.
    """
    naming = _borne_out(study, naming, before, after)
    odd = implausible(naming.base.fit) if naming.verdict == "none" else {}
    return _without(naming, "unknown", met_only_with(odd)) if odd else naming


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
