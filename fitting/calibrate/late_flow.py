"""A flow meter that seems late: a calibration leaves much of the pressure at the root, and far less with a delay.

Pressure and flow of one place rise together, whatever lies behind it. A difference between their feet is therefore one
of the meters, and the network is calibrated once more with this delay known. Without the feet a delay is no evidence:
fitted to the whole beat, it also mends a network that is wrong.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver.laws.catalogue import DELAY
from solver.network.description import Network
from solver.quantities.legible import number
from solver.quantities.units import INFLOW, MMHG
from solver.simulate import BROKEN

from ..first.estimates import late
from ..inference.gauss_newton import Rules
from ..inference.joint.calibration import Problem
from ..inference.joint.model_error import Ended, minimum
from ..records import limits
from ..records.channels.inflow import flowed


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
