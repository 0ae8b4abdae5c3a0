"""Tables of a cohort on the terminal."""

from __future__ import annotations

from rich.console import RenderableType
from rich.table import Table

from arterial_fmu.cli.terminal.console import right
from fitting.cohort.fits import Cohort, Summary
from fitting.cohort.report import evidence_sentence
from solver.quantities.legible import DASH, number, plus_minus

# heading, quantity, factor from SI
_SHOWN = (
    ("E_inc, MPa", "E_inc", 1e-6),
    ("E, MPa", "E", 1e-6),
    ("φ0, kPa·s", "phi0", 1e-3),
    ("φ0/E, ms", "phi0/E", 1e3),
    ("φNL/φ0, s", "phiNL/phi0", 1.0),
    ("R0, mm", "R0", 1e3),
    ("R0 measured,\nmm", "R0 measured", 1e3),
)


def tables(cohort: Cohort) -> list[RenderableType]:
    """Means ± standard deviations of the main model by site, the claims, and the failures."""
    cohorts = [cohort] if cohort.evidence is None or cohort.evidence.decided else [cohort, *cohort.others]
    means = [_means(each) for each in cohorts]
    means[-1].caption = evidence_sentence(cohort)
    claims = Table("claim", "verdict", "why", title=f"Claims of the paper; {cohort.label}", show_lines=True)
    for claim in cohort.claims():
        claims.add_row(claim.name, claim.verdict, claim.text)
    if not cohort.failures:
        return [*means, claims]
    unused = Table(cohort.noun, "site", "why", title="Not used", show_lines=True)
    for failure in cohort.failures:
        unused.add_row(failure.entry.animal, failure.entry.site, failure.sentence)
    return [*means, claims, unused]


def _means(cohort: Cohort) -> Table:
    """The numbers of ``_SHOWN`` by site."""
    numbers = [right(heading) for heading in ("n", *(heading for heading, _, _ in _SHOWN))]
    spread = f" ± standard deviation between {cohort.noun}s" if len(cohort.animals) > 1 else ""
    title = f"{cohort.label}; {cohort.main} model, {cohort.elastic} law{': mean' if spread else ''}{spread}"
    table = Table("site", *numbers, title=title, padding=0)  # eight quantities fit 80 columns
    for site, row in cohort.table().items():
        n = str(row["E"].n) if "E" in row else "0"
        table.add_row(site, n, *(_cell(row.get(quantity), factor) for _, quantity, factor in _SHOWN))
    return table


def _cell(summary: Summary | None, factor: float) -> str:
    """Mean ± standard deviation, one below the other: seven numbers fit 80 columns."""
    if summary is None:
        return DASH
    mean, sd = factor * summary.mean, factor * summary.sd
    return plus_minus(mean, sd).replace(" ± ", "\n±") if sd > 0.0 else number(mean, 4)
