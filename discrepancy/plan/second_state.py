"""The second recording that would separate the class: simulations of states of the subject that were not recorded.

The best member a of the class gives a noise-free record of the state, and another member b is fitted to it:

    d'² = min_δ |z + J δ|² + δᵀ C⁻¹ δ = zᵀ (1 + J C Jᵀ)⁻¹ z

with the whitened residual z and the Jacobian J of b in the state, and the covariance C of b from the first record. The
noise is that of the record. For a class of more than two members the least d' counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fitting.inference.fit import Array, Fit
from fitting.inference.forward import Forward
from fitting.inference.gauss_newton import Trial
from fitting.inference.joint.joint_record import Several
from fitting.inference.models.bench import Bench
from fitting.inference.models.network import NetworkProblem
from fitting.inference.runs import Runs
from fitting.records.channels.noise import Target
from solver.errors import InputError

from ..findings.isolability import INSEPARABLE
from ..findings.map_marks import label_text
from ..name.verdict import Naming

_MOST = 4  # members of a class that are simulated
_NEWTON, _CLOSE = 30, 1e-9  # at most, Newton steps to the radius under a pressure, and their relative tolerance


@dataclass(frozen=True)
class SecondState:
    """Another state of the subject: heart rate and inflow (on a bench the pulse of the pressure) as factors of the
    recorded ones, and the relative change of the mean pressure."""

    words: str
    rate: float = 1.0
    flow: float = 1.0
    level: float = 0.0


STATES = (
    SecondState("heart rate × 1.5", rate=1.5),
    SecondState("mean pressure + 30 %", level=0.3),
    SecondState("mean pressure − 30 %", level=-0.3),
    SecondState("inflow × 1.5", flow=1.5),
)
_OF_BENCH = {"inflow × 1.5": "pulse pressure × 1.5"}


def second_state(naming: Naming) -> str:
    """A sentence on the state that separates the class best; "" for a class of one, or if no state can be simulated."""
    found = separations(naming)
    if not found:
        return ""
    worded = {_OF_BENCH.get(words, words) if naming.problem.site else words: d for words, d in found.items()}
    best, *others = sorted(worded, key=lambda words: -worded[words])
    alternatives = ", ".join(f"{words}: {worded[words]:.2g}" for words in others)
    if worded[best] < INSEPARABLE:
        tried = f"{best}: {worded[best]:.2g}" + (f", {alternatives}" if alternatives else "")
        return f"No second state that was simulated would separate the class (d′ below {INSEPARABLE:g}: {tried})."
    members = " from ".join(label_text(n.label) for n in naming.members[:2])
    more = " and the others" if len(naming.members) > 2 else ""
    d = f"d′ {worded[best]:.2g}" + (f"; {alternatives}" if alternatives else "")
    return f"A second recording at {best} would tell {members}{more} ({d}): give it with --and."


def separations(naming: Naming) -> dict[str, float]:
    """For each state, by its words, the least d' between the best of the class and its other members."""
    if len(naming.members) < 2:
        return {}
    problem, (best, *others) = naming.problem, [n.fit for n in naming.members[:_MOST]]
    rivals = [(fit, fit.covariance) for fit in others]
    if isinstance(problem, Several):
        whole, problem = problem, problem.first
        best, rivals = whole.of(best, 0), [(whole.of(fit, 0), _anew(whole, fit)) for fit in others]
    found = {}
    for state in STATES:
        there = _of_bench(problem, state, best) if isinstance(problem, Bench) else _of_network(problem, state, best)
        each = [] if there is None else [_apart(there, fit, C) for fit, C in rivals]
        if known := [d for d in each if d is not None]:
            found[state.words] = min(known)
    return found


def _anew(whole: Several, fit: Fit) -> Array:
    """The covariance of the unknowns for a new recording: those that vary between recordings have their prior."""
    own, which = whole.own(fit.unknowns, 0)
    C = fit.covariance[np.ix_(which, which)]
    for i, (j, u) in enumerate(zip(which, own, strict=True)):
        if fit.unknowns[j] is not u and fit.unknowns[j] != u:
            C[i], C[:, i] = 0.0, 0.0
            C[i, i] = (u.prior_sd or u.typical_sd) ** 2
    return C


def _apart(there: Forward, fit: Fit, C: Array) -> float | None:
    """d' of a member fitted to the state; None if it cannot be simulated there."""
    (point,) = there.points([Trial(fit.member, np.arange(len(fit.x)), None, 0.0 * fit.x)], Runs())
    if point is None:
        return None
    V = np.eye(len(point.z)) + point.J @ C @ point.J.T
    return float(np.sqrt(point.z @ np.linalg.solve(V, point.z)))


def _of_network(problem: Forward, state: SecondState, fit: Fit) -> NetworkProblem | None:
    """The problem with the simulation of a hypothesis in a state as its record; None if that fails. The mean pressure
    is changed through the venous pressures of all outlets."""
    assert isinstance(problem, NetworkProblem)
    simulator, pressures = problem.simulator, [i for i, name in enumerate(problem.signals) if name.endswith(".P")]
    network, T = simulator.network, simulator.T / state.rate
    if state.level:
        if not pressures:
            return None
        more = state.level * float(problem.target.X[0, pressures].real.mean())
        raised = {n: x + more for n, x in network.parameters().items() if n.endswith(".outlet.P_venous")}
        try:
            network = network.with_parameters(raised)
        except InputError:
            return None
    drive = replace(simulator.drive, T=T, X=state.flow * simulator.drive.X)
    there = replace(problem, simulator=replace(simulator, network=network, drive=drive, T=T))
    (X,) = there.observe([fit.member])
    return None if X is None else replace(there, target=Target.of(problem.signals, X, problem.target.covariance))


def _of_bench(problem: Bench, state: SecondState, fit: Fit) -> Bench | None:
    """The same for one wall."""
    loop, mean = problem.loop, float(problem.loop.P.mean())
    P = mean * (1.0 + state.level) + state.flow * (loop.P - mean)
    there = replace(problem, loop=replace(loop, P=P, T=loop.T / state.rate))
    observed, r = there.seen(fit.member, fit.x[None]), problem.start
    for _ in range(_NEWTON):
        with np.errstate(all="ignore"):
            step = P - observed.pressure(r)[0]
            if not np.isfinite(step).all():
                return None
            step = np.linalg.solve(observed.slope(r), step)
        r = r + step * min(1.0, 0.02 * r.mean() / max(float(np.abs(step).max()), 1e-300))
        if float(np.abs(step).max()) < _CLOSE * r.mean():
            return replace(there, loop=replace(there.loop, R=r))
    return None
