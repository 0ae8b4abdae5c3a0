"""The paper's claims on a cohort, each as a falsifiable test.

"Equal" and "negligible" need an equivalence test: every site's 90 % interval must lie within a stated margin (two
one-sided tests at 5 %; for all sites together an intersection-union test, which needs no correction). A claim is
refuted if some site's interval lies wholly outside, at 5 % after Bonferroni's correction for the number of sites.
Otherwise it is not decided: a large p-value proves nothing. Ratios are compared by logarithms: ±25 % means 1/1.25 …
1.25.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from solver.errors import InputError

from .mixed_model import Contrast, RandomIntercept, random_intercept

Cells = Mapping[tuple[str, str], float]  # by (animal, site)

SUPPORTED, REFUTED, OPEN = "supported", "refuted", "not decided"

ALPHA = 0.05
RATIO_MARGIN = 0.25
"""For φ0/E: 1.25 is the usual limit for the equivalence of ratios, as of bioavailabilities; E itself differs by a
factor of 6.7 between the paper's arteries, and its 15–20 ms are ±15 %."""
RADIUS_MARGIN = 0.02
"""For R0: a tenth of the aorta's strain of 0.15–0.2. The carotid's is 0.01: look at the smallest margin there."""
MODEL_MARGIN = 0.10  # between models: half the spread of E and φ0 between animals
NEGLIGIBLE = 0.05  # of the elastic stress, for E_NL ε²
NO_BEND = 0.05  # s: φ_NL/φ0 that changes the viscosity by 10 % at 1/s, a bench loop's fastest strain rate


@dataclass(frozen=True)
class SiteEstimate:
    """One site's value with its interval (NaN if one animal has none), from n animals; p where 0 is tested."""

    label: str
    value: float
    low: float
    high: float
    n: int
    p: float | None = None


@dataclass(frozen=True)
class Claim:
    """verdict : "supported", "refuted" or "not decided". text : the sentence for the reader.

    estimates in ``unit``, their intervals at ``level``. allowed : the range for their intervals; margin : that range as
    a margin; smallest_margin : the smallest one that would support the claim (None if there is no margin).
    n : animals. numbers : further results by name.
    """

    name: str
    statement: str
    verdict: str
    text: str
    estimates: tuple[SiteEstimate, ...]
    unit: str
    level: float
    n: int
    margin: float | None = None
    allowed: tuple[float, float] | None = None
    smallest_margin: float | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)


def constant_relaxation_time(values: Cells, margin: float = RATIO_MARGIN) -> Claim:
    """Whether φ0/E [s] is the same at all sites: log-ratio to the mean over sites, animals as random effect.

    The mixed model assumes equal scatter at all sites. The verdict must not depend on this assumption, so each site's
    own scatter must lead to the same verdict. The classical F test is given for information.
    """
    name, statement = "relaxation time", "phi0/E is the same at all sites"
    n = _animals(values)
    logs = {cell: float(np.log(value)) for cell, value in values.items()}
    try:
        fit = random_intercept(np.array(list(logs.values())), *_labels(logs))
    except InputError as error:
        return Claim(name, statement, OPEN, f"{statement}: not decided: {error}", (), "1", 0.9, n, margin)
    parts = [_Part(s, c, _count(values, s)) for s, c in zip(fit.sites, fit.deviations(), strict=True)]
    own = _own_scatter(logs, fit, parts)
    claim = _ratios(name, statement, parts, margin, n, "of the mean over sites", own)
    F, q, df, p = fit.f_test()
    text = (
        f"{claim.text} For information: F({q:.0f}, {df:.0f}) = {F:.2f}, p = {p:.2g} for equal sites; p > 0.05 would "
        "not prove constancy, nor does p < 0.05 make a difference large."
    )
    numbers = {
        "mean": float(np.exp(fit.overall().estimate)),
        "sd_log_residual": float(np.sqrt(fit.residual)),
        "variance_shared": fit.shared,
        "F": F,
        "F_df1": q,
        "F_df2": df,
        "F_p": p,
    }
    return replace(claim, text=text, numbers=numbers)


def same_radius(ratios: Cells, margin: float = RADIUS_MARGIN) -> Claim:
    """Whether the fitted R0 is the measured one, from their ratios: paired at every site, and pooled."""
    parts = _parts(ratios, logarithm=True)
    name, statement = "unstressed radius", "The fitted R0 equals the measured R0"
    claim = _ratios(name, statement, parts, margin, _animals(ratios), "of the measured")
    try:
        pooled = random_intercept(np.log(list(ratios.values())), *_labels(ratios)).overall()
    except InputError:
        return claim
    low, high = np.expm1(pooled.interval(0.95))
    bias = float(np.expm1(pooled.estimate))
    text = (
        f"{claim.text} Over all sites the fitted R0 is off by {100 * bias:+.2f} % "
        f"(95 % interval {100 * low:+.2f} to {100 * high:+.2f} %)."
    )
    numbers = {"bias": bias, "bias_low": float(low), "bias_high": float(high)}
    return replace(claim, text=text, numbers=numbers)


def nonlinear_viscosity(values: Cells) -> Claim:
    """Whether φ_NL/φ0 [s] differs from 0 at every site (t tests, Holm's correction).

    Refuted if a site's interval lies within ±0.05 s, where it is negligible.
    """
    name, statement = "nonlinear viscosity", "phiNL/phi0 differs from 0 at every site"
    parts = _parts(values)
    p = holm([part.contrast.p_value() if part.contrast else 1.0 for part in parts])
    estimates = tuple(_estimate(part, 0.95, q) for part, q in zip(parts, p, strict=True))
    differ = [e.label for e in estimates if e.p is not None and e.p < ALPHA]
    others = [e.label for e in estimates if e.label not in differ]
    inside = [part.label for part in parts if _within(part, 1.0 - 2.0 * ALPHA / len(parts), NO_BEND)]
    verdict = SUPPORTED if not others else REFUTED if inside else OPEN
    text = f"{statement}: {verdict}. It does at {_list(differ)} (t tests at 5 %, Holm)"
    text += f"; not shown at {_list(others)}, which does not make it 0 there" if others else ""
    text += f"; within ±{NO_BEND:g} s of 0 at {_list(inside)}" if inside else ""
    return Claim(name, statement, verdict, text + ".", estimates, "s", 0.95, _animals(values))


def negligible_elastic_bend(values: Cells, margin: float = NEGLIGIBLE) -> Claim:
    """Whether E_NL ε² is negligible against E ε: E_NL/E times each loop's own mean strain, within the margin."""
    name, statement = "nonlinear elasticity", "E_NL is negligible"
    parts = _parts(values)
    verdict, smallest, where = _equivalence(parts, margin)
    worst = max(parts, key=lambda part: _reach(part, 0.9), default=None)
    text = (
        f"{statement}: {verdict}. E_NL eps² is compared with {100 * margin:.0f} % of E eps at the mean strain of the "
        f"loops{_furthest(worst, lambda x: f'{100 * x:+.2f} %')}{_smallest(smallest)}{_where(verdict, where)}."
    )
    estimates = tuple(_estimate(part, 0.9) for part in parts)
    return Claim(
        name, statement, verdict, text, estimates, "1", 0.9, _animals(values), margin, (-margin, margin), smallest
    )


def same_in_both_models(ratios: Mapping[str, Cells], models: tuple[str, str], margin: float = MODEL_MARGIN) -> Claim:
    """Whether E and φ0 are nearly independent of the model: ratios by parameter name, paired at every site."""
    parts = [
        _Part(f"{part.label} {name}", part.contrast, part.n)
        for name, cells in ratios.items()
        for part in _parts(cells, logarithm=True)
    ]
    n = max((_animals(cells) for cells in ratios.values()), default=0)
    statement = f"{' and '.join(ratios)} are the same in the {models[0]} and the {models[1]} model"
    return _ratios("linear and nonlinear", statement, parts, margin, n, f"({models[0]} over {models[1]})")


def holm(p: Sequence[float]) -> list[float]:
    """p-values with Holm's correction for multiple tests."""
    order = np.argsort(p)
    steps = np.asarray(p)[order] * np.arange(len(p), 0, -1)
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return [float(x) for x in corrected]


# --- one site at a time -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """A site's estimate, None if only one animal has it."""

    label: str
    contrast: Contrast | None
    n: int


def _parts(values: Cells, logarithm: bool = False) -> list[_Part]:
    """The mean of each site's values (or of their logarithms) with the standard error of their scatter."""
    parts = []
    for site in _sites(values):
        x = np.array([v for (_, s), v in values.items() if s == site])
        x = np.log(x) if logarithm else x
        n = len(x)
        contrast = Contrast(float(x.mean()), float(x.std(ddof=1) / np.sqrt(n)), n - 1.0) if n > 1 else None
        parts.append(_Part(site, contrast, n))
    return parts


def _own_scatter(logs: Cells, fit: RandomIntercept, parts: list[_Part]) -> list[_Part]:
    """The same deviations with the standard error of each site's own scatter about its animals' means.

    For animals with m of J sites the scatter is rescaled from 1 - 1/m to 1 - 1/J of the variance of e_ij.
    """
    J, mu = len(fit.sites), dict(zip(fit.sites, fit.means, strict=True))
    rest: dict[str, dict[str, float]] = {}
    for (animal, site), value in logs.items():
        rest.setdefault(animal, {})[site] = value - float(mu[site])
    result = []
    for part in parts:
        of_site = [r for r in rest.values() if part.label in r and len(r) > 1]
        d = np.array([r[part.label] - np.mean(list(r.values())) for r in of_site])
        d *= np.sqrt((1.0 - 1.0 / J) / (1.0 - 1.0 / np.array([len(r) for r in of_site])))
        contrast = None
        if part.contrast and len(d) > 1:
            contrast = Contrast(part.contrast.estimate, float(d.std(ddof=1) / np.sqrt(len(d))), len(d) - 1.0)
        result.append(_Part(part.label, contrast, len(d)))
    return result


def _ratios(
    name: str, statement: str, parts: list[_Part], margin: float, n: int, of: str, again: list[_Part] | None = None
) -> Claim:
    """Equivalence of ratios, given by their logarithms, to 1; ``again`` with other standard errors must agree."""
    limit, doubt = float(np.log1p(margin)), ""
    verdict, smallest, where = _equivalence(parts, limit)
    if again is not None:
        other, reach, places = _equivalence(again, limit)
        smallest = None if smallest is None or reach is None else max(smallest, reach)
        if verdict not in (OPEN, other):
            doubt = f" (the mixed model alone says {verdict}, each site's own scatter does not)"
            verdict, where = OPEN, places
    smallest = None if smallest is None else float(np.expm1(smallest))
    worst = max(parts, key=lambda part: _reach(part, 0.9), default=None)
    text = (
        f"{statement}: {verdict}{doubt}. Margin ±{100 * margin:.0f} % {of}"
        f"{_furthest(worst, lambda x: f'{np.exp(x):.3f}')}{_smallest(smallest)}{_where(verdict, where)}."
    )
    estimates = tuple(
        replace(e, value=float(np.exp(e.value)), low=float(np.exp(e.low)), high=float(np.exp(e.high)))
        for e in (_estimate(part, 0.9) for part in parts)
    )
    allowed = (1.0 / (1.0 + margin), 1.0 + margin)
    return Claim(name, statement, verdict, text, estimates, "1", 0.9, n, margin, allowed, smallest)


def _equivalence(parts: list[_Part], limit: float) -> tuple[str, float | None, list[str]]:
    """Verdict, the smallest limit that all sites meet, and the sites that contradict the claim."""
    level = 1.0 - 2.0 * ALPHA
    outside = [part.label for part in parts if _outside(part, 1.0 - 2.0 * ALPHA / len(parts), limit)]
    beyond = [part.label for part in parts if not _within(part, level, limit)]
    complete = parts and all(part.contrast for part in parts)
    smallest = max(_reach(part, level) for part in parts) if complete else None
    if outside:
        return REFUTED, smallest, outside
    return (SUPPORTED if complete and not beyond else OPEN), smallest, beyond


def _reach(part: _Part, level: float) -> float:
    """The largest distance of its interval from 0."""
    return max(abs(end) for end in part.contrast.interval(level)) if part.contrast else -1.0


def _within(part: _Part, level: float, limit: float) -> bool:
    return part.contrast is not None and _reach(part, level) < limit


def _outside(part: _Part, level: float, limit: float) -> bool:
    if part.contrast is None:
        return False
    low, high = part.contrast.interval(level)
    return low > limit or high < -limit


def _estimate(part: _Part, level: float, p: float | None = None) -> SiteEstimate:
    if part.contrast is None:
        return SiteEstimate(part.label, float("nan"), float("nan"), float("nan"), part.n)
    return SiteEstimate(part.label, part.contrast.estimate, *part.contrast.interval(level), part.n, p)


# --- words --------------------------------------------------------------------------------------------------------


def _furthest(part: _Part | None, show: Callable[[float], str]) -> str:
    if part is None or part.contrast is None:
        return "; no site has two subjects"
    low, high = part.contrast.interval(0.9)
    return f"; furthest {part.label}: {show(part.contrast.estimate)} (90 % interval {show(low)} to {show(high)})"


def _smallest(margin: float | None) -> str:
    return "" if margin is None else f"; the smallest margin that all sites meet is ±{100 * margin:.1f} %"


def _where(verdict: str, sites: list[str]) -> str:
    if verdict == REFUTED:
        return f"; wholly outside: {_list(sites)}"
    return f"; the data do not decide at {_list(sites)}" if verdict == OPEN and sites else ""


def _list(names: list[str]) -> str:
    return ", ".join(names) or "no site"


def _labels(values: Cells) -> tuple[list[str], list[str]]:
    """Sites and animals of the values."""
    return [site for _, site in values], [animal for animal, _ in values]


def _sites(values: Cells) -> list[str]:
    return list(dict.fromkeys(site for _, site in values))


def _animals(values: Cells) -> int:
    return len({animal for animal, _ in values})


def _count(values: Cells, site: str) -> int:
    return sum(s == site for _, s in values)
