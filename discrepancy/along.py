"""Where along its segment: effects of a part, whose usual part promises little where they lie elsewhere."""

from __future__ import annotations

from dataclasses import replace

from fitting.inference.fit import Fit
from fitting.inference.parts import anywhere, grown
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term, of_animal

from . import thresholds as at
from .compare import Compared, within
from .weigh import Score, scores, shortlist


def moved_along(found: Compared, runs: Runs) -> list[Fit]:
    """The best effects of a part of a segment, wherever along it they may lie and then however long they may be; of one
    that explains all, only where it lies."""
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


def with_parts(found: Compared, runs: Runs) -> Compared:
    """With the parts of segments that promise most, each begun where it does. Those of walls are tried even where
    every artery differs: it is whole arteries that do."""
    base = found.none.fit
    known = {t.effect for t in found.terms}
    network = found.problem.network
    terms = [t for t in anywhere(network) if t.effect in known or of_animal(network, t)]
    promised: dict[Term, Score] = {}
    for i in range(max(len(t.starts) for t in terms)):
        there = {t.label: replace(t, starts=(t.starts[i],)) for t in terms if i < len(t.starts)}
        held = [t.held() for t in there.values()]
        columns = found.problem.columns(base, held, runs)
        promised |= {there[s.term.label]: s for s in scores(base, columns, held)}
    ranked = sorted(promised.items(), key=lambda pair: -pair[1].gain)
    best = {t.label: (t, s) for t, s in reversed(ranked)}  # of an effect at a place, the part that promises most
    chosen = shortlist(sorted((s for _, s in best.values()), key=lambda s: -s.gain), at.ALONG)
    hypotheses = [(grown(best[t.label][0]),) for t in chosen]
    fits = [f for f in found.problem.refit(hypotheses, base, runs) if f is not None]
    return found.joined_by(fits)
