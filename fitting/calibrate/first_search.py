"""The first search of a calibration, and other starts if it ends far from the record; one more search for a late flow.

A wrong minimum is recognisable, because its residual is a fraction of the pulsation rather than noise. A correct model
leaves noise and sensor faults, gain errors of a few per cent: at most a twentieth of the pulsation. If more is left,
other starts follow until one ends nearer, or until three have not, or two have come back to the first minimum: then the
model is deficient, not the search, and the result from the network's own values stands. A wrong model has lower costs
far away, at values that no artery has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from solver.errors import InputError
from solver.laws.catalogue import DELAY
from solver.network.description import Network
from solver.quantities.legible import number
from solver.quantities.units import INFLOW, MMHG
from solver.simulate import BROKEN

from ..first.estimates import late
from ..inference.gauss_newton import Rules
from ..inference.joint.calibration import Problem
from ..inference.joint.model_error import Ended, minimum
from ..inference.models.simulator import Simulator
from ..inference.unknown import Array, absent, starting_points
from ..records import limits
from ..records.alignment.beats import Beats
from ..records.channels.inflow import flowed
from ..records.channels.noise import pulses

OTHER_STARTS = 8
_SEED = 1
_FIRST_ERROR = 1e-3  # of a channel's pulse: larger than the solver's own error
FAR = 0.05  # of the RMS of the pulsation
# Gain at which a search from another start ends: it shows whether it ends nearer, and the second search goes on there
ROUGH = 1.0
_ALIKE, _BACK = 0.02, 2  # relative difference of what two ends at one minimum leave; starts that came back to the first
ENOUGH = 3  # 6 of 100 synthetic tubes need other starts (own start far off or without a beat), and none needs more


def first_search(problem: Problem, x0: Array | None, rules: Rules) -> tuple[Problem, Ended, list[str]]:
    """The problem with its first weights, the end of the first successful search, and a sentence if its start is not
    the requested one.

    x0 : (p,) start; None: the network's own values, then others. Raises ValueError if no start has a beat.
    """
    weighted: Problem | None = None
    ended: dict[int, Ended] = {}
    failure: Exception | None = None
    for i, x in enumerate(_starts(problem) if x0 is None else [x0]):
        try:
            weighted = weighted or problem.weighted(x, [first_error(*each) for each in problem.records])
            ended[i] = minimum(
                weighted.whole, weighted.at(x), replace(rules, gain=ROUGH) if ended else rules, problem.runs
            )
        except BROKEN as error:
            failure = failure or error
            weighted = weighted if ended else None
            continue
        if not far(weighted, ended[i]) or _enough(weighted, ended):
            break
    if weighted is None:
        sources = " + ".join(beats.source for beats, _ in problem.records)
        where = f"as given or at {OTHER_STARTS} other starts" if x0 is None else "at this start"
        name = problem.records[0][1].network.name
        raise InputError(f"{sources}: with its inflow, network {name} {where} cannot be simulated: {failure}") from None
    near = [i for i in ended if not far(weighted, ended[i])]
    best = min(near or ended, key=lambda i: (not near and i > 0, ended[i].history[-1]))
    asked = x0 is not None or list(ended) == [0]
    return weighted, ended[best], [] if asked else [_search_note(weighted, ended, best)]


def _enough(problem: Problem, ended: Mapping[int, Ended]) -> bool:
    """True if the ends of other starts, all of them far from the record, show that no start ends nearer."""
    misfits = {i: problem.whole.left_of_pulsation(each.fit) for i, each in ended.items()}
    back = [i for i in misfits if i and 0 in misfits and abs(misfits[i] - misfits[0]) < _ALIKE * misfits[0]]
    return len(misfits.keys() - {0}) == ENOUGH or len(back) == _BACK


def _starts(problem: Problem) -> Iterator[Array]:
    """The network's own values, then others."""
    yield absent(problem.unknowns)
    yield from starting_points(problem.unknowns, 1 + OTHER_STARTS, _SEED)[1:]


def first_error(beats: Beats, simulator: Simulator) -> Array:
    """(K+1, m) an assumed error of the solver, until it is measured."""
    names = simulator.names
    return np.full((simulator.K + 1, len(names)), _FIRST_ERROR) * pulses(beats, names)


def far(problem: Problem, found: Ended) -> bool:
    """True if a search ended so far from the record that it may be in a wrong minimum."""
    return problem.whole.left_of_pulsation(found.fit) > FAR and bool(found.errors.any())


def _search_note(problem: Problem, ended: Mapping[int, Ended], best: int) -> str:
    misfits = {i: problem.whole.left_of_pulsation(each.fit) for i, each in ended.items()}
    leaves = {i: f"{100.0 * each:.2g} % of the pulsation (rms)" for i, each in misfits.items()}
    why = f"the search leaves {leaves[0]}" if 0 in ended else "there is no periodic beat"
    then = (
        f"from other start {best} it leaves {leaves[best]}"
        if best
        else f"none of {len(ended) - 1} other starts ends closer to the record"
    )
    return f"from the network's own values {why}; {then}"


# --- a flow meter that seems late -------------------------------------------------------------------------------------
# A calibration leaves much of the pressure at the root, and far less with a delay. Pressure and flow of one place rise
# together, whatever lies behind it. A difference between their feet is therefore one of the meters, and the network is
# calibrated once more with this delay known. Without the feet a delay is no evidence: fitted to the whole beat, it also
# mends a network that is wrong.


def late_flow(problem: Problem, ended: Ended, rules: Rules) -> list[str]:
    """A sentence if inlet.Q of all recordings is late or early against the pressure at the root, and the calibration
    with that delay leaves far less of it; else none. rules : of that search."""
    networks = [simulator.network for _, simulator in problem.records]
    root = _root(networks[0])
    if any(root not in part.signals for part in problem.parts):
        return []
    delays = [late(beats, root, flowed(beats, n)) for (beats, _), n in zip(problem.records, networks, strict=True)]
    delay = float(np.median(delays))
    before, size = _left(problem, ended, root)
    if not all(each * delay > 0.0 for each in delays) or before < limits.LATE_MATTERS * size:
        return []
    known = next((c.terms.get(DELAY, 0.0) for c in networks[0].channels if c.name == INFLOW), 0.0)
    term = {f"{INFLOW}.{DELAY}": known + delay}
    records = tuple(
        (b, s.delayed(n.with_terms(term), delay)) for (b, s), n in zip(problem.records, networks, strict=True)
    )
    try:
        moved = replace(problem, records=records).weighted(ended.fit.x, [part.error for part in problem.parts])
        delayed = minimum(moved.whole, moved.at(ended.fit.x), rules, moved.runs)
    except BROKEN:  # the fitted values may have no beat under the delayed flow
        return []
    after, _ = _left(moved, delayed, root)
    if after > limits.LATE_CLOSES * before:
        return []
    side, other = ("late", "a meter with a low-pass") if delay > 0.0 else ("early", "a damped catheter")
    statement = f"leaves {number(after / MMHG)} mmHg of {root} (rms) instead of {number(before / MMHG)}"
    return [
        f"{INFLOW} seems {number(1e3 * abs(delay))} ms {side} against {root} (foot to foot): a calibration with "
        f'--filter "{INFLOW}=delay {1e3 * (known + delay):.3g} ms" {statement}; {other}, or a sensor at another place, '
        "looks alike"
    ]


def _root(network: Network) -> str:
    """The pressure where the network begins."""
    first = network.inlet.segment
    return next((f"{s.name}.P" for s in network.sites if s.segment == first and s.position == 0.0), "inlet.P")


def _left(problem: Problem, ended: Ended, root: str) -> tuple[float, float]:
    """rms residual of the pressure at the root, and the rms of its pulsation, [Pa], over all recordings."""
    misfit, size = list[float](), list[float]()
    for part, rows in zip(problem.parts, problem.whole.rows, strict=True):
        misfit.append(float(part.rms(ended.fit.z[rows])[part.signals.index(root)]))
        size.append(float(np.std(part.beats.mean(root))))
    return float(np.sqrt(np.mean(np.square(misfit)))), float(np.sqrt(np.mean(np.square(size))))
