"""Where along its segment: effects of a part, whose usual part promises little where they lie elsewhere."""

from __future__ import annotations

from dataclasses import replace

from fitting.inference.fit import Fit
from fitting.inference.parts import anywhere, grown
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term

from . import thresholds as at
from .compare import Compared, within
from .weigh import Score, scores, shortlist


def moved_along(found: Compared, runs: Runs) -> list[Fit]:
    """Fits of the best single effects of a part of a segment, wherever along it they may lie; of those that were moved
    before, however long they may be. Of one that explains all, only where it lies."""
    best = found.best.fit
    local = [n.fit for n in found.ranked if len(n.fit.terms) == 1 and within(at.ALONG_COST, n.fit, best)]
    if found.best.explains:
        local = [fit for fit in local[:1] if not fit.terms[0].moves_along]
    fits = []
    for fit in local[: at.ALONG]:
        term = found.problem.placed(fit, fit.terms[0])
        if term is not None:
            fits += [f for f in found.problem.refit([(term,)], fit, runs) if f is not None]
    return fits


def promising(found: Compared, runs: Runs) -> list[Fit]:
    """Fits of the parts of segments that promise most at the animal without effect, each begun where it does.

    Those of walls are tried even where every artery differs: it is whole arteries that do.
    """
    base = found.none.fit
    best: dict[str, tuple[Term, Score]] = {}  # of an effect at a place, the part that promises most
    for some in _begun_at_each(found):
        held = [t.held() for t in some.values()]
        columns = found.problem.columns(base, held, runs)
        for score in scores(base, columns, held):
            label = score.term.label
            if label not in best or score.gain > best[label][1].gain:
                best[label] = (some[label], score)
    chosen = shortlist(sorted((score for _, score in best.values()), key=lambda s: -s.gain), at.ALONG)
    hypotheses = [(grown(best[t.label][0]),) for t in chosen]
    return [f for f in found.problem.refit(hypotheses, base, runs) if f is not None] if hypotheses else []


def _begun_at_each(found: Compared) -> list[dict[str, Term]]:
    """By their labels, all effects of a part that are in the catalogue asked, at the first place where a search may
    begin, at the second, and so on."""
    asked = {t.effect for t in found.terms}
    terms = [t for t in anywhere(found.problem.network) if t.effect in asked]
    most = max((len(t.starts) for t in terms), default=0)
    return [{t.label: replace(t, starts=(t.starts[i],)) for t in terms if i < len(t.starts)} for i in range(most)]
